"""A robot on eight cells whose momentum is exact: its motion asks for the forces, interval by interval."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from _synthetic import DT, HEIGHT, LAYOUT, MASS, NOMINAL
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY, MomentumReference, Parameters

Floats = NDArray[np.float64]
WEIGHT = MASS * GRAVITY


@dataclass(frozen=True)
class Errors:
    """Spread of the errors of sensors and beliefs."""

    scale: float = 0.0
    offset: float = 0.0
    scale_drift: float = 0.0
    offset_drift: float = 0.0
    noise: float = 0.0
    com: float = 0.0
    velocity: float = 0.0
    vertical: float = 0.0
    spin: float = 0.0

    @classmethod
    def stated(cls) -> "Errors":
        """Those that the filter is told of, in W and m/s; noise of beliefs is white from sample to sample."""
        root = np.sqrt(0.1 / DT)
        return cls(0.12, 0.03, 0.02, 0.02, 5e-4, 0.002, 0.01 * root, 0.003 * root, 0.001 * root)


class Motion(NamedTuple):
    """A log: readings, beliefs and truth."""

    raw: Floats
    reference: MomentumReference
    force: Floats
    correction: Parameters


def move(
    seed: int = 0,
    seconds: float = 20.0,
    errors: Errors | None = None,
    *,
    walking: bool = True,
    lifted: Floats | None = None,
    aside: tuple[float, float] = (0.0, 0.0),
) -> Motion:
    """Walk in place, or sway on both feet.

    Args:
        seed: Of everything random.
        seconds: Duration.
        errors: Of sensors and beliefs.
        walking: Whether feet are lifted in turn, half a second each.
        lifted: Share of the weight that somebody carries at each sample, shape (N,).
        aside: Where from the centre of mass in m.
    """
    errors, rng = errors or Errors(), np.random.default_rng([11, seed])
    n = round(seconds / DT)
    time = np.arange(n) * DT
    phase = rng.uniform(0.0, 2.0 * np.pi, 6)
    sway = np.array([0.02, 0.03, 0.004]) * np.sin(2 * np.pi * time[:, None] * (0.9, 0.5, 1.3) + phase[:3])
    com = np.array([0.024, 0.0, HEIGHT]) + sway
    velocity = np.diff(com, axis=0, prepend=com[:1]) / DT
    spin = 0.004 * np.sin(2 * np.pi * time[:, None] * (0.8, 1.1, 0.6) + phase[3:]) * (1.0, 1.0, 0.0)
    middle = 0.5 * (com + np.vstack([com[:1], com[:-1]]))

    # By the robot's mass and over an interval: force, and torque about the origin on the ground.
    about = spin + np.cross(com, velocity)
    force = np.diff(velocity, axis=0, prepend=velocity[:1]) / DT + (0.0, 0.0, GRAVITY)
    torque = np.diff(about, axis=0, prepend=about[:1]) / DT + np.cross(middle, (0.0, 0.0, GRAVITY))
    if lifted is not None:
        force[:, 2] -= lifted * GRAVITY
        torque -= np.cross(middle + np.array([*aside, 0.0]), lifted[:, None] * (0.0, 0.0, GRAVITY))
    cop = np.column_stack([-torque[:, 1], torque[:, 0]]) / force[:, 2:]
    soles = np.tile([[0.0, 0.05, 0.0], [0.0, -0.05, 0.0]], (n, 1, 1))
    step = (time // 0.5).astype(int) % 4
    share = np.clip(0.5 + cop[:, 1] / 0.1, 0.1, 0.9)
    share = np.column_stack([share, 1.0 - share])
    air = np.zeros((n, 2), bool)
    if walking:
        for foot, phase_of in ((0, 1), (1, 3)):
            air[step == phase_of, foot] = True
            share[step == phase_of] = (foot == 1, foot == 0)
    cells = _share(share * MASS * force[:, 2:], cop, soles, rng, air)

    drift = rng.normal(size=(2, n, 8)).cumsum(axis=1) * np.sqrt(DT / 60.0)
    a = 1.0 + errors.scale * rng.normal(size=8) + errors.scale_drift * drift[0]
    zero = WEIGHT * (errors.offset * rng.normal(size=8) - errors.offset_drift * drift[1])
    read = (cells - zero) / a + WEIGHT * errors.noise * np.sqrt(0.2 / DT) * rng.normal(size=cells.shape)
    belief = MomentumReference(
        com=com + errors.com * np.append(rng.normal(size=2), 0.0),
        com_velocity=velocity
        + rng.normal(size=com.shape) * (errors.velocity, errors.velocity, errors.vertical),
        angular_momentum=MASS * (spin + rng.normal(size=com.shape) * errors.spin),
        position_sole=soles,
        R_level_sole=np.broadcast_to(np.eye(3), (n, 2, 3, 3)).copy(),
        stance=share > 0.02,
        swing=air,
    )
    return Motion((read - NOMINAL.offset) / NOMINAL.scale, belief, cells, Parameters(a, zero))


def _share(
    load: Floats, cop: Floats, soles: Floats, rng: np.random.Generator, air: NDArray[np.bool_]
) -> Floats:
    """Share the feet's loads between their cells so that the common centre of pressure is as asked for."""
    corner = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    total = load.sum(axis=1, keepdims=True)
    # Both feet are off from the point between them that their loads ask for by the same.
    off = cop - (load[..., None] * soles[..., :2]).sum(axis=1) / total
    cells = []
    for foot, layout in enumerate(LAYOUT.feet):
        position = layout.position_cell_sole
        assert position is not None
        centre, half = position[:, :2].mean(axis=0), np.ptp(position[:, :2], axis=0) / 2
        u = (off - centre) / half
        warp = 0.1 * np.sin(np.arange(len(u)) * DT * rng.uniform(1, 3) + rng.random() * 6)
        even = (1 + corner[:, 0] * u[:, :1]) * (1 + corner[:, 1] * u[:, 1:]) / 4
        cells.append(load[:, foot, None] * (even + 0.25 * warp[:, None] * corner.prod(axis=1)))
    return np.concatenate(cells, axis=1)
