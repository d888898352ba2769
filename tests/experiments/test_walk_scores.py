"""Scores of walks: each against an independent formula, on made logs."""

import dataclasses

import numpy as np
import pytest

from surefoot.calibration import Flag
from surefoot.calibration.layout import FeetLayout, FootLayout
from surefoot.experiments.logs.format import Log
from surefoot.experiments.study.statistics import mean_interval
from surefoot.experiments.walks.score import cop_world, hold_last, running_rmse, score_forces
from surefoot.sensors import Fault

RNG = np.random.default_rng(11)


@pytest.fixture(scope="module")
def streams(benchmark_script):
    return benchmark_script("streams")


def stream_of(streams, log: Log, **changes: object):
    return dataclasses.replace(streams.Stream(log=log, seed=5, judged=log.time >= 0.25, began=0.0), **changes)


def played_as(streams, log: Log, force: np.ndarray, flags: np.ndarray | None = None):
    shape = log.raw.shape
    silent = np.zeros(shape, dtype=np.int64) if flags is None else flags
    return streams.Played(force, np.ones(shape), np.zeros(shape), silent)


def longer(log: Log, times: int) -> Log:
    def again(part: np.ndarray) -> np.ndarray:
        return np.concatenate([part] * times)

    truth = log.truth
    assert truth is not None
    fields = {name: again(getattr(truth, name)) for name in truth.__dataclass_fields__}
    return dataclasses.replace(
        log,
        time=np.arange(times * len(log)) * log.dt,
        raw=again(log.raw),
        reference=type(log.reference)(*(again(part) for part in log.reference)),
        truth=dataclasses.replace(truth, **fields),
    )


def test_truth_itself_has_no_error_and_is_not_worse(streams, log: Log) -> None:
    assert log.truth is not None
    off = dataclasses.replace(log, raw=log.raw + RNG.normal(size=log.raw.shape) / log.nominal.scale)
    row = streams.score_run(stream_of(streams, off), played_as(streams, off, log.truth.force))
    assert row["cop"] == row["vgrf"] == row["cell"] == 0.0
    assert not row["worse_cop"]
    worse = streams.score_run(
        stream_of(streams, off), played_as(streams, off, 3.0 * off.nominal.force(off.raw) - 20.0)
    )
    assert worse["worse_cop"]
    assert worse["worse_vgrf"]


def test_true_map_undoes_gains_and_offsets(streams, log: Log) -> None:
    assert log.truth is not None
    gain, zero = RNG.uniform(0.8, 1.2, 8), RNG.normal(size=8)
    scale, offset = log.nominal.scale / gain, log.nominal.offset / gain - zero / gain
    raw = (gain * log.truth.force + zero - log.nominal.offset) / log.nominal.scale
    truth = dataclasses.replace(
        log.truth, scale=np.tile(scale, (len(log), 1)), offset=np.tile(offset, (len(log), 1))
    )
    stream = stream_of(streams, dataclasses.replace(log, raw=raw, truth=truth))
    floor, start = streams.play(stream, "true-map"), streams.play(stream, "none")
    np.testing.assert_allclose(floor.force, truth.force, atol=1e-9)
    row, raw_row = streams.score_run(stream, floor), streams.score_run(stream, start)
    assert row["scale"] < 1e-12
    assert row["offset"] < 1e-9
    # By the starting map a channel without load shows its zero, and one newton shows as its gain.
    assert raw_row["offset"] == pytest.approx(np.sqrt(np.mean(zero**2)), rel=1e-9)
    assert raw_row["scale"] == pytest.approx(np.sqrt(np.mean((gain - 1.0) ** 2)), rel=1e-9)


def test_running_rmse_against_a_loop() -> None:
    time, error = np.arange(400) / 80.0, RNG.normal(size=400)
    error[RNG.random(400) < 0.1] = np.nan
    found = running_rmse(time, error)
    assert np.isnan(found[:160]).all()
    for k in (160, 233, 399):
        piece = error[(time > time[k] - 2.0 + 1e-9) & (time <= time[k])]
        assert found[k] == pytest.approx(np.sqrt(np.nanmean(piece**2)), rel=1e-9)


def test_faults_are_timed_and_told_apart(streams, log: Log) -> None:
    walk = longer(log, 6)
    assert walk.truth is not None
    fault = Fault("dead", channel=3, start=1.0)
    stream = stream_of(streams, walk, faults=(fault,))
    flags = np.zeros(walk.raw.shape, dtype=np.int64)
    flags[40:44, 6] = int(Flag.SPIKE)
    flags[walk.time >= 1.5, 3] = int(Flag.DEAD)
    row = streams.score_run(stream, played_as(streams, walk, walk.truth.force, flags))
    assert row["found"] == pytest.approx(0.5)
    assert (row["isolated"], row["named"], row["alarms"]) == (1.0, 1.0, 1.0)
    assert row["hours"] == pytest.approx(80 / 80 / 3600, rel=0.02)
    flags[walk.time >= 2.0, 5] = int(Flag.LOST)
    assert streams.score_run(stream, played_as(streams, walk, walk.truth.force, flags))["isolated"] == 0.0
    unseen = streams.score_run(stream, played_as(streams, walk, walk.truth.force))
    assert unseen["found"] == float("inf")
    assert unseen["named"] == 0.0


