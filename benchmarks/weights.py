"""Known weights on simulated load cells before and after calibration: Tables 2 and 3 of the CoP paper.

    python benchmarks/weights.py          # seconds

Weights stand on the cells one by one, then in known holes of a plate (CoP paper, PMC12899417, section 3.1).
Whole holes are held out of the fit for the score. Cells have curves, sit off the drawing and share the load
by the statics and the stiffness of the plate; weights have play in their holes. Weights of 510 g and less
stay below the 5 N threshold: they have no centre of pressure to score.

The same weights, placed again and again in the same holes, show how well a centre of pressure is known
(section 4.2): by the map of the data sheet, by that of the weights, and by those that methods found in a walk
of 20 s.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import bench
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
from surefoot.experiments.study.tables import NOTHING, Cell, Table, decimal, number, table_of
from surefoot.experiments.weights.weighing import STREAM, WeighedCells
from surefoot.sensors import LoadCells, load_cells
from surefoot.sensors.devices.load_cells import LoadCellState
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import FootSensors, SelfCalibration

WALK = 24.0  # s of the walk before weighing, the first 4 of which are standing
PLACEMENT_LOADS = np.array([0.01, 0.1, 0.5, 1.0, 2.0, 4.0, 6.0])  # kg in every hole
HOLE_PITCH = 0.01  # distance between holes in m
FITTED_HOLES, HELD_OUT_HOLES = 40, 20  # to which the correction is fitted, and on which it is scored
STIFFNESS = (1.0, 0.8, 1.1, 0.9)  # of a foot's cells, relative
CELL_POSITION_STD = 5e-4  # error of the positions of cells against the drawing in m, per axis
HOLE_PLAY = 1e-4  # std of a weight's distance from the middle of its hole in m, per axis
REPEATS, REPEATED_LOADS = 20, (1.0, 4.0)  # of a weight in a hole, as in the paper, and the weights in kg


class Errors(NamedTuple):
    """Root-mean-square errors of the centre of pressure in m and of the vertical force in N."""

    cop: float
    vgrf: float


class Weighing(NamedTuple):
    """Placements of known weights.

    A row per map, foot, hole (x, y in m), weight (load in kg) and repeat has cop_x and cop_y in m, NaN below
    5 N, vgrf in N, and their errors.
    """

    held_out: pd.DataFrame  # in holes that no fit has seen; the maps are "initial" and "weights"
    repeats: pd.DataFrame  # the same weights in the same holes again and again, by other maps as well


TABLE_2 = np.array(
    [  # counts of eight cells under 0, 0.01, 0.05 and 0.2 kg; scale in 1e-6 kg per count; offset in kg
        [8347750, 8344582, 8326926, 8264253, -2.38250654, 19.8895457],
        [8347750, 8344582, 8301298, 8264254, -2.20853048, 18.4277626],
        [8322914, 8317325, 8301301, 8264263, -3.47692594, 28.9285295],
        [8322914, 8317325, 8301299, 8264278, -3.47779548, 28.9357592],
        [8322914, 8317426, 8301297, 8264254, -3.4736872, 28.9017197],
        [8322914, 8317356, 8301289, 8264261, -3.47589563, 28.9199912],
        [8322914, 8317320, 8301299, 8264262, -3.47698378, 28.9290027],
        [8321583, 8317321, 8301297, 8264267, -3.5299719, 29.3677097],
    ]
)
"""The paper's weighing. Six of the eight cells have one code without load; two rows share three codes."""

TABLE_3 = {"initial": Errors(0.1839, 5.298), "weights": Errors(0.0005, 0.08)}
"""Before and after the paper's manual calibration from weights."""

MAPS = {"initial": "initial", "weights": "weights", "window": "window, walked", "moment": "moment, walked"}


def errors_of(placements: pd.DataFrame) -> Errors:
    """Return rms errors over placements; those without a centre of pressure do not count for it."""
    squares = (placements[["cop_error", "vgrf_error"]] ** 2).mean()
    return Errors(*np.sqrt(squares).tolist())


