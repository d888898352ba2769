"""A robot is the same alone and at any place among many: what it sees, is told, learns and takes with it."""

from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import surefoot  # noqa: F401
from surefoot.robot.foot_view import DETERMINED, PARTS
from surefoot.sensors import LoadCells, Wire
from surefoot.wrappers import FootSensors, SelfCalibration, TruthRow, VectorFootSensors, VectorSelfCalibration

ROBOTS, EPISODE = 2, 14
NOISY = LoadCells(
    settling=4, wire=Wire(spike_rate=9.0, packet_loss=0.2, delay=0.02, jitter=0.004, under_way=12)
)
SHOWN = tuple(part for part in PARTS if part not in DETERMINED)
BROKEN = {"ankles": "icub-ftsens", "faults": ["at t=0.1 s cell left/2 dies"], "severity": 0.5}
CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "usual": ({}, {}),
    "noisy": ({"config": NOISY, "fresh": True}, {"initial": "calibrated", "show": SHOWN}),
    "broken": (BROKEN | {"link": {"delay": 0.03, "jitter": 0.004}}, {"show": ("wrench", "foot_flags")}),
    "ankles": ({"config": "icub-ftsens", "measure_state": False}, {"errors": {"mass": 0.0}, "lag": 9}),
    "tare": ({}, {"method": "tare"}),
    "stamped": ({"config": LoadCells(stamped=True)}, {"show": SHOWN}),
    "by Python": ({}, {"method": "window", "window": 2.0}),
    "all shown": ({}, {"show": PARTS}),
    "by chance": (
        {"severity": (0.0, 2.0), "faults": {"dies": 0.1, "within 0.2 s sticks": 0.2}, "fresh": True},
        {"show": ("wrench", "foot_flags")},
    ),
}


def _bare(task: str, steps: int) -> gym.Env[Any, Any]:
    return gym.make(f"surefoot/{task}-v0", max_episode_steps=steps, disable_env_checker=True)


def _many(robots: list[Any], feet: dict[str, Any], calibrator: dict[str, Any], mode: Any) -> Any:
    copies = SyncVectorEnv([lambda make=make: TruthRow(make()) for make in robots], autoreset_mode=mode)
    return VectorSelfCalibration(VectorFootSensors(copies, **feet), **calibrator)


def _of(parts: Any, robot: int) -> Any:
    if isinstance(parts, dict):
        return {name: _of(part, robot) for name, part in parts.items()}
    return None if parts is None else parts[robot]


def _same(found: Any, expected: Any, path: str = "") -> None:
    if isinstance(expected, dict):
        assert found.keys() == expected.keys(), path
        for name, part in expected.items():
            _same(found[name], part, f"{path}/{name}")
    elif expected is not None:
        found, expected = np.asarray(found), np.asarray(expected)
        assert (found.shape, found.dtype) == (expected.shape, expected.dtype), path
        np.testing.assert_array_equal(found, expected, err_msg=path)


def _told(info: dict[str, Any]) -> dict[str, Any]:
    # The truth is worked out in two ways, and no part of what a robot has.
    return {name: part for name, part in info["surefoot"].items() if name != "truth"}


def _drawn(info: dict[str, Any]) -> dict[str, Any]:
    truth = info["surefoot"]["truth"]
    return {name: truth[name] for name in ("severity", "fault") if name in truth}


