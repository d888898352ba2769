"""How sure the moment filter is of what it says, and whether it may be."""

import numpy as np
import pytest
from _matched import ANKLES, matched, on_ankles, on_cells
from _native import library_with
from _robots import BAD, calibrated, rows_of
from _synthetic import DT, LAYOUT, MASS, NOMINAL, walk
from scipy.stats import chi2

from surefoot.calibration import OnlineSetup, online_method
from surefoot.calibration.moment import stream as stream_module
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.native import NATIVE, native_filter
from surefoot.native import compiler


def test_what_is_claimed_of_forces_and_of_the_centre_of_pressure_follows_from_the_parameters():
    log = walk(3, 0.1, 6.0, 1.0, BAD)
    estimate = calibrated(log.raw, log.reference)
    rng, k = np.random.default_rng(3), 400
    S, F0 = estimate.covariance[k], NOMINAL.force(log.raw[k])
    row = np.concatenate([np.diag(F0), np.eye(8)], axis=1)
    np.testing.assert_allclose(estimate.force_std[k] ** 2, np.diag(row @ S @ row.T), rtol=1e-9)
    place = np.concatenate(
        [
            log.reference.position_sole[k, i, :2] + foot.position_cell_sole[:, :2]
            for i, foot in enumerate(LAYOUT.feet)
        ]
    )

    def cop(change):
        force = estimate.force[k] + row @ change
        return place.T @ force / force.sum()

    np.testing.assert_allclose(cop(np.zeros(16)), estimate.cop[k], atol=1e-12)
    step = 1e-6
    J = np.stack([(cop(step * e) - cop(-step * e)) / (2 * step) for e in np.eye(16)], axis=1)
    np.testing.assert_allclose(estimate.cop_covariance[k], J @ S @ J.T, rtol=1e-6, atol=1e-12)
    assert np.isfinite(rng.multivariate_normal(np.zeros(16), S)).all()


def test_innovations_are_told_when_a_block_ends_and_only_then():
    log = walk(0, 0.1, 2.0, 1.0, BAD)
    method = online_method("moment", OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL))
    state = method.init(log.raw[0])
    for k in range(len(log.raw)):
        state, estimate = method.update(state, log.raw[k], rows_of(log.reference, k), DT)
        if (k + 1) % 16:
            assert estimate.nis is None or np.isnan(estimate.nis)
            assert estimate.nis_rows is None or estimate.nis_rows == 0
        elif k > 48:
            assert estimate.nis > 0.0
            assert estimate.nis_rows in (24, 28)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The filter in C with other constants: 200 runs in Python would take minutes."""
    if compiler() is None:
        pytest.skip("there is no C compiler")
    # Noise and drift that are known need neither a gate nor factors and allowances, and blocks of a robot
    # that stands still are then as good as any. The readings' own noise is in no row: it is small.
    # The filter's own posterior is judged, which then begins with the prior that the truth is drawn from.
    others = {"SF_RATE_MEMORY": 0.0, "SF_LONGEST_STANCE": 0.0, "SF_FIRST_WIDTH": 1.0}
    others |= {"SF_NOISE_MEMORY": 0.0, "SF_FIRST_NOISE": 1.0}
    return library_with(NATIVE, tmp_path_factory.mktemp("known"), **others)


def consistency(truth, layout, library, monkeypatch, runs=200, **options):
    """NEES of (a, b) of many runs, their number, and (nis, rows) of each block."""
    # The constants of one robot, its first covariance among them, are worked out in Python.
    monkeypatch.setattr(stream_module, "FIRST_WIDTH", 1.0)
    monkeypatch.setattr(stream_module, "FIRST_NOISE", 1.0)
    # Nothing repeats here but what has an unknown: the centre of mass may be known to any depth.
    config = MomentFilterConfig(
        com_known=0.0, timing_noise=0.0, swing_noise=5e-5, still=0.0, gate=1e6, **options
    )
    drawn = matched(truth, layout, config, runs, 5)
    of_map = drawn.unknowns.map
    # What the last block told is of its middle samples, and what wanders after them is not in it.
    last = len(drawn.raw) // config.every * config.every - config.settle - 1
    filter_ = native_filter(library, "moment", drawn.setup, vars(config))
    assert filter_ is not None
    nees, nis, rows = [], [], []
    for run in drawn.runs():
        state = filter_.init()
        seen = [filter_.update(state, run.raw[k], rows_of(run.reference, k), DT) for k in range(len(run.raw))]
        blocks = [(estimate.nis, estimate.nis_rows) for estimate in seen if np.isfinite(estimate.nis)]
        nis.append([found for found, _ in blocks])
        rows.append([number for _, number in blocks])
        found = filter_.unpack(state)
        error = found.mean[of_map] - run.path[last, of_map]
        nees.append(error @ np.linalg.solve(found.covariance[of_map, of_map], error))
    # Until the offsets are known, rows allow for more than there is: their product with the scales' errors.
    later = slice(len(nis[0]) // 2, None)
    return np.array(nees), of_map.stop, np.array(nis).T[later], np.array(rows).T[later]


WALKERS = [(on_cells, LAYOUT), (on_ankles, ANKLES)]


@pytest.mark.slow
@pytest.mark.parametrize(("walker", "layout"), WALKERS)
def test_errors_are_as_large_as_claimed(walker, layout, library, monkeypatch):
    # Errors of the reference for which the first order, which is all that the rows tell, is enough.
    small = {
        "com_std": 1e-3,
        "sole_std": 1e-4,
        "mass_std": 2.5e-3,
        "acceleration_std": 0.01,
        "delay_std": 1e-3,
    }
    nees, known, nis, rows = consistency(walker(1, 0.1, 12.0), layout, library, monkeypatch, **small)
    low, high = chi2.ppf([0.025, 0.975], len(nees) * known) / len(nees)
    low_nis, high_nis = chi2.ppf([0.025, 0.975], rows[-1].sum())
    assert low_nis < nis[-1].sum() < high_nis
    assert 0.98 < nis.sum() / rows.sum() < 1.02
    assert low < nees.mean() < high


@pytest.mark.slow
@pytest.mark.parametrize(("walker", "layout"), WALKERS)
def test_with_all_errors_of_the_reference_they_are_hardly_larger(walker, layout, library, monkeypatch):
    nees, known, nis, rows = consistency(walker(1, 0.1, 12.0), layout, library, monkeypatch)
    low, _ = chi2.ppf([0.025, 0.975], len(nees) * known) / len(nees)
    assert 0.98 < nis.sum() / rows.sum() < 1.02
    assert low < nees.mean() < 1.2 * known


@pytest.mark.slow
@pytest.mark.parametrize(("walker", "layout"), WALKERS)
def test_without_errors_of_the_reference_errors_are_as_large_as_claimed(walker, layout, library, monkeypatch):
    right = {"com_std": 0.0, "sole_std": 0.0, "mass_std": 0.0, "acceleration_std": 0.0, "delay_std": 0.0}
    nees, known, nis, rows = consistency(walker(1, 0.1, 12.0), layout, library, monkeypatch, **right)
    low, high = chi2.ppf([0.005, 0.995], len(nees) * known) / len(nees)
    assert 0.98 < nis.sum() / rows.sum() < 1.02
    assert low < nees.mean() < high * 1.05
