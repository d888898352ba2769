"""Fitting channels to known loads."""

import numpy as np
import pytest
from _refusals import refusals
from hypothesis import given, settings
from hypothesis import strategies as st

from surefoot.calibration.results import CalibrationRefused, FitResult
from surefoot.calibration.weights.channels import fit_channels

# The CoP paper's Table 2: codes without load and under 0.01, 0.05 and 0.2 kg; scaling and biasing
# coefficients as printed (1e-6 kg per count, kg).
TABLE_2_LOADS = [0.0, 0.01, 0.05, 0.2]
TABLE_2 = [
    ("left foot, front left", [8347750, 8344582, 8326926, 8264253], -2.38250654, 19.8895457),
    ("left foot, front right", [8347750, 8344582, 8301298, 8264254], -2.20853048, 18.4277626),
    ("left foot, rear left", [8322914, 8317325, 8301301, 8264263], -3.47692594, 28.9285295),
    ("left foot, rear right", [8322914, 8317325, 8301299, 8264278], -3.47779548, 28.9357592),
    ("right foot, front left", [8322914, 8317426, 8301297, 8264254], -3.47368720, 28.9017197),
    ("right foot, front right", [8322914, 8317356, 8301289, 8264261], -3.47589563, 28.9199912),
    ("right foot, rear left", [8322914, 8317320, 8301299, 8264262], -3.47698378, 28.9290027),
    ("right foot, rear right", [8321583, 8317321, 8301297, 8264267], -3.52997190, 29.3677097),
]


def test_reproduces_table_2_of_the_paper():
    codes = np.array([row[1] for row in TABLE_2]).T
    fit = fit_channels(codes, TABLE_2_LOADS, [row[0] for row in TABLE_2])
    np.testing.assert_allclose(fit.value.scale, [row[2] * 1e-6 for row in TABLE_2], rtol=1e-8)
    np.testing.assert_allclose(fit.value.offset, [row[3] for row in TABLE_2], rtol=1e-8)


def test_only_the_first_cell_of_table_2_is_straight():
    # Under at most 200 g, a line leaves 1 g at the first cell and 8 to 26 g at the others.
    fit = fit_channels(np.array([row[1] for row in TABLE_2]).T, TABLE_2_LOADS)
    rms = np.array([stats.residual_rms for stats in fit.stats])
    assert rms[0] < 0.001
    assert ((rms[1:] > 0.008) & (rms[1:] < 0.027)).all()


@settings(deadline=None, derandomize=True, max_examples=100)
@given(
    size=st.floats(-7.0, 0.0),
    sign=st.sampled_from([-1.0, 1.0]),
    zero=st.floats(-8.4e6, 8.4e6),
    top=st.floats(-2.0, 2.0),
)
def test_recovers_a_line_without_noise(size, sign, zero, top):
    scale = sign * 10.0**size
    load = np.array([0.0, 0.2, 0.5, 1.0]) * 10.0**top
    code = load / scale + zero
    fit = fit_channels(code[:, None], load)
    # Codes near 8 million have their own rounding, which a small span of codes magnifies.
    lost = np.finfo(float).eps * np.max(np.abs(code)) / np.ptp(code)
    np.testing.assert_allclose(fit.value.scale, scale, rtol=1e-12 + 10 * lost)
    np.testing.assert_allclose(fit.value.force(code), load, atol=1e-9 * load[-1] + 10 * lost * load[-1])
    assert fit.result is FitResult.DETERMINED


def test_each_channel_may_bear_its_own_loads():
    rng = np.random.default_rng(21)
    scale, offset = rng.uniform(2e-5, 5e-5, 8) * np.tile([-1.0, 1.0], 4), rng.uniform(-300.0, 300.0, 8)
    load = rng.uniform(0.0, 59.0, (6, 8))
    fit = fit_channels((load - offset) / scale, load)
    np.testing.assert_allclose(fit.value.scale, scale, rtol=1e-9)
    np.testing.assert_allclose(fit.value.offset, offset, rtol=1e-9)
    in_kg = fit_channels((load - offset) / scale, load / 9.81)
    np.testing.assert_allclose(in_kg.value.scale * 9.81, scale, rtol=1e-9)


