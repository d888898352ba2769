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


def read_as(j, change):
    """Return a way to spoil one set, whose readings are changed."""
    return lambda sets: [replace(one, raw=change(one.raw)) if i == j else one for i, one in enumerate(sets)]


def read_more(j, wrench, first, last=None):
    """Return a way to spoil one set, which reads a wrench more between two rows."""
    more = RESPONSE @ wrench
    return read_as(
        j, lambda raw: np.concatenate([raw[:first], raw[first:last] + more, raw[last or len(raw) :]])
    )


def read_at(j, channel, change):
    """Return a way to spoil one set, whose readings of one channel are changed."""
    return read_as(j, lambda raw: np.insert(np.delete(raw, channel, 1), channel, change(raw[:, channel]), 1))


LIMB = KnownLimb(MASS, 0.02, COM, 0.002)
FREE = InSituOptions(factory_std=(1.0,) * 6)
"""What cross-validation chooses for a factory matrix that is far off."""
