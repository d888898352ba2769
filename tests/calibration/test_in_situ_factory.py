"""Factory matrices that the readings contradict."""

import re
from dataclasses import replace

import numpy as np
import pytest
from _in_situ_leg import COM, FREE, LIMB, MASS, MATRIX, RESPONSE, leg_sets
from _in_situ_stacked import wrench_of_gravity

from surefoot.calibration.in_situ import InSituSet, KnownLimb, calibrate_in_situ
from surefoot.calibration.in_situ.data import Task
from surefoot.calibration.in_situ.judge import data_rank
from surefoot.calibration.in_situ.solver.compress import compress
from surefoot.calibration.in_situ.solver.problem import problem_of, starts
from surefoot.calibration.results import CalibrationRefused, FitResult

NOISE = np.array([0.05, 0.05, 0.05, 0.001, 0.001, 0.001])
TRANSFORMS = {
    "transposed": (lambda F: F.T, "the factory's matrix is transposed"),
    "inverted": (np.linalg.inv, "the factory's matrix is inverted"),
    "torques first": (lambda F: np.roll(F, 3, axis=0), "rows of the factory's matrix are torques first"),
    "N mm": (lambda F: np.concatenate([F[:3], 1e3 * F[3:]]), "units of the factory's torques are N mm"),
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        pytest.param(*row, id=name, marks=() if name == "torques first" else pytest.mark.slow)
        for name, row in TRANSFORMS.items()
    ],
)
def test_a_factory_matrix_that_is_read_wrongly_is_named(change, words):
    with pytest.raises(CalibrationRefused, match=f"The likeliest cause: {words}"):
        calibrate_in_situ(leg_sets(), factory_matrix=change(MATRIX))


def test_rank_is_judged_at_a_limb_that_may_be():
    """In N mm a matrix that has aged shows a limb of some hundred metres, at which one unknown is open."""
    aged = (np.eye(6) + 0.05 * np.random.default_rng(94).standard_normal((6, 6))) @ MATRIX
    task = Task(tuple(leg_sets()), np.concatenate([aged[:3], 1e3 * aged[3:]]))
    parts = compress(task.sets, task.options, moving=False, temperature=False)
    problem = problem_of(task, parts, temperature=False)
    assert data_rank(problem, starts(problem, task.factory, None)[0]).missing == 0


@pytest.mark.parametrize(
    ("mass", "place", "words"),
    [
        (1.0 / 0.45359237, 1.0, "masses are in lb"),
        pytest.param(1.0, -1.0, "all places of the masses", marks=pytest.mark.slow),
    ],
)
def test_units_and_signs_of_masses_contradict_a_factory_matrix(mass, place, words):
    sets = [
        replace(one, added_mass=mass * one.added_mass, added_com=place * one.added_com) for one in leg_sets()
    ]
    with pytest.raises(CalibrationRefused, match=f"The likeliest cause: {words}"):
        calibrate_in_situ(sets, factory_matrix=MATRIX)


@pytest.mark.parametrize(
    ("row", "column", "factor", "sets", "given"),
    [
        (2, 4, -1.0, 4, {}),
        *(
            pytest.param(*entry, *log, marks=pytest.mark.slow)
            for entry in ((2, 4, -1.0), (0, 5, 10.0), (1, 1, 0.1))
            for log in ((4, {"options": FREE}), (1, {"limb": LIMB, "options": FREE}))
        ),
    ],
)
def test_one_corrupt_entry_of_the_factory_matrix_is_named(row, column, factor, sets, given):
    corrupt = MATRIX.copy()
    corrupt[row, column] *= factor
    message = re.escape(
        f"The likeliest cause: entry [{row}, {column}] of the factory's matrix, {corrupt[row, column]:.4g}, "
        "is "
    )
    with pytest.raises(CalibrationRefused, match=message):
        calibrate_in_situ(leg_sets()[:sets], factory_matrix=corrupt, **given)


def test_planar_motion_is_a_warning_beside_a_factory_matrix():
    rng = np.random.default_rng(1)
    angle = np.radians(rng.uniform(-40.0, 40.0, 400))
    gravity = 9.81 * np.stack([np.sin(angle), np.zeros(400), np.cos(angle)], axis=1)
    raw = (
        gravity @ wrench_of_gravity(MASS, COM).T @ RESPONSE.T
        + (NOISE * rng.standard_normal((400, 6))) @ RESPONSE.T
    )
    fit = calibrate_in_situ(
        [InSituSet(raw, gravity)], factory_matrix=MATRIX, limb=KnownLimb(MASS, 0.05, COM, 0.005)
    )
    assert fit.result is FitResult.PARTLY_DETERMINED
    assert "in one plane only" in fit.warnings[0]
    np.testing.assert_allclose(fit.offset @ MATRIX.T, 0.0, atol=0.6)


def test_gravity_of_the_wrong_sign_contradicts_a_factory_matrix():
    up = [replace(one, gravity=-one.gravity) for one in leg_sets()]
    with pytest.raises(CalibrationRefused, match="cause: the sign of gravity or of the factory"):
        calibrate_in_situ(up[:1], factory_matrix=MATRIX, limb=LIMB, options=FREE)


def test_a_scale_that_is_the_makers_is_as_unsure_as_makers_are():
    fit = calibrate_in_situ(leg_sets()[:1], factory_matrix=1.1 * MATRIX)
    assert fit.data_share[fit.columns.limb][0] < 0.01
    assert abs(fit.limb.mass - MASS) < 2.5 * fit.limb_mass_std


@pytest.mark.parametrize("aged", [0.64, pytest.param([1.7, 1.6, 1.5, 1, 1, 1], marks=pytest.mark.slow)])
def test_a_factory_matrix_that_has_aged_is_no_other_unit(aged):
    fit = calibrate_in_situ(leg_sets(), factory_matrix=np.multiply(np.reshape(aged, (-1, 1)), MATRIX))
    assert fit.maker.share > 0.1


@pytest.mark.parametrize(
    ("aged", "unit"), [pytest.param(0.54, "masses are in lb", marks=pytest.mark.slow), (1.9, "converted")]
)
def test_a_factory_matrix_whose_scale_is_clearly_that_of_another_unit_is_refused(aged, unit):
    with pytest.raises(CalibrationRefused, match=f"The likeliest cause: .*{unit}"):
        calibrate_in_situ(leg_sets(), factory_matrix=aged * MATRIX)
