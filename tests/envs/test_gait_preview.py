"""Preview control: the zero-moment point follows, whatever the reference."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.envs.gait.preview import CartTable, track_zmp
from surefoot.envs.gait.swing import minimum_jerk

DT = 1 / 80


def staircase(levels, hold=40, move=26):
    """A reference that goes smoothly from level to level, shape (ticks, 1)."""
    parts = [np.full(160, levels[0])]
    for before, after in pairwise(levels):
        parts += [before + (after - before) * minimum_jerk(np.arange(move) / move), np.full(hold, after)]
    parts.append(np.full(240, levels[-1]))
    return np.concatenate(parts)[:, None]


@settings(max_examples=25, deadline=None)
@given(levels=st.lists(st.floats(-0.1, 0.1), min_size=2, max_size=6), height=st.floats(0.15, 0.6))
def test_zmp_follows_its_reference(levels, height):
    reference = staircase(levels)
    model = CartTable(height, DT)
    track = track_zmp(reference, model)
    largest_move = np.abs(np.diff(levels)).max()
    assert np.abs(track.zmp - reference).max() <= 0.02 * largest_move + 1e-9
    # It ends at rest above the reference's end.
    assert track.position[-1] == pytest.approx(reference[-1], abs=1e-4)
    assert track.velocity[-1] == pytest.approx([0.0], abs=1e-3)


def test_zmp_is_that_of_the_cart_table():
    track = track_zmp(staircase([0.0, 0.05, -0.05]), CartTable(0.26, DT))
    assert track.zmp == pytest.approx(track.position - 0.26 / 9.81 * track.acceleration, abs=1e-12)


def test_position_velocity_and_acceleration_belong_together():
    track = track_zmp(staircase([0.0, 0.05, -0.05]), CartTable(0.26, DT))
    assert np.diff(track.velocity, axis=0) / DT == pytest.approx(
        (track.acceleration[1:] + track.acceleration[:-1]) / 2, abs=1e-9
    )
    mean = (track.velocity[1:] + track.velocity[:-1]) / 2
    jerk = np.diff(track.acceleration, axis=0) / DT
    assert np.diff(track.position, axis=0) / DT == pytest.approx(mean - jerk * DT**2 / 12, abs=1e-9)


def test_the_mass_starts_before_its_reference_moves():
    reference = staircase([0.0, 0.05])
    track = track_zmp(reference, CartTable(0.26, DT))
    start = int(np.argmax(reference[:, 0] > 0))
    assert track.position[start, 0] > 1e-3


def test_moving_the_reference_moves_the_motion():
    reference = staircase([0.0, 0.05, -0.02])
    model = CartTable(0.26, DT)
    assert track_zmp(reference + 3.0, model).position == pytest.approx(
        track_zmp(reference, model).position + 3.0, abs=1e-9
    )


def test_axes_do_not_mix():
    first, second = staircase([0.0, 0.05, -0.02]), staircase([0.0, -0.03, 0.04])
    model = CartTable(0.26, DT)
    both = track_zmp(np.hstack([first, second]), model)
    assert both.position[:, :1] == pytest.approx(track_zmp(first, model).position, abs=1e-12)


def test_gains_solve_the_quadratic_problem():
    """Changing any jerk by a little makes the cost of Kajita's problem no smaller."""
    model = CartTable(0.26, DT)
    reference = staircase([0.0, 0.05, 0.0])[:, 0]
    track = track_zmp(reference[:, None], model)
    jerk = np.diff(track.acceleration[:, 0], append=0.0) / DT

    def cost(u):
        state, total = np.zeros(3), 0.0
        for k in range(len(u)):
            total += (model.C @ state - reference[k]) ** 2 + 1e-6 * (u[k] - (u[k - 1] if k else 0.0)) ** 2
            state = model.A @ state + model.B * u[k]
        return total

    best = cost(jerk)
    for k in (100, 180, 200):
        for change in (-0.05, 0.05):
            # Opposite changes that leave the final state alone keep the tail of the sum out of it.
            moved = jerk.copy()
            moved[k : k + 4] += change * np.array([1.0, -3.0, 3.0, -1.0])
            assert cost(moved) > best


def test_impossible_references_are_refused():
    model = CartTable(0.26, DT)
    with pytest.raises(ValueError, match="not finite"):
        track_zmp(np.array([[0.0], [np.nan]]), model)
    with pytest.raises(ValueError, match=r"\(ticks, axes\)"):
        track_zmp(np.zeros(5), model)
