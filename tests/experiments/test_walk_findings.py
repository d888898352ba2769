"""Sentences and tables say what the numbers say."""

import numpy as np
import pandas as pd
import pytest

from surefoot.experiments.study.tables import Verdict
from surefoot.experiments.walks import findings, tables
from surefoot.experiments.walks.findings import claims_of, scenario_findings
from surefoot.experiments.walks.scenarios import SCENARIOS
from surefoot.experiments.walks.tables import alarm_table, scenario_table

SEEDS = range(5)


def scores(window: float, against: str = "truth", spread: float = 0.1) -> pd.DataFrame:
    """Raw feet 10 mm off, the window as told, and quasi-static 12 mm; all with a little spread over seeds."""
    level = {"none": 10.0, "window": window, "quasi-static": 12.0}
    return pd.DataFrame(
        {
            "condition": "paper",
            "speed": 0.04,
            "seed": seed,
            "method": method,
            "against": against,
            "cop": 1e-3 * (value + spread * seed),
            "vgrf": value / 10,
            "cop_foot": 1e-3,
            "cell": 0.5,
        }
        for method, value in level.items()
        for seed in SEEDS
    )


def test_falls_are_paired_by_seed() -> None:
    fell = {"none": [1, 1, 1, 0], "window": [0, 0, 0, 1]}
    runs = pd.DataFrame(
        {
            "severity": 2.0,
            "speed": 0.1,
            "seed": seed,
            "feed": feed,
            "fell": bool(values[seed]),
            "cop_error": 0.03 if values[seed] else 0.01,
        }
        for feed, values in fell.items()
        for seed in range(4)
    )
    (said,) = findings.loop_findings(runs)
    assert "of those that fall on drifting raw CoP it saves 3, of those that do not it loses 1" in said
    assert "sign test p = 0.62" in said


def test_the_baseline_scores_nothing_by_construction() -> None:
    table = scores(5.0, "baseline")
    table.loc[table["method"] == "none", ["cop", "vgrf"]] = 0.0
    laid_out = tables.walking_table(table, 0.04, [("paper", "the paper's conditions")])
    row = next(row for row in laid_out.rows if row[1] == "raw (none)")
    assert row[2] == "0 *"
    window = next(row for row in laid_out.rows if row[1].startswith("window"))
    assert window[2:4] == ("5.20 ± 0.20", "10.8")


def test_what_comes_first_is_counted() -> None:
    runs = pd.DataFrame(
        {"severity": 3.0, "speed": 0.04, "seed": seed, "feed": feed, "fell": feed == "none" and seed > 0}
        for feed in ("true", "none", "window", "moment")
        for seed in range(3)
    )
    said = findings.lead_finding(runs)
    assert "fed the raw CoP the robot falls in 2 of 3 walks, fed the true CoP in 0 and" in said
    yardsticks = scores(5.0).assign(condition="bad-start")
    raw = yardsticks[yardsticks["method"] == "none"]
    yardsticks = pd.concat([yardsticks, raw.assign(method="moment", cop=0.2 * raw["cop"])])
    rows = {row[0]: row for row in tables.lead_table(yardsticks, runs, "bad-start", "In short").rows}
    window = rows["window (CoP paper)"]
    assert window[1:] == ("0 of 3", "5.20 ± 0.20", "3.16 ± 0.16", "0.500 ± 0.000")
    assert window[1].good
    assert window[3].good
    assert rows["moment"][3] == rows["true CoP"][3] == ""
    assert not isinstance(rows["raw (none)"][1], Verdict)


PLAIN, SOFT = SCENARIOS["speed-0.04"], SCENARIOS["soft-ground"]


def scores_of(scenario: str, cop: dict[str, list[float]], **changes: object) -> pd.DataFrame:
    """One row a run, in which only the CoP errors (mm) tell methods apart."""
    rows = [
        {"scenario": scenario, "method": method, "seed": seed, "cop": 1e-3 * value, "end": 1e-3 * value}
        for method, values in cop.items()
        for seed, value in enumerate(values)
    ]
    common = {
        "fell": False, "cop_foot": 2e-3,
        "vgrf": 0.3, "cell": 0.35, "finite": True, "scale": 0.01, "offset": 0.1,
        "worse": False, "worse_foot": False,
        "worse_vgrf": False, "worse_cell": False, "converged": 4.0, "spread": 1e-4,
        "nees_end": np.nan, "nees_cop": np.nan, "nis": np.nan, "nis_rows": 0.0, "parameters": 16.0,
        "alarms": 0.0, "hours": 0.5, "found": np.nan, "isolated": np.nan, "named": np.nan, "after": np.nan,
        "after_foot": np.nan,
    }  # fmt: skip
    return pd.DataFrame(rows).assign(**(common | changes))


def test_differences_are_paired() -> None:
    scores = scores_of(PLAIN.name, {"moment": [4, 5, 6], "tare": [7, 8, 9.3], "none": [4, 9, 7.5]})
    table = scenario_table(scores, PLAIN)
    rows = {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
    behind = {name: row[tables.BEHIND] for name, row in rows.items()}
    assert behind["swing tare"] == "3.10 ± 0.43"
    assert behind["swing tare"].good
    assert behind["moment"] == ""
    assert not isinstance(behind["raw (none)"], Verdict)


def test_falls_and_forces_that_are_not_finite_are_counted() -> None:
    soft = scores_of(SOFT.name, {"none": [10, 10], "window": [6, 6]}, fell=[True, False] * 2)
    soft.loc[2, "finite"] = False
    said = scenario_findings(soft, SOFT, left_out=3)
    assert said[0] == "Runs in which a force was not finite: {'window': 1}."
    assert said[-1] == "4 of 5 walks ended in a fall (scored up to 1 s before it: 1; left out: 3)."
    assert "3 of 3 ended in a fall" in scenario_findings(soft, PLAIN, left_out=3)[0]


@pytest.mark.parametrize(("nees", "inside"), [(1.0, True), (1.8, False), (0.4, False)])
def test_targets_are_judged(nees: float, inside: bool) -> None:
    scores = scores_of(PLAIN.name, {"moment": [1.9, 1.8], "window": [9, 8]}, nees_end=nees)
    met = {claim.what: claim.met for claim in claims_of(scores)}
    assert met["speed 0.04 m/s, CoP rmse (mm)"]
    assert met["speed 0.04 m/s, window's CoP error over its"]
    assert met["NEES"] == inside
    assert claims_of(scores[scores["method"] == "window"]) == []


def test_alarm_rates_have_an_exact_interval() -> None:
    scores = scores_of(PLAIN.name, {"tare": [1, 1], "true-map": [1, 1]}, alarms=1.0)
    ((name, hours, alarms, rate, interval),) = alarm_table(scores).rows
    # Two events: Garwood's interval of a Poisson mean is 0.242 to 7.22.
    assert (name, hours, alarms, rate, interval) == ("swing tare", "1.00", "2", "2.00", "0.242 to 7.22")


def test_tables_say_what_is_missing_with_a_dash() -> None:
    scores = scores_of(
        PLAIN.name, {"true-map": [0.01, 0.01], "none": [9, 8]}, converged=[0, 0, np.inf, np.inf]
    )
    table = scenario_table(scores, PLAIN)
    floor, none = (dict(zip(table.columns, row, strict=True)) for row in table.rows)
    assert floor["ends worse"] == floor["converged (s)"] == "–"
    assert none["converged (s)"] == "never"
    assert none["NEES"] == none["NIS"] == "–"
