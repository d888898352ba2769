"""The instruments under a recorded robot's feet: load cells, six-axis sensors at the ankles, or both.

Their channels follow each other foot by foot: (left cells, left ankle, right cells, right ankle).
"""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY, FeetLayout, FootLayout, Parameters
from surefoot.envs.robot import BelowSensor, below_ankle, below_cells
from surefoot.experiments.bench import run_bench
from surefoot.sensors import (
    ForceTorque,
    ForceTorqueState,
    LoadCells,
    LoadCellState,
    force_torque,
    load_cells,
    true_map,
)

__all__ = ["FootInstruments"]

Floats = NDArray[np.float64]

_STREAM = 0x10605
"""Keeps the instruments' randomness apart from every other stream with the same seed."""


class _Cells:
    """Eight load cells."""

    def __init__(self, config: LoadCells, rng: np.random.Generator, seed: int, truth: Any) -> None:
        self._config, self._rng = config, rng
        self._instrument = load_cells(config)
        force = truth.force_cell
        self._state: LoadCellState = self._instrument.init(force.shape[-1:], rng)
        self.bench: Parameters = run_bench(cells=config, state=self._state, seed=seed).channels.value
        # Every chip delivers once before the walk, as they do while a robot boots.
        rate = config.rate
        _, self._state = self._instrument.apply(force, self._state, rng, 1.0 / rate[0] if rate else 0.0125)

    @property
    def nominal(self) -> Parameters:
        return Parameters(self._config.nominal_scale, self._config.nominal_offset)

    def read(self, truth: Any, dt: float) -> Floats:
        counts, self._state = self._instrument.apply(truth.force_cell, self._state, self._rng, dt)
        read: Floats = counts
        return read

    def force(self, truth: Any) -> Floats:
        force: Floats = truth.force_cell[-1].copy()
        return force

    def map(self) -> tuple[Floats, Floats]:
        scale, offset = true_map(self._config, self._state)
        return scale, offset


class _Ankles:
    """Two six-axis sensors; what a level foot at rest weighs counts as part of their zeros."""

    def __init__(self, config: ForceTorque, rng: np.random.Generator, below: BelowSensor) -> None:
        self._config, self._rng = config, rng
        self._instrument = force_torque(config)
        self._state: ForceTorqueState = self._instrument.init((config.channels,), rng)
        self.preload = np.concatenate([_weight(below, foot) for foot in (0, 1)])
        self.nominal = Parameters(config.nominal_scale, np.zeros(config.channels))

    def read(self, truth: Any, dt: float) -> Floats:
        counts, self._state = self._instrument.apply(
            truth.wrench_ankle[-1].ravel(), self._state, self._rng, dt
        )
        read: Floats = counts
        return read

    def force(self, truth: Any) -> Floats:
        wrench: Floats = truth.wrench_ankle[-1].ravel() + self.preload
        return wrench

    def map(self) -> tuple[Floats, Floats]:
        gain = 1.0 + np.diagonal(self._state.error, axis1=-2, axis2=-1).ravel()
        return self._config.nominal_scale / gain, self.preload - self._state.zero.ravel() / gain

    @property
    def cross_talk(self) -> Floats:
        """What each channel feels of the others', rows read and columns felt, shape (12, 12)."""
        scale = self._config.full_scale[:6]
        off = self._state.error * (1.0 - np.eye(6)) * (scale[:, None] / scale)
        both = np.zeros((12, 12))
        both[:6, :6], both[6:, 6:] = off
        return both