def weigh(
    cells: LoadCells = HX711_LOAD_CELLS,
    *,
    state: LoadCellState | None = None,
    seed: int = 0,
    maps: Mapping[str, Parameters] | None = None,
) -> Weighing:
    """Calibrate a NAO's load cells with known weights, and score the fits in held-out holes.

    ``state`` holds the errors of the cells, which are drawn by default. With other ``maps`` of these cells,
    by name, placements are repeated and read by these maps as well.
    """
    layout, rng = nao_shoe_layout(), np.random.default_rng([STREAM, seed])
    if state is None:
        state = load_cells(cells).init((cells.channels,), rng)
    weighed = WeighedCells(cells, state, rng)
    found = {"initial": Parameters(cells.nominal_scale, cells.nominal_offset), "weights": weighed.fit()}
    held_out, repeats = [], [pd.DataFrame()]
    for foot, where in zip(layout.feet, layout.slices, strict=True):

        def read(load: Floats, where: slice = where) -> Floats:
            on_all = np.zeros((len(load), cells.channels))
            on_all[:, where] = load
            return weighed.read(on_all)

        hole, load, unseen, cell_load, plate = place(foot, rng)
        raw = read(cell_load)
        after = found["weights"].force(raw)[:, where]
        fit = fit_cop_correction(after[~unseen], load[~unseen], hole[~unseen], positions(foot))
        about = foot.name, where, fit
        held_out.append(read_by_maps(found, raw[unseen], hole[unseen], load[unseen], *about))
        if maps is not None:
            hole, load, cell_load = repeat(plate, np.unique(hole[unseen], axis=0), rng)
            repeats.append(read_by_maps(found | dict(maps), read(cell_load), hole, load, *about))
    return Weighing(pd.concat(held_out), pd.concat(repeats))


def read_by_maps(
    maps: Mapping[str, Parameters],
    raw: Floats,
    hole: Floats,
    load: Floats,
    foot: str,
    where: slice,
    fit: CopCorrectionFit,
) -> pd.DataFrame:
    """Read weights in N, (n,), in holes in m, (n, 2), on a foot by each map of the counts, (n, K)."""
    about, found = {"foot": foot, "x": hole[:, 0], "y": hole[:, 1], "load": load / GRAVITY}, []
    for name, one in maps.items():
        force = one.force(raw)[:, where]
        cop = fit.cop(force) if name == "weights" else cop_of_cells(force, fit.position_cell_sole)
        vgrf = force.sum(axis=1)
        read = {"map": name, "cop_x": cop[:, 0], "cop_y": cop[:, 1], "vgrf": vgrf}
        errors = {"cop_error": np.linalg.norm(cop - hole, axis=1), "vgrf_error": vgrf - load}
        found.append(pd.DataFrame(about | read | errors))
    return pd.concat(found)


def weigh_after_walk(seed: int = 0, methods: tuple[str, ...] = ("window", "moment")) -> Weighing:
    """Walk, then calibrate the same cells with known weights; repeat placements by all maps."""
    maps = {}
    for method in methods:
        walker = gym.make(
            "surefoot/NaoWalk-v0", disable_env_checker=True, push_impulse=(0.0, 0.0), stand_time=4.0
        )
        sensors = FootSensors(walker, HX711_LOAD_CELLS)
        env = SelfCalibration(sensors, method)
        env.reset(seed=seed)
        for _ in range(round(WALK / sensors.source.dt)):
            *_, info = env.step(np.zeros(env.action_space.shape or ()))
        maps[method] = Parameters(**info["surefoot"]["parameters"])
        state = sensors.robot.hardware().cells
        env.close()
    return weigh(state=state, seed=seed, maps=maps)


def positions(foot: FootLayout) -> Floats:
    """Return the places of a foot's cells in its sole, shape (4, 2)."""
    assert foot.position_cell_sole is not None
    return foot.position_cell_sole[:, :2]


def place(
    foot: FootLayout, rng: np.random.Generator
) -> tuple[Floats, Floats, NDArray[np.bool_], Floats, SolePlate]:
    """Return holes (n, 2) in m, loads (n,) in N, if held out (n,), loads of cells (n, 4) in N, the plate."""
    drawn = positions(foot)
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
    return hole, load, held_out, share_load(plate, load, stands), plate


