"""Six-axis sensors of strain gauges: their errors as specified, and the map that undoes them."""

import json
from dataclasses import asdict, replace
from itertools import product

import numpy as np
import pytest
from _refusals import refusals
from _streams import follow, stream

from surefoot.sensors import StrainGauges, preset, strain_gauges
from surefoot.sensors.devices.strain_gauge_config import FTSENS_SN039, FTSENS_SN142
from surefoot.sensors.devices.strain_gauges import OFFSET, SCALE, shift_offset, true_response
from surefoot.sensors.presets import resolve
from surefoot.sensors.stages.nonlinearity import cross_nonlinearity

LEG = preset("icub-ftsens-leg", StrainGauges)
PERFECT = preset("perfect", StrainGauges)
WRENCH = np.array([12.0, -9.0, 44.0, 3.1, -2.2, 0.4])
RESPONSE_8 = np.random.default_rng(80).normal(size=(8, 6)) * np.repeat([15.0, 900.0], 3)
EIGHT = replace(PERFECT, matrix=np.linalg.pinv(RESPONSE_8))
FORCE, TORQUE = slice(0, 3), slice(3, 6)


def drawn(config, seed=0):
    sensor, rng = strain_gauges(config), np.random.default_rng(seed)
    return sensor, sensor.init((config.channels,), rng), rng


def many(config, count, seed):
    sensor, rng = strain_gauges(config), np.random.default_rng(seed)
    return [sensor.init((config.channels,), rng) for _ in range(count)]


def wrenches(config, counts):
    """What the maker's matrix shows."""
    return counts @ config.nominal_matrix.T


@pytest.mark.parametrize("matrix", [FTSENS_SN039, FTSENS_SN142])
def test_the_makers_matrix_turns_perfect_counts_into_the_wrench(matrix):
    config = replace(PERFECT, matrix=matrix)
    sensor, state, rng = drawn(config)
    counts, _ = sensor.apply(WRENCH, state, rng, 0.01)
    np.testing.assert_allclose(np.array(matrix) @ counts, WRENCH, rtol=0.0, atol=1e-12 * 50.0)
    np.testing.assert_allclose(config.nominal_response @ WRENCH, counts, rtol=1e-12)


@pytest.mark.parametrize("config", [LEG, preset("icub-ftsens-foot", StrainGauges)], ids=["leg", "foot"])
def test_the_true_response_undoes_every_wandering_heating_sensor(config):
    """w = A^+ (r - o) but for what creeps, lags, hisses and rounds (in-situ paper, Eq. 2)."""
    still = {"hysteresis": 0.0, "noise_force": 0.0, "noise_torque": 0.0, "adc_bits": 0}
    config = replace(
        config, **still, creep_shares=(), creep_time_constants=(), temperature_ramp=0.1, temperature_rise=14.0
    )
    for seed in range(30):
        sensor, state, rng = drawn(config, seed)
        for _ in range(50):
            counts, state = sensor.apply(WRENCH, state, rng, 2.0)
        A, o = true_response(config, state)
        assert (A.shape, o.shape) == ((6, 6), (6,))
        np.testing.assert_allclose(counts, A @ WRENCH + o, rtol=1e-12)
        np.testing.assert_allclose(np.linalg.solve(A, counts - o), WRENCH, atol=1e-9)


def test_without_offsets_the_true_matrix_is_exact():
    config = replace(PERFECT, scale_error_std=0.2, cross_talk_std=0.03)
    for seed in range(200):
        sensor, state, rng = drawn(config, seed)
        counts, _ = sensor.apply(WRENCH, state, rng, 0.01)
        A, o = true_response(config, state)
        np.testing.assert_allclose(np.linalg.inv(A) @ (counts - o), WRENCH, atol=1e-12 * 50.0)


def test_small_matrix_errors_have_their_spread_and_large_ones_stay_invertible():
    for gain, talk in ((0.01, 0.003), (0.5, 0.1)):
        config = replace(PERFECT, scale_error_std=gain, cross_talk_std=talk)
        response = np.array([state.response for state in many(config, 4000, seed=3)])
        scale = config.full_scale
        shown = config.nominal_matrix @ response * scale / scale[:, None]
        error = shown - np.eye(6)
        if gain < 0.1:
            assert np.diagonal(error, axis1=1, axis2=2).std() == pytest.approx(gain, rel=0.02)
            assert error[:, ~np.eye(6, dtype=bool)].std() == pytest.approx(talk, rel=0.02)
        assert np.linalg.det(shown).min() > 0.0
        assert np.linalg.cond(shown).max() < 200.0


def test_an_old_leg_sensor_shows_a_weight_as_badly_as_the_papers_did():
    """In-situ paper, Table I, manufacturer, leg: the longest semi-axis is 1.7 to 1.9 times the shortest."""
    response = np.array([state.response for state in many(LEG, 4000, seed=4)])
    mass, com = 4.9, np.array([0.01, 0.02, 0.17])
    skew = np.cross(np.eye(3), com).T
    carried = 9.81 * mass * np.concatenate([np.eye(3), skew])
    axes = np.linalg.svd((LEG.nominal_matrix @ response @ carried)[:, FORCE], compute_uv=False)
    assert np.median(axes[:, 0] / axes[:, 2]) == pytest.approx(1.9, abs=0.1)


