"""Plans of motions: what they promise is the bound, and they beat what they are made of."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from _synthetic import DT, HEIGHT, LAYOUT, MASS, WIDTH

from surefoot.calibration import (
    GRAVITY,
    FootMotion,
    MovingRobot,
    Reference,
    plan_foot_excitation,
)
from surefoot.calibration.excitation import plan as planning

SOLES = np.array([[0.0, WIDTH / 2, 0.0], [0.0, -WIDTH / 2, 0.0]])
CELLS = np.concatenate(
    [sole + foot.position_cell_sole for sole, foot in zip(SOLES, LAYOUT.feet, strict=True)]
)
MIDDLE = CELLS[:, :2].mean(axis=0)


def motion(x=0.0, y=0.0, lifted=None, period=2.0, length=2.0):
    """Sway about the middle with amplitudes in m, or over one foot with the other in the air."""
    time = DT * np.arange(round(length / DT))
    rate = 2.0 * np.pi / period
    middle = np.array([*(MIDDLE if lifted is None else CELLS[4 - 4 * lifted :][:4, :2].mean(axis=0)), HEIGHT])
    amplitude = np.array([x, y, 0.0])
    com = middle + np.sin(rate * time)[:, None] * amplitude
    acceleration = -(rate**2) * np.sin(rate * time)[:, None] * amplitude
    cop = com[:, :2] - HEIGHT / GRAVITY * acceleration[:, :2]
    bears = np.ones(8, dtype=bool)
    swing = np.zeros((len(time), 2), dtype=bool)
    if lifted is not None:
        bears[4 * lifted : 4 * lifted + 4] = False
        swing[:, lifted] = True
    force = np.zeros((len(time), 8))
    asked = MASS * GRAVITY * np.column_stack([np.ones(len(time)), cop])
    force[:, bears] = asked @ np.linalg.pinv(np.column_stack([np.ones(8), CELLS[:, :2]])[bears]).copy()
    shape = (len(time), 2, 3, 3)
    reference = Reference(
        com=com,
        com_acceleration=acceleration,
        angular_momentum_rate=np.zeros_like(com),
        position_sole=np.tile(SOLES, (len(time), 1, 1)),
        R_level_sole=np.broadcast_to(np.eye(3), shape),
        stance=~swing,
        swing=swing,
        accelerometer=acceleration + np.array([0.0, 0.0, GRAVITY]),
        gyroscope=np.zeros_like(com),
    )
    return FootMotion(force, reference)


@pytest.fixture(scope="module")
def robot():
    motions = {
        "forward": motion(x=0.03),
        "left": motion(y=0.03),
        "barely": motion(x=0.001),
        "left up": motion(x=0.01, y=0.01, lifted=0),
        "right up": motion(x=0.01, y=0.01, lifted=1),
    }
    return MovingRobot(mass=MASS, motions=motions, dt=DT, lag=0)


@pytest.fixture(scope="module", autouse=True)
def passages_once(robot):
    """Each motion's passages are worked out once: plans of one robot, with one setup, share them."""
    made, work_out = {}, planning._passages_of

    def recall(setup, motion, config):
        if id(motion) not in made:
            made[id(motion)] = work_out(setup, motion, config)
        return made[id(motion)]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(planning, "_passages_of", recall)
        yield


@pytest.fixture(scope="module")
def plan(robot):
    """Give the plan of twelve seconds for the centre of pressure."""
    return plan_foot_excitation(LAYOUT, robot, 12.0)


def test_a_plan_beats_each_of_its_motions_and_keeps_to_its_time(robot, plan):
    assert plan.time[-1] <= 12.0
    assert plan.std[-1] < 0.2 * plan.before
    for name in ("forward", "left up"):
        alone = plan_foot_excitation(LAYOUT, robot, 12.0, motions=[name] * 6)
        assert plan.std[-1] < alone.std[-1]
        assert plan.rates[name] == pytest.approx(np.log(alone.before / alone.std[0]) / alone.time[0])
    again = plan_foot_excitation(LAYOUT, robot, 12.0, motions=plan.motions)
    np.testing.assert_allclose(again.std, plan.std)
    # What two of them can bring in any order, the search has seen.
    few = replace(robot, motions={name: robot.motions[name] for name in ("forward", "left up")})
    pairs = product(few.motions, repeat=2)
    best = min(plan_foot_excitation(LAYOUT, few, 4.0, motions=pair).std[-1] for pair in pairs)
    assert plan_foot_excitation(LAYOUT, few, 4.0).std[-1] <= best * (1.0 + 1e-9)


def test_a_sway_shows_the_gradient_along_its_direction(robot):
    """Front cells that read too much and rear cells too little are seen by a sway along x, not along y."""
    gradient = {
        "forward": np.tile([1.0, 1.0, -1.0, -1.0], 2) / np.sqrt(8.0),
        "left": np.repeat([1.0, -1.0], 4) / np.sqrt(8.0),
    }
    variance = {
        (name, way): direction @ plan.covariance[:8, :8] @ direction
        for name in gradient
        for plan in [plan_foot_excitation(LAYOUT, robot, 8.0, motions=[name] * 4)]
        for way, direction in gradient.items()
    }
    for name, other in (("forward", "left"), ("left", "forward")):
        assert variance[name, name] < 0.5 * variance[other, name]
    barely = plan_foot_excitation(LAYOUT, robot, 8.0, motions=["barely"] * 4).covariance
    assert gradient["forward"] @ barely[:8, :8] @ gradient["forward"] > 2.0 * variance["forward", "forward"]


def test_a_plan_ends_when_that_is_enough(robot, plan):
    enough = 1.2 * plan.std[-1]
    short = plan_foot_excitation(LAYOUT, robot, 12.0, enough=enough)
    assert short.std[-1] <= enough < short.std[:-1].min(initial=np.inf)
    assert short.time[-1] < plan.time[-1]


def test_the_worst_channel_is_another_goal(robot, plan):
    worst = plan_foot_excitation(LAYOUT, robot, 12.0, goal="channel")
    other = plan_foot_excitation(LAYOUT, robot, 12.0, goal="channel", motions=plan.motions)
    assert worst.std[-1] <= 1.01 * other.std[-1]  # the search is no optimum
    # Of each foot only its offsets in the air can be told apart: both are lifted.
    assert {"left up", "right up"} <= set(worst.motions)
    assert worst.std[-1] < 3.0 < worst.before * 3.0


@pytest.mark.parametrize(
    ("budget", "options", "match"),
    [
        (0.0, {}, "'budget' must be finite and positive"),
        (1.0, {}, "nothing fits into a budget of 1 s; the shortest motion takes 2 s"),
        (9.0, {"goal": "vgrf"}, r"'goal' must be one of \('cop', 'channel'\), got 'vgrf'"),
        (9.0, {"motions": ["dance"]}, "cannot do 'dance'. It can do: forward, left"),
    ],
)
def test_what_makes_no_plan_is_refused(robot, budget, options, match):
    with pytest.raises(ValueError, match=match):
        plan_foot_excitation(LAYOUT, robot, budget, **options)
