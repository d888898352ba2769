"""Sentences and tables say what the numbers say."""

import pandas as pd
import pytest

from surefoot.experiments.study.tables import Verdict, number, with_interval
from surefoot.experiments.walks import findings, tables
from surefoot.experiments.walks.findings import loop_claims, walking_claims, weight_claims
from surefoot.experiments.weights.paper import paper_table_2

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
            "cell": 0.5,
        }
        for method, value in level.items()
        for seed in SEEDS
    )


@pytest.mark.parametrize(("off", "said"), [(0.02, 1), (0.004, 0)])
def test_a_reference_worse_than_the_readings_is_named_as_the_reason(off: float, said: int) -> None:
    table = scores(15.0)
    reference = table[table["method"] == "none"].assign(method="reference", cop=off)
    found = tuple(findings.reference_findings(pd.concat([table, reference])))
    assert len(found) == said
    assert all("itself 20.0 ± 0.0 mm off, further than the readings" in text for text in found)


def test_the_papers_figures_are_compared_with() -> None:
    (said,) = findings.baseline_findings(scores(5.0, "baseline"), "paper")
    assert "the window is 5.20 ± 0.20 mm from the baseline from weights" in said
    assert "(under the paper's 10.8 mm)" in said
    assert "the quasi-static method lies 7.00 ± 0.00 mm further off in CoP" in said


def test_targets_are_reached_or_not() -> None:
    loop = pd.DataFrame(
        {"severity": 2.0, "speed": 0.04, "seed": seed, "feed": feed, "fell": feed == "none", "time": 9.0}
        for feed in ("true", "none", "window")
        for seed in SEEDS
    )
    claims = weight_claims(4e-9, 6e-4, 0.01)
    claims += [*walking_claims(scores(5.0, "baseline"), "paper", 0.5), *loop_claims(loop)]
    met = {claim.what: claim.met for claim in claims}
    assert met["Table 2 coefficients, relative"]
    assert not met["known weights, held-out CoP (mm)"]
    assert met["window at 0.04 m/s, CoP against baseline (mm)"]
    assert met["severity 2, drifting raw CoP fed back: share that falls"]
    assert met["severity 2, window-calibrated CoP fed back: share that falls"]


def test_a_lead_that_the_interval_does_not_tell_from_nothing_is_not_reached() -> None:
    for lead, expected in (([4.0, 4.1, 4.2], True), ([-3.0, 1.0, 5.0], False)):
        methods = {"window": [2.0] * 3, "quasi-static": [2.0 + gap for gap in lead]}
        table = pd.DataFrame(
            {
                "condition": "paper",
                "against": "baseline",
                "speed": 0.04,
                "seed": seed,
                "method": method,
                "cop": 1e-3 * values[seed],
                "vgrf": values[seed],
            }
            for method, values in methods.items()
            for seed in range(3)
        )
        met = {claim.what: claim.met for claim in walking_claims(table, "paper", 0.5)}
        assert met["window at 0.04 m/s, CoP less than quasi-static by (mm)"] == expected


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
    said = tuple(findings.loop_findings(runs, 20.0))
    assert said[0] == "Severity 2, drifting raw CoP: 3 of 4 walks end in a fall within 20 s."
    assert "of those that fall on drifting raw CoP it saves 3, of those that do not it loses 1" in said[1]
    assert "sign test p = 0.62" in said[1]
    assert "fell was 30.0 ± 0.0 mm off up to the fall, that of walkers that did not 10.0 mm" in said[2]


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
    rows = {row[0]: row for row in tables.lead_table(yardsticks, runs, "bad-start", "In short").rows}
    assert rows["window (CoP paper)"][1:] == ("5.20 ± 0.20", "0.500 ± 0.000", "0 of 3")
    assert rows["window (CoP paper)"][3].good
    assert not isinstance(rows["raw (none)"][3], Verdict)


def test_the_papers_table_2_comes_out() -> None:
    _, difference = paper_table_2()
    assert difference < 1e-8


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1e-12, "0"),
        (0.000123, "0.000123"),
        (1234.5, "1234"),
        (9.999, "10.00"),
        (float("nan"), "–"),
    ],
)
def test_numbers_have_three_digits(value: float, text: str) -> None:
    assert number(value) == text


def test_one_seed_has_no_interval() -> None:
    assert with_interval([2.0]) == "2.00"
    assert with_interval([float("nan")]) == "–"
