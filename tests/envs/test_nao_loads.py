"""Balancing and carrying: a quiet stand, a command, and a load that nobody announces."""

from functools import partial

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from _refusals import refusals

import surefoot  # noqa: F401
from surefoot.envs.biped import effort
from surefoot.envs.nao.disturbances import Payload
from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.envs.nao.stand import LARGEST_SWAY
from surefoot.envs.nao.sway import FADE_TIME, RandomSway
from surefoot.envs.nao.walk import NaoWalkEnv
from surefoot.envs.observation import Seen
from surefoot.envs.robots.nao import load_nao_spec

ZERO = np.zeros(11, dtype=np.float32)
CALM = {"push_impulse": (0.0, 0.0), "joint_noise": 0.0, "velocity_noise": 0.0}
SHORT = {"speeds": (0.04,), "stand_time": 0.5, "duration": 2.5, "payload_time": (0.1, 0.3)}


def task(name, **options):
    return gym.make(f"surefoot/Nao{name}-v0", disable_env_checker=True, **options).unwrapped


balance, carry = partial(task, "Balance"), partial(task, "Carry")
PAYLOAD_BOXES = gym.spec("surefoot/NaoCarry-v0").kwargs["payload_boxes"]


def run(env, seed, steps, action=ZERO):
    env.reset(seed=seed)
    return [env.step(action) for _ in range(steps)]


def test_a_sway_is_still_first_and_its_derivatives_are_its_derivatives():
    sway = RandomSway.draw((0.02, 0.03), (0.5, 1.0), (0.8, 0.9), 1.0, np.random.default_rng(0))
    pelvis, motion = sway.at(1.0)
    for part in (pelvis, *motion):
        np.testing.assert_array_equal(part, 0.0)
    step = 1e-4
    for time in (1.0 + 1e-3, 1.7, 1.0 + FADE_TIME, 4.2, 9.0):
        before, now, after = (np.array(sway.at(time + shift)[1]) for shift in (-step, 0.0, step))
        np.testing.assert_allclose(now[1], (after[0] - before[0]) / (2 * step), atol=1e-5)
        np.testing.assert_allclose(now[2], (after[1] - before[1]) / (2 * step), atol=1e-5)
    places = np.array([sway.at(time)[1][0] for time in np.arange(0.0, 60.0, 0.05)])
    assert (np.abs(places) <= (0.02, 0.03)).all()
    assert (np.abs(places).max(axis=0) > (0.005, 0.007)).all()


def test_the_hard_version_draws_heavier_loads_in_wider_places():
    env = task("BalanceHard")
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
    env = balance(stand_time=0.5, duration=6.0, payload_mass=(0.0, 0.0), **CALM)
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
            env = balance(stand_time=0.5, payload_time=(0.3, 0.3), payload_mass=mass, sway=(0, 0), **CALM)
            steps.append(run(env, seed, 240)[-1][0])
        layout = env.state_layout
        moved.append(np.linalg.norm(steps[1]["cop"] - steps[0]["cop"]))
        joints = [step["state"][layout["joint_position"]] for step in steps]
        turned.append(np.abs(joints[1] - joints[0]).max())
    assert min(moved) > 0.003
    assert max(turned) < 0.005


def test_ten_millimetres_clearly_cost():
    env = balance(stand_time=0.0, **CALM)
    seen = Seen(*np.zeros(len(Seen._fields)))._replace(cop_valid=1.0)
    paid = [env.reward(seen._replace(cop_error_forward=off))["reward_cop"] for off in (0.0, 0.01)]
    assert paid[0] == pytest.approx(2.0, abs=1e-3)
    assert paid[0] - paid[1] > 0.7
    assert env.reward(seen._replace(cop_valid=0.0))["reward_cop"] == 0.0
    assert env.reward(seen._replace(effort=effort(np.ones(11))))["reward_action"] == pytest.approx(-0.1)


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


def test_speed_and_load_are_drawn():
    env = carry(**(SHORT | {"speeds": (0.02, 0.04)}))
    masses, places, lengths = [], [], set()
    for seed in range(12):
        env.reset(seed=seed)
        masses.append(env._payload.mass)
        places.append(env._payload.position)
        lengths.add(float(np.ptp(env.pattern.com[:, 0]).round(6)))
    low, high = PAYLOAD_BOXES[0]
    assert 0.5 <= min(masses) < 0.56
    assert 0.64 < max(masses) <= 0.7
    assert (np.array(places) >= low).all()
    assert (np.array(places) <= high).all()
    assert (np.ptp(places, axis=0) > 0.5 * np.subtract(high, low)).all()
    assert len(lengths) == 2


