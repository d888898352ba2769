"""One calibrator for N robots, in Python: a sample of all at once costs little more than that of one.

The robots differ in the map that they start from, c raw + d, and in the mass m that they believe in, and a
calibrator knows one of each. Both are taken out of what it sees: in units of its own mass M,

    F0 = (c raw + d) M / m,        L' M / m,

the Newton-Euler equations are those of a robot of mass M, and F m / M is the force again.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import FootCalibrator, Parameters, Reference
from surefoot.calibration.episodes import select
from surefoot.calibration.estimate import Estimate

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Together:
    """The calibrator.

    Args:
        calibrator: Of the mass M, with forces for readings.
        count: Number of robots N.
    """

    def __init__(self, calibrator: FootCalibrator, count: int) -> None:
        self._one, self._mass = calibrator, calibrator.setup.mass
        self._map: Floats = np.zeros((2, count, calibrator.setup.layout.channels))
        self._share: Floats = np.ones((count, 1))
        self._estimate: Estimate | None = None

    @property
    def state(self) -> Any:
        """What was learnt of all robots, with their starting maps and masses."""
        return self._one.state, self._map, self._share

    @state.setter
    def state(self, kept: Any) -> None:
        self._one.state, self._map, self._share = kept

    def start(self, which: list[int], starts: Sequence[tuple[Parameters, float]]) -> None:
        """Let some robots start afresh, from their maps and with the masses that they believe in in kg."""
        for i, (initial, mass) in zip(which, starts, strict=True):
            self._map[:, i], self._share[i] = initial, mass / self._mass
        mask = self._mask(which)
        # Readings do not count yet.
        fresh, state = self._one.fresh_state(self._map[0]), self._one.state
        self._one.state = fresh if state is None or mask.all() else select(mask, fresh, state)

    def update(self, raw: Floats, reference: Reference, which: list[int]) -> Estimate:
        """Take in one sample of some robots.

        Args:
            raw: Readings of all, shape (N, K).
            reference: Of all, (N, ...).
            which: The robots that take it in; of the others the last estimate stands.

        Returns:
            The estimates of all, in real units.
        """
        before, share, (scale, offset) = self._one.state, self._share, self._map
        scaled = reference._replace(angular_momentum_rate=reference.angular_momentum_rate / share)
        found = self._one.update((scale * raw + offset) / share, scaled)
        unit = np.concatenate([np.ones_like(raw), np.broadcast_to(share, raw.shape)], axis=1)
        estimate = found._replace(
            force=found.force * share,
            wrench=found.wrench * share[..., None],
            vgrf=found.vgrf * share,
            scale=found.scale * scale,
            offset=found.scale * offset + found.offset * share,
            covariance=None
            if found.covariance is None
            else found.covariance * unit[:, :, None] * unit[:, None],
            force_std=None if found.force_std is None else found.force_std * share,
        )
        if len(which) < len(raw) and self._estimate is not None:
            mask = self._mask(which)
            self._one.state = select(mask, self._one.state, before)
            estimate = select(mask, estimate, self._estimate)
        self._estimate = estimate
        return estimate

    def retract(self, mask: Mask) -> None:
        """Take back what robots have learnt of late who have fallen, shape (N,)."""
        self._one.retract(mask)

    def moved(self) -> Mask:
        """Return which robots' maps are no longer their starting maps, shape (N,)."""
        if self._estimate is None:
            return np.zeros(len(self._share), dtype=bool)
        now = np.stack([self._estimate.scale, self._estimate.offset])
        moved: Mask = (now != self._map).any(axis=(0, 2))
        return moved

    def _mask(self, which: list[int]) -> Mask:
        mask = np.zeros(len(self._share), dtype=bool)
        mask[which] = True
        return mask
