"""A walking robot on eight load cells without a simulator: a pendulum, its footsteps and its beliefs.

The centre of mass follows from a planned centre of pressure by the linear inverted pendulum; the truth then
obeys Newton and Euler exactly (Eqs. 9-11), so that a calibrator fed perfect sensors and beliefs has nothing
to correct.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, FeetLayout, Parameters, Reference, nao_shoe_layout

LAYOUT: FeetLayout = nao_shoe_layout()
MASS, HEIGHT, DT = 5.305, 0.26, 1.0 / 80.0
WIDTH = 0.1
NOMINAL = Parameters(np.tile([-2.4e-5, 2.2e-5], 4), np.tile([201.0, -184.0], 4))


@dataclass(frozen=True)
class Faults:
    """What is wrong with sensors and beliefs."""

    gain: float = 0.0
    offset: float = 0.0
    gain_drift: float = 0.0
    offset_drift: float = 0.0
    noise: float = 0.0
    com: float = 0.0
    mass: float = 0.0
    acceleration: float = 0.0
    rate: float = 0.0
    lag: int = 0

    @classmethod
    def mild(cls) -> "Faults":
        """Bench-calibrated, then drifting: the paper's conditions."""
        return cls(0.01, 0.1, 0.02, 1.0, 0.05, 3e-3, 5e-3, 0.1, 0.05, 2)

    @classmethod
    def bad(cls) -> "Faults":
        """Gains off by 12 %, offsets by 1.5 N, drifting."""
        return cls(0.12, 1.5, 0.02, 1.0, 0.05, 3e-3, 5e-3, 0.1, 0.05, 2)


class Walk(NamedTuple):
    """A log: what the robot reads and believes, and the truth."""

    raw: Floats
    reference: Reference
    force: Floats
    vgrf: Floats
    cop: Floats
    correction: Parameters


def walk(
    seed: int = 0,
    speed: float = 0.04,
    duration: float = 20.0,
    stand: float = 4.0,
    faults: Faults | None = None,
) -> Walk:
    """Stand, then walk; the readings' errors and the beliefs' errors are drawn from the seed."""
    faults = faults or Faults()
    rng = np.random.default_rng([7, seed])
    time = np.arange(round((stand + duration) / DT)) * DT
    share, soles, in_air, foot_cop = _footsteps(time - stand, speed, rng)
    plan = np.einsum("nf,nfx->nx", share, soles[..., :2] + foot_cop)
    com = np.column_stack([_pendulum(plan[:, 0]), _pendulum(plan[:, 1]), np.full(len(time), HEIGHT)])
    acceleration = np.zeros_like(com)
    acceleration[:, :2] = GRAVITY / HEIGHT * (com[:, :2] - plan)
    moving = np.clip(time - stand, 0.0, 1.0)
    acceleration[:, 2] = moving * 0.3 * np.sin(2 * np.pi * time / 0.8)
    momentum = np.zeros_like(com)
    momentum[:, :2] = moving[:, None] * 0.1 * np.sin(2 * np.pi * (time[:, None] / 1.6 + rng.random(2)))

    vgrf = MASS * (acceleration[:, 2] + GRAVITY)
    cop = com[:, :2] - (MASS * HEIGHT * acceleration[:, :2] + momentum[:, [1, 0]] * (1, -1)) / vgrf[:, None]
    force = _cells(share * vgrf[:, None], foot_cop + (cop - plan)[:, None, :], rng)

    frame = soles[..., :2].mean(axis=1)
    belief = Reference(
        com=_late(com - np.pad(frame, ((0, 0), (0, 1))), faults.lag)
        + np.append(rng.normal(size=2) * faults.com, 0.0),
        com_acceleration=_late(acceleration, faults.lag) + rng.normal(size=com.shape) * faults.acceleration,
        angular_momentum_rate=_late(momentum, faults.lag) + rng.normal(size=com.shape) * faults.rate,
        position_sole=_late(soles - np.pad(frame, ((0, 0), (0, 1)))[:, None], faults.lag),
        R_level_sole=np.broadcast_to(np.eye(3), (len(time), 2, 3, 3)).copy(),
        stance=_late(share > 0.02, faults.lag),
        swing=_late(in_air, faults.lag),
        accelerometer=_late(acceleration, faults.lag) + np.array([0.0, 0.0, GRAVITY]),
        gyroscope=np.zeros_like(com),
    )
    gain, offset = _errors(len(time), faults, rng)
    reported = gain * force + offset + rng.normal(size=force.shape) * faults.noise
    place = belief.position_sole[:, :, None, :2] + np.stack(
        [foot.position_cell_sole[:, :2] for foot in LAYOUT.feet]  # type: ignore[index]
    )
    total = force.sum(axis=1)
    true_cop = np.einsum("nk,nkx->nx", force, place.reshape(len(time), 8, 2)) / total[:, None]
    return Walk(
        raw=(reported - NOMINAL.offset) / NOMINAL.scale,
        reference=belief,
        force=force,
        vgrf=total,
        cop=true_cop,
        correction=Parameters(1.0 / gain, -offset / gain),
    )


