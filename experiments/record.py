"""Record walks as logs: the truth, the robot's beliefs, and what cells of several kinds make of them.

The robot walks on its true centre of pressure, so that the walk does not depend on any calibrator. Nor do its
load cells act back on it, so that one walk serves all conditions: the same true forces and the same beliefs,
read by other cells. The bench calibration is done with those very cells before the walk.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import surefoot
from surefoot.calibration import Parameters, Reference
from surefoot.controllers import Stabiliser
from surefoot.experiments.bench import run_bench
from surefoot.experiments.log_format import Log, LogTruth
from surefoot.experiments.walkers import STAND_TIME, make_walker
from surefoot.sensors import (
    HX711_LOAD_CELLS,
    PER_SQRT_MINUTE,
    LoadCells,
    LoadCellState,
    load_cells,
    true_map,
)

__all__ = ["CONDITIONS", "Condition", "record_walk"]

_STREAM = 0x10605
"""Keeps the cells' randomness apart from every other stream with the same seed."""

_SETTLING = 16
"""Rows cut off at the beginning of a log, in which telemetry has not yet arrived."""


@dataclass(frozen=True)
class Condition:
    """What cells a robot walks on, and what it knows of them.

    Attributes:
        name: Short name, for files.
        title: What to call it.
        cells: The load cells.
        start: The map that calibrators start from: ``"bench"`` or ``"nominal"``.
    """

    name: str
    title: str
    cells: LoadCells
    start: str


CONDITIONS = (
    Condition(
        "paper",
        "the paper's conditions",
        LoadCells(gain_drift=0.005 * PER_SQRT_MINUTE, zero_drift=0.2 * PER_SQRT_MINUTE),
        "bench",
    ),
    Condition("bad-start", "bad start", HX711_LOAD_CELLS, "nominal"),
)
"""The CoP paper's, calibrated on the bench and then drifting mildly (0.5 % and 0.2 N per square root of a
minute); and a bad start: never calibrated (gains 12 % off, zeros 1.5 N) and drifting by 2 % and 1 N."""


class _Cells:
    """The cells of one condition under one walk.

    Args:
        condition: What cells.
        index: Number of its random stream.
        seed: Seed of the walk.
        force: True forces of the first block in N, shape (S, K).
    """

    def __init__(self, condition: Condition, index: int, seed: int, force: NDArray[np.float64]) -> None:
        self.condition = condition
        self._rng = np.random.default_rng([_STREAM, index, seed])
        self._instrument = load_cells(condition.cells)
        self._state: LoadCellState = self._instrument.init(force.shape[-1:], self._rng)
        self.bench: Parameters = run_bench(cells=condition.cells, state=self._state, seed=seed).channels.value
        self._counts: list[NDArray[np.float64]] = []
        self._maps: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        rate = condition.cells.rate
        # Every chip delivers once before the walk, as they do while a robot boots.
        _, self._state = self._instrument.apply(
            force, self._state, self._rng, 1.0 / rate[0] if rate else 0.0125
        )

    def read(self, force: NDArray[np.float64], dt: float) -> None:
        """Take the readings after a control step."""
        counts, self._state = self._instrument.apply(force, self._state, self._rng, dt)
        self._counts.append(counts)
        self._maps.append(true_map(self.condition.cells, self._state))

    @property
    def raw(self) -> NDArray[np.float64]:
        """All readings in counts, shape (N, K)."""
        return np.array(self._counts)

    @property
    def maps(self) -> NDArray[np.float64]:
        """The maps that would have undone the cells' errors, (scale, offset), shape (N, 2, K)."""
        return np.array(self._maps)


def record_walk(
    speed: float,
    seed: int,
    duration: float,
    conditions: Sequence[Condition] = CONDITIONS,
    **env_options: Any,
) -> dict[str, Log]:
    """Walk once, and log what the cells of each condition read.

    As in the CoP paper nobody pushes, unless ``push_impulse`` says so.

    Args:
        speed: Walking speed in m/s.
        seed: Of the walk, the sensors, the beliefs and the bench.
        duration: Duration in s, standing included; a fall ends the walk earlier.
        conditions: What cells to read it with.
        **env_options: Further options of :class:`~surefoot.envs.nao_walk.NaoWalkEnv`.

    Returns:
        A log by the condition's name.
    """
    undisturbed = {"push_impulse": (0.0, 0.0)}
    env, tap = make_walker("none", speed=speed, duration=duration, **(undisturbed | env_options))
    bare: Any = env.unwrapped
    controller = Stabiliser(bare.state_layout, engage_after=STAND_TIME)
    _, info = env.reset(seed=seed)
    controller.reset()
    cells = [_Cells(c, i, seed, bare.truth.force_cell.copy()) for i, c in enumerate(conditions)]
    time: list[float] = []
    beliefs: list[Reference] = []
    force, position, rotation = [], [], []
    done = terminated = False
    while not done:
        _, _, terminated, truncated, info = env.step(controller(tap.seen))
        truth = bare.truth
        time.append((len(time) + 1) * bare.dt)
        beliefs.append(info["surefoot"]["reference"])
        for one in cells:
            one.read(truth.force_cell, bare.dt)
        force.append(truth.force_cell[-1].copy())
        position.append(truth.position_sole[-1].copy())
        rotation.append(truth.R_world_sole[-1].copy())
        done = terminated or truncated
    walker: Any = env
    layout, mass = walker.layout, walker.calibrator.setup.mass
    env.close()

    kept = slice(_SETTLING, None)
    about = {
        "speed_m_s": speed,
        "fell": bool(terminated),
        "duration_s": duration,
        "surefoot": surefoot.__version__,
    }
    reference = Reference(*(np.array(parts)[kept] for parts in zip(*beliefs, strict=True)))
    return {
        one.condition.name: Log(
            time=np.array(time)[kept],
            raw=one.raw[kept],
            reference=reference,
            layout=layout,
            mass=mass,
            nominal=Parameters(one.condition.cells.nominal_scale, one.condition.cells.nominal_offset),
            bench=one.bench,
            dt=bare.dt,
            lag=int(info["surefoot"]["lag"]),
            seed=seed,
            truth=LogTruth(
                force=np.array(force)[kept],
                position_sole=np.array(position)[kept],
                R_world_sole=np.array(rotation)[kept],
                scale=one.maps[kept, 0],
                offset=one.maps[kept, 1],
            ),
            about=about
            | {
                "condition": one.condition.name,
                "start": one.condition.start,
                "sample_age_s": one.condition.cells.nominal_age,
            },
        )
        for one in cells
    }