def test_nees_of_errors_that_are_as_large_as_claimed_is_one(streams) -> None:
    root = RNG.normal(size=(6, 6))
    covariance = root @ root.T + 0.1 * np.eye(6)
    error = RNG.multivariate_normal(np.zeros(6), covariance, size=4000)
    found = np.array([streams.normalise(one, covariance) for one in error])
    assert found.mean() == pytest.approx(1.0, abs=0.03)
    direct = np.array([e @ np.linalg.solve(covariance, e) / 6 for e in error[:50]])
    np.testing.assert_allclose(found[:50], direct, rtol=1e-8)


@pytest.mark.parametrize("broken", [np.diag([1.0, -1.0]), np.full((2, 2), np.nan), np.zeros((2, 2))])
def test_a_covariance_that_is_none_is_infinitely_wrong(streams, broken: np.ndarray) -> None:
    assert streams.normalise(np.ones(2), broken) == np.inf


def test_readings_that_do_not_arrive_are_held() -> None:
    readings = np.array([[1.0, 2.0], [np.nan, 3.0], [np.nan, np.nan]])
    np.testing.assert_array_equal(hold_last(readings), [[1.0, 2.0], [1.0, 3.0], [1.0, 3.0]])


CORNERS = np.array([(0.1, 0.05), (0.1, -0.05), (-0.1, 0.05), (-0.1, -0.05)])
LAYOUT = FeetLayout((FootLayout.load_cells("left", CORNERS), FootLayout.load_cells("right", CORNERS)))
POSITION = np.array([[[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]])
FLAT = np.eye(3)[None, None].repeat(2, axis=1)


def score(estimate: list[list[float]], truth: list[list[float]], settle: float = 0.0) -> dict[str, float]:
    n = len(truth)
    return score_forces(
        np.array(estimate),
        np.array(truth),
        layout=LAYOUT,
        position_sole=POSITION.repeat(n, axis=0),
        R_world_sole=FLAT.repeat(n, axis=0),
        time=np.arange(n, dtype=float),
        settle=settle,
    )._asdict()


EVEN = [5.0] * 8
LEFT = [10.0] * 4 + [0.0] * 4
AIR = [0.5] * 8


def test_a_perfect_estimate_scores_nothing() -> None:
    result = score([EVEN, LEFT, AIR], [EVEN, LEFT, AIR])
    assert result == dict.fromkeys(result, 0.0)


def test_weight_moved_from_foot_to_foot() -> None:
    # All weight on the left foot where half is on each: the CoP is off by 0.1 m in y, the sum by nothing.
    result = score([LEFT], [EVEN])
    assert result["cop"] == pytest.approx(0.1)
    assert result["cop_foot"] == pytest.approx(0.0)
    assert result["vgrf"] == pytest.approx(0.0)
    assert result["cell"] == pytest.approx(5.0)


def test_errors_of_both_axes_add_as_squares() -> None:
    # Four newtons more on the left front-left cell at (0.1, 0.15): 44 N at (0.4, 0.6) / 44.
    estimate = [9.0, *EVEN[1:]]
    result = score([estimate, EVEN], [EVEN, EVEN])
    assert result["cop"] == pytest.approx(np.hypot(0.4, 0.6) / 44 / np.sqrt(2))
    # Of the left foot 24 N at (0.4, 0.2) / 24: one of four values of feet that are not 0.
    assert result["cop_foot"] == pytest.approx(np.hypot(0.4, 0.2) / 24 / np.sqrt(4))
    assert result["vgrf"] == pytest.approx(4 / np.sqrt(2))
    assert result["cell"] == pytest.approx(4 / np.sqrt(16))


def test_no_centre_of_pressure_in_the_air() -> None:
    # The last sample truly weighs 4 N: its CoP does not count, its force does.
    result = score([EVEN, LEFT], [EVEN, AIR])
    assert result["cop"] == pytest.approx(0.0)
    assert result["vgrf"] == pytest.approx(36 / np.sqrt(2))


def test_an_estimate_without_a_centre_of_pressure_holds_its_last() -> None:
    result = score([LEFT, AIR], [LEFT, EVEN])
    assert result["cop"] == pytest.approx(0.1 / np.sqrt(2))


def test_samples_before_settling_and_without_reading_do_not_count() -> None:
    assert score([EVEN, LEFT, LEFT], [LEFT, LEFT, LEFT], settle=1.0)["cop"] == pytest.approx(0.0)
    result = score([[np.nan, *EVEN[1:]], LEFT], [EVEN, LEFT])
    assert result["cop"] == pytest.approx(0.0)
    with pytest.raises(ValueError, match=r"No sample from 9 s on has finite forces.*the walk ends at 1 s"):
        score([EVEN, EVEN], [EVEN, EVEN], settle=9.0)


def test_turned_soles_move_the_centre_of_pressure() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    R = np.stack([quarter, np.eye(3)])[None]
    cop = cop_world(np.array([[10.0, 0, 0, 0, 0, 0, 0, 0]]), LAYOUT, POSITION, R)
    np.testing.assert_allclose(cop, [[-0.05, 0.2]])


def test_intervals_leave_out_what_is_not_there() -> None:
    interval = mean_interval([1.0, np.nan, 3.0])
    assert (interval.mean, interval.n) == (2.0, 2)
    assert interval.half == pytest.approx(12.7062, abs=1e-4)
    assert np.isnan(mean_interval([4.0]).half)
    assert mean_interval([]).n == 0
