"""In-situ calibration of real sensors; the recordings are found through SUREFOOT_DATA."""

import os
from pathlib import Path

import numpy as np
import pytest

from surefoot.calibration import CalibrationRefused
from surefoot.calibration.in_situ import calibrate_in_situ

LOOSE, TIGHT, FILTERED = (
    "in situ, mass known to 1 %",
    "mass to 1 %, place to 0.3 mm",
    "fitted to filtered counts",
)
DATA = Path(os.environ.get("SUREFOOT_DATA") or "nowhere")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (DATA / "ft").is_dir(),
        reason="the environment variable SUREFOOT_DATA names no folder with real recordings",
    ),
]


@pytest.fixture(scope="module")
def metal(benchmark_script):
    return benchmark_script("in_situ_real")


@pytest.fixture(scope="module")
def foot(metal):
    rows = metal.icub_foot(DATA, [LOOSE, TIGHT, FILTERED])
    return {(row.method, row.fitted): row for row in rows}


@pytest.fixture(scope="module")
def gamma(metal):
    return {row.gravity: row for row in metal.gamma_on_arm(DATA)}


@pytest.fixture(scope="module")
def predicted(metal):
    return {row.method: row for row in metal.optical_sensor(DATA)}


@pytest.mark.parametrize("fitted", ["first", "second"])
def test_the_foots_forces_are_better_on_the_half_that_was_not_fitted(foot, fitted):
    factory, ours = (foot[name, fitted] for name in ("factory matrix, offset by the model", LOOSE))
    assert np.linalg.norm(ours.rmse[:3]) < 0.3 * np.linalg.norm(factory.rmse[:3])
    assert ours.mass == pytest.approx(0.382, rel=0.02)


def test_a_filter_is_no_help(foot):
    counts, filtered = (
        np.linalg.norm([foot[name, half].rmse[:3] for half in ("first", "second")])
        for name in (LOOSE, FILTERED)
    )
    assert counts < filtered


@pytest.mark.parametrize("fitted", ["first", "second"])
def test_knowing_where_the_foots_mass_is_keeps_the_torques_right(foot, fitted):
    factory = foot["factory matrix, offset by the model", fitted].rmse
    loose, tight = (foot[name, fitted].rmse for name in (LOOSE, TIGHT))
    assert np.linalg.norm(tight[3:]) < np.linalg.norm(factory[3:])
    assert np.linalg.norm(loose[3:]) < 3.0 * np.linalg.norm(factory[3:])


def test_an_accelerometers_own_bias_no_longer_moves_the_offset(gamma):
    as_read, calibrated = gamma["accelerometer as it reads"], gamma["accelerometer calibrated first"]
    assert as_read.error == pytest.approx(0.70, abs=0.02)  # III-B
    assert as_read.error_in_situ < 0.02
    assert calibrated.error < 0.02
    assert calibrated.error_in_situ < 0.02


def test_the_gammas_load_and_ellipsoid_are_those_of_independent_code(gamma):
    joints = gamma["the arm's joints"]
    np.testing.assert_allclose(joints.offset[:3], [9.08, -1.02, 9.98], atol=0.006)
    np.testing.assert_allclose(joints.axes, [9.28, 9.11, 9.08], atol=0.006)
    for row in gamma.values():
        assert row.mass == pytest.approx(0.932, abs=0.006)
        assert row.held_out < 0.1


def test_a_printed_sensor_is_refused_for_not_being_linear(metal):
    with pytest.raises(CalibrationRefused, match="the limb bends as it turns, or the sensor is not linear"):
        calibrate_in_situ(metal.load_optical(DATA)[0])
    assert "standard deviation" in metal.optical_table(DATA).note


def test_regressing_on_readings_loses_the_printed_sensors_base(predicted):
    paper, ours = predicted["paper (III-B, III-C)"], predicted["in situ"]
    assert paper.mass < 0.3 * 0.309
    assert paper.com_error > 0.1
    assert 0.309 < ours.mass < 0.45
    assert ours.com_error < 0.015


def test_a_matrix_that_is_too_small_predicts_the_printed_sensors_unseen_loads_better(predicted):
    paper, ours, known, zero = (
        predicted[name].loaded
        for name in ("paper (III-B, III-C)", "in situ", "in situ, base known to 1 %", "zero")
    )
    assert paper < known < ours < zero


def test_without_the_bare_load_only_a_known_base_gives_a_matrix(predicted):
    for method in ("paper (III-B, III-C)", "in situ"):
        assert np.isnan(predicted[method].force[0])
    assert predicted["in situ, base known to 1 %"].force[0] < 1.75
