"""All sensors of a wrapped robot by the library against the Python that specifies them, side by side."""

import copy
import pickle
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import numpy as np
import pytest

import surefoot  # noqa: F401
from surefoot.envs import FeetTruth
from surefoot.native import SENSORS, Record, compiler
from surefoot.robot import RobotSensors
from surefoot.robot.sensing.native import NativeSensing
from surefoot.robot.sensing.python import PythonSensing
from surefoot.sensors import Fault, LoadCells, Wire
from surefoot.sensors.randomness import Stream
from surefoot.wrappers import FootSensors

CLOSE, STEPS = 1e-9, 25
WIRE = Wire(spike_rate=9.0, packet_loss=0.2, delay=0.02, jitter=0.004, under_way=12)
BROKEN = (
    "at t=0.1 s cell left/2 dies",
    "from t=0 s to t=0.9 s cell left/3 drops 40 % in gaps of 0.1 s",
    "at t=0.2 s cell right/1 spikes 20 /s by 9 N",
    "at t=0.5 s cell right/3 swaps with left/1",
)
CASES: dict[str, dict[str, Any]] = {
    "usual": {},
    "cells that remember": {
        "config": LoadCells(settling=4, wire=WIRE, scale_tempco=1e-3, temperature_ramp=0.5)
    },
    "broken": {"config": "hx711-bar-cells", "faults": BROKEN},
    "ankles": {"config": "icub-ftsens", "faults": [Fault("stuck", 7, 0.2), Fault("flipped", 2)]},
    "both": {"ankles": "icub-ftsens", "faults": BROKEN, "severity": 0.5},
    "nobody listens": {"faults": BROKEN, "measure_state": False},
    "a robot of others": {"soles": True, "ankles": "icub-ftsens"},
    "shear": {"config": LoadCells(shear_std=0.05), "ankles": "icub-ftsens"},
    "a robot of others with shear": {"soles": True, "config": LoadCells(shear_std=0.05, capacity=500.0)},
    "a cell a foot with shear": {
        "soles": True,
        "config": LoadCells(channels=2, polarity=(1,), shear_std=0.05, capacity=900.0),
    },
}

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


def leaves(state: Any) -> list[Any]:
    if isinstance(state, tuple):
        return [leaf for part in state for leaf in leaves(part)]
    return [] if state is None else [state]


def same(one: FootSensors, other: FootSensors) -> None:
    np.testing.assert_allclose(one.raw, other.raw, rtol=CLOSE, atol=CLOSE)
    for mine, theirs in zip(leaves(one.robot.hardware()), leaves(other.robot.hardware()), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=CLOSE, atol=CLOSE)
    for mine, theirs in zip(one.packets, other.packets, strict=True):
        np.testing.assert_allclose(mine.values, theirs.values, rtol=CLOSE, atol=CLOSE)


@pytest.mark.parametrize("case", CASES)
def test_episodes_are_the_same(case: str) -> None:
    """The library's robot is pickled on the way, and Python goes on with its state until the next reset."""
    without, rng = patch.object(SENSORS, "_found", (None,)), np.random.default_rng(0)

    def made() -> FootSensors:
        if "soles" in CASES[case]:
            bare = gym.make("Humanoid-v5", disable_env_checker=True, include_cfrc_ext_in_observation=False)
        else:
            bare = gym.make("surefoot/NaoBalance-v0", disable_env_checker=True)
        return FootSensors(bare, **CASES[case])

    library = made()
    with without:
        python = made()
    fresh = {"surefoot": {"sensors": "fresh"}}
    for seed, options in ((3, None), (None, None), (5, None), (None, fresh)):
        found, _ = library.reset(seed=seed, options=options)
        with without:
            expected, _ = python.reset(seed=seed, options=options)
        for k in range(STEPS):
            assert isinstance(library.robot.backend, NativeSensing) == (k <= 10)
            assert isinstance(python.robot.backend, PythonSensing)
            for part, shown in found.items():
                np.testing.assert_allclose(shown, expected[part], rtol=1e-6, atol=1e-6, err_msg=part)
            same(library, python)
            if k == 5:
                library.robot = pickle.loads(pickle.dumps(copy.deepcopy(library.robot)))
            action = rng.uniform(-0.2, 0.2, library.action_space.shape).astype(np.float32)
            if k == 10:
                library.robot._backend = library.robot.backend.python()
                library.robot._chosen_for = None
            found, *_ = library.step(action)
            with without:
                expected, *_ = python.step(action)


