"""The carrying task: a quiet stand, a walk to the end, a load that is not announced."""

import gymnasium as gym
import numpy as np
import pytest
from _refusals import refusals

import surefoot  # noqa: F401
from surefoot.envs.nao.carry import COP_SCALE, COP_WEIGHT, PAYLOAD_BOXES, NaoCarryEnv
from surefoot.envs.nao.walk import NaoWalkEnv

ZERO = np.zeros(11, dtype=np.float32)
CALM = {"push_impulse": (0.0, 0.0), "joint_noise": 0.0, "velocity_noise": 0.0}
SHORT = {"speeds": (0.04,), "stand_time": 0.5, "duration": 2.5, "payload_time": (0.1, 0.3)}


def run(env, seed, steps, action=ZERO):
    env.reset(seed=seed)
    return [env.step(action) for _ in range(steps)]


def test_speed_and_load_are_drawn():
    env = NaoCarryEnv(**(SHORT | {"speeds": (0.02, 0.04)}))
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
    env = NaoCarryEnv(**(SHORT | CALM | {"payload_mass": (0.0, 0.0)}))
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
    carry = NaoCarryEnv(**(SHORT | CALM | {"payload_mass": (0.0, 0.0)}))
    carry.reset(seed=0)
    # An episode of 2.5 s ends before the last three steps and the last stand of its plan.
    walk = NaoWalkEnv(speed=0.04, duration=2.5 + 3 * 0.8 + 0.5, stand_time=0.5, **CALM)
    assert carry.pattern is walk.pattern


def test_a_load_moves_the_centre_of_pressure():
    cops = []
    for mass in ((0.0, 0.0), (1.2, 1.2)):
        env = NaoCarryEnv(**(SHORT | CALM | {"payload_mass": mass}))
        cops.append(np.array([o["cop"] for o, *_ in run(env, 3, 120)[60:]]))
        assert env.model.body_subtreemass[0] == pytest.approx(5.305 + mass[0], abs=1e-3)
    assert np.linalg.norm((cops[1] - cops[0]).mean(axis=0)) > 0.003


def test_nobody_acts_and_nobody_pushes_during_the_quiet_stand():
    env = NaoCarryEnv(**(SHORT | {"push_impulse": (1.0, 1.0), "push_interval": 0.05}))
    acted, still = run(env, 2, 50, np.ones(11, dtype=np.float32)), run(env, 2, 50)
    calm = run(NaoCarryEnv(**(SHORT | {"push_impulse": (1.0, 1.0), "push_interval": 500.0})), 2, 40)
    for (a, *_, info), (b, *_), (c, *_) in zip(acted[:40], still[:40], calm, strict=True):
        np.testing.assert_array_equal(a["state"], b["state"])
        np.testing.assert_array_equal(b["state"], c["state"])
        assert info["reward_action"] == 0.0
    assert not np.array_equal(acted[49][0]["state"], still[49][0]["state"])


def test_the_centre_of_pressure_pays_as_much_as_all_the_rest():
    env = NaoCarryEnv(**(SHORT | CALM))
    *_, info = run(env, 0, 20)[-1]
    assert info["reward_cop"] == pytest.approx(COP_WEIGHT, abs=0.05)
    assert sum(info[term] for term in info if term.startswith("reward_")) == pytest.approx(6.0, abs=0.1)
    # The walk of the sibling is paid by its own, wider scale.
    assert NaoWalkEnv.cop_scale > NaoCarryEnv.cop_scale == COP_SCALE


test_it_refuses = refusals(
    lambda options: NaoCarryEnv(**options),
    ({"speeds": ()}, "'speeds'"),
    ({"speeds": (0.04, 9.0)}, "'speed'"),
    ({"payload_mass": (0.5, 0.1)}, "'payload_mass'"),
    ({"payload_time": (-1.0, 0.1)}, "'payload_time'"),
    ({"stand_time": 0.0}, "'stand_time'"),
    ({"duration": -1.0}, "'duration'"),
)


test_it_refuses_what_it_draws_or_does_not_know = refusals(
    lambda options: NaoCarryEnv(**options),
    ({"payload": (0.3, 1.0)}, "NaoCarryEnv draws its payload"),
    ({"turn_rate": 0.1}, "turn_rate"),
    error=TypeError,
)