def test_offsets_lie_within_their_range_and_fill_it():
    shown = wrenches(LEG, np.array([state.offset for state in many(LEG, 4000, seed=5)]))
    for part, most in ((FORCE, LEG.offset_force), (TORQUE, LEG.offset_torque)):
        assert 0.99 * most < abs(shown[:, part]).max() <= most * (1.0 + 1e-9)
        assert shown[:, part].std() == pytest.approx(most / np.sqrt(3.0), rel=0.02)


def test_noise_shows_as_specified():
    config = replace(PERFECT, noise_force=0.1, noise_torque=0.0025)
    shown = wrenches(config, stream(strain_gauges(config), np.tile(WRENCH, (5000, 1)), seed=6)) - WRENCH
    np.testing.assert_allclose(shown.std(axis=0), np.repeat([0.1, 0.0025], 3), rtol=0.05)
    assert abs(np.corrcoef(shown.T) - np.eye(6)).max() < 0.06


@pytest.mark.parametrize("steps", [2, 20])
def test_drift_depends_on_time_and_not_on_the_step(steps):
    walks = {name: getattr(LEG, name) for name in ("offset_drift_force", "offset_drift_torque")}
    config = replace(PERFECT, **walks)
    # Without a load it reads its offsets: what they do from minute to minute.
    counts = stream(strain_gauges(config), np.zeros((1000 * steps, 6)), seed=7, dt=60.0 / steps)
    shown = np.diff(wrenches(config, counts[steps - 1 :: steps]), axis=0)
    assert shown[:, FORCE].std() == pytest.approx(0.05, rel=0.04)
    assert shown[:, TORQUE].std() == pytest.approx(0.001, rel=0.04)


def test_offsets_jump_between_recordings():
    _, state, rng = drawn(LEG, seed=8)
    later = [shift_offset(LEG, state, rng, 2.0, 0.04) for _ in range(3000)]
    jump = wrenches(LEG, np.array([one.offset for one in later]) - state.offset)
    assert jump[:, FORCE].std() == pytest.approx(2.0, rel=0.03)
    assert jump[:, TORQUE].std() == pytest.approx(0.04, rel=0.03)
    np.testing.assert_array_equal(later[0].response, state.response)
    with pytest.raises(ValueError, match="'torque_std' must be finite and not negative, got -1"):
        shift_offset(LEG, state, rng, 1.0, -1.0)


@pytest.mark.parametrize("step", [1.0, 90.0])
def test_heat_moves_offsets_and_scales_as_specified(step):
    config = replace(
        PERFECT,
        offset_tempco_force=0.05,
        offset_tempco_torque=0.001,
        scale_tempco=2e-4,
        temperature_ramp=14.0 / 900.0,
        temperature_rise=14.0,
    )
    rise, tempco = 14.0 * (1.0 - np.exp(-1.0)), []
    for number, state in enumerate(many(config, 2000, seed=9)):
        tempco.append(state.tempco)
        if number < 3:
            sensor, rng = strain_gauges(config), np.random.default_rng(number)
            for _ in range(int(900 / step)):
                counts, state = sensor.apply(WRENCH, state, rng, step)
            np.testing.assert_allclose(state.temperature, rise, rtol=1e-12)
            np.testing.assert_allclose(state.offset, rise * state.tempco[OFFSET], rtol=1e-9)
            relative = (counts - state.offset) / (config.nominal_response @ WRENCH) - 1.0
            np.testing.assert_allclose(relative, rise * state.tempco[SCALE], atol=1e-12)
    zero = wrenches(config, np.array(tempco)[:, OFFSET])
    assert zero[:, FORCE].std() == pytest.approx(0.05, rel=0.04)
    assert zero[:, TORQUE].std() == pytest.approx(0.001, rel=0.04)
    assert np.array(tempco)[:, SCALE].std() == pytest.approx(2e-4, rel=0.04)


def test_each_component_of_the_load_lags_on_its_own():
    """A force of 2 N beside a torque of 6 N m, swinging out of step: each has its own loop."""
    config = replace(PERFECT, hysteresis=0.01)
    angle = 2.0 * np.pi * np.arange(200) / 100.0
    swing = np.zeros((200, 6))
    swing[:, 2], swing[:, 3] = 2.0 * np.sin(angle), 6.0 * np.cos(angle)
    shown = wrenches(config, stream(strain_gauges(config), swing, dt=0.1))[100:]
    # Beneath is what the steps of the sampling leave of the extremes.
    assert abs(shown[0, 2] - shown[50, 2]) == pytest.approx(0.01 * 4.0, rel=0.05)
    assert abs(shown[75, 3] - shown[25, 3]) == pytest.approx(0.01 * 12.0, rel=0.05)


