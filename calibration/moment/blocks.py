r"""Samples that wait until a block's time is full, and blocks made of them.

Nothing is learnt from a block with a gap, a bad reference or a foot that is not read, and the momentum starts
again after it.

A six-axis sensor also carries the foot below it, of mass m. A level foot at rest counts as part of the zero.
What remains is, with the acceleration x'' of the foot's centre of mass in the axes that do not turn and the
rotation R from the sole's frame to these,

.. math:: f = m \, (g e_z - R^T (x'' + g e_z)) .

It is subtracted from the readings. Otherwise a swing shows its mean, 2 N under a G1 that walks, as a zero.
"""

from math import ceil
from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array, in_a_row, skew
from surefoot.calibration.front_end.readings import LONGEST_GAP, FrontEnd, Sample
from surefoot.calibration.moment.faults import USABLE_SCALES, ChannelFaults
from surefoot.calibration.moment.motion import Track, follow_accelerations, follow_momentum, plausible
from surefoot.calibration.moment.state import MomentState
from surefoot.calibration.setup import OnlineSetup


class Block(NamedTuple):
    """n samples in a row; K channels, F feet."""

    force: Array  # F0 in W, shape (n, K)
    read: Array  # whether it was read (0 or 1), shape (n, K)
    end: Array  # centre of mass at the ends of the samples' intervals in m, shape (n, 3)
    com: Array  # centre of mass while they were taken in m, shape (n, 3)
    velocity: Array  # its velocity at the ends in m/s, shape (n, 3)
    spin: Array  # angular momentum by the mass there in m^2/s, shape (n, 3)
    sole: Array  # soles while they were taken in m, shape (n, F, 3)
    rotation: Array  # their rotations to the axes that do not turn, shape (n, F, 3, 3)
    swing: Array  # feet surely in the air (0 or 1), the sample before the block first, shape (n + 1, F)
    dt: Array  # lengths of the intervals in s, shape (n,)

    @classmethod
    def of(cls, before: Array, samples: Array, columns: dict[str, slice], feet: int) -> "Block":
        """Take a block out of the row before it, and its own rows; ``columns`` has the place of each part."""
        parts = {name: samples[:, columns[name]] for name in cls._fields}
        return cls(**parts)._replace(
            sole=parts["sole"].reshape(-1, feet, 3),
            rotation=parts["rotation"].reshape(-1, feet, 3, 3),
            swing=np.vstack([before[columns["swing"]], parts["swing"]]),
            dt=parts["dt"][:, 0],
        )

    @property
    def duration(self) -> float:
        """Its length in s."""
        return float(self.dt.sum())


