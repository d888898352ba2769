"""Wrappers of Stable-Baselines3: its vectors and its own wrappers, files, and what its logger is told."""

from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import A2C, SAC
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    SubprocVecEnv,
    VecCheckNan,
    VecFrameStack,
    VecMonitor,
    VecNormalize,
)

import surefoot  # noqa: F401
from surefoot.calibration.cop import cop_of_feet, sole_wrenches
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.wrappers import FootSensors, SelfCalibration, VectorFootSensors, VectorSelfCalibration
from surefoot.wrappers.vector.sb3 import VecFootSensors, VecSelfCalibration
from surefoot.wrappers.vector.sb3_log import FLAGGED, STATED_STD, TRUE_ERROR, CalibrationLog

ROBOTS = 2
SHORT = {"stand_time": 0.1, "duration": 0.25}


def _functions(**options: Any) -> list[Any]:
    # Processes of their own cannot import this file: the function travels as it is.
    def copy(options: dict[str, Any]) -> Any:
        import gymnasium as gym

        import surefoot.wrappers as wrappers

        return wrappers.TruthRow(gym.make("surefoot/NaoBalance-v0", disable_env_checker=True, **options))

    return [partial(copy, SHORT | options)] * ROBOTS


def _venv(kind: Any = DummyVecEnv, method: str = "moment", **options: Any) -> VecSelfCalibration:
    return VecSelfCalibration(VecFootSensors(kind(_functions(**options)), fresh=True), method)


def _actions(count: int, size: float = 0.3) -> Any:
    rng = np.random.default_rng(0)
    for _ in range(count):
        yield rng.uniform(-size, size, (ROBOTS, 11)).astype(np.float32)


@pytest.mark.slow  # each process imports torch; Gymnasium's own are beside VectorFootSensors
def test_processes_of_their_own_go_through_ends_of_episodes_as_one_process_does() -> None:
    near, far = _venv(), _venv(SubprocVecEnv)
    try:
        near.seed(4)
        far.seed(4)
        seen, ends = (near.reset(), far.reset()), 0
        for actions in _actions(50):
            for key in seen[0]:
                np.testing.assert_array_equal(seen[0][key], seen[1][key], err_msg=key)
            (one, _, dones, infos), (other, _, over, told) = near.step(actions), far.step(actions)
            np.testing.assert_array_equal(dones, over)
            for i in np.flatnonzero(dones):
                final, its = infos[i]["terminal_observation"], told[i]["terminal_observation"]
                assert set(final) == set(its) == set(near.observation_space.spaces)
                for key in final:
                    np.testing.assert_array_equal(final[key], its[key], err_msg=key)
                ends += 1
            seen = one, other
        assert ends >= 4
    finally:
        far.close()


def _single(**options: Any) -> DummyVecEnv:
    def copy() -> Any:
        return SelfCalibration(FootSensors(gym.make("surefoot/NaoBalance-v0", **(SHORT | options))))

    return DummyVecEnv([copy] * ROBOTS)


@pytest.mark.parametrize("make", [_venv, _single])
def test_wrappers_of_sb3_go_around(make: Any) -> None:
    inner = VecNormalize(VecCheckNan(VecMonitor(make()), raise_exception=True))
    outer = VecFrameStack(inner, 3)
    assert set(inner.norm_obs_keys) == set(inner.observation_space.spaces)
    seen, ends = outer.reset(), 0
    for actions in _actions(50):
        for key, space in outer.observation_space.spaces.items():
            assert seen[key].shape == (ROBOTS, *space.shape)
            assert seen[key].dtype == space.dtype == np.float32
            assert np.isfinite(seen[key]).all()
        seen, _, dones, infos = outer.step(actions)
        for i in np.flatnonzero(dones):
            assert "episode" in infos[i]
            for key, part in infos[i]["terminal_observation"].items():
                assert part.shape == outer.observation_space[key].shape
            ends += 1
    assert ends >= 4


