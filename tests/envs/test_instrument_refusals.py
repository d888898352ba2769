"""Robots and environments that are refused before the first step, and the way out."""

from copy import deepcopy

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from _refusals import refusals
from _toy import LEGS, TOY, Toy, warned

from surefoot.envs import InstrumentedEnv, instrument


def test_another_model_made_at_a_reset_is_refused(path):
    class Fickle(Toy):
        def reset(self, **given):
            self.make()
            return super().reset(**given)

    env = InstrumentedEnv(Fickle(fullpath=path))
    with pytest.raises(RuntimeError, match="Fickle has made another model at a reset"):
        env.reset()


def test_bad_input_is_refused_before_the_first_step(path):
    with pytest.raises(TypeError, match=r"on MuJoCo, .* CartPoleEnv has no 'model', no 'data'\. Give an"):
        InstrumentedEnv(gym.make("CartPole-v1"))
    with pytest.raises(ValueError, match="No left and right foot could be found"):
        InstrumentedEnv(gym.make("Ant-v5"))
    for in_place in (None, False):
        with pytest.raises(ValueError, match=r"each once, got \['paw'\]; the model's bodies are \['torso'"):
            InstrumentedEnv(gym.make("Humanoid-v5"), ["paw"], in_place=in_place)
        with pytest.raises(ValueError, match=r"no area: .* give it a flat geom: InstrumentedEnv\("):
            InstrumentedEnv(gym.make("Humanoid-v5"), cells={"left_foot": np.zeros((4, 2))}, in_place=in_place)
    for feet, got in (("left_foot", "a string"), (1, "1"), ([1, 2], r"\[1, 2\]"), (b"ab", "b'ab'")):
        with pytest.raises(TypeError, match=f"'feet' must be a sequence of names of bodies.* got {got}"):
            InstrumentedEnv(gym.make("Humanoid-v5"), feet)
    once = InstrumentedEnv(Toy(fullpath=path))
    with pytest.raises(ValueError, match="is instrumented already: use it as it is"):
        InstrumentedEnv(once)
    with pytest.raises(ValueError, match="begin with 'surefoot/' already"):
        InstrumentedEnv(once.env)


