"""The bound against one dense computation over a whole log, and the estimator against the bound."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from _matched import matched, on_cells
from _native import library_with
from _synthetic import DT, LAYOUT

from surefoot.calibration import Parameters, Reference
from surefoot.calibration.front_end.motion import Motions
from surefoot.calibration.moment.bound import posterior_bound
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.newton_euler import NewtonEuler
from surefoot.calibration.moment.rows import Block
from surefoot.calibration.moment.tare import Tare
from surefoot.calibration.moment.unknowns import Unknowns
from surefoot.calibration.native import NATIVE, native_filter
from surefoot.native import compiler

KNOWN = {"com_known": 0.0, "timing_noise": 0.0, "swing_noise": 5e-5, "still": 0.0, "gate": 1e6}
"""Options with which :mod:`_matched` draws from just what the filter believes."""


class Log(NamedTuple):
    """One run's arguments of the bound."""

    setup: object
    raw: np.ndarray
    reference: Reference
    truth: Parameters

    def bound(self, **options):
        return posterior_bound(*self, MomentFilterConfig(**KNOWN, **options))


def run_of(drawn, i):
    run = drawn.run(i)
    return Log(drawn.setup, run.raw, run.reference, Parameters(run.gain, run.offset))


@pytest.fixture(scope="module")
def log():
    return run_of(matched(on_cells(1, 0.1, 3.0), LAYOUT, MomentFilterConfig(**KNOWN), 1, 9), 0)


def blocks_of(log, config, unknowns):
    """Rows of all whole blocks at the truth, and the sample that each ends before."""
    newton_euler, tare = (kind(log.setup, config, unknowns) for kind in (NewtonEuler, Tare))
    motions = Motions(log.setup)
    motion = np.array([motions.flatten(Reference(*row)) for row in zip(*log.reference, strict=True)])
    span, ones = config.every + 2 * config.settle, np.ones(len(log.raw))
    for end in range(config.every, len(log.raw) + 1, config.every):
        if end < span:
            continue
        part = slice(end - span, end)
        swing = log.reference.swing[part].astype(float)
        block = Block(log.raw[part], motion[part], swing, ones[part], ones[part])
        x = unknowns.start.copy()
        x[unknowns.scale] = log.truth.scale[end - 1]
        x[unknowns.offset] = log.truth.offset[end - 1] / (log.truth.scale[end - 1] * unknowns.unit)
        rows, _ = newton_euler.rows(x, block, np.ones(newton_euler.kinds))
        yield end, rows.beside(tare.rows(x, block, *tare.hanging(x, block)))


def test_the_bound_is_the_inverse_information_of_the_whole_path(log):
    config = MomentFilterConfig(**KNOWN)
    unknowns = Unknowns(log.setup, config)
    found = log.bound()
    N, blocks = unknowns.size, list(blocks_of(log, config, unknowns))
    # What neither starts unknown nor wanders has no information to be inverted: it is known.
    free = np.nonzero(unknowns.std > 0.0)[0]
    walk = unknowns.walk * config.every * DT
    wanders = walk > 0.0
    # One state a block for what wanders, one for all blocks for what does not.
    columns, size = [], N
    for k in range(len(blocks)):
        at = np.arange(N)
        if k:
            at[wanders] = np.arange(size, size + wanders.sum())
            size += int(wanders.sum())
        columns.append(at)
    information = np.zeros((size, size))
    information[free, free] += 1.0 / (unknowns.std**2 + walk)[free]
    checked = 0
    for k, (end, rows) in enumerate(blocks):
        if k:
            for before, after, q in zip(
                columns[k - 1][wanders], columns[k][wanders], walk[wanders], strict=True
            ):
                pair = np.ix_([before, after], [before, after])
                information[pair] += np.array([[1.0, -1.0], [-1.0, 1.0]]) / q
        information[np.ix_(columns[k], columns[k])] += rows.H.T @ (rows.H / rows.variance[:, None])
        if k % 5 and k < len(blocks) - 1:
            continue
        until = columns[k].max() + 1
        covariance = np.linalg.inv(information[:until, :until])[np.ix_(columns[k], columns[k])]
        # From the middle of the block to the middle of its use, everything has drifted on.
        covariance += np.diag(unknowns.walk * (config.settle + config.every) * DT)
        checked += check_spread(found, log, covariance[:16, :16], unknowns, end)
    assert checked >= 4
    # From a and o to a and b = a o.
    a, b = (np.diag(part[-1]) for part in log.truth)
    to_map = np.block([[np.eye(8), np.zeros((8, 8))], [b / a.diagonal(), a * unknowns.unit]])
    np.testing.assert_allclose(found.covariance, to_map @ covariance[:16, :16] @ to_map.T, rtol=1e-6)


