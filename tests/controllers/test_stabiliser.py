"""The stabiliser's contract; that it walks is tested with the environment."""

import numpy as np
import pytest
from _refusals import refusals
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.controllers import Stabiliser, zero_action

LAYOUT = {
    "joint_position": slice(0, 4),
    "tilt": slice(4, 6),
    "gyroscope": slice(6, 9),
    "cop_reference": slice(9, 11),
}
number = st.floats(-0.25, 0.25, width=32)


def observe(cop=(0.0, 0.0), tilt=(0.0, 0.0), gyroscope=(0.0, 0.0, 0.0), reference=(0.0, 0.0), valid=True):
    state = np.zeros(11, dtype=np.float32)
    state[4:6], state[6:9], state[9:11] = tilt, gyroscope, reference
    return {
        "state": state,
        "cop": np.array(cop, dtype=np.float32),
        "cop_valid": np.array([valid, 1, 1], dtype=np.float32),
    }


@st.composite
def observations(draw):
    pair, triple = st.tuples(number, number), st.tuples(number, number, number)
    return observe(draw(pair), draw(pair), draw(triple), draw(pair), draw(st.booleans()))


def mirrored(observation):
    """The same moment seen in a mirror: left is right."""
    state = observation["state"].copy()
    state[[4, 6, 8, 10]] *= -1
    return observation | {"state": state, "cop": observation["cop"] * np.float32([1, -1])}


def mirrored_action(action):
    legs = action[1:6], action[6:11]
    sign = np.array([-1, 1, 1, 1, -1])
    return np.concatenate([action[:1], legs[1] * sign, legs[0] * sign])


@settings(max_examples=50, deadline=None)
@given(st.lists(observations(), min_size=1, max_size=30))
def test_actions_are_bounded_finite_and_repeatable(stream):
    stabiliser = Stabiliser(LAYOUT)
    actions = [stabiliser(observation) for observation in stream]
    for action in actions:
        assert action.shape == (11,)
        assert action.dtype == np.float32
        assert np.isfinite(action).all()
        assert np.abs(action).max() <= 1
    stabiliser.reset()
    assert (np.array([stabiliser(observation) for observation in stream]) == np.array(actions)).all()


@settings(max_examples=50, deadline=None)
@given(st.lists(observations(), min_size=1, max_size=30))
def test_the_mirror_image_of_a_walk_is_balanced_by_the_mirror_image_of_the_action(stream):
    one, other = Stabiliser(LAYOUT), Stabiliser(LAYOUT)
    for observation in stream:
        assert other(mirrored(observation)) == pytest.approx(mirrored_action(one(observation)), abs=1e-6)


def test_it_leaves_the_observation_alone():
    observation = observe(cop=(0.01, 0.02), tilt=(0.1, 0.2))
    before = {name: value.copy() for name, value in observation.items()}
    Stabiliser(LAYOUT)(observation)
    assert all((observation[name] == before[name]).all() for name in before)


def test_on_its_reference_it_does_nothing():
    stabiliser = Stabiliser(LAYOUT)
    for _ in range(100):
        action = stabiliser(observe(cop=(0.02, -0.04), reference=(0.02, -0.04)))
    assert (action == 0).all()


@pytest.mark.parametrize(
    ("bad", "valid"),
    [((0.5, -0.5), False), ((np.nan, 0.0), False), ((np.nan, 0.0), True), ((0.0, np.inf), True)],
)
def test_an_invalid_cop_is_not_looked_at(bad, valid):
    tilt = (0.01, 0.02)
    one = Stabiliser(LAYOUT)(observe(cop=bad, tilt=tilt, valid=valid))
    assert (one == Stabiliser(LAYOUT)(observe(cop=(0.0, 0.0), tilt=tilt))).all()


def test_ankles_give_way_where_the_sole_presses():
    """Pressed in front, toes up (negative pitch); pressed on the left, left side up (positive roll)."""
    action = Stabiliser(LAYOUT)(observe(cop=(0.02, 0.01)))
    assert action[4] == action[9] < 0
    assert action[5] == action[10] > 0
    assert (np.delete(action, [4, 5, 9, 10]) == 0).all()


def test_a_lean_is_answered_by_pushing_back():
    """Leaning forward (positive pitch) and to the left (negative roll), toes and left sides go down."""
    action = Stabiliser(LAYOUT)(observe(tilt=(-0.02, 0.02)))
    assert action[4] > 0
    assert action[5] < 0
    rates = Stabiliser(LAYOUT)(observe(gyroscope=(-0.1, 0.1, 0.0)))
    assert rates[4] > 0
    assert rates[5] < 0


def test_a_bias_leans_the_body_as_far_as_the_docstring_says():
    """The pendulum at rest on a flat foot: tilt and centre of pressure follow the ankle."""
    stabiliser = Stabiliser(LAYOUT, lever=0.24, position_gain=1.5, velocity_gain=0.0)
    bias = 0.01
    for _ in range(4000):
        lean = stabiliser.angle[0]
        stabiliser(observe(cop=(0.24 * lean + bias, 0.0), tilt=(0.0, lean)))
    assert 0.24 * stabiliser.angle[0] == pytest.approx(bias / 0.5, rel=1e-3)


def test_the_angle_is_limited_and_does_not_wind_up():
    stabiliser = Stabiliser(LAYOUT, largest_angle=0.1)
    for _ in range(2000):
        action = stabiliser(observe(cop=(0.05, 0.0)))
    assert action[4] == pytest.approx(-0.5)
    stabiliser(observe(cop=(-0.05, 0.0)))
    assert stabiliser.angle[0] < 0.1


def test_it_waits_until_it_is_engaged():
    stabiliser = Stabiliser(LAYOUT, engage_after=0.1)
    actions = [stabiliser(observe(cop=(0.05, 0.0))) for _ in range(10)]
    assert (np.array(actions[:8]) == 0).all()
    assert actions[8][4] < 0
    stabiliser.reset()
    assert (stabiliser(observe(cop=(0.05, 0.0))) == 0).all()


def test_the_action_scale_scales():
    one = Stabiliser(LAYOUT)(observe(cop=(0.02, 0.0)))
    two = Stabiliser(LAYOUT, action_scale=0.4)(observe(cop=(0.02, 0.0)))
    assert two == pytest.approx(one / 2)


test_impossible_gains_are_refused = refusals(
    lambda options: Stabiliser(LAYOUT, **options),
    ({"admittance": 0.0}, "'admittance' must be finite and positive, got 0.0"),
    ({"lever": float("nan")}, "'lever'"),
    ({"dt": -1.0}, "'dt'"),
    ({"velocity_gain": -0.1}, "'velocity_gain' must be finite and not negative"),
    ({"engage_after": -1.0}, "'engage_after'"),
    ({"position_gain": 1.0}, "'position_gain' must be above 1"),
)


def test_a_layout_that_lacks_a_part_is_named():
    with pytest.raises(ValueError, match=r"lacks \['tilt', 'gyroscope'\].*state_layout"):
        Stabiliser({"cop_reference": slice(0, 2)})


def test_the_zero_action_is_zero():
    assert zero_action(observe(cop=(0.1, 0.1))) == pytest.approx(np.zeros(11))


@pytest.mark.parametrize("engage_after", [0.0, 1.0])
def test_an_observation_without_a_centre_of_pressure_is_explained(engage_after):
    text = (
        r"The observation lacks \['cop', 'cop_valid'\]; it has \['state'\].*SelfCalibration\(FootSensors\(env"
    )
    with pytest.raises(ValueError, match=text):
        Stabiliser(LAYOUT, engage_after=engage_after)({"state": observe()["state"]})
