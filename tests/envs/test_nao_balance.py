"""The balance task: a quiet stand, a command that moves smoothly, a load that only the feet tell of."""

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from _refusals import refusals

import surefoot  # noqa: F401
from surefoot.envs.biped import effort
from surefoot.envs.nao.balance import FADE_TIME, LARGEST_SWAY, NaoBalanceEnv, RandomSway
from surefoot.envs.nao.disturbances import Payload
from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.envs.observation import Seen
from surefoot.envs.robots.nao import load_nao_spec

ZERO = np.zeros(11, dtype=np.float32)
CALM = {"push_impulse": (0.0, 0.0), "joint_noise": 0.0, "velocity_noise": 0.0}


def run(env, seed, steps, action=ZERO):
    env.reset(seed=seed)
    return [env.step(action) for _ in range(steps)]


def test_a_sway_is_still_first_and_its_derivatives_are_its_derivatives():
    sway = RandomSway.draw((0.02, 0.03), (0.5, 1.0), 1.0, np.random.default_rng(0))
    for part in sway.at(1.0):
        np.testing.assert_array_equal(part, 0.0)
    step = 1e-4
    for time in (1.0 + 1e-3, 1.7, 1.0 + FADE_TIME, 4.2, 9.0):
        before, now, after = (np.array(sway.at(time + shift)) for shift in (-step, 0.0, step))
        np.testing.assert_allclose(now[1], (after[0] - before[0]) / (2 * step), atol=1e-5)
        np.testing.assert_allclose(now[2], (after[1] - before[1]) / (2 * step), atol=1e-5)
    places = np.array([sway.at(time)[0] for time in np.arange(0.0, 60.0, 0.05)])
    assert (np.abs(places) <= (0.02, 0.03)).all()
    assert (np.abs(places).max(axis=0) > (0.005, 0.007)).all()


def test_the_hard_version_draws_heavier_loads_in_wider_places():
    env = gym.make("surefoot/NaoBalanceHard-v0").unwrapped
    masses, places, sways = [], [], []
    for seed in range(12):
        env.reset(seed=seed)
        masses.append(env._payload.mass)
        places.append(env._payload.position)
        sways.append(np.sum(env.state.plan.waves, axis=1)[:, 0])
    assert 1.0 <= min(masses) < max(masses) <= 1.4
    assert 0.15 < np.abs(places).max() <= 0.2
    assert (0.8 * np.array((0.065, 0.045)) <= sways).all()
    assert (sways <= np.array((0.065, 0.045))).all()


def test_without_load_and_pushes_the_pattern_alone_follows_the_command():
    env = NaoBalanceEnv(stand_time=0.5, duration=6.0, payload_mass=(0.0, 0.0), **CALM)
    error = [
        np.linalg.norm(o["cop"] - o["state"][env.state_layout["cop_reference"]])
        for o, *_ in run(env, 1, 480)[40:]
    ]
    assert np.sqrt(np.mean(np.square(error))) < 0.002


def test_a_load_moves_the_centre_of_pressure_and_hardly_the_joints():
    moved, turned = [], []
    for seed in (1, 2, 3):
        steps = []
        for mass in ((0.0, 0.0), (1.0, 1.0)):
            env = NaoBalanceEnv(
                stand_time=0.5, payload_time=(0.3, 0.3), payload_mass=mass, sway=(0, 0), **CALM
            )
            steps.append(run(env, seed, 240)[-1][0])
        layout = env.state_layout
        moved.append(np.linalg.norm(steps[1]["cop"] - steps[0]["cop"]))
        joints = [step["state"][layout["joint_position"]] for step in steps]
        turned.append(np.abs(joints[1] - joints[0]).max())
    assert min(moved) > 0.003
    assert max(turned) < 0.005


def test_nobody_acts_and_nothing_comes_during_the_quiet_stand():
    env = NaoBalanceEnv(stand_time=0.5, push_impulse=(2.0, 2.0), push_interval=0.05, payload_time=(0.0, 0.0))
    full = np.ones(11, dtype=np.float32)
    acted, still = run(env, 2, 50, full), run(env, 2, 50)
    for (a, *_, info), (b, *_) in zip(acted[:40], still[:40], strict=True):
        np.testing.assert_array_equal(a["state"], b["state"])
        assert info["reward_action"] == 0.0
    assert not np.array_equal(acted[49][0]["state"], still[49][0]["state"])
    assert env.model.body_subtreemass[0] > 5.7
    # Later, when nothing is to come, it is the same stand.
    later = NaoBalanceEnv(
        stand_time=0.5, push_impulse=(2.0, 2.0), push_interval=500.0, payload_time=(9.0, 9.0)
    )
    np.testing.assert_array_equal(still[39][0]["state"], run(later, 2, 40)[-1][0]["state"])


def test_ten_millimetres_clearly_cost():
    env = NaoBalanceEnv(stand_time=0.0, **CALM)
    seen = Seen(*np.zeros(len(Seen._fields)))._replace(cop_valid=1.0)
    paid = [env.reward(seen._replace(cop_error_forward=off))["reward_cop"] for off in (0.0, 0.01)]
    assert paid[0] == pytest.approx(2.0, abs=1e-3)
    assert paid[0] - paid[1] > 0.7
    assert env.reward(seen._replace(cop_valid=0.0))["reward_cop"] == 0.0
    assert env.reward(seen._replace(effort=effort(np.ones(11))))["reward_action"] == pytest.approx(-0.1)


test_it_refuses = refusals(
    lambda options: NaoBalanceEnv(**options),
    ({"sway": (0.1, 0.0)}, f"between 0 and {LARGEST_SWAY}"),
    ({"sway": (0.01,)}, "'sway'"),
    ({"payload_mass": (0.5, 0.1)}, "'payload_mass'"),
    ({"payload_time": (-1.0, 0.1)}, "'payload_time'"),
    ({"stand_time": -1.0}, "'stand_time'"),
    ({"sway_share": (1.0, 0.5)}, "'sway_share'"),
    ({"payload_boxes": ((0.0, 0.0, 0.1),)}, "'payload_boxes' must be boxes of a lowest and a"),
    ({"payload_boxes": ()}, r"shape \(boxes, 2, 3\), at least one"),
)


test_it_refuses_what_it_draws_or_does_not_know = refusals(
    lambda options: NaoBalanceEnv(**options), ({"payload": (0.3, 1.0)}, "payload_mass"), error=TypeError
)


def test_a_planned_payload_adds_its_mass_and_moment_where_it_is():
    model = load_nao_spec().compile()
    payload = Payload(model, None, CONTROL_STEP)
    torso = model.body("torso").id
    mass, centre = float(model.body_mass[torso]), model.body_ipos[torso].copy()
    place = np.array([0.05, -0.1, 0.02])
    payload.plan(0.7, 0.0, place.tolist())
    payload.apply(1)
    assert model.body_mass[torso] == pytest.approx(mass + 0.7)
    np.testing.assert_allclose(
        model.body_ipos[torso] * model.body_mass[torso], mass * centre + 0.7 * place, atol=1e-12
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with pytest.raises(RuntimeError, match="carries a payload"):
        payload.plan(0.1, 0.0)
    payload.reset()
    np.testing.assert_array_equal(model.body_ipos[torso], centre)
