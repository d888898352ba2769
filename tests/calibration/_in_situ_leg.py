"""A leg whose in-situ sets are sound, to be spoilt."""

from dataclasses import replace
from functools import cache

import numpy as np
from _in_situ import SENSORS, noisy_sets

from surefoot.calibration.in_situ import InSituOptions, KnownLimb, calibrate_in_situ

MATRIX, MASS, COM, _ = SENSORS["leg"]
RESPONSE = np.linalg.inv(MATRIX)


@cache
def leg_sets():
    """Give the paper's four sets of a leg."""
    return noisy_sets("leg", np.random.default_rng(0), noise=0.5)[0]


@cache
def sound_fit():
    """Give their fit, with a reason that nothing needs."""
    return calibrate_in_situ(leg_sets(), accept="for all cases")


def with_raw(one, change):
    raw = one.raw.copy()
    change(raw)
    return replace(one, raw=raw)


LIMB = KnownLimb(MASS, 0.02, COM, 0.002)
FREE = InSituOptions(factory_std=(1.0,) * 6)
"""What cross-validation chooses for a factory matrix that is far off."""
