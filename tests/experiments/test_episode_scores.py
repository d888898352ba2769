"""Numbers of a study's rows: losses won back, the severity at which half fall, shares and bands."""

import re
from math import inf
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _made_episodes import MEANS, episodes, frame_of, row

from surefoot.experiments.episodes.scores import (
    COMPARISONS,
    HalfFall,
    Run,
    difference,
    half_fall,
    recovery_share,
)
from surefoot.experiments.episodes.tables import difference_table, score_table
from surefoot.experiments.study.statistics import fall_share, survival
from surefoot.experiments.study.tables import Verdict


def test_a_loss_that_is_none_is_not_won_back():
    flat = dict.fromkeys(MEANS, 100.0)
    frame = frame_of(episodes("zero", flat))
    assert not recovery_share(frame, "moment", 1.0).narrow
    cells = [row[3] for row in score_table(frame).rows]
    assert {cell for cell in cells if not cell.startswith("cannot be told (cost ")} == {""}
    # Exactly the same returns on all feet: no division by nothing.
    same = frame.assign(**{"return": 100.0})
    assert not recovery_share(same, "window", 2.0).narrow
    won = {row[:2]: row[3] for row in score_table(frame_of(episodes())).rows}
    assert won["moment", "1"].startswith("94.")


def test_the_loss_and_what_is_won_of_it_are_over_the_same_seeds():
    # Where all three feeds were run, drifting feet cost nothing; they do only where moment was not run.
    rng = np.random.default_rng(3)
    noise = rng.normal(0.0, 1.0, (3, 30))
    cost = np.where(np.arange(30) < 15, 0.0, 100.0)
    totals = {"true": noise[0], "none": noise[1] - cost, "moment": noise[2][:15]}
    frame = frame_of([row(feed, seed, total) for feed, of in totals.items() for seed, total in enumerate(of)])
    assert not recovery_share(frame, "moment", 1.0).narrow


def test_of_a_small_loss_in_large_noise_no_share_is_told() -> None:
    # True feet are ahead by a clear 1, and a calibration scatters by 100 around drifting feet.
    rng = np.random.default_rng(1)
    totals = {"true": np.full(6, 101.0), "none": np.full(6, 100.0), "moment": rng.normal(100.0, 100.0, 6)}
    frame = frame_of([row(feed, seed, total) for feed, of in totals.items() for seed, total in enumerate(of)])
    share = recovery_share(frame, "moment", 1.0)
    assert share.loss.apart
    assert share.high - share.low > 10.0
    table = score_table(frame)
    cell = next(cells[3] for cells in table.rows if cells[0] == "moment")
    assert re.fullmatch(r"cannot be told \(-?\d+ to -?\d+ %\)", cell)
    assert table.to_plain()["rows"][-1]["loss won back"] is None
    assert score_table(frame[frame["seed"] == 0]).note.startswith("Means of 1 paired episode with")


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


def test_a_clear_loss_is_not_good_and_a_cost_is_no_merit() -> None:
    rows = frame_of(episodes(means=MEANS | {"moment": 40.0}, severities=(1.0,)))
    compared = COMPARISONS[0].find(rows)
    cells = {row[1]: row[-1] for row in difference_table(compared, "differences", "Differences").rows}
    assert isinstance(cells["moment less drifting"], Verdict)
    assert (cells["moment less drifting"], cells["moment less drifting"].good) == ("yes", False)
    assert cells["true less moment"] == "yes"
    assert not isinstance(cells["true less moment"], Verdict)


def test_the_loss_won_back_is_the_share_of_the_means_and_its_interval_holds_it() -> None:
    rng = np.random.default_rng(0)
    base, gap = rng.normal(100.0, 30.0, 60), rng.uniform(5.0, 15.0, 60)
    noisy = base + 0.5 * gap + rng.normal(0.0, 3.0, 60)
    totals = {"true": base + gap, "none": base, "moment": base + 0.8 * gap, "window": noisy}
    frame = frame_of([row(feed, seed, total) for feed, of in totals.items() for seed, total in enumerate(of)])
    assert recovery_share(frame, "moment", 1.0)[:3] == pytest.approx((0.8, 0.8, 0.8))
    won, low, high, _ = recovery_share(frame, "window", 1.0)
    assert low < won < high
    assert low < 0.5 < high
    interval = difference(frame, Run("true"), Run("none"), 1.0)
    assert interval.mean == pytest.approx(gap.mean())
    assert interval.half < 1.0
    assert recovery_share(frame, "tare", 1.0) is None
    assert difference(frame, Run("true"), Run("tare")) is None
    with pytest.raises(ValueError, match="was run more than once with the same seed"):
        difference(pd.concat([frame, frame]), Run("true"), Run("none"))
