"""Scores of the arena: each against an independent formula, on made logs."""

import dataclasses

import numpy as np
import pytest

from surefoot.calibration import Flag
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walks.play import FALLING, Consistency, Played, Stream, _normalised, cut_fall, play
from surefoot.experiments.walks.run_score import running_rmse, score_run
from surefoot.experiments.walks.score import held, score_forces
from surefoot.sensors import Fault

RNG = np.random.default_rng(11)
NOTHING = np.full(0, np.nan)
SILENT = Consistency(NOTHING, NOTHING, NOTHING, NOTHING, float("nan"), 0.0)


def stream_of(log: Log, **changes: object) -> Stream:
    return dataclasses.replace(Stream(log=log, seed=5, judged=log.time >= 0.25, began=0.0), **changes)


def played_as(log: Log, force: np.ndarray, flags: np.ndarray | None = None) -> Played:
    shape = log.raw.shape
    silent = np.zeros(shape, dtype=np.int64) if flags is None else flags
    return Played(force, np.ones(shape), np.zeros(shape), silent, SILENT)


def longer(log: Log, times: int) -> Log:
    """The same log again and again."""

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


def test_errors_are_those_of_the_other_scores(log: Log) -> None:
    assert log.truth is not None
    force = log.truth.force + RNG.normal(size=log.raw.shape)
    row = score_run(stream_of(log), played_as(log, force))
    truth = log.truth
    other = score_forces(
        force,
        truth.force,
        layout=log.layout,
        position_sole=truth.position_sole,
        R_world_sole=truth.R_world_sole,
        time=log.time,
        settle=0.25,
    )
    for name in ("cop", "vgrf", "cell"):
        assert row[name] == pytest.approx(getattr(other, name), rel=1e-12)


def test_truth_itself_has_no_error_and_is_not_worse(log: Log) -> None:
    assert log.truth is not None
    off = dataclasses.replace(log, raw=log.raw + RNG.normal(size=log.raw.shape) / log.nominal.scale)
    row = score_run(stream_of(off), played_as(off, log.truth.force))
    assert row["cop"] == row["vgrf"] == row["cell"] == 0.0
    assert not row["worse"]
    worse = score_run(stream_of(off), played_as(off, 3.0 * off.nominal.force(off.raw) - 20.0))
    assert worse["worse"]
    assert worse["worse_vgrf"]


def test_true_map_undoes_gains_and_offsets(log: Log) -> None:
    assert log.truth is not None
    gain, zero = RNG.uniform(0.8, 1.2, 8), RNG.normal(size=8)
    scale, offset = log.nominal.scale / gain, log.nominal.offset / gain - zero / gain
    raw = (gain * log.truth.force + zero - log.nominal.offset) / log.nominal.scale
    truth = dataclasses.replace(
        log.truth, scale=np.tile(scale, (len(log), 1)), offset=np.tile(offset, (len(log), 1))
    )
    stream = stream_of(dataclasses.replace(log, raw=raw, truth=truth))
    (floor,), (start,) = play([stream], "floor"), play([stream], "none")
    np.testing.assert_allclose(floor.force, truth.force, atol=1e-9)
    row, raw_row = score_run(stream, floor), score_run(stream, start)
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


def test_convergence_is_when_the_error_came_to_stay(log: Log) -> None:
    walk = longer(log, 20)
    assert walk.truth is not None
    # All cells of both feet read 4 N too much up to 6 s and 0.1 N after: both feet are pulled to the middle.
    force = walk.truth.force + np.where(walk.time < 6.0, 4.0, 0.1)[:, None] * np.array([1, 0] * 4)
    row = score_run(stream_of(walk, judged=walk.time >= 9.0), played_as(walk, force))
    # Two seconds after the change the last large error has left the running one.
    assert row["converged"] == pytest.approx(8.0, abs=0.05)


def test_faults_are_timed_and_told_apart(log: Log) -> None:
    walk = longer(log, 6)
    assert walk.truth is not None
    fault = Fault("dead", channel=3, start=1.0)
    stream = stream_of(walk, faults=(fault,))
    flags = np.zeros(walk.raw.shape, dtype=np.int64)
    flags[40:44, 6] = int(Flag.SPIKE)
    flags[walk.time >= 1.5, 3] = int(Flag.DEAD)
    row = score_run(stream, played_as(walk, walk.truth.force, flags))
    assert row["found"] == pytest.approx(0.5)
    assert (row["isolated"], row["named"], row["alarms"]) == (1.0, 1.0, 1.0)
    assert row["hours"] == pytest.approx(80 / 80 / 3600, rel=0.02)
    flags[walk.time >= 2.0, 5] = int(Flag.LOST)
    assert score_run(stream, played_as(walk, walk.truth.force, flags))["isolated"] == 0.0
    unseen = score_run(stream, played_as(walk, walk.truth.force))
    assert unseen["found"] == float("inf")
    assert unseen["named"] == 0.0


def test_nees_of_errors_that_are_as_large_as_claimed_is_one() -> None:
    root = RNG.normal(size=(6, 6))
    covariance = root @ root.T + 0.1 * np.eye(6)
    error = RNG.multivariate_normal(np.zeros(6), covariance, size=4000)
    found = np.array([_normalised(one, covariance) for one in error])
    assert found.mean() == pytest.approx(1.0, abs=0.03)
    direct = np.array([e @ np.linalg.solve(covariance, e) / 6 for e in error[:50]])
    np.testing.assert_allclose(found[:50], direct, rtol=1e-8)


@pytest.mark.parametrize("broken", [np.diag([1.0, -1.0]), np.full((2, 2), np.nan), np.zeros((2, 2))])
def test_a_covariance_that_is_none_is_infinitely_wrong(broken: np.ndarray) -> None:
    assert _normalised(np.ones(2), broken) == np.inf


def test_readings_that_do_not_arrive_are_held() -> None:
    readings = np.array([[1.0, 2.0], [np.nan, 3.0], [np.nan, np.nan]])
    np.testing.assert_array_equal(held(readings), [[1.0, 2.0], [1.0, 3.0], [1.0, 3.0]])


def test_a_fall_is_cut_off(log: Log) -> None:
    walk = longer(log, 4)
    cut = cut_fall(walk)
    assert cut.time[-1] <= walk.time[-1] - FALLING
    assert len(cut.raw) == len(cut.time) == len(cut.reference.com)
    assert cut.truth is not None
    assert len(cut.truth.force) == len(cut.time)