def repeat(plate: SolePlate, holes: Floats, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Place weights in the outermost holes and the middle one, again and again.

    Returns holes (n, 2) in m, loads (n,) in N, and the loads of cells (n, 4) in N.
    """
    off = holes - holes.mean(axis=0)
    outermost = [np.argmax(off @ corner) for corner in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
    chosen = holes[[*outermost, np.argmin(np.linalg.norm(off, axis=1))]]
    hole = np.repeat(chosen, len(REPEATED_LOADS) * REPEATS, axis=0)
    load = np.tile(np.repeat(REPEATED_LOADS, REPEATS), len(chosen)) * GRAVITY
    stands = hole + HOLE_PLAY * rng.standard_normal(hole.shape)
    return hole, load, share_load(plate, load, stands)


def share_load(plate: SolePlate, load: Floats, stands: Floats) -> Floats:
    """Return the loads of cells in N, (n, 4), under weights in N, (n,), at places in m, (n, 2)."""
    return np.column_stack([load, stands[:, 1] * load, -stands[:, 0] * load]) @ plate.share.T


def table_2() -> tuple[Table, float]:
    """Fit the paper's counts; return a table beside its coefficients, and the largest relative difference."""
    names = nao_shoe_layout().channel_names
    scale, offset = 1e-6 * TABLE_2[:, 4], TABLE_2[:, 5]
    fit = fit_channels(TABLE_2[:, :4].T, np.array([0.0, 0.01, 0.05, 0.2]), names).value
    difference = np.maximum(np.abs(fit.scale / scale - 1), np.abs(fit.offset / offset - 1))
    columns: dict[str, Callable[[int], str]] = {
        "cell": lambda i: names[i],
        "c, ours": lambda i: decimal(1e6 * fit.scale[i], ".8f"),
        "c, paper": lambda i: decimal(TABLE_2[i, 4], ".8f"),
        "d, ours": lambda i: decimal(fit.offset[i], ".7f"),
        "d, paper": lambda i: decimal(offset[i], ".7f"),
        "largest difference": lambda i: decimal(difference[i], ".1e"),
    }
    note = "c in 1e-6 kg per count and d in kg, by regression of the load on the counts."
    title = "Table 2: the paper's counts, fitted again"
    return table_of("table2_paper", title, columns, range(len(names)), note), float(difference.max())


def table_3(found: Weighing) -> Table:
    """Return the errors in held-out holes as the paper's Table 3."""
    ours = [errors_of(found.held_out[found.held_out["map"] == name]) for name in TABLE_3]
    both = (*ours, *TABLE_3.values())
    rows = (
        ("CoP (mm)", *(number(1e3 * errors.cop) for errors in both)),
        ("vGRF (N)", *(number(errors.vgrf) for errors in both)),
    )
    columns = ("rmse", "initial, ours", "calibrated, ours", "initial, paper", "calibrated, paper")
    calibrated = found.held_out[found.held_out["map"] == "weights"]
    note = (
        f"{calibrated['cop_x'].count()} placements with a centre of pressure and {len(calibrated)} weighings "
        "in holes that the fit has not seen; the paper does not say how many of its placements were held out."
    )
    return Table("table3", "Table 3: before and after calibration from weights", columns, rows, note)


def repeat_table(found: Weighing) -> Table:
    """Return how repeated placements agree with their holes and with each other, by map."""
    spots, rows = ["foot", "x", "y", "load"], found.repeats

    def spread(column: str, factor: float) -> Cell:
        # About the mean of the same hole and weight.
        return lambda part: number(factor * float(np.sqrt(part[1].groupby(spots)[column].var().mean())))

    def rmse(column: str, factor: float) -> Cell:
        return lambda part: number(factor * getattr(errors_of(part[1]), column))

    def paper(column: str, factor: float) -> Cell:
        return lambda part: (
            number(factor * getattr(TABLE_3[part[0]], column)) if part[0] in TABLE_3 else NOTHING
        )

    columns: dict[str, Cell] = {
        "map": lambda part: MAPS[part[0]],
        "CoP rmse (mm)": rmse("cop", 1e3),
        "CoP rmse, paper (mm)": paper("cop", 1e3),
        "std of repeats, x (mm)": spread("cop_x", 1e3),
        "std of repeats, y (mm)": spread("cop_y", 1e3),
        "vGRF rmse (N)": rmse("vgrf", 1.0),
        "vGRF rmse, paper (N)": paper("vgrf", 1.0),
        "std of repeats, vGRF (N)": spread("vgrf", 1.0),
    }
    amount = len(rows) // rows.groupby([*spots, "map"]).ngroups
    note = "Rmse is the distance from hole and weight; std is about the mean of the same hole and weight."
    title = f"{amount} repeats of each placement"
    return table_of("repeats", title, columns, rows.groupby("map", sort=False), note)


def main() -> None:
    """Weigh, and write the tables."""
    parser = bench.options(__doc__, "weights")
    parser.add_argument("--seed", type=int, default=0, help="of everything random")
    given = parser.parse_args()
    found = weigh_after_walk(given.seed)
    tables = [table_2()[0], table_3(found), repeat_table(found)]
    bench.publish(given.out, "Known weights", "The CoP paper's Tables 2 and 3, and simulated cells.", tables)


if __name__ == "__main__":
    bench.start(__file__)