class Blocks:
    """Collects the samples of one setup.

    Args:
        front_end: The way of a sample.
        duration: Of a block in s.
        faults: Faults of channels.

    Attributes:
        capacity: Most samples of a block.
        width: Numbers of a sample, S.
        below: Force on each channel in W by the foot below its sensor, per m/s^2 of f / m, shape (K, 3).
        carries: Whether any sensor carries a foot.
        com_below: Centre of mass of that foot in the sole's frame in m, shape (F, 3).
    """

    def __init__(self, front_end: FrontEnd, duration: float, faults: ChannelFaults) -> None:
        self._setup: OnlineSetup = front_end.setup
        self._motions, self._duration = front_end.motions, duration
        self._feet = len(self._setup.layout.feet)
        self._faults = faults
        layout = self._setup.layout
        K, F = layout.channels, self._feet
        places = in_a_row(K, K, 3, 3, 3, 3, 3 * F, 9 * F, F, 1)
        self._columns = dict(zip(Block._fields, places, strict=True))
        self.capacity = ceil(duration / self._setup.dt) + ceil(LONGEST_GAP)
        self.width = int(self._columns["dt"].stop)
        self.below, self.com_below = np.zeros((K, 3)), np.zeros((F, 3))
        for i, (foot, part) in enumerate(zip(layout.feet, layout.slices, strict=True)):
            for sensor in foot.sensors:
                if sensor.six_axis and sensor.mass_below > 0.0:
                    self.com_below[i] = sensor.com_below_sole
                    load = sensor.mass_below * np.vstack([np.eye(3), skew(sensor.com_below_sole)])
                    at = np.arange(part.start, part.stop)[sensor.channels]
                    self.below[at] = np.linalg.solve(sensor.wrench_map, load) / self._setup.weight
        self.carries = bool(self.below.any())

    def collect(self, state: MomentState, sample: Sample, momentum: bool, dt: float) -> MomentState:
        """Put a sample to those that wait.

        Args:
            state: The filter's state.
            sample: The sample.
            momentum: Whether its reference holds momentum.
            dt: Time since the one before in s.
        """
        if not sample.sound:
            return self.break_off(state)
        columns, mass = self._motions.columns, self._setup.mass
        if momentum:
            track, pose = follow_momentum(state.track, sample.motion, columns, mass)
        else:
            track, pose = follow_accelerations(state.track, sample.motion, columns, mass, sample.stance, dt)
            if not self._motions.ground(sample.motion)[2]:
                return self.break_off(state)
        if not plausible(track):
            return self.break_off(state)
        row = np.concatenate(
            [
                sample.past / self._setup.weight, sample.read, pose.end, pose.com, track.velocity, track.spin,
                pose.sole.ravel(), pose.rotation.ravel(), sample.swing, [dt],
            ]
        )  # fmt: skip
        if state.waiting < 0:
            return state._replace(track=track, before=row, waiting=0)
        pending = state.pending.copy()
        pending[state.waiting] = row
        if state.waiting > 0:
            before = pending[state.waiting - 2] if state.waiting > 1 else state.before
            at, width = state.waiting - 1, self._columns["read"].stop
            pending[at, :width] = self._faults.smooth(before[:width], pending[at, :width], row[:width], 1.0)
            if self.carries:
                scale = state.published.mean[: len(sample.past)]
                pending[at, : len(scale)] -= self._load_below(before, pending[at], row) / np.clip(
                    scale, *USABLE_SCALES
                )
        return state._replace(track=track, pending=pending, waiting=state.waiting + 1)

    def _load_below(self, before: Array, row: Array, after: Array) -> Array:
        """Return the load of the feet below their sensors at a sample in W, shape (K,), by its neighbours."""
        rows, columns, gravity = np.stack([before, row, after]), self._columns, self._setup.gravity
        R = rows[:, columns["rotation"]].reshape(3, -1, 3, 3)
        x = rows[:, columns["sole"]].reshape(3, -1, 3) + np.einsum("nfij,fj->nfi", R, self.com_below)
        dt = rows[1:, columns["dt"]]
        velocity = np.diff(x, axis=0) / dt[:, :, None]
        felt = np.diff(velocity, axis=0)[0] / dt.mean() + (0.0, 0.0, gravity)
        load = np.array([0.0, 0.0, gravity]) - np.einsum("fji,fj->fi", R[1], felt)
        force: Array = (self.below * load[self._setup.layout.foot_of_channel]).sum(axis=1)
        return force

    def break_off(self, state: MomentState) -> MomentState:
        """Forget the samples that wait, and the momentum."""
        return state._replace(
            track=Track.begin(state.track.motion), pending=np.zeros_like(state.pending), waiting=-1, linked=0
        )

    def full(self, state: MomentState) -> bool:
        """Return whether a block is full."""
        time = state.pending[: max(state.waiting - 1, 0), self._columns["dt"]].sum()
        enough = time >= self._duration - 0.5 * self._setup.dt or state.waiting == self.capacity
        return bool(state.waiting >= 2 and enough)

    def block(self, state: MomentState) -> Block:
        """Return the block of the samples that wait."""
        return Block.of(state.before, state.pending[: state.waiting - 1], self._columns, self._feet)

    def begin(self, state: MomentState) -> MomentState:
        """Begin the next block behind the samples that wait."""
        pending = np.zeros_like(state.pending)
        pending[0] = state.pending[state.waiting - 1]
        return state._replace(before=state.pending[state.waiting - 2], pending=pending, waiting=1)
