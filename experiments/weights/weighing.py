"""Known weights on simulated cells, one by one, then at known holes of a plate (CoP paper, section 3.1).

Whole holes are held out of the fit for the score. Cells have curves, sit off the drawing and share the load
by the plate's statics and their stiffnesses; weights have play in their holes. Weights of 510 g and less stay
below the 5 N threshold: they have no centre of pressure to score.

The same weights, put again and again into the same holes, say how far a centre of pressure is known (section
4.2): by the data sheet's map, by that of the weights, and by those that the robot found while it walked.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from surefoot.calibration.checks import check_count, check_not_negative, check_positive
from surefoot.calibration.cop import cop_of_cells
from surefoot.calibration.layout import FeetLayout, FootLayout, nao_shoe_layout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.weights.channels import ChannelFit, fit_channels
from surefoot.calibration.weights.cop_correction import CopCorrectionFit, fit_cop_correction
from surefoot.envs.instrumentation.plate import SolePlate
from surefoot.experiments.arrays import Floats
from surefoot.sensors import LoadCells, load_cells
from surefoot.sensors.devices.load_cells import LoadCellState, static_counts
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import FootSensors, SelfCalibration

_STREAM = 7001  # keeps this randomness apart from every other stream with the same seed
_WALK = 24.0  # s of the walk before weighing, of which 4 are stood


@dataclass(frozen=True)
class WeighingSetup:
    """The loads, and how carefully they are weighed."""

    channel_loads: tuple[float, ...] = (0.0, 0.001, 0.01, 0.05, 0.2, 0.5, 1.0, 2.0, 4.0, 6.0)  # kg
    placement_loads: tuple[float, ...] = (0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 6.0)  # kg, at every hole
    hole_pitch: float = 0.01  # distance between holes in m
    fitted_holes: int = 40  # holes that the correction of the centre of pressure is fitted to
    held_out_holes: int = 20  # further holes that it is only scored on
    readings: int = 80  # conversions averaged for each weighing: one second at 80 per second
    stiffness: tuple[float, float, float, float] = (1.0, 0.8, 1.1, 0.9)  # of a foot's cells, relative
    cell_position_std: float = 5e-4  # how far cells sit from the drawing in m, per axis
    nonlinearity: float = 5e-4  # largest bow of a cell's curve, drawn either way, as a share of its capacity
    hole_play: float = 1e-4  # std of a weight's distance from the middle of its hole in m, per axis
    seconds_per_weighing: float = 0.0  # from one to the next, in which the cells drift; 0 if settled
    repeats: int = 20  # of a weight in a hole, as in the paper
    repeated_loads: tuple[float, ...] = (1.0, 4.0)  # kg

    def __post_init__(self) -> None:
        """Raise ValueError if a number is too small."""
        check_count(self, "fitted_holes", "held_out_holes", "readings", "repeats")
        check_positive(self, "hole_pitch")
        check_not_negative(self, "cell_position_std", "nonlinearity", "hole_play", "seconds_per_weighing")


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

    channel_names: tuple[str, ...]
    channel_load: Floats  # on each cell in kg, shape (n,)
    channel_code: Floats  # mean counts under them, shape (n, K)
    channels: ChannelFit  # in N; ``channels.value`` is the calibrated map
    held_out: (
        pd.DataFrame
    )  # at holes that no fit saw; the maps are "initial", "weights" and their "lines" alone
    repeats: pd.DataFrame  # the same weights in the same holes again and again, by further maps as well

    def errors(self, name: str) -> MethodErrors:
        """Errors of a map at held-out holes, on both feet."""
        return errors_of(self.held_out[self.held_out["map"] == name])


def errors_of(placements: pd.DataFrame) -> MethodErrors:
    """Root-mean-square errors over placements; those without a centre of pressure have none of it."""
    squares = (placements[["cop_error", "vgrf_error"]] ** 2).mean()
    return MethodErrors(*np.sqrt(squares).tolist())


@dataclass(eq=False)
class _Cells:
    """The cells: read true loads as mean counts, and grow older with every weighing."""

    config: LoadCells
    state: LoadCellState
    setup: WeighingSetup
    rng: np.random.Generator
    bow: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.bow = self.setup.nonlinearity * self.rng.uniform(-1.0, 1.0, self.config.channels)

    def read(self, load: Floats) -> Floats:
        """Return mean counts of true loads in N, shape (n, K), weighed one after another."""
        share = load / self.config.capacity
        bowed = load + self.bow * self.config.capacity * 4.0 * share * (1.0 - share)
        step = np.sqrt(self.setup.seconds_per_weighing)
        walk = np.cumsum(self.rng.standard_normal((2, *load.shape)), axis=1) * step
        density = np.array([self.config.scale_drift, self.config.offset_drift])[:, None, None]
        counts, error = np.empty_like(load), self.state.error[:, None] + density * walk
        for i, one in enumerate(bowed):
            self.state = self.state._replace(error=error[:, i])
            repeated = np.tile(one, (self.setup.readings, 1))
            counts[i] = static_counts(self.config, self.state, repeated, self.rng).mean(axis=0)
        return counts

    def read_foot(self, where: slice, load: Floats) -> Floats:
        """Return mean counts of all cells while those of one foot bear loads in N, shape (n, 4)."""
        on_all = np.zeros((len(load), self.config.channels))
        on_all[:, where] = load
        return self.read(on_all)


def run_weighing(
    setup: WeighingSetup | None = None,
    cells: LoadCells = HX711_LOAD_CELLS,
    *,
    state: LoadCellState | None = None,
    layout: FeetLayout | None = None,
    seed: int = 0,
    maps: Mapping[str, Parameters] | None = None,
) -> WeighingReport:
    """Calibrate a robot's load cells with known weights, and score the fits on held-out holes.

    Args ``state`` are the very cells, as ``load_cells(cells).init`` made them, of which errors of scale and
    offset are used; by default some are drawn. The layout has four cells a foot, a NAO's shoes by default.
    With other ``maps`` of these cells, by name, placements are repeated, and read by these as well. Raises
    ValueError for other layouts or too few holes.
    """
    setup = WeighingSetup() if setup is None else setup
    layout = nao_shoe_layout() if layout is None else layout
    if cells.channels != layout.channels:
        raise ValueError(f"The layout has {layout.channels} cells, but 'cells' describes {cells.channels}.")
    rng = np.random.default_rng([_STREAM, seed])
    if state is None:
        state = load_cells(cells).init((cells.channels,), rng)
    weighed = _Cells(cells, state, setup, rng)

    weight = np.array(setup.channel_loads) * GRAVITY
    code = weighed.read(np.repeat(weight[:, None], cells.channels, axis=1))
    channels = fit_channels(code, weight, layout.channel_names)

    own = {"initial": Parameters(cells.nominal_scale, cells.nominal_offset), "weights": channels.value}
    held_out, plates = [], []
    for foot, where in zip(layout.feet, layout.slices, strict=True):
        hole, load, unseen, cell_load, plate = _place(setup, foot, rng)
        raw = weighed.read_foot(where, cell_load)
        after = channels.value.force(raw)[:, where]
        fit = fit_cop_correction(after[~unseen], load[~unseen], hole[~unseen], _positions(foot))
        read = partial(_read_by_maps, foot=foot.name, where=where, fit=fit)
        lines = {"lines": channels.value}
        held_out.append(read(own | lines, raw[unseen], hole[unseen], load[unseen]))
        plates.append((plate, np.unique(hole[unseen], axis=0), where, read))
    repeats = [pd.DataFrame()]
    for plate, holes, where, read in plates if maps is not None else ():
        hole, load, cell_load = _repeat(setup, plate, holes, rng)
        repeats.append(read(own | dict(maps or {}), weighed.read_foot(where, cell_load), hole, load))
    return WeighingReport(
        channel_names=layout.channel_names,
        channel_load=np.array(setup.channel_loads),
        channel_code=code,
        channels=channels,
        held_out=pd.concat(held_out),
        repeats=pd.concat(repeats),
    )


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
    if foot.position_cell_sole is None or foot.channels != 4:
        raise ValueError(f"Weighing needs four load cells a foot, but foot '{foot.name}' has none or others.")
    return foot.position_cell_sole[:, :2]


def _place(
    setup: WeighingSetup, foot: FootLayout, rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.bool_], Floats, SolePlate]:
    """Return holes (n, 2) in m, loads (n,) in N, if held out (n,), cells' loads (n, 4) in N, the plate."""
    drawn = _positions(foot)
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    # The sides are not exact in binary: without the slack, rounding would decide about the outermost row.
    count = np.floor((high - low) / setup.hole_pitch + 1e-6) + 1.0
    x, y = np.arange(count[0]), np.arange(count[1])
    grid = np.stack(np.meshgrid(x - x.mean(), y - y.mean(), indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid * setup.hole_pitch + 0.5 * (low + high)
    wanted = setup.fitted_holes + setup.held_out_holes
    if wanted > len(grid):
        raise ValueError(
            f"The plate of foot '{foot.name}' has {len(grid)} holes, but {wanted} were asked for."
        )
    chosen = rng.choice(len(grid), wanted, replace=False)
    load = np.tile(np.array(setup.placement_loads) * GRAVITY, wanted)
    hole = np.repeat(grid[chosen], len(setup.placement_loads), axis=0)
    held_out = np.repeat(np.arange(wanted) >= setup.fitted_holes, len(setup.placement_loads))
    stands = hole + setup.hole_play * rng.standard_normal(hole.shape)
    plate = SolePlate(drawn + setup.cell_position_std * rng.standard_normal(drawn.shape), setup.stiffness)
    return hole, load, held_out, _share(plate, load, stands), plate


def _repeat(
    setup: WeighingSetup, plate: SolePlate, holes: Floats, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Put weights into the outermost holes and the middle one, again and again.

    Return holes (n, 2) in m, loads (n,) in N, and the cells' loads (n, 4) in N.
    """
    off = holes - holes.mean(axis=0)
    outermost = [np.argmax(off @ corner) for corner in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
    chosen = holes[[*outermost, np.argmin(np.linalg.norm(off, axis=1))]]
    hole = np.repeat(chosen, len(setup.repeated_loads) * setup.repeats, axis=0)
    load = np.tile(np.repeat(setup.repeated_loads, setup.repeats), len(chosen)) * GRAVITY
    stands = hole + setup.hole_play * rng.standard_normal(hole.shape)
    return hole, load, _share(plate, load, stands)


def _share(plate: SolePlate, load: Floats, stands: Floats) -> Floats:
    """Return the cells' loads in N, (n, 4), under weights in N, (n,), that stand at places in m, (n, 2)."""
    return np.column_stack([load, stands[:, 1] * load, -stands[:, 0] * load]) @ plate.share.T
