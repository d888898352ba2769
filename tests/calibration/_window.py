"""Walks for tests of the window."""

import numpy as np
from _synthetic import DT, LAYOUT, NOMINAL, Faults, believed_mass, walk

from surefoot.calibration import Reference, replay


def run(log, method="window", faults=None, **options):
    faults = faults or Faults()
    mass = believed_mass(faults)
    return replay(
        LAYOUT, method, log.raw, log.reference, DT, mass=mass, initial=NOMINAL, lag=faults.lag, **options
    )


def at_rest(samples, log=None):
    log = log or walk(0, duration=0.0)
    return np.repeat(log.raw[:1], samples, axis=0), Reference(
        *(np.repeat(part[:1], samples, axis=0) for part in log.reference)
    )
