"""Stacks of observations that count in seconds."""

import gymnasium as gym
import numpy as np
import pytest

from surefoot.wrappers import FootSensors, SampleHistory, SelfCalibration

STILL = np.zeros(11, dtype=np.float32)


def test_a_stack_holds_what_was_seen_at_its_moments(make_bare) -> None:
    env = SampleHistory(SelfCalibration(FootSensors(make_bare())), ("cop", "cop_valid"), 3, 0.05)
    seen = []
    observation, _ = env.reset(seed=0)
    for step in range(30):
        assert env.observation_space.contains(observation)
        assert observation["cop"].shape == (3, 2)
        seen.append(observation["cop"][-1])
        for row, back in enumerate((8, 4, 0)):
            np.testing.assert_array_equal(observation["cop"][row], seen[max(step - back, 0)])
        assert observation["foot_force"].shape == (8,)
        observation, *_ = env.step(STILL)
    again, _ = env.reset()
    np.testing.assert_array_equal(again["cop"], np.repeat(again["cop"][-1:], 3, axis=0))


def test_moments_between_steps_are_the_nearest(make_bare) -> None:
    env = SampleHistory(FootSensors(make_bare()), ("foot_raw",), 4, 0.03)
    seen = [env.reset(seed=0)[0]["foot_raw"][-1]]
    for _ in range(12):
        observation, *_ = env.step(STILL)
        seen.append(observation["foot_raw"][-1])
    # 30, 60 and 90 ms are 2.4, 4.8 and 7.2 steps of 12.5 ms.
    np.testing.assert_array_equal(observation["foot_raw"], [seen[12 - back] for back in (7, 5, 2, 0)])


@pytest.mark.parametrize(
    ("options", "error", "text"),
    [
        ({"keys": ("zmp",)}, ValueError, "'keys' must name parts of"),
        ({"keys": "cop"}, TypeError, "a sequence of names"),
        (
            {"keys": ("foot_raw",), "samples": 1},
            ValueError,
            "'samples' must be a whole number from 2 on, got 1",
        ),
        ({"keys": ("foot_raw",), "period": 0.001}, ValueError, "at least a control step, 0.0125 s here"),
    ],
)
def test_stacks_that_make_no_sense_are_refused(options, error, text, make_bare) -> None:
    with pytest.raises(error, match=text):
        SampleHistory(FootSensors(make_bare()), **options)


def test_flat_stacks_are_gymnasiums_business(make_bare) -> None:
    env = SampleHistory(SelfCalibration(FootSensors(make_bare())), ("cop",), 4)
    flat = gym.wrappers.FlattenObservation(gym.wrappers.FilterObservation(env, ["state", "cop"]))
    observation, _ = flat.reset(seed=0)
    assert observation.shape == (63 + 8,)
