"""Calibrators on recordings of a real plate and a balance board, with errors that are added to the readings.

    SUREFOOT_DATA=/path/to/recordings python benchmarks/real_recordings.py --seeds 10

A board or a plate is one foot on four cells. Gains and offsets are put onto the recorded cells,
and the calibrators are told

* the person's weight as a constant, or for the rocked pole the plate's own summed force as its motion,
* the centre of pressure of the record before the errors were put in,
* when nothing stood on the plate.

Scored is as walks are by ``walks.py``, against the record itself, for truth that no
record knows better: a plate's own errors are in both.

``$SUREFOOT_DATA`` has to hold ``foot/wii_board_18min.npz``, ``caltester_FP1_600hz.npz`` (made from public
recordings of a balance board, corkine/BalanceBoardDataAnalysis, and of a force plate, sample 15 of c3d.org),
which are not part of this package.
"""

import argparse
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console
from streams import TRUE_MAP, Stream, score_all

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, METHODS, FeetLayout, FootLayout, Parameters, Reference, zero_phase
from surefoot.calibration.contacts import reference_of_contacts
from surefoot.calibration.cop import cop_of_cells
from surefoot.experiments.logs.format import Log, LogTruth
from surefoot.experiments.study.tables import Frame, Table, with_interval
from surefoot.experiments.walks.score import hold_last

RATE = 80.0  # samples per second that all recordings are brought to: the rate of the CoP paper's cells
SCALE_STD, OFFSET_SHARE = 0.1, 0.03
"""Standard deviations of what is put in: of scales, and of offsets in weights."""

_STREAM = 0x5EA2


class Recording(NamedTuple):
    """One plate over time, at the rate of :data:`RATE`; errors come later."""

    name: str  # in tables
    layout: FeetLayout  # one foot of four cells: x ahead (AP), y to the left (ML)
    force: Floats  # cells in N, their own zeros taken off where they were seen, (N, 4); NaN for a gap
    vgrf: Floats  # vertical force that the calibrators are told, in N, shape (N,)
    cop: Floats  # centre of pressure that they are told, and are scored against, in m, shape (N, 2)
    loaded: NDArray[np.bool_]  # where something surely stood on the plate, shape (N,)
    empty: NDArray[np.bool_]  # where surely nothing did, shape (N,)
    still: bool  # whether somebody stood still, so that a standing start makes sense
    judged: NDArray[np.bool_]  # samples that are scored, shape (N,)

    @property
    def weight(self) -> float:
        """Mean vertical force while loaded in N."""
        return float(self.vgrf[self.loaded].mean())

    def reference(self) -> Reference:
        """Return the beliefs that calibrators are given of a robot whose feet stand at one place."""
        samples = len(self.force)
        at_rest = reference_of_contacts(self.loaded[:, None], self.empty[:, None], np.zeros((samples, 1, 3)))
        acceleration = np.zeros((samples, 3))
        acceleration[:, 2] = np.where(self.loaded, self.vgrf / self.weight - 1.0, 0.0) * GRAVITY
        cop = np.where(self.loaded[:, None], self.cop, 0.0)
        return at_rest._replace(
            com=np.column_stack([cop, np.full(samples, 1.0)]),
            com_acceleration=acceleration,
            accelerometer=at_rest.accelerometer + acceleration,
            gyroscope=np.repeat(np.where(self.loaded & self.still, 0.0, 1.0)[:, None], 3, axis=1),
        )


def read_board(folder: Path) -> tuple[Floats, Floats, Floats]:
    """Read the balance board: times in s, cells in kg, (N, 4), and their places in m, ahead and to the left.

    The board's long side runs across the body: its x is to the right, its y ahead.
    """
    with np.load(folder / "foot" / "wii_board_18min.npz") as file:
        place = file["cell_xy_cm"] / 100.0
        return file["t_s"], file["cells_kg"].astype(np.float64), np.column_stack([place[:, 1], -place[:, 0]])


def read_plate(folder: Path, session: str, name: str) -> tuple[Floats, float, Floats]:
    """Read a Kistler plate: cells in N, (N, 4), rows a second, and their places in m, round from (+a, +b)."""
    with np.load(folder / "foot" / f"{session}_600hz.npz") as file:
        a, b = float(file["a_m"]), float(file["b_m"])
        place = np.array([(a, b), (-a, b), (-a, -b), (a, -b)])
        return file[f"{name}_N"][4:].T.astype(np.float64), float(file["rate_hz"]), place


def wii_board(folder: Path) -> Recording:
    """Load a minute of the balance board: empty, then a person of 46 kg standing quietly."""
    time, cells, place = read_board(folder)
    part = (time >= 614.0) & (time <= 660.0)
    time, force = time[part], cells[part] * GRAVITY
    layout = _one_foot("board", place)
    even = np.arange(time[0], time[-1], 1.0 / RATE)
    resampled = np.column_stack([np.interp(even, time, cell) for cell in force.T])
    nearest = np.searchsorted(time, even).clip(1, len(time) - 1)
    resampled[time[nearest] - time[nearest - 1] > 0.1] = np.nan
    total = np.nan_to_num(resampled.sum(axis=1))
    loaded, empty = _surely(total > 300.0, 3.0), _surely(total < 20.0, 0.5)
    resampled -= np.nanmean(resampled[empty], axis=0)
    settled = loaded & (np.cumsum(loaded) > 10 * RATE) & np.isfinite(resampled).all(axis=1)
    weight = float(np.median(resampled[settled].sum(axis=1)))
    return Recording(
        name="balance board",
        layout=layout,
        force=resampled,
        vgrf=np.full(len(even), weight),
        cop=_cop(layout, resampled),
        loaded=loaded & np.isfinite(resampled).all(axis=1),
        empty=empty,
        still=True,
        judged=settled,
    )


