"""How causes of a spoilt in-situ log are compared: the likelihood of coloured rows."""

from dataclasses import replace

import numpy as np
import pytest
from _in_situ import ADDED_COM_LEG, ADDED_MASS, noisy_sets
from scipy.fft import idct
from scipy.stats import multivariate_normal

from surefoot.calibration.in_situ.calibrate import _gather_evidence
from surefoot.calibration.in_situ.colour import Colour, Part
from surefoot.calibration.in_situ.compress import _triangularise
from surefoot.calibration.in_situ.covariance import _doublings
from surefoot.calibration.in_situ.data import InSituOptions, Task
from surefoot.calibration.in_situ.solve import deviance, solve

COLOURS = {
    "white": Colour(),
    "drift": Colour(drift=Part(0.3, 2.0)),
    "hysteresis": Colour(hysteresis=Part(1.5, 2.0, 0.4)),
    "both": Colour(Part(0.3, 2.0), Part(1.5, 1.0, 0.4)),
}


def evidence_of(sets, **options):
    """What causes of some sets are judged by."""
    return _gather_evidence(Task(tuple(sets), options=InSituOptions(**options)), tuple(sets))


def coloured_fit(colour, n=80):
    """Four short sets whose second mass is 20 % too heavy, with rows of a colour."""
    rng = np.random.default_rng(3)
    sets = noisy_sets("leg", rng, n=n)[0]
    sets[1] = replace(sets[1], added_mass=1.2 * ADDED_MASS[1], added_com=ADDED_COM_LEG[1])
    evidence = evidence_of(sets, robust=False)
    parts = tuple(_triangularise(part.source, colour) for part in evidence.problem.sets)
    return solve(replace(evidence.problem, sets=parts), [evidence.solution.outer])


@pytest.mark.parametrize("colour", COLOURS.values(), ids=COLOURS)
def test_deviance_is_that_of_a_dense_normal_distribution(colour):
    solution = coloured_fit(colour)
    left, dense = [], []
    for part, response in zip(solution.problem.sets, solution.predicted, strict=True):
        source = part.source
        b, u, r = np.split(source.columns, [1, 1 + source.inputs], axis=1)
        offset = np.linalg.lstsq(b, r - u @ response.T, rcond=None)[0]
        left.append(r - b @ offset - u @ response.T)
        power = colour.power_after(part.rows, source.spacing) / colour.weights(part.rows, source.spacing)
        waves = idct(np.eye(part.rows), norm="ortho", axis=0)
        dense.append(waves @ np.diag(power) @ waves.T)
    rows = sum(map(len, left))
    scatter = sum(one.T @ np.linalg.solve(cov, one) for one, cov in zip(left, dense, strict=True)) / rows
    expected = sum(
        -2.0 * multivariate_normal.logpdf(one.ravel(), cov=np.kron(cov, scatter))
        for one, cov in zip(left, dense, strict=True)
    )
    assert deviance(solution) == pytest.approx(expected, rel=1e-9)


def test_slopes_are_open_by_how_far_swings_of_like_axes_lie_apart():
    swing = np.array([1.0, 4.0, 16.0])
    load = np.linspace(-1.0, 1.0, 50)[:, None] * swing
    np.testing.assert_allclose(_doublings([load]), np.hypot([2.0, 0.0, 2.0], 1.0), rtol=1e-12)
    np.testing.assert_allclose(_doublings([8.0 * load]), _doublings([load]), rtol=1e-12)
    # What swings little about a large load, is open up to that.
    np.testing.assert_allclose(_doublings([load + np.array([31.0, 0.0, 0.0])])[0], 5.0, rtol=1e-12)
    np.testing.assert_array_equal(_doublings([0.0 * load]), 1.0)
