"""The bound against the filter's own algebra, physics' demands, and the estimator against it."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from _moment import Errors, move
from _synthetic import DT, LAYOUT, MASS, NOMINAL

from surefoot.calibration import MomentumReference, OnlineSetup, Parameters, posterior_bound, replay
from surefoot.calibration.excitation.bound import LogPassages, Passage
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.modes import update

SETUP = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, dt=DT, lag=0)


class Log(NamedTuple):
    """One run's arguments of the bound."""

    raw: np.ndarray
    reference: MomentumReference
    truth: Parameters

    def bound(self, **options):
        return posterior_bound(SETUP, *self, Moment(**options))


def log_of(seed, seconds, errors):
    motion = move(seed, seconds, errors)
    a, zero = motion.correction
    return Log(motion.raw, motion.reference, Parameters(a * NOMINAL.scale, a * NOMINAL.offset + zero))


@pytest.fixture(scope="module")
def log():
    return log_of(1, 6.0, Errors.stated())


@pytest.fixture(scope="module")
def short(log):
    """The first 3 s, with both feet's swings, and its bound as stated."""
    first = Log(*(cut(part, 240) for part in log))
    return first, first.bound()


def test_a_passage_is_a_prediction_and_an_update():
    rng = np.random.default_rng(5)
    N, m = 9, 4
    S, R, Q = (A @ A.T + 0.1 * np.eye(len(A)) for A in (rng.normal(size=(k, k)) for k in (N, m, N)))
    F, H = np.eye(N) + 0.2 * rng.normal(size=(N, N)), rng.normal(size=(m, N))
    _, learnt = update(np.zeros(N), S, H, np.zeros(m), R, slice(0))
    both = Passage.learn(H, R).then(Passage.move(F, Q))
    np.testing.assert_allclose(both.after(S), F @ learnt @ F.T + Q, rtol=1e-9, atol=1e-9)
    twice = both.then(both)
    np.testing.assert_allclose(twice.after(S), both.after(both.after(S)), rtol=1e-9, atol=1e-9)


def test_a_whole_log_is_its_blocks_one_after_the_other(log):
    passages = LogPassages(SETUP, *log)
    covariance = passages.start
    for _, passage in passages.blocks:
        covariance = passage.after(covariance)
    std = np.sqrt(np.diagonal(covariance))
    off = (passages.whole().after(passages.start) - covariance) / np.outer(std, std)
    assert np.abs(off).max() < 1e-6
    np.testing.assert_allclose(log.bound().covariance, passages.of_parameters(covariance), rtol=1e-12)


def test_deviations_are_those_of_forces_and_pressures_by_differences(log):
    passages, k = LogPassages(SETUP, *log), 301
    covariance = passages.start
    for end, passage in passages.blocks:
        if end <= k:
            covariance = passage.after(covariance)
    of_map = passages.of_parameters(covariance, k)
    true = log.truth.relative_to(Parameters(*(np.asarray(part) for part in NOMINAL)))
    at, F0 = np.concatenate([true.scale[k], true.offset[k]]), NOMINAL.force(log.raw[k])
    place = np.concatenate(
        [
            log.reference.position_sole[k, i, :2] + foot.position_cell_sole[:, :2]
            for i, foot in enumerate(LAYOUT.feet)
        ]
    )

    def read(x):
        force = x[:8] * F0 + x[8:]
        return np.concatenate([force, [force.sum()], place.T @ force / force.sum()])

    step = 1e-6
    J = np.stack([(read(at + step * e) - read(at - step * e)) / (2 * step) for e in np.eye(16)], axis=1)
    expected = np.sqrt(np.diag(J @ of_map @ J.T))
    found = log.bound()
    np.testing.assert_allclose(found.force[k], expected[:8], rtol=1e-5)
    assert found.vgrf[k] == pytest.approx(expected[8], rel=1e-5)
    np.testing.assert_allclose(found.cop[k], expected[9:], rtol=1e-4)


@pytest.mark.parametrize(
    "name", ["velocity_noise", "vertical_noise", "momentum_noise", "tare_noise", "scale_std", "offset_drift"]
)
def test_more_noise_is_never_better(short, name):
    (log, as_stated), stated = short, getattr(Moment(), name)
    half, double = (log.bound(**{name: factor * stated}) for factor in (0.5, 2.0))
    bounds = half, as_stated, double
    for less, more in pairwise(bounds):
        for field in ("force", "vgrf", "cop"):
            a, b = getattr(less, field), getattr(more, field)
            assert (b >= a * (1.0 - 1e-7)).all(), field
        assert more.force.mean() > (1.0 + 1e-6) * less.force.mean()
        std = np.sqrt(np.diagonal(more.covariance))
        worse = (more.covariance - less.covariance) / np.outer(std, std)
        assert np.linalg.eigvalsh(worse).min() > -1e-7


def test_more_data_is_never_worse_without_drift():
    log = log_of(1, 6.0, Errors(scale=0.12, offset=0.03))
    still = {"scale_drift": 0.0, "offset_drift": 0.0}
    found, shorter = log.bound(**still), Log(*(cut(part, 200) for part in log)).bound(**still)
    np.testing.assert_allclose(found.cop[:200], shorter.cop, rtol=1e-9)
    assert np.linalg.eigvalsh(shorter.covariance - found.covariance).min() > -1e-9
    assert np.sqrt((found.cop[-80:] ** 2).mean()) < 0.2 * np.sqrt((found.cop[:8] ** 2).mean())


def test_without_load_there_is_no_centre_of_pressure(log):
    found = Log(*(cut(part, 48) for part in log))
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


def test_the_estimator_comes_near_the_bound():
    """Over robots as bad as stated: it weighs how bad they are, so that a single one may be better."""
    known = {"ripple": 0.0}  # readings are means over their intervals
    wrong, bounds = [], []
    after = slice(round(6.0 / DT), None)
    for seed in range(8):
        log = log_of(seed, 10.0, Errors.stated())
        robot = {"mass": MASS, "initial": NOMINAL, "lag": 0}
        estimate = replay(LAYOUT, "moment", log.raw, log.reference, DT, **robot, **known)
        true = log.truth.scale * log.raw + log.truth.offset
        wrong.append(np.square(estimate.force - true)[after].mean())
        bounds.append(np.square(log.bound(**known).force[after]).mean() if seed < 2 else np.nan)
    ratio = np.sqrt(np.mean(wrong) / np.nanmean(bounds))
    assert 0.8 < ratio < 1.5, ratio
