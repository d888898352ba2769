"""What the arena says is what its figures show."""

import numpy as np
import pandas as pd
import pytest

from surefoot.experiments.walks.findings import claims_of, scenario_findings, summary_findings
from surefoot.experiments.walks.scenarios import SCENARIOS
from surefoot.experiments.walks.tables import alarm_table, scenario_table

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
        "bound_cop": np.nan, "bound_vgrf": np.nan, "bound_cell": np.nan,
    }  # fmt: skip
    return pd.DataFrame(rows).assign(**(common | changes))


def test_the_best_is_named_and_the_lead_measured() -> None:
    scores = scores_of(PLAIN.name, {"none": [10, 11, 12], "window": [4, 5, 6], "tare": [7, 8, 9.3]})
    said = scenario_findings(scores, PLAIN)
    assert said[0].startswith("Nearest to the truth is window with 5.00 ± 2.48 mm of CoP error; tare is 3.10")
    assert "no clear difference" not in said[0]
    assert any("window: CoP 5.00 ± 2.48 mm, 2.20 times smaller than by the starting map" in s for s in said)
    assert "none of 3 runs ends with a worse CoP" in said[1]


def test_a_lead_within_its_interval_is_not_called_one() -> None:
    scores = scores_of(PLAIN.name, {"none": [5, 9, 7], "window": [4, 9, 7.5]})
    said = scenario_findings(scores, PLAIN)
    assert "which is no clear difference" in said[0]
    assert "no clear difference to the readings as they are" in said[1]


def test_harm_is_said() -> None:
    scores = scores_of(PLAIN.name, {"none": [5, 5.1, 5.2], "window": [20, 21, 22]})
    scores.loc[scores["method"] == "window", "worse"] = [True, True, False]
    said = scenario_findings(scores, PLAIN)
    assert "LARGER than by the starting map" in said[1]
    assert "2 of 3 runs end with a worse CoP" in said[1]
    scores.loc[2, "worse_foot"] = scores.loc[3, "worse_foot"] = True
    assert "(1 with worse feet, 0 with worse cells)" in scenario_findings(scores, PLAIN)[1]
    assert "2 of 3 runs end with a worse CoP" in summary_findings(scores)[1]


def test_a_scenario_is_held_against_plain_walking_and_falls_are_counted() -> None:
    plain = scores_of(PLAIN.name, {"none": [10, 10], "window": [4, 4]})
    soft = scores_of(SOFT.name, {"none": [10, 10], "window": [6, 6]}, fell=[True, False] * 2)
    said = scenario_findings(pd.concat([plain, soft]), SOFT, left_out=3)
    assert "CoP error over that of plain walking at 0.04 m/s: window 1.50." in said
    assert said[-1] == "4 of 5 walks ended in a fall (scored up to 1 s before it: 1; left out: 3)."
    assert "3 of 3 ended in a fall" in scenario_findings(plain, SOFT, left_out=3)[0]


@pytest.mark.parametrize(("nees", "inside"), [(1.0, True), (1.8, False), (0.4, False)])
def test_targets_are_judged(nees: float, inside: bool) -> None:
    scores = scores_of(PLAIN.name, {"moment": [1.9, 1.8], "window": [9, 8]}, nees_end=nees)
    timing = pd.DataFrame(
        {"method": ["moment", "window"], "median_us": [90.0, 70.0], "mean_us": [95.0, 200.0]}
    )
    met = {claim.what: claim.met for claim in claims_of(scores, timing)}
    assert met["speed 0.04 m/s, CoP rmse (mm)"]
    assert met["speed 0.04 m/s, window's CoP error over its"]
    assert met["one update of one robot, median (µs)"]
    assert not met["window's time per sample over its"]
    assert met["NEES"] == inside
    assert claims_of(scores[scores["method"] == "window"], timing) == []


def test_alarm_rates_have_an_exact_interval() -> None:
    scores = scores_of(PLAIN.name, {"tare": [1, 1], "floor": [1, 1]}, alarms=1.0)
    ((name, hours, alarms, rate, interval),) = alarm_table(scores).rows
    # Two events: Garwood's interval of a Poisson mean is 0.242 to 7.22.
    assert (name, hours, alarms, rate, interval) == ("swing tare", "1.00", "2", "2.00", "0.242 to 7.22")


def test_tables_say_what_is_missing_with_a_dash() -> None:
    scores = scores_of(PLAIN.name, {"floor": [0.01, 0.01], "none": [9, 8]}, converged=[0, 0, np.inf, np.inf])
    table = scenario_table(scores, PLAIN)
    floor, none = (dict(zip(table.columns, row, strict=True)) for row in table.rows)
    assert floor["ends worse"] == floor["converged (s)"] == "–"
    assert none["converged (s)"] == "never"
    assert none["NEES"] == none["NIS"] == none["bound on CoP (mm)"] == "–"
