"""Known weights on simulated cells, one by one, then at known holes of a plate (CoP paper, section 3.1).

Whole holes are held out of the fit for the score. Cells have curves, sit off the drawing and share the load
by the plate's statics and their stiffnesses; weights have play in their holes. Weights of 510 g and less stay
below the 5 N threshold: they have no centre of pressure to score.

The same weights, put again and again into the same holes, say how far a centre of pressure is known (section
4.2): by the data sheet's map, by that of the weights, and by those that the robot found while it walked.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration.cop import cop_of_cells
from surefoot.calibration.layout import FootLayout, nao_shoe_layout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.weights.channels import fit_channels
from surefoot.calibration.weights.cop_correction import CopCorrectionFit, fit_cop_correction
from surefoot.envs.instrumentation.plate import SolePlate
from surefoot.sensors import LoadCells, load_cells
from surefoot.sensors.devices.load_cells import LoadCellState, static_counts
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import FootSensors, SelfCalibration

_STREAM = 7001  # keeps this randomness apart from every other stream with the same seed
_WALK = 24.0  # s of the walk before weighing, of which 4 are stood

CHANNEL_LOADS = np.array([0.0, 0.001, 0.01, 0.05, 0.2, 0.5, 1.0, 2.0, 4.0, 6.0])  # kg on each cell
PLACEMENT_LOADS = np.array([0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 6.0])  # kg at every hole
HOLE_PITCH = 0.01  # distance between holes in m
FITTED_HOLES, HELD_OUT_HOLES = (
    40,
    20,
)  # that the correction is fitted to, and further ones that it is scored on
READINGS = 80  # conversions averaged for each weighing: one second at 80 per second
STIFFNESS = (1.0, 0.8, 1.1, 0.9)  # of a foot's cells, relative
CELL_POSITION_STD = 5e-4  # how far cells sit from the drawing in m, per axis
NONLINEARITY = 5e-4  # largest bow of a cell's curve, drawn either way, as a share of its capacity
HOLE_PLAY = 1e-4  # std of a weight's distance from the middle of its hole in m, per axis
REPEATS, REPEATED_LOADS = 20, (1.0, 4.0)  # of a weight in a hole, as in the paper, and the weights in kg


class MethodErrors(NamedTuple):
    """Root-mean-square errors of the centre of pressure in m and of the vertical force in N."""

    cop: float
    vgrf: float


@dataclass(frozen=True, eq=False)
class WeighingReport:
    """The result of known weights.

    Placements have a row a map, foot, hole (x, y in m), weight (load in kg) and repeat: cop_x, cop_y in m,
    NaN below 5 N, vgrf in N, and their errors.
    """

    held_out: pd.DataFrame  # at holes that no fit saw; the maps are "initial" and "weights"
    repeats: pd.DataFrame  # the same weights in the same holes again and again, by further maps as well

    def errors(self, name: str) -> MethodErrors:
        """Errors of a map at held-out holes, on both feet."""
        return errors_of(self.held_out[self.held_out["map"] == name])


def errors_of(placements: pd.DataFrame) -> MethodErrors:
    """Root-mean-square errors over placements; those without a centre of pressure have none of it."""
    squares = (placements[["cop_error", "vgrf_error"]] ** 2).mean()
    return MethodErrors(*np.sqrt(squares).tolist())


class _Cells:
    def __init__(self, config: LoadCells, state: LoadCellState, rng: np.random.Generator) -> None:
        self._config, self._state, self._rng = config, state, rng
        self._bow = NONLINEARITY * config.capacity * rng.uniform(-1.0, 1.0, config.channels)

    def read(self, load: Floats) -> Floats:
        """Return mean counts of true loads in N, shape (n, K), weighed one after another."""
        share = load / self._config.capacity
        bowed = (load + self._bow * 4.0 * share * (1.0 - share))[:, None].repeat(READINGS, axis=1)
        return np.array(
            [static_counts(self._config, self._state, one, self._rng).mean(axis=0) for one in bowed]
        )

    def fit(self) -> Parameters:
        """Weigh the cells one by one; return the lines through their mean counts, in N."""
        weight = CHANNEL_LOADS * GRAVITY
        code = self.read(np.repeat(weight[:, None], self._config.channels, axis=1))
        return fit_channels(code, weight, nao_shoe_layout().channel_names).value

    def read_foot(self, where: slice, load: Floats) -> Floats:
        """Return mean counts of all cells while those of one foot bear loads in N, shape (n, 4)."""
        on_all = np.zeros((len(load), self._config.channels))
        on_all[:, where] = load
        return self.read(on_all)


def weigh_cells(cells: LoadCells, state: LoadCellState, seed: int) -> Parameters:
    """Return the map of a NAO's cells by known weights on each, as :func:`run_weighing` finds it."""
    return _Cells(cells, state, np.random.default_rng([_STREAM, seed])).fit()


