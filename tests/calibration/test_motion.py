"""The flat equations of the online methods against the documented ones."""

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.calibration import OnlineSetup, Parameters, Reference, ground_reference
from surefoot.calibration.cop import moment_rows
from surefoot.calibration.front_end.motion import Motions
from surefoot.calibration.layout import nao_shoe_layout

LAYOUT = nao_shoe_layout()
SETUP = OnlineSetup(layout=LAYOUT, mass=5.3, initial=Parameters(np.ones(8), np.zeros(8)))
SAMPLES = 50


def beliefs(rng: np.random.Generator) -> Reference:
    position = np.array([(0.0, 0.05, 0.0), (0.0, -0.05, 0.0)]) + rng.normal(0, 0.02, (SAMPLES, 2, 3))
    rotation = Rotation.from_rotvec(rng.normal(0, 0.2, (2 * SAMPLES, 3))).as_matrix()
    return Reference(
        com=rng.normal((0.0, 0.0, 0.26), 0.02, (SAMPLES, 3)),
        com_acceleration=rng.normal(0, 1.0, (SAMPLES, 3)),
        angular_momentum_rate=rng.normal(0, 0.3, (SAMPLES, 3)),
        position_sole=position,
        R_level_sole=rotation.reshape(SAMPLES, 2, 3, 3),
        stance=rng.random((SAMPLES, 2)) < 0.5,
        swing=np.zeros((SAMPLES, 2), dtype=bool),
        accelerometer=np.zeros((SAMPLES, 3)),
        gyroscope=np.zeros((SAMPLES, 3)),
    )


def test_rows_are_those_of_the_centre_of_pressure() -> None:
    reference, motions = beliefs(np.random.default_rng(0)), Motions(SETUP)
    expected = moment_rows(LAYOUT, reference.position_sole, reference.R_level_sole)
    for k in range(SAMPLES):
        found = motions.rows(motions.flatten(Reference(*(part[k] for part in reference))))
        np.testing.assert_allclose(found, expected[k], atol=1e-14)


def test_the_ground_is_that_of_the_centroidal_equations() -> None:
    reference = beliefs(np.random.default_rng(1))
    for quasi_static in (False, True):
        motions = Motions(SETUP, quasi_static=quasi_static)
        expected = ground_reference(reference, SETUP.mass, quasi_static=quasi_static)
        for k in range(SAMPLES):
            flat = motions.flatten(Reference(*(part[k] for part in reference)))
            vgrf, cop, possible = motions.ground(flat)
            assert possible
            np.testing.assert_allclose(vgrf, expected.vgrf[k], atol=1e-12)
            np.testing.assert_allclose(cop, expected.cop[k], atol=1e-14)
