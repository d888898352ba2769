"""Statistics of paired episodes: what is claimed follows from the rows, and intervals hold what they say."""

from math import inf, isnan
from typing import Any

import numpy as np
import pandas as pd
import pytest

from surefoot.experiments.evaluate.page import answer
from surefoot.experiments.evaluate.statistics import (
    HalfFall,
    Run,
    bootstrap,
    difference,
    fieller,
    half_fall,
    improvement,
    interquartile_mean,
    mean_over,
    pair,
    returns_of,
    share_won_back,
    worst_decile,
)
from surefoot.experiments.evaluate.tables import (
    between_feeds,
    between_policies,
    difference_table,
    score_table,
)
from surefoot.experiments.study.statistics import fall_share, survival
from surefoot.experiments.study.tables import Verdict

MEANS = {"true": 100.0, "raw": 50.0, "window": 80.0, "moment": 97.0}
STUDIES = 600  # simulated studies whose intervals are checked: enough to tell 95 % from 93 and 97 %


def made(
    means: dict[str, float] = MEANS,
    policy: str = "ppo",
    *,
    trainings: int = 1,
    seeds: int = 20,
    noise: float = 0.5,
    rng: Any = 7,
    severities: tuple[float, ...] = (1.0, 2.0),
    apart: float = 0.0,
) -> pd.DataFrame:
    """Rows whose returns differ by seed, the same on all feeds, by training, and by some noise."""
    rng = np.random.default_rng(rng)
    base, rows = rng.normal(0.0, 5.0, seeds), []
    for training in range(trainings):
        shift = {feed: apart * rng.normal() for feed in means}
        for feed, mean in means.items():
            for severity in (0.0,) if feed == "true" else severities:
                total = mean + shift[feed] + base + rng.normal(0.0, noise, seeds)
                rows += [
                    {"policy": policy, "training": training, "feed": feed, "severity": severity, "seed": seed,
                     "return": value, "fell": False, "time": 18.0, "cop_error": 0.01}
                    for seed, value in enumerate(total)
                ]  # fmt: skip
    return pd.DataFrame(rows)


def test_a_loss_that_is_none_is_not_won_back() -> None:
    flat = made(dict.fromkeys(MEANS, 100.0))
    assert isnan(share_won_back(flat, Run("ppo", "moment", 1.0)).value)
    cells = [row[3] for row in score_table(flat).rows]
    assert set(cells) == {"", "loss not clear"}
    same = flat.assign(**{"return": 100.0})
    assert isnan(share_won_back(same, Run("ppo", "window", 2.0)).value)
    assert "does not use its feet" in answer(same)
    won = {row[:2]: row[3] for row in score_table(made()).rows}
    assert won["moment", "1"].startswith("94 % (9")
    assert answer(made()).startswith(
        "At severity 1 drift costs ppo 49.7 of 98.23 in return (95 % interval 49"
    )
    assert "'moment' wins back 94 % (9" in answer(made())


def test_the_loss_and_what_is_won_of_it_are_over_the_same_seeds() -> None:
    rows = made()
    part = rows[(rows["feed"] != "moment") | (rows["seed"] < 12)]
    share = share_won_back(part, Run("ppo", "moment", 1.0))
    both = rows[rows["seed"] < 12]
    assert share == share_won_back(both, Run("ppo", "moment", 1.0))
    assert [len(one) for one in pair(part, Run("ppo", "moment", 1.0), Run("ppo", "raw", 1.0))] == [12, 12]
    assert difference(rows, Run("ppo", "tare", 1.0), Run("ppo", "raw", 1.0)) is None
    assert share_won_back(rows, Run("ppo", "raw", 1.0)) is None


def test_pairs_leave_out_what_all_feeds_share() -> None:
    interval = difference(made(), Run("ppo", "true", 0.0), Run("ppo", "raw", 1.0))
    assert interval.mean == pytest.approx(50.0, abs=1.0)
    assert interval.half < 0.6 < mean_over(returns_of(made(), Run("ppo", "raw", 1.0))).half


def test_of_several_trainings_the_interval_is_over_trainings() -> None:
    few = made(trainings=5, apart=3.0)
    interval = difference(few, Run("ppo", "true", 0.0), Run("ppo", "raw", 1.0))
    assert interval.n == 5
    one = difference(few[few["training"] == 0], Run("ppo", "true", 0.0), Run("ppo", "raw", 1.0))
    assert one.n == 20
    assert interval.half > 3.0 * one.half


def test_policies_are_compared_on_the_same_seeds_and_nobody_stands_for_all_feeds() -> None:
    nobody = made({"true": 60.0}, "zero", rng=8)
    rows = pd.concat([made(), nobody], ignore_index=True)
    found = {(one.first.feed, one.first.severity): one for one in between_policies(rows)}
    assert len(found) == 1 + 3 * 2
    assert {one.second for one in found.values()} == {Run("zero", "true", 0.0)}
    assert found["moment", 2.0].better.value == 1.0
    worse = found["raw", 1.0]
    table = difference_table([worse], "policies", "Policies")
    assert table.rows[0][1] == "ppo (raw) less zero (true)"
    assert isinstance(table.rows[0][-1], Verdict)
    assert not table.rows[0][-1].good