def test_covariance_agrees_with_the_errors():
    # Known codes and noisy weights: the errors of (c, d) against the covariance claimed, over 2000 benches.
    rng = np.random.default_rng(22)
    n, trials, scale, offset = 10, 2000, 3.4e-5, -283.0
    load = np.linspace(0.0, 58.86, n)
    code = (load - offset) / scale
    noisy = load[:, None] + 0.02 * rng.standard_normal((n, trials))
    fit = fit_channels(np.repeat(code[:, None], trials, axis=1), noisy)
    error = np.stack([fit.value.scale - scale, fit.value.offset - offset], axis=-1)
    nees = np.einsum("ti,tij,tj->t", error, np.linalg.inv(fit.covariance), error)
    # With the noise estimated from n - 2 residuals, NEES / 2 is F(2, n - 2), whose mean is (n-2)/(n-4).
    np.testing.assert_allclose(nees.mean() / 2.0, (n - 2) / (n - 4), rtol=0.1)


def test_two_loads_make_a_line_without_a_spread():
    fit = fit_channels([[8_000_000.0], [8_300_000.0]], [0.0, 10.0])
    np.testing.assert_allclose(fit.value.force(np.array([8_150_000.0])), 5.0)
    assert np.isnan(fit.covariance).all()
    assert fit.stats[0].rank == 2


def test_leaves_out_what_is_not_finite_and_says_so():
    load = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    raw = np.stack([100.0 * load, -50.0 * load], axis=-1)
    raw[1, 0], raw[2, 0] = np.nan, np.inf
    kept = raw.copy()
    fit = fit_channels(raw, load)
    np.testing.assert_allclose(fit.value.scale, [0.01, -0.02], rtol=1e-12)
    assert [stats.dropped for stats in fit.stats] == [2, 0]
    assert [stats.samples for stats in fit.stats] == [3, 5]
    with pytest.raises(CalibrationRefused, match=r"'channel 0' saw only the load 2 N, and a line needs two"):
        fit_channels([[100.0, np.nan], [np.nan, 300.0]], [2.0, 2.0])
    np.testing.assert_array_equal(raw, kept)


@pytest.mark.parametrize(
    ("raw", "load", "reason", "cure"),
    [
        (
            [[100.0], [101.0], [99.0]],
            [2.0, 2.0, 2.0],
            "The cell 'left/front-left' saw only the load 2 N, and a line needs two.",
            "Add a reading of this cell without load",
        ),
        (
            [[np.nan], [np.inf]],
            [0.0, 2.0],
            "saw no load (2 samples without a finite value left out)",
            "Add a reading",
        ),
        (
            [[np.nan], [500.0]],
            [0.0, 2.0],
            "saw only the load 2 N (1 samples without a finite value left out)",
            "Add a reading",
        ),
        (
            [[8388607.0], [8388607.0], [8388607.0]],
            [0.0, 1.0, 2.0],
            "The cell 'left/front-left' read 8.38861e+06 under all 3 loads.",
            "Check its wiring",
        ),
    ],
)
def test_refuses_what_no_line_goes_through(raw, load, reason, cure):
    with pytest.raises(CalibrationRefused) as refusal:
        fit_channels(raw, load, ["left/front-left"])
    assert reason in refusal.value.reason
    assert cure in refusal.value.cure
    assert str(refusal.value) == f"{refusal.value.reason} {refusal.value.cure}"
    assert isinstance(refusal.value, ValueError)


test_refuses_shapes_that_do_not_belong_together = refusals(
    fit_channels,
    (np.ones(3), np.ones(3), None, "'raw' must have shape (samples, channels), got (3,)."),
    (np.ones((3, 2)), np.ones(2), None, "'load' must have shape (3,) or (3, 2) for 'raw' of shape (3, 2)"),
    (np.eye(3), np.arange(3), ["a"], "'raw' has 3 channels, but 1 channel names were given."),
    plain=True,
)


def test_no_samples_are_refused():
    with pytest.raises(ValueError, match=r"'raw' must hold at least one sample, got shape \(0, 2\)"):
        fit_channels(np.zeros((0, 2)), [])
