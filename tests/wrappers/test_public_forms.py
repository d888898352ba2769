"""Environments and robots in the forms in which people publish them, one line each, under one contract.

Whatever the form: the episode is the bare one's, a step lasts as long as it does, the feet carry the weight,
cells read the truth, and the robot's beliefs have its mass and know its posture.
"""

from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from _bipeds import LIGHT, ROBOTS, TRUNK, WELDED, biped
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.vector import SyncVectorEnv

from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.wrappers import (
    FootSensors,
    SelfCalibration,
    TruthRow,
    VectorFootSensors,
    VectorSelfCalibration,
)


class Own(gym.Env):
    """An environment of one's own; a form overrides what it has of its own."""

    frame_skip: Any = 5

    def __init__(self, path: str) -> None:
        self.fullpath = path
        self.model = mujoco.MjModel.from_xml_path(path)
        self.data = mujoco.MjData(self.model)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (self.model.nu,), np.float64)
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (self.model.nq,), np.float64)
        self.prepare()

    def prepare(self) -> None:
        """Do what a form does in its constructor."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.begin()
        mujoco.mj_forward(self.model, self.data)
        return self.data.qpos.copy(), {}

    def begin(self) -> None:
        mujoco.mj_resetData(self.model, self.data)

    def step(self, action):
        self.data.ctrl[:] = action
        self.simulate()
        return self.data.qpos.copy(), 0.0, False, False, {}

    def simulate(self) -> None:
        for _ in range(self.frame_skip):
            mujoco.mj_step(self.model, self.data)


class TimestepIsDt(Own):
    def prepare(self):
        self.dt = self.model.opt.timestep


class DtAlone(Own):
    frame_skip = property()  # raises AttributeError

    def prepare(self):
        self.dt, self.count = 0.01, 5

    def simulate(self):
        mujoco.mj_step(self.model, self.data, self.count)


class Decimation(Own):
    frame_skip = property()

    def prepare(self):
        self.sim_dt, self.decimation = self.model.opt.timestep, 5

    def simulate(self):
        mujoco.mj_step(self.model, self.data, self.decimation)


class DtIsThePolicysInMs(Decimation):
    dt = 10


class UntilTime(Own):
    frame_skip = None

    def simulate(self):
        end = self.data.time + 0.0099
        while self.data.time < end:
            mujoco.mj_step(self.model, self.data)


class DataAtEachReset(Own):
    def begin(self):
        self.data = mujoco.MjData(self.model)


class Randomised(Own):
    """Masses differ from episode to episode."""

    def begin(self):
        super().begin()
        self.randomise(self.np_random)


class InAClosure(Randomised):
    def prepare(self):
        model, mass = self.model, self.model.body_mass.copy()
        self.randomise = lambda rng: model.body_mass.__setitem__(slice(None), mass * rng.uniform(0.8, 1.2))


class ViewInAClosure(Randomised):
    def prepare(self):
        mass, drawn = self.model.body_mass, self.model.body_mass.copy()

        def randomise(rng):
            mass[:] = drawn * rng.uniform(0.8, 1.2)

        self.randomise = randomise


def _scale(model, mass, rng):
    model.body_mass[:] = mass * rng.uniform(0.8, 1.2)


class InAPartial(Randomised):
    def prepare(self):
        self.randomise = partial(_scale, self.model, self.model.body_mass.copy())


class Slotted:
    __slots__ = ("mass", "model")

    def __init__(self, model):
        self.model, self.mass = model, model.body_mass.copy()

    def apply(self, rng):
        _scale(self.model, self.mass, rng)


class InAMethod(Randomised):
    def prepare(self):
        self.hooks = {"reset": [[Slotted(self.model).apply]]}
        self.randomise = lambda rng: self.hooks["reset"][0][0](rng)


class Gymnasiums(MujocoEnv):
    metadata = {  # noqa: RUF012
        "render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
        "render_fps": 100,
    }

    def __init__(self, path: str) -> None:
        size = mujoco.MjModel.from_xml_path(path).nq
        super().__init__(path, 5, gym.spaces.Box(-np.inf, np.inf, (size,), np.float64))

    def reset_model(self):
        self.set_state(self.init_qpos, self.init_qvel)
        return self.data.qpos.copy()

    def step(self, action):
        self.do_simulation(action, self.frame_skip)
        return self.data.qpos.copy(), 0.0, False, False, {}


ENVIRONMENTS = {
    kind.__name__: (kind, biped())
    for kind in (
        *(Gymnasiums, Own, TimestepIsDt, DtAlone, Decimation, DtIsThePolicysInMs, UntilTime, DataAtEachReset),
        *(InAClosure, ViewInAClosure, InAPartial, InAMethod),
    )
}
FORMS = ENVIRONMENTS | {name: (Gymnasiums, text) for name, text in ROBOTS.items()}
PERFECT: dict[str, Any] = {"config": "perfect", "imu": "perfect", "encoders": "perfect", "link": "perfect"}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.filterwarnings("ignore:The feet of .* are read once a control step")
@pytest.mark.filterwarnings("ignore:'gravcomp' of the bodies")
def test_a_published_form_is_exact(form: str, tmp_path: Path) -> None:
    kind, text = FORMS[form]
    path = tmp_path / "robot.xml"
    path.write_text(text)
    bare = kind(str(path))
    env = SelfCalibration(
        FootSensors(kind(str(path)), **PERFECT), errors=NO_ERRORS, show=("foot_raw", "vgrf")
    )
    for seed in (1, 2):
        bare.reset(seed=seed)
        env.reset(seed=seed)
        loads, read = [], []
        for k in range(100):
            sway = 0.02 * np.sin(0.1 * k)
            action = np.array([sway, 0.0, -sway, 0.0] * 2)
            before = bare.data.time
            bare.step(action)
            seen, *_, info = env.step(action)
            told = info["surefoot"]
            loads.append(told["truth"]["vgrf"])
            read.append(seen["foot_raw"] - told["truth"]["force_cell"])
        np.testing.assert_array_equal(env.unwrapped.data.qpos, bare.data.qpos)
        np.testing.assert_array_equal(env.unwrapped.model.body_mass, bare.model.body_mass)
        left_alone = env.get_wrapper_attr("untouched")
        assert len(env.get_wrapper_attr("truth").rows) == (1 if left_alone else 5)
        assert not left_alone or "holds a view of it" in left_alone
        drawing, model = env.get_wrapper_attr("drawing"), bare.model
        assert env.get_wrapper_attr("dt") == pytest.approx(bare.data.time - before)
        assert drawing.feet == ("left_foot", "right_foot")
        carried = model.body_mass * (1.0 - model.body_gravcomp)
        weight = np.linalg.norm(model.opt.gravity) * carried.sum()
        vertical = -model.opt.gravity[2] * carried.sum()
        assert np.sum(loads[50:], axis=1).mean() == pytest.approx(vertical, rel=0.01)
        assert np.abs(read).max() < 1e-5 * weight
        assert told["reference"]["known"]
        if not isinstance(bare, Randomised):
            assert drawing.weight == pytest.approx(weight)
            assert env.robot.model.mass == pytest.approx(carried.sum())


def written(tmp_path: Path, text: str) -> str:
    path = tmp_path / "robot.xml"
    path.write_text(text)
    return str(path)


def test_changes_by_a_script_that_kept_the_model_count(tmp_path: Path) -> None:
    """What a script changes in the model that was replaced counts in the one with sensors."""
    path = written(tmp_path, biped())
    bare, base = Own(path), Own(path)
    scripts = bare.model, base.model
    gravity = [model.opt for model in scripts]
    env = FootSensors(base, "perfect")
    assert base.model is not scripts[1]
    for seed in (1, 2):
        for model, option in zip(scripts, gravity, strict=True):
            model.body_mass[1] *= 1.2
            model.geom_friction[:, 0] = 0.5
            option.gravity[2] = -9.0 - 0.2 * seed
        bare.reset(seed=seed)
        env.reset(seed=seed)
        for _ in range(5):
            bare.step(np.zeros(8))
            env.step(np.zeros(8))
        scripts[0].body_mass[1] = scripts[1].body_mass[1] = 9.0
        for _ in range(5):
            bare.step(np.zeros(8))
            env.step(np.zeros(8))
        np.testing.assert_array_equal(env.unwrapped.data.qpos, bare.data.qpos)


def packets_of_a_start(env: FootSensors) -> np.ndarray:
    """Return the accelerometer of the packets that were sent before a reset."""
    env.reset(seed=1)
    return np.array([packet.values[env.robot.telemetry.layout.accelerometer] for packet in env.packets])


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (-1.2, 0.6, -9.7), (0.3, 0.4, -3.0)])
def test_packets_before_a_reset_are_of_a_robot_at_rest(tmp_path: Path, gravity: tuple[float, ...]) -> None:
    """Their specific force points against the gravity of the episode, which a script may have tilted."""
    base = Own(written(tmp_path, biped()))
    env = FootSensors(base, "perfect")
    env.listen()
    base.model.opt.gravity[:] = gravity
    measured = packets_of_a_start(env)
    assert len(measured) > 1
    up = env.source.truth.R_world_torso[-1].T @ np.negative(gravity)
    np.testing.assert_allclose(measured.mean(axis=0), up, atol=0.1)


KEPT: list[Any] = []


class Elsewhere(Own):
    """Randomises a model that is kept where nobody can look for it."""

    def prepare(self):
        KEPT[:] = [self.model]

    def begin(self):
        super().begin()
        if self.np_random_seed == 3:
            KEPT[0].body_mass[2] *= 1.1


def test_changes_that_come_to_nothing_within_a_reset_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, biped())
    env = FootSensors(Elsewhere(path), "perfect")
    env.reset(seed=1)
    with pytest.raises(RuntimeError, match=r"Elsewhere has changed \['body_mass'\] .* in_place=False\)"):
        env.reset(seed=3)
    KEPT.clear()


def test_joints_without_encoders_are_named(tmp_path: Path) -> None:
    ankle = biped()
    for s in ("left", "right"):
        ankle = ankle.replace(f'<joint name="{s}_pitch" axis="0 1 0"/>', "")
        ankle = ankle.replace(
            f'<joint name="{s}_roll" axis="1 0 0"/>', f'<joint name="{s}_roll" type="ball"/>'
        )
        for joint in ("pitch", "roll"):
            ankle = ankle.replace(f'<position joint="{s}_{joint}"/>', "")
    with pytest.raises(ValueError, match=r"and its feet; got \['left_roll', 'right_roll'\], of another kind"):
        SelfCalibration(FootSensors(Gymnasiums(written(tmp_path, ankle)), "perfect"))
    lift = WELDED.replace(TRUNK, '<joint name="lift" type="slide" axis="0 0 1" stiffness="9e4"/>' + TRUNK)
    lift = biped(LIGHT.format(1.0, 0.01, 0.01, 0.01) + lift)
    with pytest.warns(
        UserWarning, match=r"joints \['lift'\] have no encoders: .* 5\d % of its mass, stays in"
    ):
        SelfCalibration(FootSensors(Gymnasiums(written(tmp_path, lift)), "perfect"))
    with pytest.warns(
        UserWarning, match=r"'gravcomp' of the bodies \['left_arm', 'right_arm'\] carries 17\.7 N"
    ):
        SelfCalibration(FootSensors(Gymnasiums(written(tmp_path, ROBOTS["weightless arms"])), "perfect"))
    with pytest.raises(ValueError, match="'gravcomp' of the robot's bodies carries all of its weight"):
        FootSensors(Gymnasiums(written(tmp_path, biped().replace("<body ", '<body gravcomp="1" '))))


@pytest.mark.parametrize("kind", [TimestepIsDt, Decimation])
def test_vectors_of_published_forms_know_how_long_a_step_lasts(kind: Any, tmp_path: Path) -> None:
    path = written(tmp_path, biped())
    envs = SyncVectorEnv([lambda: TruthRow(kind(path))] * 2)
    env = VectorSelfCalibration(VectorFootSensors(envs, **PERFECT), errors=NO_ERRORS)
    env.reset(seed=0)
    for _ in range(60):
        *_, infos = env.step(np.zeros((2, 8)))
    assert env.env.sensors.time.tolist() == pytest.approx([0.6, 0.6])
    weight = 9.81 * envs.envs[0].unwrapped.model.body_mass.sum()
    truth = infos["surefoot"]["truth"]["vgrf"]
    np.testing.assert_allclose(truth.sum(axis=1), weight, rtol=0.01)
    np.testing.assert_allclose(infos["surefoot"]["vgrf"], truth, atol=0.01 * weight)


class Terrain(Own):
    """Fills its height field in its constructor, and drops the robot on it."""

    def prepare(self):
        self.model.hfield_data[:] = np.linspace(0.0, 1.0, self.model.hfield_data.size)


def test_terrain_that_an_environment_has_filled_stays(tmp_path: Path) -> None:
    field = '<hfield name="ground" nrow="20" ncol="20" size="2 2 0.04 0.1"/>'
    text = biped(height=0.8, floor='<geom type="hfield" hfield="ground"/>', assets=field)
    path = written(tmp_path, text)
    bare, env = Terrain(path), FootSensors(Terrain(path), "perfect")
    bare.reset(seed=0)
    env.reset(seed=0)
    for _ in range(60):
        bare.step(np.zeros(8))
        env.step(np.zeros(8))
    assert env.source.truth.vgrf().max() > 10.0
    np.testing.assert_array_equal(env.unwrapped.data.qpos, bare.data.qpos)