def check_spread(found, log, covariance, unknowns, k):
    """Hold the bound of one sample against finite differences of its forces and centre of pressure."""
    if k >= len(log.raw):
        return 0
    place = np.concatenate(
        [
            log.reference.position_sole[k, i, :2] + foot.position_cell_sole[:, :2]
            for i, foot in enumerate(LAYOUT.feet)
        ]
    )
    scale, offset = (part[k] for part in log.truth)
    at = np.concatenate([scale, offset / (scale * unknowns.unit)])

    def said(x):
        force = x[:8] * (log.raw[k] + x[8:] * unknowns.unit)
        return np.concatenate([force, [force.sum()], place.T @ force / force.sum()])

    step = 1e-6
    J = np.stack([(said(at + step * e) - said(at - step * e)) / (2 * step) for e in np.eye(16)], axis=1)
    expected = np.sqrt(np.diag(J @ covariance @ J.T))
    np.testing.assert_allclose(found.force[k], expected[:8], rtol=1e-5)
    assert found.vgrf[k] == pytest.approx(expected[8], rel=1e-5)
    np.testing.assert_allclose(found.cop[k], expected[9:], rtol=1e-4)
    return 1


@pytest.mark.parametrize("name", ["force_noise", "cop_noise", "swing_noise", "scale_std", "offset_drift"])
def test_more_noise_is_never_better(log, name):
    value = {**KNOWN, **MomentFilterConfig(**KNOWN).__dict__}[name]
    bounds = [
        posterior_bound(*log, MomentFilterConfig(**{**KNOWN, name: factor * value}))
        for factor in (0.5, 1.0, 2.0)
    ]
    for less, more in pairwise(bounds):
        for field in ("force", "vgrf", "cop"):
            a, b = getattr(less, field), getattr(more, field)
            assert (b >= a * (1.0 - 1e-9)).all(), field
            assert b.mean() > (1.0 + 1e-6) * a.mean(), field
        assert np.linalg.eigvalsh(more.covariance - less.covariance).min() > -1e-9


def test_more_data_is_never_worse_without_drift(log):
    # The same map throughout, so that covariances at different times are of the same errors.
    log = log._replace(truth=Parameters(*(np.broadcast_to(part[0], part.shape) for part in log.truth)))
    found = log.bound(scale_drift=0.0, offset_drift=0.0)
    shorter = Log(log.setup, *(cut(part, 200) for part in log[1:])).bound(scale_drift=0.0, offset_drift=0.0)
    np.testing.assert_allclose(found.cop[:200], shorter.cop, rtol=1e-9)
    assert np.linalg.eigvalsh(shorter.covariance - found.covariance).min() > -1e-12
    assert np.sqrt((found.cop[-80:] ** 2).mean()) < 0.1 * np.sqrt((found.cop[:16] ** 2).mean())


def test_without_load_there_is_no_centre_of_pressure(log):
    found = Log(log.setup, cut(log.raw, 48), cut(log.reference, 48), cut(log.truth, 48))
    lifted = Parameters(found.truth.scale, -found.truth.scale * found.raw)
    assert np.isnan(found._replace(truth=lifted).bound().cop).all()
    assert np.isfinite(found.bound().cop).all()


def cut(part, samples):
    if isinstance(part, tuple):
        return type(part)(*(cut(inner, samples) for inner in part))
    return part[:samples]