def run_weighing(
    cells: LoadCells = HX711_LOAD_CELLS,
    *,
    state: LoadCellState | None = None,
    seed: int = 0,
    maps: Mapping[str, Parameters] | None = None,
) -> WeighingReport:
    """Calibrate a NAO's load cells with known weights, and score the fits on held-out holes.

    Args ``state`` are the very cells, as ``load_cells(cells).init`` made them, of which errors of scale and
    offset are used; by default some are drawn. With other ``maps`` of these cells, by name, placements are
    repeated, and read by these as well.
    """
    layout, rng = nao_shoe_layout(), np.random.default_rng([_STREAM, seed])
    if state is None:
        state = load_cells(cells).init((cells.channels,), rng)
    weighed = _Cells(cells, state, rng)
    calibrated = weighed.fit()
    own = {"initial": Parameters(cells.nominal_scale, cells.nominal_offset), "weights": calibrated}
    held_out, repeats = [], [pd.DataFrame()]
    for foot, where in zip(layout.feet, layout.slices, strict=True):
        hole, load, unseen, cell_load, plate = _place(foot, rng)
        raw = weighed.read_foot(where, cell_load)
        after = calibrated.force(raw)[:, where]
        fit = fit_cop_correction(after[~unseen], load[~unseen], hole[~unseen], _positions(foot))
        read = partial(_read_by_maps, foot=foot.name, where=where, fit=fit)
        held_out.append(read(own, raw[unseen], hole[unseen], load[unseen]))
        if maps is not None:
            hole, load, cell_load = _repeat(plate, np.unique(hole[unseen], axis=0), rng)
            repeats.append(read(own | dict(maps), weighed.read_foot(where, cell_load), hole, load))
    return WeighingReport(pd.concat(held_out), pd.concat(repeats))


def _read_by_maps(
    maps: Mapping[str, Parameters],
    raw: Floats,
    hole: Floats,
    load: Floats,
    *,
    foot: str,
    where: slice,
    fit: CopCorrectionFit,
) -> pd.DataFrame:
    """Read weights in N, (n,), at holes in m, (n, 2), on a foot by each map of the counts, (n, K)."""
    about, found = {"foot": foot, "x": hole[:, 0], "y": hole[:, 1], "load": load / GRAVITY}, []
    for name, one in maps.items():
        force = one.force(raw)[:, where]
        cop = fit.cop(force) if name == "weights" else cop_of_cells(force, fit.position_cell_sole)
        vgrf = force.sum(axis=1)
        read = {"map": name, "cop_x": cop[:, 0], "cop_y": cop[:, 1], "vgrf": vgrf}
        errors = {"cop_error": np.linalg.norm(cop - hole, axis=1), "vgrf_error": vgrf - load}
        found.append(pd.DataFrame(about | read | errors))
    return pd.concat(found)


def weigh_after_walk(seed: int = 0, methods: tuple[str, ...] = ("window", "moment")) -> WeighingReport:
    """Walk for a while, then calibrate the same cells with known weights; repeat placements by all maps."""
    maps = {}
    for method in methods:
        walker = gym.make(
            "surefoot/NaoWalk-v0", disable_env_checker=True, push_impulse=(0.0, 0.0), stand_time=4.0
        )
        sensors = FootSensors(walker, HX711_LOAD_CELLS)
        env = SelfCalibration(sensors, method)
        env.reset(seed=seed)
        for _ in range(round(_WALK / sensors.source.dt)):
            *_, info = env.step(np.zeros(env.action_space.shape or ()))
        maps[method] = Parameters(**info["surefoot"]["parameters"])
        state = sensors.robot.hardware().instruments.cells
        env.close()
    return run_weighing(state=state, seed=seed, maps=maps)


def _positions(foot: FootLayout) -> Floats:
    assert foot.position_cell_sole is not None
    return foot.position_cell_sole[:, :2]


def _place(
    foot: FootLayout, rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.bool_], Floats, SolePlate]:
    """Return holes (n, 2) in m, loads (n,) in N, if held out (n,), cells' loads (n, 4) in N, the plate."""
    drawn = _positions(foot)
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    # The sides are not exact in binary: without the slack, rounding would decide about the outermost row.
    count = np.floor((high - low) / HOLE_PITCH + 1e-6) + 1.0
    x, y = np.arange(count[0]), np.arange(count[1])
    grid = np.stack(np.meshgrid(x - x.mean(), y - y.mean(), indexing="ij"), axis=-1).reshape(-1, 2)
    wanted, loads = FITTED_HOLES + HELD_OUT_HOLES, len(PLACEMENT_LOADS)
    chosen = rng.choice(len(grid), wanted, replace=False)
    hole = np.repeat(grid[chosen] * HOLE_PITCH + 0.5 * (low + high), loads, axis=0)
    load = np.tile(PLACEMENT_LOADS * GRAVITY, wanted)
    held_out = np.repeat(np.arange(wanted) >= FITTED_HOLES, loads)
    stands = hole + HOLE_PLAY * rng.standard_normal(hole.shape)
    plate = SolePlate(drawn + CELL_POSITION_STD * rng.standard_normal(drawn.shape), STIFFNESS)
    return hole, load, held_out, _share(plate, load, stands), plate


def _repeat(plate: SolePlate, holes: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Put weights into the outermost holes and the middle one, again and again.

    Return holes (n, 2) in m, loads (n,) in N, and the cells' loads (n, 4) in N.
    """
    off = holes - holes.mean(axis=0)
    outermost = [np.argmax(off @ corner) for corner in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
    chosen = holes[[*outermost, np.argmin(np.linalg.norm(off, axis=1))]]
    hole = np.repeat(chosen, len(REPEATED_LOADS) * REPEATS, axis=0)
    load = np.tile(np.repeat(REPEATED_LOADS, REPEATS), len(chosen)) * GRAVITY
    stands = hole + HOLE_PLAY * rng.standard_normal(hole.shape)
    return hole, load, _share(plate, load, stands)


def _share(plate: SolePlate, load: Floats, stands: Floats) -> Floats:
    """Return the cells' loads in N, (n, 4), under weights in N, (n,), that stand at places in m, (n, 2)."""
    return np.column_stack([load, stands[:, 1] * load, -stands[:, 0] * load]) @ plate.share.T
