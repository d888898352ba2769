"""Sensors around vector environments: the same robots, felt through honest instruments."""

from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import surefoot  # noqa: F401
from surefoot.envs.instrumentation.means import mean_truth
from surefoot.sensors import LoadCells, Wire, preset
from surefoot.wrappers import FootSensors
from surefoot.wrappers.vector.foot_sensors import VectorFootSensors
from surefoot.wrappers.vector.truth_row import TRUTH_KEY, TruthRow

ROBOTS, EPISODE = 3, 9
ACTIONS = np.zeros((ROBOTS, 11), dtype=np.float32)


def _walk(steps: int | None = EPISODE, **options: Any) -> gym.Env[Any, Any]:
    return gym.make(
        "surefoot/NaoWalk-v0",
        speed=0.04,
        duration=12.0,
        max_episode_steps=steps,
        disable_env_checker=True,
        **options,
    )


def _copies(mode: AutoresetMode = AutoresetMode.NEXT_STEP, **options: Any) -> SyncVectorEnv:
    # Episodes of different lengths: robots are reset at different times.
    lengths = [EPISODE + 2 * i for i in range(ROBOTS)]
    return SyncVectorEnv(
        [partial(lambda steps: TruthRow(_walk(steps)), steps) for steps in lengths],
        autoreset_mode=mode,
        **options,
    )


def _cells(env: VectorFootSensors, name: str) -> np.ndarray:
    """Return a part of the state of all robots' load cells."""
    return np.array([getattr(robot.hardware().cells, name) for robot in env.sensors.robots])


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_robots_do_what_they_do_bare_and_observations_fit_their_space(mode):
    bare = SyncVectorEnv([partial(_walk, EPISODE + 2 * i) for i in range(ROBOTS)], autoreset_mode=mode)
    felt = VectorFootSensors(_copies(mode))
    bare.reset(seed=5)
    seen, infos = felt.reset(seed=5)
    ends = 0
    for _ in range(30):
        assert seen in felt.observation_space
        assert set(seen) == {"state", "foot_raw"}
        expected = bare.step(ACTIONS)
        seen, *told, infos = felt.step(ACTIONS)
        for own, other in zip(told, expected[1:4], strict=True):
            np.testing.assert_array_equal(own, other)
        for own, other in zip(felt.unwrapped.envs, bare.envs, strict=True):
            np.testing.assert_array_equal(own.unwrapped.data.qpos, other.unwrapped.data.qpos)
        done = told[1] | told[2]
        ends += int(done.sum())
        if mode is AutoresetMode.SAME_STEP:
            for robot in np.flatnonzero(done):
                final = infos["final_obs"][robot]
                assert final in felt.single_observation_space
                assert (final["foot_raw"] != seen["foot_raw"][robot]).any()
        if mode is AutoresetMode.DISABLED and done.any():
            bare.reset(options={"reset_mask": done})
            options = {"reset_mask": done}
            seen, infos = felt.reset(options=options)
            assert "reset_mask" in options
    assert ends >= 6


def test_seeds_settle_all_and_options_decide_for_one_reset():
    felt = VectorFootSensors(_copies())

    def run(**options: Any) -> list[Any]:
        readings = [felt.reset(**options)[0]["foot_raw"]]
        return [*readings, *(felt.step(ACTIONS)[0]["foot_raw"] for _ in range(12))]

    first, again = run(seed=3), run(seed=3)
    np.testing.assert_array_equal(first, again)
    # One number counts up, as it does for the environments.
    np.testing.assert_array_equal(run(seed=[3, 4, 5]), first)
    period = _cells(felt, "period")
    run()
    np.testing.assert_array_equal(_cells(felt, "period"), period)
    run(seed=[None, 7, None])
    changed = (_cells(felt, "period") != period).all(axis=1)
    np.testing.assert_array_equal(changed, [False, True, False])
    run(seed=3, options={"surefoot": {"sensors": "keep"}})
    period = _cells(felt, "period")
    run(options={"surefoot": {"sensors": "fresh"}})
    assert (_cells(felt, "period") != period).all()
    other = VectorFootSensors(_copies(), stream=99)
    assert (other.reset(seed=3)[0]["foot_raw"] != first[0]).all()