@pytest.mark.parametrize(
    ("name", "feet", "match"),
    [
        ("Hopper-v5", None, r"only 'foot' is at the ground\. InstrumentedEnv\(env, feet=\('foot',\)\) tells"),
        (
            "Ant-v5",
            None,
            r"4 of them are equally low, .* feet=\(first, second, \.\.\.\)\..*'body 4 without a name'",
        ),
        ("HalfCheetah-v5", None, "'bfoot' and 'ffoot' do not lie side by side.* name them: feet="),
        (
            "HumanoidStandup-v5",
            None,
            "lower_arm' are lowest, but in its zero pose the robot lies: .*keyframe",
        ),
        (
            "HumanoidStandup-v5",
            ["left_foot", "right_foot"],
            "does not stand on them in its zero pose: its centre of mass is",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:.*settotalmass")
def test_robots_that_do_not_stand_on_two_feet_are_told_what_they_can_do(name, feet, match):
    with pytest.raises(ValueError, match=match):
        InstrumentedEnv(gym.make(name), feet)


def test_the_way_out_of_a_hopper_is_open():
    env = InstrumentedEnv(gym.make("Hopper-v5"), ("foot",))
    env.reset(seed=0)
    loads = [env.step(np.zeros(3))[4]["surefoot"]["truth"]["vgrf"][0] for _ in range(30)]
    assert max(loads) > 10.0


def test_the_way_out_of_a_robot_that_was_drawn_lying_is_open():
    bare = gym.make("HumanoidStandup-v5")
    spec = mujoco.MjSpec.from_file(bare.unwrapped.fullpath)
    half = np.sqrt(0.5)
    spec.add_key(name="stand", qpos=[0.0, 0.0, 1.3, half, 0.0, half, 0.0, *np.zeros(17)])
    env = InstrumentedEnv(bare, ("left_foot", "right_foot"), spec=spec)
    assert not env.untouched
    # Its soles look away from the head, which lies along -x, and its toes point to where its belly is.
    for foot in env.instrumentation.feet:
        np.testing.assert_allclose(foot.R_foot_sole[:, 2], (-1.0, 0.0, 0.0), atol=0.02)
        np.testing.assert_allclose(foot.R_foot_sole[:, 0], (0.0, 0.0, 1.0), atol=0.02)
    other = gym.make("HumanoidStandup-v5")
    np.testing.assert_array_equal(env.reset(seed=3)[0], other.reset(seed=3)[0])
    for _ in range(10):
        action = env.action_space.sample()
        np.testing.assert_array_equal(env.step(action)[0], other.step(action)[0])
    # Soles are put under feet as they stand there, and not as they lie.
    soled = InstrumentedEnv(gym.make("HumanoidStandup-v5"), soles=True, spec=spec)
    assert all(len(foot.polygon) == 4 for foot in soled.instrumentation.feet)


@pytest.mark.parametrize(
    ("extra", "match"),
    [
        ('<joint name="more" axis="1 0 0"/>', "the one hangs on 3 joints and the other on 2"),
        ('<geom size="0.02" pos="0 0 -0.5"/>', "'trunk' is lower than 'foot_l' and 'foot_r'"),
    ],
    ids=["unlike", "lower"],
)
def test_a_pair_that_is_no_pair_of_feet_is_refused_and_may_be_named(extra, match):
    text = TOY.format(site="", legs=LEGS, end="")
    where = '<joint name="l"' if "joint" in extra else '<geom size="0.1" mass="5"/>'
    text = text.replace(where, extra.replace("-0.5", "-0.9") + where)
    spec = mujoco.MjSpec.from_string(text)
    with pytest.raises(ValueError, match=match + r".* name them: feet=\(left, right\)"):
        instrument(spec)
    assert [foot.body for foot in instrument(spec, ("foot_l", "foot_r")).feet] == ["foot_l", "foot_r"]


class Physics:
    """Holds a robot as dm_control's physics does."""

    class Held:
        def __init__(self, ptr):
            self.ptr = ptr

    def __init__(self, xml):
        self.model = self.Held(mujoco.MjModel.from_xml_string(xml))
        self.data = self.Held(mujoco.MjData(self.model.ptr))


class Controlled(Toy):
    """An environment of dm_control, as shimmy shows it."""

    def make(self):
        self.physics = Physics(self.xml)

    def control_timestep(self):
        return self.frame_skip * self.physics.model.ptr.opt.timestep

    def reset(self, *, seed=None, options=None):
        mujoco.mj_resetData(self.physics.model.ptr, self.physics.data.ptr)
        return self.physics.data.ptr.qpos.copy(), {}

    def step(self, action):
        mujoco.mj_step(self.physics.model.ptr, self.physics.data.ptr, self.frame_skip)
        return self.physics.data.ptr.qpos.copy(), 0.0, False, False, {}


def test_dm_controls_physics_is_read_beside():
    with warned("dm_control's physics holds it"):
        env = InstrumentedEnv(Controlled())
    own = InstrumentedEnv(Toy(), in_place=False)
    assert env.dt == own.dt
    assert env.untouched == "dm_control's physics holds it"
    env.reset(seed=0)
    own.reset(seed=0)
    for _ in range(20):
        env.step(None)
        own.step(None)
        np.testing.assert_array_equal(env.truth.rows, own.truth.rows)
    assert env.truth.vgrf().sum() > 10.0
    copy = deepcopy(env)
    copy.step(None)
    env.step(None)
    np.testing.assert_array_equal(copy.truth.rows, env.truth.rows)
    copy.unwrapped.make()
    with pytest.raises(TypeError, match="copied to another model, which nobody watches"):
        deepcopy(copy)
    with pytest.raises(ValueError, match="dm_control's physics cannot exchange"):
        InstrumentedEnv(Controlled(), soles=True)


test_options_that_name_no_feet_are_refused = refusals(
    lambda options: InstrumentedEnv(gym.make("Humanoid-v5"), **options),
    ({"cells": [(0.0, 0.0)]}, "'cells' must map the bodies of feet to places of four cells"),
    ({"soles": ["left_foot"]}, "'soles' must be True, or map the bodies of feet"),
    error=TypeError,
)
