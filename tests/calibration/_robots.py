"""Walks of several robots, and the moment filter over their streams."""

import numpy as np
from _synthetic import DT, LAYOUT, NOMINAL, Faults, believed_mass, walk

from surefoot.calibration import METHODS, Reference, replay

BAD = Faults.bad()


def short(name):
    """Options that end the standing start soon, for methods that have one."""
    config = METHODS[name].config
    if config is None or "standing_warm_up" not in config.__dataclass_fields__:
        return {}
    return {"standing_warm_up": 0.1, "standing_duration": 0.2, "standing_samples": 10}


def rows_of(reference, k):
    return Reference(*(part[k] for part in reference))


def stream(method, raw, reference, state=None, dt=DT):
    """Stream samples, and hand back the state, the last estimate, and (nis, rows) of each block."""
    state = method.init(raw[0]) if state is None else state
    blocks = []
    for k in range(len(raw)):
        state, estimate = method.update(state, raw[k], rows_of(reference, k), dt)
        if estimate.nis is not None and np.isfinite(np.asarray(estimate.nis)).all():
            blocks.append((np.asarray(estimate.nis), np.asarray(estimate.nis_rows)))
    return state, estimate, blocks


def fleet(seeds, speeds=(0.02, 0.04, 0.1), faults=BAD, **options):
    return [walk(seed, speed, faults=faults, **options) for speed in speeds for seed in seeds]


def calibrated(raw, reference, faults=BAD, name="moment", **options):
    return replay(LAYOUT, name, raw, reference, DT, mass=believed_mass(faults), initial=NOMINAL, **options)