def test_perfect_cells_read_the_truth_and_truth_is_each_copys_own():
    copies = SyncVectorEnv([lambda: TruthRow(_walk(None))] * ROBOTS)
    felt = VectorFootSensors(copies, "perfect", imu="perfect", encoders="perfect", link="perfect")
    felt.reset(seed=0)
    for _ in range(20):
        seen, *_, infos = felt.step(ACTIONS)
    told = infos["surefoot"]["truth"]
    for i, copy in enumerate(copies.envs):
        truth = copy.unwrapped.truth
        np.testing.assert_allclose(seen["foot_raw"][i], truth.force_cell.mean(axis=0), atol=1e-4)
        own = mean_truth(truth.rows, truth.layout)
        assert set(told) == set(own)
        for name, part in own.items():
            np.testing.assert_allclose(told[name][i], part, atol=1e-12)
        state, layout = seen["state"][i], copy.unwrapped.state_layout
        np.testing.assert_allclose(state[layout["joint_position"]], truth.joint_position[-1], atol=1e-6)
        np.testing.assert_allclose(state[layout["gyroscope"]], truth.gyroscope.mean(axis=0), atol=1e-6)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_copies_in_processes_of_their_own_are_felt_alike(mode):
    functions = [partial(lambda steps: TruthRow(_walk(steps)), EPISODE + i) for i in range(2)]
    near = VectorFootSensors(SyncVectorEnv(functions, autoreset_mode=mode))
    far = VectorFootSensors(gym.vector.AsyncVectorEnv(functions, autoreset_mode=mode))
    try:
        shown = [env.reset(seed=4)[0] for env in (near, far)]
        for _ in range(14):
            for key in shown[0]:
                np.testing.assert_array_equal(shown[0][key], shown[1][key])
            steps = [env.step(ACTIONS[:2]) for env in (near, far)]
            shown = [step[0] for step in steps]
            if mode is AutoresetMode.SAME_STEP and steps[0][3].any():
                robot = int(np.flatnonzero(steps[0][3])[0])
                finals = [step[4]["final_obs"][robot] for step in steps]
                assert TRUTH_KEY not in finals[1]
                np.testing.assert_array_equal(finals[0]["foot_raw"], finals[1]["foot_raw"])
    finally:
        far.close()


def test_buffers_of_the_environment_are_neither_handed_out_nor_changed():
    felt = VectorFootSensors(_copies(copy=False))
    felt.reset(seed=0)
    own = felt.env.unwrapped._observations
    seen, *_, infos = felt.step(ACTIONS)
    force, state = infos["surefoot"]["truth"]["force_cell"].copy(), own["state"].copy()
    assert not np.shares_memory(seen["state"], own["state"])
    seen["state"][:] = np.nan
    np.testing.assert_array_equal(own["state"], state)
    felt.step(ACTIONS)
    np.testing.assert_array_equal(infos["surefoot"]["truth"]["force_cell"], force)


def test_what_does_not_fit_is_refused_at_the_door():
    bare = SyncVectorEnv([partial(_walk, None)] * 2)
    with pytest.raises(TypeError, match=r"wrappers=\[TruthRow\]"):
        VectorFootSensors(bare)
    with pytest.raises(TypeError, match="one is enough"):
        TruthRow(TruthRow(_walk()))
    with pytest.raises(TypeError, match="TruthRow"):
        FootSensors(TruthRow(_walk()))
    copies = _copies()
    with pytest.raises(ValueError, match="no foot sensor preset 'hx712'"):
        VectorFootSensors(copies, "hx712")
    with pytest.raises(ValueError, match="room for 8 cells"):
        VectorFootSensors(copies, LoadCells(channels=12))
    with pytest.raises(ValueError, match="'stream'"):
        VectorFootSensors(copies, stream=-1)
    with pytest.raises(TypeError, match="TruthRow found FootSensors below it"):
        VectorFootSensors(SyncVectorEnv([lambda: TruthRow(FootSensors(_walk()))] * 2))
    boxes = [gym.spaces.Box(-high, high, (17,), np.float64) for high in (1e3, 2e3)]
    odd = [
        lambda box=box: TruthRow(gym.wrappers.TransformObservation(gym.make("Walker2d-v5"), lambda o: o, box))
        for box in boxes
    ]
    with pytest.raises(ValueError, match=r"copies \[1\]"):
        VectorFootSensors(SyncVectorEnv(odd, observation_mode="different"))
    other = [lambda: TruthRow(_walk()), lambda: TruthRow(_other())]
    with pytest.raises(ValueError, match=r"copies \[1\] are of another"):
        VectorFootSensors(SyncVectorEnv(other))