def believed_mass(faults: Faults) -> float:
    return MASS * (1.0 + faults.mass)


def errors(estimate: Any, log: Walk, after: float) -> tuple[float, float]:
    """Root mean square errors of the centre of pressure (mm, both axes) and of the force (N) after a time."""
    rows = slice(round(after / DT), None)
    cop = np.asarray(estimate.cop)[rows] - log.cop[rows]
    force = np.asarray(estimate.vgrf)[rows].sum(axis=-1) - log.vgrf[rows]
    return 1e3 * float(np.sqrt((cop**2).sum(axis=1).mean())), float(np.sqrt((force**2).mean()))


def _footsteps(
    time: Floats, speed: float, rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.bool_], Floats]:
    """Plan load shares (N, 2), soles (N, 2, 3), feet in the air (N, 2) and CoPs on the soles (N, 2, 2)."""
    step, double = 0.8, 0.32
    index = np.floor(time / step).astype(int)
    within = time - index * step
    walking = time >= 0.0
    swing = np.where(walking, index % 2, -1)  # foot 0 swings in even steps
    length = speed * step
    air = np.clip((within - double) / (step - double), 0.0, 1.0)
    ease = air - np.sin(2 * np.pi * air) / (2 * np.pi)
    soles = np.zeros((len(time), 2, 3))
    share = np.full((len(time), 2), 0.5)
    for foot in (0, 1):
        soles[:, foot, 1] = (0.5 - foot) * WIDTH
        landed = np.maximum(0, (index + 1 - foot) // 2)
        soles[:, foot, 0] = np.where(walking, 2 * length * landed, 0.0)
        mine = swing == foot
        soles[mine, foot, 0] = 2 * length * ((index[mine] - foot) // 2 + ease[mine])
        soles[mine, foot, 2] = 0.015 * np.sin(np.pi * air[mine]) ** 2
    before = np.where(index == 0, 0.5, 1.0)  # share of the foot that is about to swing, as its step begins
    fall = before * (1.0 - np.clip(within / double, 0.0, 1.0))
    for foot in (0, 1):
        mine = swing == foot
        share[mine, foot], share[mine, 1 - foot] = fall[mine], 1.0 - fall[mine]
    in_air = (share <= 0.0) & (soles[..., 2] > 1e-3)
    phase = 2 * np.pi * (time / 1.6)[:, None] + rng.random((1, 2)) * 6
    rolling = np.clip(time, 0.0, 1.0)[:, None]
    foot_cop = np.stack([0.024 + rolling * 0.03 * np.sin(phase), rolling * 0.015 * np.cos(phase)], axis=-1)
    return share, soles, in_air, foot_cop


def _pendulum(plan: Floats) -> Floats:
    """Solve x'' = g / z (x - p) for the bounded x."""
    stiff = HEIGHT / GRAVITY / DT**2
    bands = np.zeros((3, len(plan)))
    bands[0, 2:], bands[1], bands[2, :-2] = -stiff, 1.0 + 2.0 * stiff, -stiff
    bands[1, [0, -1]] = 1.0
    return np.asarray(solve_banded((1, 1), bands, plan))


def _cells(load: Floats, cop_sole: Floats, rng: np.random.Generator) -> Floats:
    """Share each foot's load between its cells: bilinear, and some warp that neither sum nor CoP shows."""
    corner = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    cells = []
    for foot, layout in enumerate(LAYOUT.feet):
        position = layout.position_cell_sole
        assert position is not None
        centre, half = position[:, :2].mean(axis=0), np.ptp(position[:, :2], axis=0) / 2
        u = (cop_sole[:, foot] - centre) / half
        warp = 0.15 * rng.normal() + 0.1 * np.sin(
            np.arange(len(u)) * DT * rng.uniform(1, 3) + rng.random() * 6
        )
        even = (1 + corner[:, 0] * u[:, :1]) * (1 + corner[:, 1] * u[:, 1:]) / 4
        share = even + 0.25 * warp[:, None] * corner.prod(axis=1)
        cells.append(load[:, foot, None] * share)
    return np.concatenate(cells, axis=1)


def _errors(samples: int, faults: Faults, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw gains and offsets that wander; densities are per square root of a minute."""
    walk = rng.normal(size=(2, samples, 8)).cumsum(axis=1) * np.sqrt(DT / 60.0)
    gain = 1.0 + faults.gain * rng.normal(size=8) + faults.gain_drift * walk[0]
    offset = faults.offset * rng.normal(size=8) + faults.offset_drift * walk[1]
    return gain, offset


def _late(values: Any, lag: int) -> Any:
    """Shift a log so that row k holds what was true at k - lag."""
    values = np.asarray(values)
    return np.concatenate([np.repeat(values[:1], lag, axis=0), values[: len(values) - lag]])
