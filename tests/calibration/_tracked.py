"""A calibrated leg sensor with errors drawn from the covariance that it claims."""

from typing import NamedTuple

import numpy as np
from _in_situ import LEG_MATRIX, NOISE, OFFSET_WRENCH, SENSORS

from surefoot.calibration.in_situ import InSituFit, Limb
from surefoot.calibration.in_situ.fit import SetFit
from surefoot.calibration.results import FitResult, FitStats

RESPONSE = np.linalg.inv(LEG_MATRIX)
OFFSET = RESPONSE @ OFFSET_WRENCH
MASS, MASS_COM = SENSORS["leg"][1], SENSORS["leg"][1] * SENSORS["leg"][2]
NOISE_ROOT = RESPONSE * NOISE
INERTIA = MASS * np.diag([0.06, 0.06, 0.01])

_SIZE = np.array([48.0, 48.0, 48.0, 10.0, 10.0, 10.0])


def covariance_of_fit(scale=0.005, talk=0.002, offset=0.2, limb=0.005):
    """As a fit would claim it: relative scales, cross-talk in shares of the loads, N (N m / 50), share."""
    D = np.where(np.eye(6, dtype=bool), scale, talk) * _SIZE[:, None] / _SIZE
    # C = (1 + D)^-1 C0: rows of C by rows of D.
    root = np.zeros((46, 46))
    root[:36, :36] = np.kron(np.eye(6), LEG_MATRIX.T) * D.ravel()
    root[36:42, 36:42] = RESPONSE * offset * np.repeat([1.0, 0.02], 3)
    root[42:, 42:] = limb * MASS * np.diag([1.0, 0.2, 0.2, 0.2])
    return root @ root.T


def make_fit(covariance=None, **changes):
    nothing = FitStats(0, 0, 0, 0.0, 46, 46, 1.0)
    fields = {
        "matrix": LEG_MATRIX,
        "offset": OFFSET,
        "response": RESPONSE,
        "limb": Limb(MASS, MASS_COM),
        "covariance": covariance_of_fit() if covariance is None else covariance,
        "noise": NOISE_ROOT @ NOISE_ROOT.T,
        "result": FitResult.DETERMINED,
        "stats": nothing,
        "sets": (SetFit("set", OFFSET, nothing, 0.0),),
    }
    return InSituFit(**(fields | changes))


class Truth(NamedTuple):
    """Sensors as they are, ``runs`` of them: response (runs, 6, 6), offset (runs, 6), limb (runs, 4)."""

    response: np.ndarray
    offset: np.ndarray
    limb: np.ndarray

    def read(self, gravity):
        """Count without noise under gravity, (3,) or (runs, 3): r = A M(m, c) g + o."""
        g = np.broadcast_to(gravity, (len(self.offset), 3))
        wrench = np.concatenate([self.limb[:, :1] * g, np.cross(self.limb[:, 1:], g)], axis=1)
        return (self.response @ wrench[..., None])[..., 0] + self.offset


def draw_truth(fit, rng, runs, since_force=0.0, since_torque=0.0):
    """Draw sensors that the fit may be of."""
    values, vectors = np.linalg.eigh(fit.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    errors = rng.standard_normal((runs, 46)) @ root.T
    matrix = fit.matrix + errors[:, :36].reshape(runs, 6, 6)
    jump = rng.standard_normal((runs, 6)) * np.repeat([since_force, since_torque], 3)
    limb = np.concatenate([[fit.limb.mass], fit.limb.mass_com]) + errors[:, 42:]
    return Truth(np.linalg.inv(matrix), fit.offset + errors[:, 36:42] + jump @ RESPONSE.T, limb)
