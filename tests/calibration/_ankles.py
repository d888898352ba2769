"""The walk of :mod:`_synthetic` on two ankle sensors."""

from typing import NamedTuple

import numpy as np
from _synthetic import DT, LAYOUT, MASS, Floats, walk

from surefoot.calibration import FeetLayout, FootLayout, Reference

SENSOR = {"position_sensor_sole": (0.01, -0.005, 0.06)}
ANKLES = FeetLayout(tuple(FootLayout.force_torque(name, **SENSOR) for name in ("left", "right")))


class Truth(NamedTuple):
    """A perfect robot: its channels (N, K), its reference, and where its ground force acts (N, 2)."""

    force: Floats
    reference: Reference
    cop: Floats


def on_ankles(seed: int, speed: float, duration: float) -> Truth:
    """Walk on two ankle sensors: the same walk, with shear, and feet that rub against each other."""
    log = walk(seed, speed, duration, 1.0)
    reference, time = log.reference, np.arange(len(log.raw)) * DT
    maps = LAYOUT.wrench_map
    wrench = np.einsum("fwk,nk->nfw", maps, log.force)
    share = wrench[..., 2] / wrench[..., 2].sum(axis=1, keepdims=True)
    shear = MASS * reference.com_acceleration[:, None, :2] * share[..., None]
    both = (4.0 * share[:, 0] * share[:, 1])[:, None]
    rub = both * np.column_stack([3.0 * np.sin(5.0 * time), 2.0 * np.cos(3.0 * time)])
    wrench[..., :2] = shear + np.stack([rub, -rub], axis=1)
    wrench[..., 5] = share * 0.4 * np.sin(2.0 * time + 1.0)[:, None]
    arm = reference.position_sole - reference.com[:, None]
    twist = np.cross(arm, wrench[..., :3])[..., 2] + wrench[..., 5]
    rate = reference.angular_momentum_rate.copy()
    rate[:, 2] = twist.sum(axis=1)
    channels = [wrench[:, foot] @ np.linalg.inv(side.wrench_map).T for foot, side in enumerate(ANKLES.feet)]
    return Truth(np.concatenate(channels, axis=1), reference._replace(angular_momentum_rate=rate), log.cop)
