"""Routes: legs that walk, turn and stand, one after another."""

import json
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from _refusals import refusals
from gymnasium.envs.registration import EnvSpec

import surefoot  # noqa: F401
from surefoot.envs.gait.footsteps import GaitTiming
from surefoot.envs.gait.ground import lay_out
from surefoot.envs.gait.pattern import Pattern, plan_route, plan_walk
from surefoot.envs.gait.route import Leg, parse_route, plan_legs
from surefoot.envs.nao.walk import NaoWalkEnv

STAND = Leg(2.0, 0.0, 0.0)
ROUTE = (Leg(2.8, 0.04, 0.0), Leg(1.0, 0.0, 0.0), Leg(2.8, 0.0, 0.2))
TIMING = GaitTiming()
ARRAYS = [name for name, kind in Pattern.__annotations__.items() if "NDArray" in str(kind)]


def ground_of(*legs):
    """What a route means on the ground, without the inverse kinematics, and its footsteps."""
    walks, end = plan_legs(legs, TIMING)
    ground = lay_out(walks, TIMING, end + TIMING.stand_ticks)
    return ground, [step for walk in walks for step in walk.footsteps]


@pytest.mark.parametrize(("speed", "turn_rate"), [(0.04, -0.1), (-0.04, 0.0)])
def test_a_route_of_one_leg_is_that_walk(speed, turn_rate):
    """The walk is 6 s long with a second of standing at either end: the leg takes 4 s."""
    walk, route = plan_walk(speed, turn_rate, 6.0), plan_route((Leg(4.0, speed, turn_rate),), 6.0)
    assert route.footsteps == walk.footsteps
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(route, name), getattr(walk, name), err_msg=name)


def test_the_robot_stands_where_a_leg_stands_and_nowhere_else_for_long():
    route = plan_route(ROUTE)
    standing = slice(304, 384)
    assert route.stance[standing].all()
    assert not np.diff(route.cop[standing], axis=0).any()
    assert not np.diff(route.position_sole[standing], axis=0).any()
    assert (route.phase[standing] == 0.0).all()
    for walking in (slice(80, 304), slice(384, 608)):
        in_air = ~route.stance[walking]
        assert in_air.any(axis=0).all()
        # What a walk leaves of its time is shorter than a step.
        still = np.flatnonzero((np.diff(route.cop[walking], axis=0) != 0.0).any(axis=1))
        assert len(in_air) - still[-1] < 64 + 1
        assert still[0] < 3
    command = route.command(340)
    assert command.stance.all()
    assert not command.swing.any()
    swinging = int(np.flatnonzero(~route.stance[:, 0])[0])
    assert route.command(swinging).swing.tolist() == [True, False]
    assert route.command(swinging).stance.tolist() == [False, True]


def test_walking_legs_flow_into_each_other():
    ground, steps = ground_of(Leg(4.0, 0.04, 0.0), Leg(4.0, 0.02, 0.15), Leg(4.0, 0.04, -0.15))
    feet = [step.foot for step in steps]
    assert all(a != b for a, b in pairwise(feet))
    assert len(feet) == (12 * 80 - 26) // 64
    # Single and double supports alternate without a gap.
    both = ground.stance.all(axis=1)
    lengths = np.diff(np.flatnonzero(np.diff(both)))
    assert set(lengths.tolist()) == {38, 26}


def test_a_route_goes_where_its_legs_lead():
    legs = (Leg(8.0, 0.04, 0.0), STAND, Leg(8.8, 0.0, 0.2), STAND, Leg(8.0, 0.04, 0.0))
    route, _ = ground_of(*legs)
    middle = route.position_sole.mean(axis=1)[:, :2]
    heading = route.yaw_sole.mean(axis=1)
    # Of n steps the first and the last count half, and one closes: n - 2 moves.
    walked, turned = (9 - 2) * 0.032, (10 - 2) * 0.16
    assert heading[-1] == pytest.approx(turned, abs=1e-9)
    start, turning, away = middle[0], middle[10 * 80], middle[-1]
    np.testing.assert_allclose(turning - start, (walked, 0.0), atol=1e-9)
    step = away - middle[22 * 80 - 10]
    # A turn ends with the inner foot a little further out, and so the middle beside the path.
    np.testing.assert_allclose(step, walked * np.array([np.cos(turned), np.sin(turned)]), atol=4e-3)


def test_feet_toe_out_but_never_in_whichever_way_turns_follow_each_other():
    rates = (0.2, -0.2, 0.0, 0.1, -0.1, 0.0, -0.2, 0.15)
    route, _ = ground_of(*(Leg(2.4 + 0.4 * (i % 3), 0.02, rate) for i, rate in enumerate(rates)))
    apart = route.yaw_sole[:, 0] - route.yaw_sole[:, 1]
    assert apart.min() > -1e-9
    # An opening foot takes two steps' worth of yaw.
    assert 0.1 < apart.max() < 2 * 0.16 + 1e-9
    assert apart[-1] == pytest.approx(0.0, abs=1e-9)


def test_what_a_route_leaves_of_its_duration_is_stood():
    legs = (Leg(2.0, 0.04, 0.0),)
    short, long = plan_route(legs), plan_route(legs, 6.0)
    assert (short.ticks, long.ticks) == (320, 480)
    np.testing.assert_array_equal(long.cop[:320], short.cop)
    assert long.stance[320:].all()


def test_routes_come_back_from_json_and_are_walked():
    route = [list(leg) for leg in ROUTE]
    env = gym.make("surefoot/NaoWalk-v0", route=route, duration=8.6, push_impulse=(0.0, 0.0))
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    bare = again.unwrapped
    again.reset(seed=0)
    start = bare.truth.com[-1].copy()
    terminated = truncated = False
    while not (terminated or truncated):
        _, _, terminated, truncated, _ = again.step(np.zeros(11, dtype=np.float32))
    assert not terminated
    legs = parse_route(json.loads(json.dumps(route)))
    np.testing.assert_array_equal(bare.pattern.qpos, plan_route(legs, 8.6).qpos)
    planned = bare.pattern.com[-1] - bare.pattern.com[0]
    np.testing.assert_allclose((bare.truth.com[-1] - start)[:2], planned[:2], atol=0.02)


test_impossible_routes_are_refused = refusals(
    lambda route: NaoWalkEnv(route=route, duration=20.0),
    ([], r"'route' must hold one or more legs .* got \[\]"),
    ([[8.0, 0.04]], r"'route' leg 0 must be .*got \[8.0, 0.04\]"),
    ([[8.0, 0.3, 0.0]], "'route' leg 0: 'speed' 0.3 m/s .* walk at most"),
    ([[8.0, 0.04, 0.0], [1.0, 0.04, 0.1]], "'route' leg 1 lasts 1.0 s, too short for two steps; 2.72 s"),
    ([[8.0, 0.04, 0.0], [0.2, 0.0, 0.0]], "'route' leg 1 stands for 0.2 s; stand for at least 0.5 s"),
    ([[60.0, 0.04, 0.0]], "'route' takes 62.0 s .* longer than its 'duration' of 20.0 s"),
)


def test_the_time_named_is_enough_for_a_leg_anywhere_in_a_route():
    for before in np.arange(4.0, 5.0, 0.05):
        legs = (Leg(float(before), 0.04, 0.0), Leg(2.72, 0.02, 0.1))
        walks, _ = plan_legs(legs, GaitTiming())
        assert len(walks) == 1