def test_arguments_that_do_not_fit_are_refused(log):
    spoilt = log.raw.copy()
    spoilt[7, 3] = np.nan
    with pytest.raises(ValueError, match=r"'raw' must have shape \(samples, channels\) and hold no gaps"):
        log._replace(raw=spoilt).bound()
    with pytest.raises(ValueError, match=r"'raw' must have shape \(samples, channels\) and hold no gaps"):
        log._replace(raw=log.raw[None]).bound()
    with pytest.raises(ValueError, match=r"'raw' must hold one reading for each of the 8 channels"):
        log._replace(raw=log.raw[:, :7]).bound()
    for name in Parameters._fields:
        short = log.truth._replace(**{name: getattr(log.truth, name)[:-1]})
        shape = rf"\({len(log.raw)}, 8\), got \({len(log.raw) - 1}, 8\)"
        with pytest.raises(ValueError, match=rf"'truth\.{name}' must have the shape of 'raw', {shape}"):
            log._replace(truth=short).bound()


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The filter in C, told the noise as the bound is."""
    if compiler() is None:
        pytest.skip("there is no C compiler")
    told = {"SF_NOISE_MEMORY": 0.0, "SF_FIRST_NOISE": 1.0, "SF_FIRST_MISFIT": 1.0}
    return library_with(NATIVE, tmp_path_factory.mktemp("told"), **told)


def against_the_bound(library, **options):
    """Median errors of runs in forces and in the centre of pressure after 4 s, over those of the bound."""
    config, runs = MomentFilterConfig(**KNOWN, **options), 64
    drawn = matched(on_cells(1, 0.1, 12.0), LAYOUT, config, runs, 6)
    filter_ = native_filter(library, "moment", drawn.setup, vars(config))
    assert filter_ is not None
    force, cop = np.empty((len(drawn.raw), runs, 8)), np.empty((len(drawn.raw), runs, 2))
    for i, run in enumerate(drawn.runs()):
        state = filter_.init()
        for k in range(len(run.raw)):
            row = Reference(*(part[k] for part in run.reference))
            estimate = filter_.update(state, run.raw[k], row, DT)
            force[k, i], cop[k, i] = estimate.force, estimate.cop
    true = drawn.gain * drawn.raw + drawn.offset
    place = [
        drawn.reference.position_sole[:, :, i, None, :2] + foot.position_cell_sole[:, :2]
        for i, foot in enumerate(LAYOUT.feet)
    ]
    true_cop = np.einsum("nrk,nrkx->nrx", true, np.concatenate(place, axis=2)) / true.sum(-1)[..., None]
    # The bounds of single runs hardly differ: their motion is the same.
    bounds = [run_of(drawn, i).bound(**options) for i in range(0, runs, 16)]
    after = slice(round(4.0 / DT), None)
    ratios = []
    for wrong, field in ((force - true, "force"), (cop - true_cop, "cop")):
        bound = np.square([getattr(bound, field)[after] for bound in bounds]).mean()
        runs_off = np.square(wrong[after]).mean(axis=(0, *range(2, wrong.ndim)))
        ratios.append(np.sqrt(np.median(runs_off) / bound))
    return ratios


@pytest.mark.slow
def test_without_drift_the_estimator_reaches_the_bound(library):
    force, cop = against_the_bound(library, scale_drift=0.0, offset_drift=0.0)
    # Until a foot has swung, the estimator cannot know, as the bound does, at which offset to write rows, and
    # forgets the scales that it learnt by then.
    assert 0.85 < force < 1.4
    assert 0.85 < cop < 1.35


@pytest.mark.slow
def test_with_drift_forces_are_close_to_the_bound(library):
    force, _ = against_the_bound(library)
    assert 0.85 < force < 1.15


@pytest.mark.slow
def test_with_drift_the_centre_of_pressure_is_close_to_the_bound(library):
    right = {"com_std": 0.0, "sole_std": 0.0, "mass_std": 0.0, "acceleration_std": 0.0, "delay_std": 0.0}
    _, cop = against_the_bound(library, **right)
    assert 0.85 < cop < 1.15