def test_cycles_of_the_stated_amplitude_end_where_the_true_response_says():
    config = replace(PERFECT, hysteresis=0.01)
    sensor, state, rng = drawn(config)
    for axis, amplitude in ((0, 50.0), (4, 5.0)):
        shown = []
        for sign in (1.0, -1.0):
            counts, state = sensor.apply(sign * amplitude * np.eye(6)[axis], state, rng, 0.1)
            shown.append(wrenches(config, counts)[axis])
        assert shown[0] - shown[1] == pytest.approx(2.0 * amplitude, rel=1e-12)


def test_an_element_bends_in_shares_of_its_full_scales():
    bends = {"nonlinearity": 0.04, "cross_nonlinearity": 0.01}
    config = replace(PERFECT, full_scale_force=60.0, full_scale_torque=6.0, **bends)
    for seed in range(5):
        sensor, state, rng = drawn(config, seed)
        counts, _ = sensor.apply(WRENCH, state, rng, 0.01)
        bent, _ = cross_nonlinearity(0.04, 0.01, config.full_scale).apply(WRENCH, state.bend, rng, 0.01)
        np.testing.assert_allclose(wrenches(config, counts), bent, rtol=1e-9)
        assert abs(bent - WRENCH).max() > 0.2


def test_a_constant_load_creeps():
    config = replace(PERFECT, creep_shares=(0.002,), creep_time_constants=(30.0,))
    sensor, state, rng = drawn(config)
    for _ in range(30):
        counts, state = sensor.apply(WRENCH, state, rng, 1.0)
    np.testing.assert_allclose(wrenches(config, counts), WRENCH * (1.002 - 0.002 * np.exp(-1.0)), rtol=1e-9)


def test_counts_are_whole_and_end_at_the_converters_range():
    for seed, size in product(range(20), (1.0, 1e4, -1e4)):
        sensor, state, rng = drawn(LEG, seed)
        counts, _ = sensor.apply(size * WRENCH, state, rng, 0.01)
        np.testing.assert_array_equal(counts, np.round(counts))
        assert abs(counts).max() == 32767.0 if abs(size) > 1.0 else abs(counts).max() < 32767.0
    assert StrainGauges(adc_bits=12).code_range == (-2047.0, 2047.0)


def test_eight_gauges_show_their_redundancy():
    np.testing.assert_allclose(EIGHT.nominal_response, RESPONSE_8, rtol=1e-9)
    noisy = replace(EIGHT, noise_force=0.1, noise_torque=0.0025)
    counts = follow(strain_gauges(noisy), np.tile(WRENCH, (5000, 1)), state=drawn(noisy, seed=11)[1])[0]
    assert counts.shape == (5000, 8)
    shown = wrenches(noisy, counts) - WRENCH
    np.testing.assert_allclose(shown.std(axis=0), np.repeat([0.1, 0.0025], 3), rtol=0.05)
    # No wrench causes this part of the noise, which is as large as the rest is on average.
    noise = counts - RESPONSE_8 @ WRENCH
    image = shown @ RESPONSE_8.T
    assert (noise - image).var() * 8 / 2 == pytest.approx(image.var() * 8 / 6, rel=0.05)
    A, o = true_response(EIGHT, drawn(replace(EIGHT, scale_error_std=0.2, offset_force=50.0), seed=12)[1])
    np.testing.assert_allclose(np.linalg.pinv(A) @ (A @ WRENCH + o - o), WRENCH, atol=1e-11)
    assert abs(o - RESPONSE_8 @ EIGHT.nominal_matrix @ o).max() > 1.0


def test_matrices_may_come_as_arrays_and_lists():
    config = StrainGauges(matrix=np.array(FTSENS_SN039))
    assert config == LEG
    assert hash(config) == hash(LEG)
    assert resolve(json.loads(json.dumps(asdict(EIGHT))), StrainGauges) == EIGHT


test_impossible_values_are_refused = refusals(
    lambda fields: StrainGauges(**fields),
    ({"matrix": ((1.0, 2.0),)}, "StrainGauges.matrix must have six rows of at least six numbers"),
    ({"matrix": (FTSENS_SN039[0],) * 6}, "StrainGauges.matrix must be finite and have rank six"),
    ({"scale_error_std": 0.6}, "StrainGauges.scale_error_std must be at most 0.5, got 0.6"),
    ({"adc_bits": 1}, "StrainGauges.adc_bits must be 0 or lie in 2 to 32, got 1"),
    (
        {"hysteresis_true_torque": 36.0},
        "StrainGauges.hysteresis_true_torque must be at most the full scale, 35.0, got 36.0",
    ),
    (
        {"nonlinearity": 0.1, "cross_nonlinearity": 0.02},
        r"cross_nonlinearity must keep 5.2 nonlinearity \+ 30 cross_nonlinearity below 1.*got 0.02",
    ),
    ({"creep_shares": (0.1,)}, "StrainGauges.creep_time_constants must hold a positive time for each of"),
)


def test_wrong_shapes_are_refused():
    sensor, state, rng = drawn(EIGHT)
    with pytest.raises(ValueError, match=r"must hold the 8 channels, got shape \(12,\); give \(8,\)"):
        sensor.init((12,), rng)
    with pytest.raises(ValueError, match=r"^A wrench must have the shape \(6,\), got \(8,\)\.$"):
        sensor.apply(np.zeros(8), state, rng, 0.01)