@pytest.mark.parametrize("behind", [True, False])
@pytest.mark.slow
def test_a_load_of_the_hard_version_fells_who_does_nothing(behind):
    falls = {}
    for name in ("surefoot/NaoCarry-v0", "surefoot/NaoCarryHard-v0"):
        options = CALM | {"speeds": (0.04,), "stand_time": 0.5, "duration": 10.0, "payload_time": (1.0, 1.1)}
        env = gym.make(name, **options).unwrapped
        for seed in range(20):
            env.reset(seed=seed)
            if (env._payload.position[0] < 0.0) == behind:
                break
        steps = [env.step(ZERO) for _ in range(800)]
        falls[name] = (
            [fell for _, _, fell, *_ in steps].index(True) / 80 if any(s[2] for s in steps) else None
        )
    assert falls["surefoot/NaoCarry-v0"] is None
    assert 2.0 < falls["surefoot/NaoCarryHard-v0"] < 10.0


def test_it_walks_from_the_end_of_the_stand_to_the_end_of_the_episode():
    env = carry(**(SHORT | CALM | {"payload_mass": (0.0, 0.0)}))
    steps = run(env, 0, 200)
    stance = np.array([o["state"][env.state_layout["stance"]] for o, *_ in steps])
    error = [np.linalg.norm(o["cop"] - o["state"][env.state_layout["cop_reference"]]) for o, *_ in steps]
    assert (stance[:40] == 1.0).all()
    assert (stance[40:120].sum(axis=1) == 1.0).any()
    assert (stance[136:].sum(axis=1) == 1.0).any()
    assert np.sqrt(np.mean(np.square(error))) < 0.004
    assert [truncated for *_, truncated, _ in steps] == [False] * 199 + [True]
    # Where the plan would stop is not seen any more.
    assert env.command.com_velocity[0] > 0.02


def test_without_load_the_zero_action_is_the_walk_of_its_sibling():
    carrying = carry(**(SHORT | CALM | {"payload_mass": (0.0, 0.0)}))
    carrying.reset(seed=0)
    # An episode of 2.5 s ends before the last three steps and the last stand of its plan.
    walk = NaoWalkEnv(speed=0.04, duration=2.5 + 3 * 0.8 + 0.5, stand_time=0.5, **CALM)
    assert carrying.pattern is walk.pattern


def test_a_load_moves_the_centre_of_pressure():
    cops = []
    for mass in ((0.0, 0.0), (1.2, 1.2)):
        env = carry(**(SHORT | CALM | {"payload_mass": mass}))
        cops.append(np.array([o["cop"] for o, *_ in run(env, 3, 120)[60:]]))
        assert env.model.body_subtreemass[0] == pytest.approx(5.305 + mass[0], abs=1e-3)
    assert np.linalg.norm((cops[1] - cops[0]).mean(axis=0)) > 0.003


def test_the_centre_of_pressure_pays_as_much_as_all_the_rest():
    env = carry(**(SHORT | CALM))
    *_, info = run(env, 0, 20)[-1]
    assert info["reward_cop"] == pytest.approx(3.0, abs=0.05)
    assert sum(info[term] for term in info if term.startswith("reward_")) == pytest.approx(6.0, abs=0.1)


@pytest.mark.parametrize(
    ("make", "push"),
    [
        (partial(balance, stand_time=0.5, payload_time=(0.0, 0.0)), 2.0),
        (partial(carry, **(SHORT | {"payload_time": (0.0, 0.0)})), 1.0),
    ],
)
def test_nobody_acts_and_nothing_comes_during_the_quiet_stand(make, push):
    env = make(push_impulse=(push, push), push_interval=0.05)
    acted, still = run(env, 2, 50, np.ones(11, dtype=np.float32)), run(env, 2, 50)
    # Later, when nothing is to come, it is the same stand.
    calm = run(make(push_impulse=(push, push), push_interval=500.0, payload_time=(9.0, 9.0)), 2, 40)
    for (a, *_, info), (b, *_), (c, *_) in zip(acted[:40], still[:40], calm, strict=True):
        np.testing.assert_array_equal(a["state"], b["state"])
        np.testing.assert_array_equal(b["state"], c["state"])
        assert info["reward_action"] == 0.0
    assert not np.array_equal(acted[49][0]["state"], still[49][0]["state"])
    assert env.model.body_subtreemass[0] > 5.7


test_it_refuses = refusals(
    lambda make, options: make(**options),
    (balance, {"sway": (0.1, 0.0)}, f"at most {LARGEST_SWAY}"),
    (balance, {"sway_share": (1.0, 0.5)}, "'sway_share'"),
    (balance, {"payload_boxes": ((0.0, 0.0, 0.1),)}, "'payload_boxes' must be boxes of a lowest and a"),
    (carry, {"speeds": ()}, "'speeds'"),
    (carry, {"turn_rate": 0.1}, "without 'route' and 'turn_rate'"),
    (carry, {"payload": (0.3, 1.0)}, "either 'payload' or 'payload_mass'"),
)
