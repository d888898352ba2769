"""Feet of several bodies, gravity that is not the Earth's, and simulations that blow up."""

import gymnasium as gym
import mujoco
import numpy as np
import pytest

from surefoot.envs import instrument
from surefoot.envs.instrumentation.reader import FeetReader
from surefoot.wrappers import FootSensors, SelfCalibration

BALL = '<geom type="capsule" fromto="0 0 0 0 0 -.16" size=".03" mass=".5"/>'
SOLE = '<geom type="box" size="{l} .03 .008" pos="{x} 0 0" mass=".2"/>'
TOE = f'<body name="SIDE_toe" pos=".06 0 0">{{joint}}{SOLE.format(l=0.025, x=0.025)}</body>'
HINGE = '<joint name="SIDE_toe" axis="0 1 0" stiffness="20" damping="1"/>'
HEEL = SOLE.format(l=0.05, x=0.005)
FEET = {
    "toe": HEEL + TOE.replace("{joint}", HINGE),
    "welded": HEEL + TOE.replace("{joint}", ""),
    "frame": SOLE.format(l=0.08, x=0.02) + '<body name="SIDE_frame"><site name="SIDE_site"/></body>',
    "heel": SOLE.format(l=0.04, x=0.05)
    + f'<body name="SIDE_heel" pos="-.03 0 0">{SOLE.format(l=0.03, x=-0.01)}</body>',
}


def biped(foot: str, gravity: str = "0 0 -9.81", more: str = "") -> str:
    """Write a robot of 6.4 kg or so whose knees and ankles are stiff springs."""
    legs = "".join(
        f'<body name="{s}_thigh" pos="0 {y} 0"><joint name="{s}_hip" axis="0 1 0" stiffness="900"/>{BALL}'
        f'<body name="{s}_foot" pos="0 0 -.25"><joint name="{s}_ankle" axis="0 1 0" stiffness="900"/>'
        f"{foot.replace('SIDE', s)}"
        "</body></body>"
        for s, y in (("left", 0.06), ("right", -0.06))
    )
    return (
        f'<mujoco><option gravity="{gravity}"/><default><joint damping="9"/></default><worldbody>'
        '<geom type="plane" size="3 3 .1"/><body name="torso" pos="0 0 .26"><freejoint/>'
        f'<geom type="box" size=".05 .08 .08" pos=".01 0 .1" mass="5"/>{more}{legs}'
        "</body></worldbody></mujoco>"
    )


@pytest.mark.parametrize("kind", FEET)
def test_all_bodies_of_a_foot_bear_its_load(kind):
    """A toe on a hinge, a heel or a welded body presses on the ground for its foot; both readers agree."""
    made = instrument(mujoco.MjSpec.from_string(biped(FEET[kind])))
    assert [foot.body for foot in made.feet] == ["left_foot", "right_foot"]
    model = made.spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 60)
    mujoco.mj_forward(model, data)
    force = made.read(model, data).force_world[..., 2]
    ground, wrench = 0.0, np.zeros(6)
    for k in range(data.ncon):
        assert 0 in data.contact.geom[k]
        mujoco.mj_contactForce(model, data, k, wrench)
        ground += wrench[0]
    weight = 9.81 * model.body_subtreemass[1]
    assert force.sum() == pytest.approx(ground, rel=1e-9)
    assert ground > 0.5 * weight
    beside = FeetReader(model, data).now()
    np.testing.assert_allclose(beside.force_world[0, :, 2], force, rtol=1e-9)
    np.testing.assert_allclose(beside.wrench_sole[0], made.read(model, data).wrench_sole, atol=1e-6 * weight)
    assert np.ptp(made.feet[0].polygon[:, 0]) > 0.12


def test_feet_that_do_not_bear_the_weight_are_refused_with_both_figures():
    """A tail of the robot's own stands on the ground as well."""
    tail = '<geom type="box" size=".02 .02 .01" pos="-.15 0 -.25" mass="3"/>'
    with pytest.raises(ValueError, match=r"weighs 9\d\.\d N, has \d+\.\d N on them\. Name its feet: feet=\("):
        instrument(mujoco.MjSpec.from_string(biped(FEET["frame"], more=tail)))


def test_gravity_is_that_of_the_model():
    """What is drawn has the world's own gravity, which may be tilted but must point down."""
    made = instrument(mujoco.MjSpec.from_string(biped(FEET["frame"], gravity="0 0 -3.7")))
    mass = made.spec.compile().body_subtreemass[1]
    assert made.drawing.gravity == pytest.approx(3.7)
    assert made.drawing.weight == pytest.approx(3.7 * mass)
    tilted = instrument(mujoco.MjSpec.from_string(biped(FEET["frame"], gravity="1.2 0 -3.5")))
    assert tilted.drawing.gravity == pytest.approx(3.7)
    with pytest.raises(ValueError, match=r"Gravity must point down .* got \[8\.0, 0\.0, -5\.8\]"):
        instrument(mujoco.MjSpec.from_string(biped(FEET["frame"], gravity="8 0 -5.8")))


def test_a_simulation_that_blows_up_goes_on_without_a_sample():
    """MuJoCo begins again by itself: time goes back, the reading is lost, and the next ones come."""
    humanoid = gym.make("Humanoid-v5", terminate_when_unhealthy=False, include_cfrc_ext_in_observation=False)
    env = SelfCalibration(FootSensors(humanoid, "icub-force-torque"))
    env.reset(seed=3)
    rest = np.zeros(env.action_space.shape, np.float32)
    for _ in range(4):
        env.step(rest)
    env.unwrapped.data.qvel[9] = 3e13
    env.step(rest)
    assert np.isnan(env.env.raw).all()
    env.step(rest)
    assert np.isfinite(env.env.raw).all()


@pytest.mark.filterwarnings("ignore:.*observation space")
@pytest.mark.parametrize("bad", [np.nan, 7e11])
def test_no_reward_is_nan(bad):
    """A task whose simulation blows up pays a finite reward, and the episode ends."""
    env = gym.make("surefoot/NaoWalk-v0", duration=6.0)
    env.reset(seed=2)
    env.unwrapped.data.qvel[10] = bad
    _, reward, terminated, _, _ = env.step(np.zeros(env.action_space.shape, np.float32))
    assert np.isfinite(reward)
    assert terminated