@pytest.mark.parametrize("method", ["moment", "tare"])
def test_files_are_those_of_gymnasiums_vectors(method: str, tmp_path: Any) -> None:
    old = _venv(method=method, duration=5.0)
    copies = gym.vector.SyncVectorEnv(_functions(duration=5.0))
    new = VectorSelfCalibration(VectorFootSensors(copies), method)
    for what, env in (("calibrator", old), ("sensors", old.venv)):
        with pytest.raises(RuntimeError, match=rf"no {what} before the first reset\(\)"):
            env.save(tmp_path / "early.npz")
    old.seed(1)
    old.reset()
    new.reset(seed=9)
    for actions in _actions(80, 0.02):
        old.step(actions)
    old.save(tmp_path / "learnt.npz")
    old.venv.save(tmp_path / "sensors.npz")
    new.load(tmp_path / "learnt.npz")
    new.env.load(tmp_path / "sensors.npz")
    for one, other in zip(old.venv.true_parameters(), new.env.true_parameters(), strict=True):
        np.testing.assert_array_equal(one, other)
    new.save(tmp_path / "again.npz")
    with np.load(tmp_path / "learnt.npz") as one, np.load(tmp_path / "again.npz") as other:
        assert set(one) == set(other)
        # The comparison with the start begins again: sensors may have changed since the state was saved.
        for name in (name for name in one if "versus_start" not in name):
            np.testing.assert_array_equal(one[name], other[name], err_msg=name)


def test_a_seed_given_before_there_were_sensors_seeds_them_as_well() -> None:
    seen = []
    for early in (True, False):
        copies = DummyVecEnv(_functions())
        if early:
            copies.seed(3)
        venv = VecSelfCalibration(VecFootSensors(VecMonitor(copies), measure_state=False))
        if not early:
            venv.seed(3)
        seen.append((venv.reset(), venv.venv.true_parameters()))
        assert venv.venv.seeds == [3, 4]
        venv.reset()
        assert venv.venv.seeds == [None, None]
    for one, other in zip(*[[*shown.values(), *maps] for shown, maps in seen], strict=True):
        np.testing.assert_array_equal(one, other)


def test_options_of_one_reset_are_those_of_gymnasiums_vectors() -> None:
    venv = VecMonitor(VecSelfCalibration(VecFootSensors(DummyVecEnv(_functions()))))
    feet = venv.venv.venv
    venv.reset()
    drawn = feet.true_parameters().scale
    for options, kept in ((None, True), ({"surefoot": {"sensors": "fresh"}}, False), (None, True)):
        if options is not None:
            venv.set_options(options)
        venv.reset()
        now = feet.true_parameters().scale
        assert np.allclose(now, drawn, rtol=1e-3) is kept
        drawn = now
    venv.set_options([{"surefoot": {"sensors": "fresh"}}, {"surefoot": {"sensors": "fresh"}, "more": 1}])
    assert feet.venv._options == [{}, {"more": 1}]
    with pytest.raises(ValueError, match="the same for all robots"):
        venv.set_options([{"surefoot": {"sensors": "fresh"}}, {}])
    with pytest.raises(ValueError, match="must be one of"):
        venv.set_options({"surefoot": {"sensors": "new"}})


def _logged(venv: Any, folder: Any, steps: int = 16, every: int = 1) -> dict[str, Any]:
    """Train for one rollout, and return what the logger was told last."""
    model = A2C("MultiInputPolicy", venv, n_steps=steps, seed=0, device="cpu")
    model.set_logger(configure(str(folder), []))
    told: dict[str, Any] = {}
    dump = model.logger.dump

    def keep(step: int = 0) -> None:
        told.update(model.logger.name_to_value)
        dump(step)

    model.logger.dump = keep  # type: ignore[method-assign]
    model.learn(steps * ROBOTS, log_interval=1, callback=CalibrationLog(every))
    return told