def test_a_cost_is_no_merit() -> None:
    cells = {(one.first.feed, one.second.feed): one for one in between_feeds(made(severities=(1.0,)))}
    table = difference_table([*cells.values()], "differences", "Differences")
    verdicts = {row[1]: row[-1] for row in table.rows}
    assert isinstance(verdicts["moment less raw"], Verdict)
    assert verdicts["moment less true"] == "yes"
    assert not isinstance(verdicts["moment less true"], Verdict)


def test_robust_means_have_intervals() -> None:
    values = np.arange(20.0)
    assert interquartile_mean(values) == 9.5
    assert worst_decile(values) == 0.5
    assert improvement(np.array([1.0, 0.0, -1.0, 2.0])) == 0.625
    column = returns_of(made(), Run("ppo", "raw", 1.0))
    found = bootstrap(column, interquartile_mean)
    assert found.low < found.value < found.high
    many = bootstrap(returns_of(made(trainings=5, apart=5.0), Run("ppo", "raw", 1.0)), interquartile_mean)
    assert many.high - many.low > found.high - found.low


@pytest.mark.slow
@pytest.mark.parametrize(("trainings", "seeds"), [(1, 50), (1, 12), (5, 20)])
def test_intervals_hold_the_truth_as_often_as_they_say(trainings: int, seeds: int) -> None:
    """Of simulated studies with a known effect: the cost of drift, and the share that is won back."""
    cost = share = 0
    for study in range(STUDIES):
        given: Any = {"trainings": trainings, "seeds": seeds, "severities": (1.0,), "noise": 8.0}
        rows = made(MEANS, rng=[11, study], apart=4.0 if trainings > 1 else 0.0, **given)
        interval = difference(rows, Run("ppo", "true", 0.0), Run("ppo", "raw", 1.0))
        cost += abs(interval.mean - 50.0) <= interval.half
        won = share_won_back(rows, Run("ppo", "window", 1.0))
        share += won.low <= 0.6 <= won.high
    assert 0.93 <= cost / STUDIES <= 0.97
    assert 0.93 <= share / STUDIES <= 0.97


def test_a_ratio_of_what_is_not_clear_has_no_interval() -> None:
    rng = np.random.default_rng(3)
    assert isnan(fieller(rng.normal(1.0, 1.0, 10), rng.normal(0.0, 1.0, 10)).value)
    assert isnan(fieller([1.0], [1.0]).value)
    exact = fieller([8.0, 8.8, 9.6], [10.0, 11.0, 12.0])
    assert exact == pytest.approx((0.8, 0.8, 0.8))


SEVERITIES = np.array([0.0, 1.0, 2.0, 4.0])


def fallen(threshold: Any, severities: Any = SEVERITIES) -> pd.DataFrame:
    """Every seed falls from a severity of its own on."""
    return pd.DataFrame(
        [
            {"seed": seed, "severity": severity, "fell": bool(severity >= limit)}
            for seed, limit in enumerate(threshold)
            for severity in severities
        ]
    )


def test_the_band_holds_what_it_says() -> None:
    rng, median = np.random.default_rng(5), 8.0
    held = 0
    for _ in range(400):
        time = rng.exponential(median / np.log(2.0), 40)
        curve = survival(np.minimum(time, 20.0), time < 20.0)
        k = int(np.searchsorted(curve.time, median, side="right")) - 1
        held += curve.low[k] <= 0.5 <= curve.high[k]
    assert 0.92 <= held / 400 <= 0.98


def test_half_fall_is_found_and_its_interval_too() -> None:
    threshold = np.random.default_rng(1).normal(1.5, 0.5, 40)
    found = half_fall(fallen(threshold, np.linspace(0.0, 3.0, 13)))
    assert found is not None
    assert found.severity == pytest.approx(np.median(threshold), abs=0.25)
    assert found.low < found.severity < found.high < found.low + 1.0


def test_half_fall_where_it_is_not_reached() -> None:
    beyond = half_fall(fallen([9.0] * 10))
    assert beyond is not None
    assert (beyond.severity, beyond.words()) == (inf, "not reached up to 4")
    below = half_fall(fallen([0.0] * 10))
    assert below is not None
    assert (below.severity, below.words()) == (-inf, "more than half at 0")
    near = half_fall(fallen([1.5] * 6 + [9.0] * 5))
    assert near is not None
    assert near.high == inf
    assert near.words().endswith("to above 4)")
    assert half_fall(fallen([1.0] * 5, [2.0])) is None


def test_more_errors_may_fell_fewer() -> None:
    rows = fallen([1.0] * 6 + [9.0] * 4)
    rows.loc[(rows["severity"] == 2.0) & (rows["seed"] < 3), "fell"] = False
    found = half_fall(rows)
    assert found is not None
    # 60 % at severity 1 and 30 % at 2 are pooled to 45 %; at 4 it is 60 %.
    assert found.severity == pytest.approx(2.0 + 2.0 * 0.05 / 0.15)


def test_shares_have_intervals() -> None:
    assert fall_share([True] * 5).low > 0.5
    assert fall_share([True] * 5).high == pytest.approx(1.0)
    assert np.isnan(fall_share([]).share)
    assert HalfFall(1.0, 1.0, 1.0, 0.0, 2.0).words() == "1"
