"""Many walking robots whose errors are drawn from what the moment filter says that it believes of them.

The motion is that of :mod:`_synthetic`; gains and offsets start at and wander by their priors, the reference
is off by constants and late by a delay, and its noise is white and of the stated size.
"""

from typing import NamedTuple

import numpy as np
from _synthetic import DT, LAYOUT, MASS, Floats, walk

from surefoot.calibration import GRAVITY, FeetLayout, FootLayout, OnlineSetup, Parameters, Reference
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.unknowns import Unknowns

SENSOR = {"position_sensor_sole": (0.01, -0.005, 0.06)}
ANKLES = FeetLayout(tuple(FootLayout.force_torque(name, **SENSOR) for name in ("left", "right")))
CELL_NOISE = 4.0
"""Standard deviation of one reading over that of a swing's mean, which is stated for 16 samples."""


class Truth(NamedTuple):
    """A perfect robot: its channels (N, K), its reference, and where its ground force acts (N, 2)."""

    force: Floats
    reference: Reference
    cop: Floats


class Run(NamedTuple):
    """The stream of one run, and the unknowns that were drawn for it, time first."""

    raw: Floats
    reference: Reference
    gain: Floats
    offset: Floats
    path: Floats


class Matched(NamedTuple):
    """Streams of many runs, and the unknowns that were drawn for them: time first, then runs."""

    setup: OnlineSetup
    config: MomentFilterConfig
    unknowns: Unknowns
    raw: Floats
    reference: Reference
    gain: Floats
    offset: Floats
    path: Floats

    def run(self, i: int) -> Run:
        """Return one of them."""
        reference = Reference(*(part[:, i] for part in self.reference))
        return Run(self.raw[:, i], reference, self.gain[:, i], self.offset[:, i], self.path[:, i])

    def runs(self) -> list[Run]:
        """Return all of them."""
        return [self.run(i) for i in range(self.raw.shape[1])]


def on_cells(seed: int, speed: float, duration: float) -> Truth:
    """Walk on eight cells."""
    log = walk(seed, speed, duration, 1.0)
    return Truth(log.force, log.reference, log.cop)


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


def matched(truth: Truth, layout: FeetLayout, config: MomentFilterConfig, runs: int, seed: int) -> Matched:
    """Draw errors for many runs of one motion."""
    rng = np.random.default_rng([23, seed])
    K = layout.channels
    setup = OnlineSetup(
        layout=layout,
        mass=MASS,
        initial=Parameters(np.ones(K), np.zeros(K)),
        dt=DT,
        lag=0,
        foot_length=0.17,
    )
    unknowns = Unknowns(setup, config)
    N, W, L = len(truth.force), setup.weight, setup.length
    x = unknowns.start + rng.normal(size=(runs, unknowns.size)) * unknowns.std
    # What wanders does so between blocks, as the filter has it: a block is learnt from up to ``settle``
    # samples before its end.
    steps = np.zeros((N, runs, unknowns.size))
    steps[(-config.settle) % config.every :: config.every] = np.sqrt(unknowns.walk * DT * config.every)
    path = x + (steps * rng.normal(size=steps.shape)).cumsum(axis=0)
    gain, zero = path[..., unknowns.scale], path[..., unknowns.offset] * unknowns.unit

    force = truth.force[:, None, :] / (1.0 + x[:, unknowns.mass, None])
    A = np.zeros((N, runs, K, K))
    A[..., unknowns.out, unknowns.inp] = gain
    raw = np.linalg.solve(A, force[..., None])[..., 0] - zero
    offset = (A @ zero[..., None])[..., 0]
    raw = raw + rng.normal(size=raw.shape) * CELL_NOISE * config.swing_noise * unknowns.unit

    # Readings are those of a moment, the reference that of a delay later.
    late = x[:, unknowns.delay] / DT
    first = np.floor(late).astype(int)
    part = late - first
    at = np.clip(np.arange(N)[:, None] + first, 0, N - 1)

    def delayed(values: Floats) -> Floats:
        tail = (1,) * (values.ndim - 1)
        weight = part.reshape(1, runs, *tail)
        return (1.0 - weight) * values[at] + weight * values[np.minimum(at + 1, N - 1)]

    belief = Reference(
        *(values[at] if values.dtype == bool else delayed(values) for values in truth.reference)
    )
    com = belief.com.copy()
    com[..., :2] += x[:, unknowns.com] * L
    sole = belief.position_sole.copy()
    sole[..., :2] += x[:, None, unknowns.sole] * np.array([[-L], [L]])
    noise = rng.normal(size=(N, runs, 3)) * config.force_noise * GRAVITY
    if layout is not ANKLES:
        noise[..., :2] = 0.0
    # White at the centre of pressure, which is where the rows take their moments about.
    arm = np.zeros((N, runs, 3))
    arm[..., :2] = delayed(truth.cop) - belief.com[..., :2]
    arm[..., 2] = belief.position_sole[..., 2].min(axis=-1) - belief.com[..., 2]
    white = rng.normal(size=(N, runs, 3)) * config.cop_noise * W
    return Matched(
        setup,
        config,
        unknowns,
        raw,
        belief._replace(
            com=com,
            position_sole=sole,
            com_acceleration=belief.com_acceleration + x[:, unknowns.acceleration] * GRAVITY + noise,
            angular_momentum_rate=belief.angular_momentum_rate + white + np.cross(arm, noise * MASS),
        ),
        gain,
        offset,
        path,
    )
