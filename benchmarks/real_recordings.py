"""Calibrators on real plates whose four corner cells were recorded one by one, with errors put in by hand.

A board or a plate is one foot on four cells. Gains and offsets are put onto the recorded cells, and the
calibrators are told

* the person's weight as a constant, or for the rocked pole the plate's own summed force as its motion,
* the centre of pressure of the record before the errors were put in,
* when nothing stood on the plate.

Scored is as the walks of ``surefoot compare walking`` are, against the record itself, for truth that no
record knows better: a plate's own errors are in both.

    SUREFOOT_DATA=/path/to/recordings python benchmarks/real_recordings.py --seeds 10

``$SUREFOOT_DATA/foot`` has to hold ``wii_board_18min.npz`` and ``caltester_FP1_600hz.npz``, made from public
recordings of a balance board (corkine/BalanceBoardDataAnalysis) and of a force plate (sample 15 of c3d.org);
they are not part of this package.
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

from surefoot.calibration import GRAVITY, METHODS, FeetLayout, FootLayout, Parameters, Reference, zero_phase
from surefoot.calibration.cop import cop_of_cells
from surefoot.experiments.arrays import Floats
from surefoot.experiments.logs.contacts import refer_to_contacts
from surefoot.experiments.logs.format import Log, LogTruth
from surefoot.experiments.study.tables import Frame, Table, with_interval
from surefoot.experiments.walks.play import Stream, play
from surefoot.experiments.walks.run_score import score_run
from surefoot.experiments.walks.scenarios import TRUE_MAP
from surefoot.experiments.walks.score import hold_last

RATE = 80.0
"""Samples per second that all recordings are brought to: the rate of the CoP paper's cells."""

SCALE_STD, OFFSET_SHARE = 0.1, 0.03
"""Standard deviations of what is put in: of scales, and of offsets in weights."""

_STREAM = 0x5EA2


class Recording(NamedTuple):
    """One plate over time, at the rate of :data:`RATE`; errors come later.

    Attributes:
        name: Its name in tables.
        layout: One foot of four cells: x ahead (AP), y to the left (ML).
        force: Recorded cells in N, their own zeros taken off where they were seen, shape (N, 4). NaN where
            the recorder left a gap.
        vgrf: Vertical force that the calibrators are told, in N, shape (N,).
        cop: Centre of pressure that they are told, and are scored against, in m, shape (N, 2).
        loaded: Where something surely stood on the plate, shape (N,).
        empty: Where surely nothing did, shape (N,).
        still: Whether somebody stood still, so that a standing start makes sense.
        judged: Samples that are scored, shape (N,).
    """

    name: str
    layout: FeetLayout
    force: Floats
    vgrf: Floats
    cop: Floats
    loaded: NDArray[np.bool_]
    empty: NDArray[np.bool_]
    still: bool
    judged: NDArray[np.bool_]

    @property
    def weight(self) -> float:
        """Mean vertical force while loaded in N."""
        return float(self.vgrf[self.loaded].mean())

    def reference(self) -> Reference:
        """Return the beliefs that calibrators are given of a robot whose feet stand at one place."""
        samples = len(self.force)
        at_rest = refer_to_contacts(self.loaded[:, None], self.empty[:, None], np.zeros((samples, 1, 3)))
        acceleration = np.zeros((samples, 3))
        acceleration[:, 2] = np.where(self.loaded, self.vgrf / self.weight - 1.0, 0.0) * GRAVITY
        cop = np.where(self.loaded[:, None], self.cop, 0.0)
        return at_rest._replace(
            com=np.column_stack([cop, np.full(samples, 1.0)]),
            com_acceleration=acceleration,
            accelerometer=at_rest.accelerometer + acceleration,
            gyroscope=np.repeat(np.where(self.loaded & self.still, 0.0, 1.0)[:, None], 3, axis=1),
        )


def wii_board(folder: Path) -> Recording:
    """Load a minute of the balance board: empty, then a person of 46 kg standing quietly."""
    with np.load(folder / "foot" / "wii_board_18min.npz") as file:
        time, cells, place = file["t_s"], file["cells_kg"].astype(np.float64), file["cell_xy_cm"] / 100.0
    part = (time >= 614.0) & (time <= 660.0)
    time, force = time[part], cells[part] * GRAVITY
    # The board's long side runs across the body: its x is to the right, its y ahead.
    layout = _one_foot("board", np.column_stack([place[:, 1], -place[:, 0]]))
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
    with np.load(folder / "foot" / "caltester_FP1_600hz.npz") as file:
        cells, rate = file["plate0_N"][4:].T.astype(np.float64), float(file["rate_hz"])
        layout = _plate(float(file["a_m"]), float(file["b_m"]))
    force = _resample(cells, rate)
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


def _plate(a: float, b: float) -> FeetLayout:
    """Lay out a Kistler plate: cells 1 to 4 go round it from (+a, +b)."""
    return _one_foot("plate", np.array([(a, b), (-a, b), (-a, -b), (a, -b)]))


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
    played = play(streams, method, **options)
    return pd.DataFrame([score_run(*pair) for pair in zip(streams, played, strict=True)])


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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10, help="draws of the errors")
    options = parser.parse_args()
    folder = Path(os.environ.get("SUREFOOT_DATA", "nowhere"))
    if not (folder / "foot").is_dir():
        sys.exit("SUREFOOT_DATA names no folder that holds 'foot' with the recordings of plates.")
    console = Console(width=160)
    for name in RECORDINGS:
        console.print(score_table(folder, name, options.seeds).to_rich())


if __name__ == "__main__":
    main()
