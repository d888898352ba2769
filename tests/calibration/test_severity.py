"""The prior that is learnt: exact where everything is Gaussian, and a calibrated robot keeps its map."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from _robots import calibrated, fleet
from _synthetic import LAYOUT, MASS, NOMINAL, Faults, errors
from numpy.testing import assert_allclose

from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.severity import FIRST_WIDTH, LIKELY, SEVERITIES, LearntSeverity
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.setup import OnlineSetup

UNKNOWNS = Unknowns(OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL), MomentFilterConfig())
MAP, STATED, START = UNKNOWNS.map, UNKNOWNS.std[UNKNOWNS.map], UNKNOWNS.start[UNKNOWNS.map]
SIZE = MAP.stop


def posterior(H, y, noise, std):
    """What rows say under a prior of these standard deviations: mean, covariance and log evidence."""
    V = H @ np.diag(std**2) @ H.T + noise**2 * np.eye(len(y))
    off = y - H @ START
    gain = np.diag(std**2) @ H.T @ np.linalg.inv(V)
    evidence = -0.5 * (off @ np.linalg.solve(V, off) + np.linalg.slogdet(V)[1])
    return START + gain @ off, np.diag(std**2) - gain @ H @ np.diag(std**2), evidence


def reweighted(mean, covariance, drift=0.0, misfit=1.0):
    rest = UNKNOWNS.size - SIZE
    whole = np.pad(covariance, (0, rest))
    return LearntSeverity(UNKNOWNS).reweighted(
        np.append(mean, np.zeros(rest)), whole, np.zeros(SIZE) + drift, misfit
    )


@pytest.mark.parametrize("severity", [0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("rows", [3, 40])
def test_it_is_the_mixture_of_exact_posteriors(severity, rows):
    rng = np.random.default_rng(7)
    H = rng.normal(size=(rows, SIZE)) / STATED
    y = H @ (START + severity * STATED * rng.normal(size=SIZE)) + 0.5 * rng.normal(size=rows)
    mean, covariance, _ = posterior(H, y, 0.5, FIRST_WIDTH * STATED)
    widths = UNKNOWNS.scales, UNKNOWNS.channels
    each = [posterior(H, y, 0.5, STATED * np.repeat(s, widths)) for s in product(SEVERITIES, repeat=2)]
    means, covariances, evidences = (np.array(part) for part in zip(*each, strict=True))
    before = np.array([np.prod(pair) for pair in product(LIKELY, repeat=2)])
    weight = before * np.exp(evidences - evidences.max())
    weight /= weight.sum()
    expected = weight @ means
    apart = means - expected
    spread = np.einsum("s,sij->ij", weight, covariances) + np.einsum("s,si,sj->ij", weight, apart, apart)
    found = reweighted(mean, covariance)
    assert_allclose(found[0], expected, atol=1e-6)
    assert_allclose(found[1], spread, atol=1e-5 * (STATED.max() ** 2))


def test_without_data_it_is_the_start_with_severities_as_likely_as_before():
    mean, covariance = reweighted(START, np.diag((FIRST_WIDTH * STATED) ** 2))
    assert_allclose(mean, START, atol=1e-12)
    expected = np.dot(LIKELY, np.square(SEVERITIES)) * STATED**2
    assert_allclose(np.diag(covariance), expected, rtol=1e-9)


def test_drift_widens_every_prior_by_the_same_share():
    drift = 2.0 * STATED**2
    _, covariance = reweighted(START, np.diag((FIRST_WIDTH * STATED) ** 2 + drift), drift)
    assert_allclose(np.diag(covariance), 3.0 * np.dot(LIKELY, np.square(SEVERITIES)) * STATED**2, rtol=1e-9)


def test_data_that_do_not_fit_are_worth_less():
    rng = np.random.default_rng(3)
    H = rng.normal(size=(40, SIZE)) / STATED
    y = H @ (START + STATED * rng.normal(size=SIZE)) + 0.5 * rng.normal(size=40)
    misfit = 4.0
    found = reweighted(*posterior(H, y, 0.5, FIRST_WIDTH * STATED)[:2], misfit=misfit)
    expected = reweighted(*posterior(H, y, 0.5 * misfit**0.5, FIRST_WIDTH * STATED)[:2])
    assert_allclose(found[0], expected[0], atol=1e-6)
    assert_allclose(found[1], expected[1], atol=1e-8)
    # Data that fit better than expected are worth no more.
    alike = reweighted(*posterior(H, y, 0.5, FIRST_WIDTH * STATED)[:2], misfit=0.1)
    assert_allclose(alike[0], reweighted(*posterior(H, y, 0.5, FIRST_WIDTH * STATED)[:2])[0])


def test_a_calibrated_robot_keeps_its_map_though_its_body_is_not_as_believed():
    kept = replace(Faults.mild(), gain=0.002, offset=0.05, gain_drift=0.002, offset_drift=0.1)
    for log in fleet(range(4), speeds=(0.04,), faults=kept):
        found, before = (
            errors(calibrated(log.raw, log.reference, kept, name=name), log, 10.0)[0]
            for name in ("moment", "none")
        )
        assert found < before
