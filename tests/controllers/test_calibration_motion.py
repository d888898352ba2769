"""A motion that is played until the calibrator is certain."""

import numpy as np
import pytest

from surefoot.calibration.excitation.certainty import Certainty
from surefoot.controllers import CalibrationMotion

TARGETS = np.linspace(0.0, 0.3, 60)[:, None] * [1.0, -1.0]
REST = np.isin(np.arange(60), (19, 39, 59))


def motion(**options):
    return CalibrationMotion(TARGETS, REST, ["hip", "knee"], dt=0.1, **options)


def seen(std):
    return {"cop_std": np.full(2, std / np.sqrt(2.0))}


def calls(player, observation):
    """How many rows are played."""
    rows = 0
    while not player.done:
        np.testing.assert_array_equal(player(observation), TARGETS[rows])
        rows += 1
    return rows


def test_it_stops_at_a_rest_once_it_is_certain():
    assert calls(motion(enough=1e-3), seen(2e-3)) == 60
    assert calls(motion(enough=1e-3), seen(0.5e-3)) == 20
    assert calls(motion(enough=0.0), seen(0.5e-3)) == 60
    assert calls(motion(enough=1e-3), {}) == 60
    player = motion(enough=1e-3)
    for _ in range(25):
        player(seen(2e-3))
    assert calls_from(player, seen(0.1e-3)) == 40


def calls_from(player, observation):
    row = 25
    while not player.done:
        player(observation)
        row += 1
    return row


def test_it_asks_again_when_certainty_falls():
    player = motion(enough=1e-3, again=2e-3)
    calls(player, seen(0.5e-3))
    assert player.certain
    for _ in range(100):
        held = player(seen(1.9e-3))
    assert not player.wanted
    np.testing.assert_array_equal(held, TARGETS[19])
    for _ in range(100):
        player(seen(2.1e-3))
    assert player.wanted
    player.start()
    assert not player.done
    assert calls(player, seen(0.5e-3)) == 20


def test_it_says_which_feet_are_planned_to_stand():
    stance = np.ones((60, 2), dtype=bool)
    stance[5:9, 0] = False
    player = motion(stance=stance, swing=~stance)
    told = [(player({}), player.stance.copy(), player.swing.copy())[1:] for _ in range(60)]
    np.testing.assert_array_equal([one for one, _ in told], stance)
    np.testing.assert_array_equal([one for _, one in told], ~stance)


def test_what_has_no_meaning_is_refused():
    with pytest.raises(ValueError, match=r"'targets' must be finite, shape \(60, 1\) for 60 rows"):
        CalibrationMotion(TARGETS, REST, ["hip"], dt=0.1)
    with pytest.raises(ValueError, match="last row of 'rest' must be true"):
        CalibrationMotion(TARGETS, np.roll(REST, 1), ["hip", "knee"], dt=0.1)
    with pytest.raises(ValueError, match=r"'again' must be at least 'enough', 0\.001, got 0\.0005"):
        motion(enough=1e-3, again=5e-4)


def test_certainty_passes_over_what_is_not_known():
    certainty = Certainty(enough=1e-3, dt=0.1)
    for _ in range(50):
        certainty.update([0.5e-3, np.nan])
    assert not certainty.certain
    certainty.update([0.5e-3, 0.5e-3])
    certainty.update([np.nan, np.nan])
    assert certainty.certain
    assert certainty.std == pytest.approx(0.5e-3 * np.sqrt(2.0))
    certainty.forget()
    assert not certainty.certain
