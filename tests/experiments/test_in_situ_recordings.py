"""In-situ calibration of real sensors; the recordings are found through SUREFOOT_DATA."""

import numpy as np
import pytest
from _recordings import DATA, needs

from surefoot.calibration import CalibrationRefused
from surefoot.calibration.in_situ import calibrate_in_situ

LOOSE, TIGHT, FILTERED = (
    "in situ, mass known to 1 %",
    "mass to 1 %, place to 0.3 mm",
    "fitted to filtered counts",
)
pytestmark = [pytest.mark.slow, needs("ft")]


@pytest.fixture(scope="module")
def metal(benchmark_script):
    return benchmark_script("in_situ_real")


@pytest.fixture(scope="module")
def foot(metal):
    return metal.icub_foot(DATA, [LOOSE, TIGHT, FILTERED])


@pytest.fixture(scope="module")
def gamma(metal):
    return metal.gamma_on_arm(DATA)


FORCES, TORQUES = ["Fx N", "Fy N", "Fz N"], ["Tx N m", "Ty N m", "Tz N m"]


@pytest.mark.parametrize("fitted", ["first", "second"])
def test_the_foots_forces_are_better_on_the_half_that_was_not_fitted(foot, fitted):
    factory, ours = (foot.loc[(name, fitted)] for name in ("factory matrix, offset by the model", LOOSE))
    assert np.linalg.norm(ours[FORCES]) < 0.3 * np.linalg.norm(factory[FORCES])
    assert ours["limb kg"] == pytest.approx(0.382, rel=0.02)


def test_a_filter_is_no_help(foot):
    counts, filtered = (np.linalg.norm(foot.loc[name, FORCES]) for name in (LOOSE, FILTERED))
    assert counts < filtered


@pytest.mark.parametrize("fitted", ["first", "second"])
def test_knowing_where_the_foots_mass_is_keeps_the_torques_right(foot, fitted):
    factory, loose, tight = (
        np.linalg.norm(foot.loc[(name, fitted), TORQUES])
        for name in ("factory matrix, offset by the model", LOOSE, TIGHT)
    )
    assert tight < factory
    assert loose < 3.0 * factory


def test_an_accelerometers_own_bias_no_longer_moves_the_offset(gamma):
    as_read, calibrated = (gamma.loc[f"accelerometer {how}"] for how in ("as it reads", "calibrated first"))
    assert as_read["III-B N"] == pytest.approx(0.70, abs=0.02)
    assert as_read["in situ N"] < 0.02
    assert calibrated["III-B N"] < 0.02
    assert calibrated["in situ N"] < 0.02


def test_the_gammas_load_and_ellipsoid_are_those_of_independent_code(gamma):
    np.testing.assert_allclose(gamma.loc["the arm's joints", "semi-axes N"], [9.28, 9.11, 9.08], atol=0.011)
    np.testing.assert_allclose(gamma["limb kg"], 0.932, atol=0.006)
    assert (gamma["unseen direction N"] < 0.1).all()


def test_a_printed_sensor_is_refused_as_its_readings_are_not_linear(metal):
    with pytest.raises(CalibrationRefused, match="of the readings' spread follows gravity in no linear way"):
        calibrate_in_situ(metal.load_optical(DATA))
