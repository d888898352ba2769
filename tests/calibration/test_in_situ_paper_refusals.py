"""What the paper's method says no to, and why."""

import re

import numpy as np
import pytest
from _in_situ import FOOT_MATRIX, SENSORS, make_set, offsets_of, paper_sets, swept_gravity, with_arrays
from _refusals import refusals

from surefoot.calibration.in_situ import InSituSet, estimate_matrix, estimate_offset
from surefoot.calibration.results import CalibrationRefused


@pytest.mark.parametrize(
    ("gravity", "seen"),
    [
        (np.tile([0.0, 0.0, 9.81], (20, 1)), "Gravity was seen in one direction only"),
        (
            np.repeat([[0.0, 0.0, 9.81], [0.0, 3.0, 9.34]], 10, axis=0),
            "Gravity was seen turning to and fro between two directions only",
        ),
        (swept_gravity(100, side=0.0), "Gravity was seen turning in a plane only"),
        # A cone is a plane as well: its circle lies in one, beside the origin.
        (
            np.stack([3.0 * np.cos(np.arange(60)), 3.0 * np.sin(np.arange(60)), np.full(60, 9.34)], -1),
            "Gravity was seen turning in a plane only",
        ),
    ],
)
def test_gravity_that_turns_too_little_is_refused(gravity, seen):
    rng = np.random.default_rng(12)
    noisy = gravity + 0.02 * rng.standard_normal(gravity.shape)  # an accelerometer's noise opens nothing
    raw = gravity @ np.linalg.pinv(FOOT_MATRIX)[:, :3].T + 100.0 + rng.standard_normal((len(gravity), 6))
    with pytest.raises(CalibrationRefused, match=seen) as refusal:
        estimate_offset(raw, noisy)
    assert (
        "% of its size, and 1 % are needed), so the offset across it is not determined."
        in refusal.value.reason
    )
    assert refusal.value.cure == "Turn the limb about two axes: tilt it sideways as well as back and forth."


def test_a_small_turn_passes_where_it_is_asked_for():
    offset = np.full(6, 300.0)
    gravity = swept_gravity(200, front=4.0, side=4.0)
    one = make_set(FOOT_MATRIX, offset, SENSORS["foot"][1:3], (0.0, np.zeros(3)), gravity)
    with pytest.raises(CalibrationRefused, match="in a plane only"):
        estimate_offset(one.raw, one.gravity)
    np.testing.assert_allclose(estimate_offset(one.raw, one.gravity, minimum_spread=1e-5).offset, offset)


def test_readings_that_do_not_react_are_refused():
    gravity = swept_gravity(50)
    with pytest.raises(CalibrationRefused, match="fewer than the three dimensions of gravity"):
        estimate_offset(np.full((50, 6), 3.0), gravity)
    with pytest.raises(CalibrationRefused, match="None of the 50 samples was finite"):
        estimate_offset(np.full((50, 6), np.nan), gravity)


@pytest.mark.parametrize(
    ("picked", "count"), [([1, 2], "two different added masses"), ([3], "one added mass")]
)
@pytest.mark.parametrize("copies", [1, 3])
def test_fewer_than_three_masses_are_refused_however_often_they_come(picked, count, copies):
    sets, offset = paper_sets("foot", np.random.default_rng(13), noise=0.003)
    with pytest.raises(CalibrationRefused) as refusal:
        estimate_matrix([sets[i] for i in picked] * copies, offset)
    assert str(refusal.value) == (
        f"The sets hold {count}, and three are needed (Lemma 2) to determine the matrix. Add sets "
        "with other masses at other places; one without any added mass counts as well."
    )


def test_one_mass_at_many_places_is_refused():
    sets, offset = paper_sets("foot", None)
    with pytest.raises(
        CalibrationRefused, match=r"All 3 sets bear the same added mass of 0\.703 kg, so that noth"
    ):
        estimate_matrix(sets[1:], offset)


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01])
def test_masses_on_one_line_are_refused(sensor, noise):
    matrix, mass, com, _ = SENSORS[sensor]
    rng, offset = np.random.default_rng(14), np.full(6, 300.0)
    along = [(0.0, 0.0), (0.5, 0.05), (0.5, 0.2), (0.9, 0.35)]
    sets = [
        make_set(
            matrix,
            offset,
            (mass, com),
            (added, com + place * np.eye(3)[0]),
            swept_gravity(3000),
            noise=noise,
            rng=rng,
        )
        for added, place in along
    ]
    with pytest.raises(CalibrationRefused, match=r"determine \d+ of 40 unknowns .* lie on one line"):
        estimate_matrix(sets, offset)


def test_noise_that_hides_the_masses_is_refused_unless_it_is_asked_for():
    sets, _ = paper_sets("leg", np.random.default_rng(15), n=100, noise=0.03)
    found = offsets_of(sets)
    with pytest.raises(CalibrationRefused, match="beside the noise of the readings"):
        estimate_matrix(sets, found)
    assert estimate_matrix(sets, found, noise_margin=0.0).limb.mass < 4.9


def test_a_set_without_a_finite_sample_is_refused_by_name():
    sets, offset = paper_sets("foot", None)
    empty = with_arrays(sets[2], np.full_like(sets[2].raw, np.nan), sets[2].gravity)
    with pytest.raises(CalibrationRefused, match="'data set 3': none of its 300 samples was finite"):
        estimate_matrix([*sets[:2], empty, sets[3]], offset)


test_shapes_of_the_offset_fit = refusals(
    estimate_offset,
    (np.ones(6), np.ones((1, 3)), "'raw' must have shape (n, k) with k >= 3, got (6,)."),
    (np.ones((4, 6)), np.ones((5, 3)), "'gravity' must have shape (4, 3) like 'raw', got (5, 3)."),
    plain=True,
)


def test_shapes_of_the_matrix_fit():
    sets, offset = paper_sets("foot", None)
    eight = InSituSet(np.zeros((4, 8)), np.zeros((4, 3)), name="other sensor")
    with pytest.raises(ValueError, match="'sets' must hold at least one set, got none"):
        estimate_matrix([], offset)
    with pytest.raises(ValueError, match="'other sensor' has 8 channels, but 'data set 1' has 6"):
        estimate_matrix([sets[0], eight], offset)
    with pytest.raises(ValueError, match=re.escape("'offsets' must have shape (6,) or (4, 6), got (3, 6).")):
        estimate_matrix(sets, np.zeros((3, 6)))
    with pytest.raises(ValueError, match="'offsets' must be finite"):
        estimate_matrix(sets, np.full(6, np.nan))