def test_the_logger_is_told_of_the_error_its_standard_deviation_and_flags(tmp_path: Any) -> None:
    seen: list[Any] = []

    class Kept(VecSelfCalibration):
        def step_wait(self) -> Any:
            out = super().step_wait()
            for robot, sensors in zip(self.calibration.robots, self.venv.sensors.robots, strict=True):
                now, there = robot.estimate, robot.reference
                cop = [
                    cop_of_feet(
                        sole_wrenches(scale * sensors.raw + offset, self.calibration.setup.layout),
                        there.position_sole,
                        there.R_level_sole,
                    )
                    for scale, offset in ((now.scale, now.offset), sensors.true_parameters())
                ]
                seen.append((cop[0] - cop[1], np.diagonal(now.cop_covariance), now.flags))
            return out

    feet = VecFootSensors(
        DummyVecEnv(_functions(duration=3.0)), faults=["at t=0.05 s cell left/2 drops 60 %"], fresh=True
    )
    told = _logged(VecNormalize(VecMonitor(Kept(feet))), tmp_path, 40)
    assert len(seen) == 40 * ROBOTS
    error, variance, flags = (np.array(part) for part in zip(*seen, strict=True))
    known = np.isfinite(error).all(axis=1) & np.isfinite(variance).all(axis=1)
    assert told[TRUE_ERROR] == pytest.approx(np.sqrt(np.mean(error[known] ** 2)), rel=1e-9)
    assert 1e-4 < told[TRUE_ERROR] < 0.1
    assert told[STATED_STD] == pytest.approx(np.sqrt(variance[known].mean()), rel=1e-9)
    assert told[FLAGGED] == pytest.approx(np.mean(flags != 0))
    assert told[FLAGGED] > 0.0


def test_a_map_that_is_true_has_no_error_whatever_a_policy_does(tmp_path: Any) -> None:
    """The age of readings, which are far behind while a policy explores, is not an error of the map."""
    feet = VecFootSensors(DummyVecEnv(_functions(duration=3.0)), severity=0.0)
    told = _logged(VecSelfCalibration(feet, "none", initial="calibrated", errors=NO_ERRORS), tmp_path, 40)
    assert told[TRUE_ERROR] < 1e-6


@pytest.mark.parametrize("method", ["tare", "moment"])
def test_copies_that_calibrate_themselves_are_logged_as_well(method: str, tmp_path: Any) -> None:
    def copy() -> Any:
        env = gym.make("surefoot/NaoBalance-v0", **SHORT | {"duration": 2.0})
        return SelfCalibration(FootSensors(env), method)

    told = _logged(DummyVecEnv([copy] * ROBOTS), tmp_path)
    assert 1e-4 < told[TRUE_ERROR] < 0.1
    assert (STATED_STD in told) is (method == "moment")


def test_one_step_rollouts_add_up_until_the_logger_writes(tmp_path: Any) -> None:
    model = SAC("MultiInputPolicy", _venv(), learning_starts=10_000, seed=0, device="cpu", buffer_size=500)
    model.set_logger(configure(str(tmp_path), []))
    log = CalibrationLog(every=5)
    # Nothing is known of a robot's motion in the first tenths of a second.
    model.learn(80, log_interval=10**6, callback=log)
    assert log._channels == 8 * ROBOTS * 8
    assert TRUE_ERROR in model.logger.name_to_value


def test_tensorboard_gets_the_curves(tmp_path: Any) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    model = A2C("MultiInputPolicy", _venv(), n_steps=40, tensorboard_log=str(tmp_path), device="cpu", seed=0)
    model.learn(40 * ROBOTS * 2, log_interval=1, callback=CalibrationLog())
    board = EventAccumulator(str(next(tmp_path.glob("A2C_*"))))
    board.Reload()
    for name in (TRUE_ERROR, STATED_STD, FLAGGED):
        assert [event.step for event in board.Scalars(name)] == [40 * ROBOTS, 80 * ROBOTS]


def test_feet_that_nobody_calibrates_are_refused() -> None:
    model = A2C("MultiInputPolicy", VecFootSensors(DummyVecEnv(_functions())), device="cpu")
    with pytest.raises(TypeError, match=r"VecSelfCalibration\(VecFootSensors\(venv\)\)"):
        model.learn(2, callback=CalibrationLog())
    with pytest.raises(ValueError, match=r"'every' must be a whole number of steps from 1 on, got 0"):
        CalibrationLog(0)