@pytest.mark.parametrize(
    ("case", "mode"),
    [
        *(("usual", mode) for mode in AutoresetMode),
        *((case, AutoresetMode.NEXT_STEP) for case in CASES if case != "usual"),
        *(
            pytest.param(case, mode, marks=pytest.mark.slow)
            for case in CASES
            for mode in AutoresetMode
            if case != "usual" and mode is not AutoresetMode.NEXT_STEP
        ),
    ],
)
def test_a_robot_of_many_is_the_robot_alone(case: str, mode: AutoresetMode) -> None:
    feet, calibrator = CASES[case]
    robots = [partial(_bare, "NaoBalance", EPISODE + 3 * i) for i in range(ROBOTS)]
    alone = [SelfCalibration(FootSensors(make(), **feet), **calibrator) for make in robots]
    many = _many(robots, feet, calibrator, mode)
    seeds = [6, 2]
    seen, infos = many.reset(seed=seeds)
    each: list[Any] = [own.reset(seed=seed) for own, seed in zip(alone, seeds, strict=True)]
    rng, done, ends = np.random.default_rng(0), np.zeros(ROBOTS, dtype=bool), 0
    for _ in range(3 * EPISODE):
        assert seen in many.observation_space
        for i, own in enumerate(each):
            _same(_of(seen, i), own[0])
            _same(_of(_told(infos), i), _told(own[-1]))
            _same(_of(_drawn(infos), i), _drawn(own[-1]))
            _same(many.env.true_parameters()[1][i], alone[i].env.true_parameters()[1])
        action = rng.uniform(-0.3, 0.3, (ROBOTS, 11)).astype(np.float32)
        before = done
        seen, _, terminated, truncated, infos = many.step(action)
        done = terminated | truncated
        ends += int(done.sum())
        for i, own in enumerate(alone):
            waits = mode is AutoresetMode.NEXT_STEP and before[i]
            each[i] = own.reset() if waits else own.step(action[i])
            if done[i] and mode is AutoresetMode.SAME_STEP:
                assert infos["final_obs"][i] in many.single_observation_space
                _same(infos["final_obs"][i], each[i][0])
            if done[i] and mode is not AutoresetMode.NEXT_STEP:
                each[i] = own.reset()
        if done.any() and mode is AutoresetMode.DISABLED:
            seen, infos = many.reset(options={"reset_mask": done.copy()})
            done = ~done & done
    assert ends >= 4


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_what_a_robot_learns_does_not_depend_on_who_stands_beside_it(mode: AutoresetMode) -> None:
    robots = [partial(_bare, "NaoWalk", 190 + 9 * i) for i in range(ROBOTS)]
    many, single = (_many(some, {}, {}, mode) for some in (robots, robots[:1]))
    start, still = (
        many.reset(seed=[4, 9])[1]["surefoot"]["parameters"]["scale"],
        np.zeros((2, 11), np.float32),
    )
    single.reset(seed=4)
    for _ in range(320):
        seen, _, *ends, infos = many.step(still)
        other, *_, known = single.step(still[:1])
        if mode is AutoresetMode.DISABLED and np.any(ends):
            done = ends[0] | ends[1]
            many.reset(options={"reset_mask": done})
            if done[0]:
                single.reset()
    _same(_of(seen, 0), _of(other, 0))
    _same(_of(_told(infos), 0), _of(_told(known), 0))
    assert (infos["surefoot"]["parameters"]["scale"] != start).any(axis=1).all()


@pytest.mark.parametrize("method", ["moment", "tare"])
def test_hardware_and_what_was_learnt_survive_in_files(method: str, tmp_path: Any) -> None:
    robots = [partial(_bare, "NaoStand", 400)] * ROBOTS
    old, new = (_many(robots, {}, {"method": method}, AutoresetMode.NEXT_STEP) for _ in range(2))
    with pytest.raises(RuntimeError, match=r"no calibrator before the first reset\(\)"):
        old.save(tmp_path / "learnt.npz")
    still = np.zeros((ROBOTS, 11), np.float32)
    old.reset(seed=1)
    new.reset(seed=7)
    for _ in range(150):
        *_, infos = old.step(still)
    old.env.save(tmp_path / "sensors.npz")
    old.save(tmp_path / "learnt.npz")
    new.env.load(tmp_path / "sensors.npz")
    new.load(tmp_path / "learnt.npz")
    _same(new.env.true_parameters()._asdict(), old.env.true_parameters()._asdict(), True)
    *_, told = new.reset()
    _same(told["surefoot"]["parameters"], infos["surefoot"]["parameters"], False)
    new.freeze()
    assert new.frozen
    for _ in range(20):
        *_, told = new.step(still)
    kept = told["surefoot"]["parameters"]
    for _ in range(20):
        seen, *_, told = new.step(still)
    _same(told["surefoot"]["parameters"], kept, False)
    force = kept["scale"] * [robot.raw for robot in new.env.sensors.robots] + kept["offset"]
    np.testing.assert_allclose(seen["foot_force"], force, atol=2e-3)
    three = _many([*robots, robots[0]], {}, {"method": method}, AutoresetMode.NEXT_STEP)
    three.reset(seed=1)
    with pytest.raises(ValueError, match="holds the state of 2 robot"):
        three.load(tmp_path / "learnt.npz")


@pytest.mark.parametrize("method", ["moment", "window"])
def test_of_robots_that_have_learnt_nothing_one_is_told(method: str) -> None:
    """All lie on the floor; the library's way and Python's."""
    many = _many([partial(_bare, "NaoStand", 400)] * 2, {}, {"method": method}, AutoresetMode.DISABLED)
    many.reset(seed=0)
    for robot in many.calibration.robots:
        for _ in range(850):
            robot._chances.add(False, False)
    told_why = "has learnt nothing in 11 s, .* sure of its motion .* in 0 % .* in 0 %, 0.0 s at most"
    with pytest.warns(UserWarning, match=told_why) as told:
        many.reset()
    assert len(told) == 1
    many.reset()


def test_tare_of_a_robot_that_only_stands_asks_for_a_lifted_foot() -> None:
    env = SelfCalibration(FootSensors(gym.make("surefoot/NaoStand-v0", duration=30.0)), "tare")
    env.reset(seed=0)
    for _ in range(850):
        env.step(np.zeros(env.action_space.shape, np.float32))
    with pytest.warns(UserWarning, match=r"'tare' learns the offsets of a foot while .* Lift each foot once"):
        env.reset()