@pytest.mark.parametrize(
    "options", [{"faults": ["at t=0 s cell left/2 dies"] * 17}, {"link": {"delay": 0.2, "jitter": 0.2}}]
)
def test_what_has_no_room_is_read_by_python(options: dict[str, Any]) -> None:
    env = FootSensors(gym.make("surefoot/NaoStand-v0", disable_env_checker=True), **options)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(env.action_space.shape, np.float32))
    assert isinstance(env.robot.backend, PythonSensing)


@pytest.mark.parametrize("config", ["hx711-load-cells", "icub-ftsens"])
def test_steps_may_have_other_substeps(config: str) -> None:
    env = FootSensors(gym.make("surefoot/NaoStand-v0", disable_env_checker=True), config)
    env.reset(seed=0)
    truth, dt = env.source.truth, float(env.source.dt)
    robots = library, python = [RobotSensors(env.robot.equipment, listening=True) for _ in range(2)]
    with patch.object(SENSORS, "_found", (None,)):
        python.reset(truth, dt, seed=0)
    library.reset(truth, dt, seed=0)
    for rows in (2, 10, 300):
        other = FeetTruth(np.resize(truth.rows, (rows, truth.rows.shape[1])), truth.layout)
        for robot in robots:
            robot.step(other)
        np.testing.assert_allclose(library.raw, python.raw, rtol=CLOSE, atol=CLOSE)
        np.testing.assert_allclose(library.newest, python.newest, rtol=CLOSE, atol=CLOSE)
    for first in (other, truth):
        with patch.object(SENSORS, "_found", (None,)):
            python.reset(first, dt)
        library.reset(first, dt)
        np.testing.assert_allclose(library.raw, python.raw, rtol=CLOSE, atol=CLOSE)
        np.testing.assert_allclose(library.newest, python.newest, rtol=CLOSE, atol=CLOSE)
    assert isinstance(library.backend, NativeSensing)
    assert isinstance(python.backend, PythonSensing)


def test_telemetry_is_the_same_by_either(monkeypatch: pytest.MonkeyPatch) -> None:
    """Copied and pickled on the way, as vector environments and checkpoints do."""
    rng = np.random.default_rng(7)
    rows = rng.normal(size=(10, 24)), rng.normal(size=(10, 6))
    seen = []
    for found in (None, SENSORS.installed()):
        monkeypatch.setattr(SENSORS, "installed", lambda found=found: found)
        env = FootSensors(gym.make("surefoot/NaoStand-v0"))
        observation, _ = env.reset(seed=4)
        states = [observation["state"]]
        for _ in range(30):
            observation, *_ = env.step(np.zeros(env.action_space.shape, np.float32))
            states.append(observation["state"])
        backend = env.robot.backend
        kind = type(backend.telemetry_state)
        assert isinstance(backend, NativeSensing) == (found is not None)
        seen.append(np.array(states))
        seen.append([packet.values for packet in copy.deepcopy(env).packets])
        for twin in (copy.deepcopy, lambda part: pickle.loads(pickle.dumps(part))):
            telemetry, state, rng = twin((env.telemetry, backend.telemetry_state, Stream.of(5)))
            assert type(state) is kind
            packets, _ = telemetry.advance(*rows, 31 / 80, state, rng)
            seen.append([packet.values for packet in packets])
    assert kind is Record
    for one, two in zip(seen[:4], seen[4:], strict=True):
        np.testing.assert_allclose(two, one, rtol=1e-6 if one is seen[0] else CLOSE, atol=1e-12)