@pytest.mark.parametrize(
    "memory",
    [{}, {"settling": 3, "wire": Wire(delay=0.06, jitter=0.005)}, {"rate": None, "wire": Wire(delay=0.06)}],
    ids=["clock", "filter and wire", "wire alone"],
)
def test_no_reading_of_a_new_episode_is_of_the_last_one(memory):
    cells = replace(preset("perfect", LoadCells), **({"rate": (10.0, 10.0)} | memory))
    felt = VectorFootSensors(_copies(), cells)
    since: list[list[Any]] = [[] for _ in range(ROBOTS)]

    def follow(seen: Any, infos: Any, starting: Any) -> int:
        force, starts = infos["surefoot"]["truth"]["force_cell"], 0
        for robot, loads in enumerate(since):
            if starting[robot]:
                # The weight of the dead episode is more than anything that the new one begins with.
                starts += bool(loads) and loads[-1].sum() > force[robot].sum() + 5.0
                loads.clear()
                np.testing.assert_allclose(seen["foot_raw"][robot], force[robot], atol=1e-4)
            loads.extend(felt.unwrapped.envs[robot].unwrapped.truth.force_cell)
            assert (seen["foot_raw"][robot] >= np.min(loads, axis=0) - 1e-4).all()
            assert (seen["foot_raw"][robot] <= np.max(loads, axis=0) + 1e-4).all()
        return starts

    everyone = np.ones(ROBOTS, dtype=bool)
    follow(*felt.reset(seed=5), everyone)
    done, starts = ~everyone, 0
    for _ in range(3 * EPISODE):
        starting = done
        seen, _, terminated, truncated, infos = felt.step(ACTIONS)
        done = terminated | truncated
        starts += follow(seen, infos, starting)
    assert starts >= 5
    before = [len(loads) for loads in since]
    follow(*felt.reset(), everyone)
    assert max(before) > 1


def test_truth_that_was_mixed_into_other_parts_is_refused_below_the_row():
    with pytest.raises(TypeError, match=r"(?s)wrap in this order.*FlattenObservation"):
        TruthRow(gym.wrappers.FlattenObservation(_walk()))
    with pytest.raises(
        TypeError, match="but FilterObservation below it makes something else of it; wrap in this"
    ):
        TruthRow(gym.wrappers.FilterObservation(_walk(), ["cop"]))
    with pytest.raises(TypeError, match="but FrameStackObservation below it"):
        TruthRow(gym.wrappers.FrameStackObservation(_walk(), 2))
    assert set(TruthRow(gym.wrappers.FilterObservation(_walk(), ["state"])).observation_space) == {
        "state",
        TRUTH_KEY,
    }


def test_an_environment_may_hand_out_its_own_buffer():
    class Buffered(gym.Wrapper[Any, Any, Any, Any]):
        """Writes each observation over the one before."""

        def __init__(self, env: gym.Env[Any, Any]) -> None:
            super().__init__(env)
            self._buffer: dict[str, Any] = {}

        def _write(self, seen: dict[str, Any]) -> dict[str, Any]:
            for key, part in seen.items():
                self._buffer.setdefault(key, part.copy())[...] = part
            return self._buffer

        def reset(self, **options: Any) -> Any:
            seen, info = self.env.reset(**options)
            return self._write(seen), info

        def step(self, action: Any) -> Any:
            seen, *rest = self.env.step(action)
            return self._write(seen), *rest

    mode = AutoresetMode.SAME_STEP
    plain = VectorFootSensors(SyncVectorEnv([lambda: TruthRow(_walk(EPISODE))], autoreset_mode=mode))
    reused = VectorFootSensors(
        SyncVectorEnv([lambda: TruthRow(Buffered(_walk(EPISODE)))], autoreset_mode=mode)
    )
    for env in (plain, reused):
        env.reset(seed=3)
    for _ in range(EPISODE):
        one, other = (env.step(ACTIONS[:1]) for env in (plain, reused))
    np.testing.assert_array_equal(one[0]["state"], other[0]["state"])
    final = one[4]["final_obs"][0]["state"]
    np.testing.assert_array_equal(other[4]["final_obs"][0]["state"], final)
    assert (final != one[0]["state"][0]).any()


def test_feet_without_area_have_no_centre_of_pressure_in_the_truth_either():
    copies = SyncVectorEnv(
        [lambda: TruthRow(gym.make("Humanoid-v5", include_cfrc_ext_in_observation=False), keep_info=True)] * 2
    )
    felt = VectorFootSensors(copies, "icub-force-torque")
    felt.reset(seed=0)
    pressed = 0
    for _ in range(20):
        *_, infos = felt.step(np.zeros((2, 17), dtype=np.float32))
        told = infos["surefoot"]["truth"]
        pressed += int((told["wrench_sole"][..., 2] > 50.0).sum())
        assert not told["cop_valid"][:, 1:].any()
    assert pressed > 5
    for i, copy in enumerate(copies.envs):
        own = mean_truth(copy.env.truth.rows, copy.env.truth.layout)
        np.testing.assert_allclose(own["vgrf"], told["vgrf"][i])


def _other() -> gym.Env[Any, Any]:
    """A walker whose drawing has a foot elsewhere."""
    env = _walk()
    moved = replace(env.unwrapped.drawing, position_cell_sole=env.unwrapped.position_cell_sole + 0.01)
    kind = type(env.unwrapped)
    env.unwrapped.__class__ = type("Moved", (kind,), {"drawing": property(lambda self: moved)})
    return env