def load_rocked_pole(folder: Path) -> Recording:
    """Load the force plate on which a loaded pole is rocked about a fixed tip."""
    cells, rate, place = read_plate(folder, "caltester_FP1", "plate0")
    layout, force = _one_foot("plate", place), _resample(cells, rate)
    total = force.sum(axis=1)
    loaded = total > 30.0
    tip = np.median(_cop(layout, force)[total > 100.0], axis=0)
    return Recording(
        name="pole rocked on a force plate",
        layout=layout,
        force=force,
        vgrf=total,
        cop=np.broadcast_to(tip, (len(force), 2)),
        loaded=loaded,
        empty=_surely(total < 2.0, 0.1),
        still=False,
        judged=(total > 60.0) & (np.arange(len(force)) > 4 * RATE),
    )


def _one_foot(name: str, position: Floats) -> FeetLayout:
    return FeetLayout((FootLayout.load_cells(name, position, [f"cell-{i + 1}" for i in range(4)]),))


def _cop(layout: FeetLayout, force: Floats) -> Floats:
    """Find the centre of pressure where there is force, NaN elsewhere, shape (..., 2)."""
    cells = np.asarray(layout.feet[0].position_cell_sole)[:, :2]
    return np.asarray(cop_of_cells(force, cells), dtype=np.float64)


def _resample(values: Floats, rate: float) -> Floats:
    """Bring an evenly sampled log to :data:`RATE`, faster changes than half of it taken out before."""
    smooth = zero_phase(values, 0.35 * RATE, 1.0 / rate)
    time, even = np.arange(len(values)) / rate, np.arange(0.0, (len(values) - 1) / rate, 1.0 / RATE)
    return np.column_stack([np.interp(even, time, column) for column in smooth.T])


def _surely(condition: NDArray[np.bool_], margin: float) -> NDArray[np.bool_]:
    """Keep of a condition only moments that are further than a margin in s from where it does not hold."""
    reach = round(margin * RATE)
    broken = np.convolve(~condition, np.ones(2 * reach + 1), mode="same") > 0.5
    return condition & ~broken


RECORDINGS: Mapping[str, Callable[[Path], Recording]] = {"board": wii_board, "pole": load_rocked_pole}

# Eight seconds of the pole are too short to wait for a standing start that does not come.
IMPATIENT = {"standing_patience": 3.0}


def spoil(recording: Recording, seed: int) -> Stream:
    """Put errors onto a recording."""
    rng = np.random.default_rng([_STREAM, seed])
    samples, channels = recording.force.shape
    gain = 1.0 + SCALE_STD * rng.standard_normal(channels)
    offset = OFFSET_SHARE * recording.weight * rng.standard_normal(channels)
    time, reference = np.arange(samples) / RATE, recording.reference()
    log = Log(
        time=time,
        raw=recording.force * gain + offset,
        reference=reference,
        layout=recording.layout,
        mass=recording.weight / GRAVITY,
        nominal=Parameters(np.ones(channels), np.zeros(channels)),
        calibrated=None,
        dt=1.0 / RATE,
        lag=0,
        seed=seed,
        truth=LogTruth(
            force=hold_last(recording.force),
            position_sole=reference.position_sole,
            R_world_sole=reference.R_level_sole,
            scale=np.broadcast_to(1.0 / gain, (samples, channels)),
            offset=np.broadcast_to(-offset / gain, (samples, channels)),
        ),
        about={"recording": recording.name},
    )
    there = recording.judged & np.isfinite(recording.force).all(axis=1)
    return Stream(
        log=log,
        seed=seed,
        judged=there,
        began=float(time[np.argmax(recording.loaded)]),
        cop=recording.cop,  # told and scored by one place
    )


def score(folder: Path, name: str, method: str, seeds: range) -> Frame:
    """Score a method on a recording of :data:`RECORDINGS` with errors put in, a row a seed."""
    streams = [spoil(RECORDINGS[name](folder), seed) for seed in seeds]
    options = IMPATIENT if name == "pole" and method in ("window", "quasi-static") else {}
    return pd.DataFrame(score_all(streams, method, **options))


def score_table(folder: Path, name: str, seeds: int) -> Table:
    """Score all methods on one recording."""
    rows = []
    for method in (TRUE_MAP, *METHODS):
        runs = score(folder, name, method, range(seeds))
        values = [with_interval(runs["cop"], 1e3), *(with_interval(runs[key]) for key in ("vgrf", "cell"))]
        rows.append((method, *values, f"{int(runs['worse_vgrf'].sum())} of {len(runs)}"))
    columns = ("method", "CoP (mm)", "vGRF (N)", "cell (N)", "vGRF ends worse")
    return Table(f"recording_{name}", f"Recording '{name}': means and 95 % intervals", columns, tuple(rows))


def main() -> None:
    """Print the tables."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--seeds", type=int, default=10, help="draws of the errors")
    given = parser.parse_args()
    folder = Path(os.environ.get("SUREFOOT_DATA", "nowhere"))
    if not (folder / "foot").is_dir():
        sys.exit("SUREFOOT_DATA names no folder that holds 'foot' with the recordings.")
    for name in RECORDINGS:
        Console(width=180).print(score_table(folder, name, given.seeds).to_rich())


if __name__ == "__main__":
    main()