class FootInstruments:
    """What one condition reads under one walk.

    Args:
        cells: The load cells, if there are any.
        ankle: The six-axis sensors, if there are any.
        index: Number of the random stream.
        seed: Seed of the walk.
        truth: The truth of the first moment.
        model: The simulated robot.
        layout: The feet on load cells.
    """

    def __init__(
        self,
        cells: LoadCells | None,
        ankle: ForceTorque | None,
        *,
        index: int,
        seed: int,
        truth: Any,
        model: mujoco.MjModel,
        layout: FeetLayout,
    ) -> None:
        self._parts: list[_Cells | _Ankles] = []
        self.bench: Parameters | None = None
        self.about: dict[str, Any] = {}
        feet: list[FeetLayout] = []
        if cells is not None:
            under = _Cells(cells, np.random.default_rng([_STREAM, index, seed]), seed, truth)
            self._parts.append(under)
            self.bench = under.bench if ankle is None else None
            feet.append(layout if ankle is None else _cells_layout(layout, below_cells(model)))
        if ankle is not None:
            below = below_ankle(model)
            above = _Ankles(ankle, np.random.default_rng([_STREAM, index, seed, 1]), below)
            self._parts.append(above)
            feet.append(_ankle_layout(below))
            self.about = _facts(above, 0 if cells is None else cells.channels)
        if not feet:
            raise ValueError("A condition needs load cells, ankle sensors or both, and has neither.")
        self.layout = feet[0] if len(feet) == 1 else _combined(*feet)
        per_foot = [one.channels // 2 for one in feet]
        starts = np.cumsum([0, *(one.channels for one in feet[:-1])])
        self._order = np.concatenate(
            [
                start + foot * k + np.arange(k)
                for foot in (0, 1)
                for start, k in zip(starts, per_foot, strict=True)
            ]
        )
        self._raw: list[Floats] = []
        self._force: list[Floats] = []
        self._maps: list[tuple[Floats, ...]] = []
        if self.about:
            self._sort_facts()

    @property
    def nominal(self) -> Parameters:
        """The map by the data sheets, shape (K,)."""
        return Parameters(*(self._joined([part.nominal[i] for part in self._parts]) for i in (0, 1)))

    def read(self, truth: Any, dt: float) -> None:
        """Take the readings after a control step."""
        self._raw.append(self._joined([part.read(truth, dt) for part in self._parts]))
        self._force.append(self._joined([part.force(truth) for part in self._parts]))
        maps = [part.map() for part in self._parts]
        self._maps.append(tuple(self._joined([one[i] for one in maps]) for i in (0, 1)))

    @property
    def raw(self) -> Floats:
        """All readings in counts, shape (N, K)."""
        return np.array(self._raw)

    @property
    def force(self) -> Floats:
        """What the calibrated channels should have read in N and N m, shape (N, K)."""
        return np.array(self._force)

    @property
    def maps(self) -> Floats:
        """The maps that would have undone each channel's own errors, (scale, offset), shape (N, 2, K)."""
        return np.array(self._maps)

    def _joined(self, parts: list[Floats]) -> Floats:
        joined: Floats = np.concatenate(parts)[self._order]
        return joined

    def _sort_facts(self) -> None:
        order = self._order
        talk = np.array(self.about["truth_cross_talk"])[np.ix_(order, order)]
        self.about = {
            "truth_cross_talk": talk.tolist(),
            "truth_preload": np.array(self.about["truth_preload"])[order].tolist(),
        }


def _facts(ankles: _Ankles, before: int) -> dict[str, Any]:
    """Note what maps axis by axis leave out: cross-talk, and the weight that counts as part of the zero."""
    size = before + len(ankles.preload)
    talk = np.zeros((size, size))
    talk[before:, before:] = ankles.cross_talk
    return {"truth_cross_talk": talk, "truth_preload": np.concatenate([np.zeros(before), ankles.preload])}


def _weight(below: BelowSensor, foot: int) -> Floats:
    """Weight of a level foot in its sensor's frame, upwards, shape (6,)."""
    R = below.R_sole_sensor[foot].T
    load = R @ np.array([0.0, 0.0, below.mass[foot] * GRAVITY])
    arm = R @ (below.com_sole[foot] - below.position_sensor_sole[foot])
    return np.concatenate([load, np.cross(arm, load)])


def _cells_layout(layout: FeetLayout, below: BelowSensor) -> FeetLayout:
    return FeetLayout(
        tuple(
            FootLayout.load_cells(
                foot.name,
                np.asarray(foot.position_cell_sole),
                foot.channel_names,
                mass_below=float(below.mass[i]),
                com_below_sole=below.com_sole[i],
            )
            for i, foot in enumerate(layout.feet)
        )
    )


def _ankle_layout(below: BelowSensor) -> FeetLayout:
    return FeetLayout(
        tuple(
            FootLayout.force_torque(
                name,
                position_sensor_sole=below.position_sensor_sole[i],
                R_sole_sensor=below.R_sole_sensor[i],
                mass_below=float(below.mass[i]),
                com_below_sole=below.com_sole[i],
            )
            for i, name in enumerate(("left", "right"))
        )
    )


def _combined(*layouts: FeetLayout) -> FeetLayout:
    feet = zip(*(layout.feet for layout in layouts), strict=True)
    return FeetLayout(tuple(FootLayout.combined(parts[0].name, *parts) for parts in feet))
