"""The twins of real instruments: what `surefoot twin` reads off public recordings, beside their data sheets.

    SUREFOOT_DATA=/path/to/recordings python benchmarks/twin_recordings.py        # about a minute
    python docs/study_tables.py out/results

The recordings become tables as their owners would write them (docs/log-recipes.md), and are read by the
command's own functions. ``$SUREFOOT_DATA`` has to hold ``foot/kistler2_600hz.npz``, ``wii_board_18min.npz``,
``caltester_FP1_600hz.npz``, ``icub_com-sinusoid.npz`` and ``ft/icub_right_foot_swing.npz``; they are not part
of this package.

Data sheets: Kistler 9281C and 9286A (threshold below 0.25 N, drift below 0.01 N/s, up to 10 kN, here in 16
bits); the maker's manual of the balance board (60 values a second).
"""

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.arrays import Floats
from surefoot.experiments.instrument.recording import read_recording
from surefoot.experiments.instrument.twin import Twin, identify
from surefoot.experiments.study.page import save_tables
from surefoot.experiments.study.tables import NOTHING, Table, Verdict, number, span
from surefoot.files import write_text

Foot = Mapping[str, Any]

OUT = Path("out/results/twin/tables")

TESTS = "twin against log"
DRIFT_OVER = 40.0  # s over which a drift of a data sheet is compared with a random walk


class Written(NamedTuple):
    """A recording as a table and a description."""

    columns: dict[str, Floats]
    feet: list[Foot] | None  # of the description; ``None`` for none
    mass: float = 1.0
    scale: float = 1.0  # N of one in its unit
    offset: float | None = None


def plate(folder: Path, session: str, name: str, mass: float, last: int | None = None) -> Written:
    """Return a Kistler plate's four cells in N, up to a last row."""
    with np.load(folder / "foot" / f"{session}_600hz.npz") as file:
        cells, rate = file[f"{name}_N"][4:, :last].astype(np.float64), float(file["rate_hz"])
        a, b = float(file["a_m"]), float(file["b_m"])
    return _cells(cells, np.arange(cells.shape[1]) / rate, [(a, b), (-a, b), (-a, -b), (a, -b)], mass)


def board(folder: Path) -> Written:
    """Return the balance board's cells in kg, without rows whose time is not later than the one before."""
    with np.load(folder / "foot" / "wii_board_18min.npz") as file:
        time, cells, place = file["t_s"], file["cells_kg"].astype(np.float64), file["cell_xy_cm"] / 100.0
    later = np.concatenate([[True], time[1:] > np.maximum.accumulate(time)[:-1]])
    at = list(zip(place[:, 1], -place[:, 0], strict=True))
    found = _cells(np.round(cells[later].T, 4), time[later], at, 46.24)
    return found._replace(scale=9.81, offset=None)


def icub(folder: Path) -> Written:
    """Return the vertical forces under an iCub that sways."""
    with np.load(folder / "foot" / "icub_com-sinusoid.npz") as file:
        time, force = file["t_s"], {side: file[f"{side}_fz_N"] for side in ("left", "right")}
    up = [[0.0], [0.0], [1.0], [0.0], [0.0], [0.0]]
    feet: list[Foot] = [{"name": side, "channel_names": ["fz"], "wrench_map": up} for side in force]
    columns = {f"raw_{side}_fz_count": values for side, values in force.items()}
    return Written({"time_s": time, **columns}, feet, 33.0, offset=0.0)


def ankle(folder: Path) -> Written:
    """Return the counts of an iCub's six-axis sensor, with gravity."""
    with np.load(folder / "ft" / "icub_right_foot_swing.npz") as file:
        time, raw, gravity = file["t"], file["raw"], file["gravity"]
    columns = {f"raw_{i}_count": values for i, values in enumerate(raw.T)}
    down = {f"gravity_{axis}_m_s2": values for axis, values in zip("xyz", gravity.T, strict=True)}
    return Written({"time_s": time, **columns, **down}, None)


def _cells(cells: Floats, time: Floats, place: list[tuple[float, float]], mass: float) -> Written:
    names = [f"fz{i + 1}" for i in range(len(cells))]
    foot = {"name": "plate", "channel_names": names, "position_cell_sole_m": place}
    columns = {f"raw_plate_{name}_count": values for name, values in zip(names, cells, strict=True)}
    return Written({"time_s": time, **columns}, [foot], mass, offset=0.0)


class Sheet(NamedTuple):
    """What a data sheet says of a parameter: words, and the interval that it means."""

    words: str = NOTHING
    low: float = 0.0
    high: float = np.inf
    why: str = ""  # it does not fit, where it does not


PLATE = {
    "step of a reading": Sheet("0.15 N (10 kN in 16 bits)", 0.14, 0.17),
    "noise of a conversion": Sheet(
        "threshold 0.25 N", 0.0, 0.25, "the recorder's own noise, of two of its steps, is larger"
    ),
    "random walk of the offset": Sheet(
        "drift 0.01 N/s, 0.4 N in 40 s",
        0.0,
        0.01 * np.sqrt(DRIFT_OVER),
        "the plate relaxes by newtons, its corners against each other, for 40 s after somebody left it",
    ),
}
BOARD = {
    "step of a reading": Sheet(),
    "noise of a conversion": Sheet(),
    "random walk of the offset": Sheet(),
    TESTS: Sheet(why="who stands on it sways by more than its noise"),
    "conversion rate": Sheet("60 1/s", 59.0, 61.0, "rows come in bursts by radio, whose times show no clock"),
}

RECORDINGS: Mapping[str, tuple[Callable[[Path], Written], Mapping[str, Sheet]]] = {
    "force plate 1": (lambda folder: plate(folder, "kistler2", "plate0", 72.0, -20), PLATE),
    "force plate 2": (lambda folder: plate(folder, "kistler2", "plate1", 72.0, -20), PLATE),
    "balance board": (board, BOARD),
    "force plate with a rocked pole": (lambda folder: plate(folder, "caltester_FP1", "plate0", 28.0), {}),
    "iCub's feet, swaying": (icub, {}),
    "iCub's six-axis sensor": (ankle, {}),
}
"""How each recording is read, and its data sheet."""


def write(written: Written, path: Path) -> Path:
    """Write a recording as a CSV, with its description beside it."""
    table = np.column_stack(list(written.columns.values()))
    np.savetxt(path, table, delimiter=",", comments="", header=",".join(written.columns), fmt="%.9g")
    if written.feet is not None:
        channels = sum(len(foot["channel_names"]) for foot in written.feet)
        nominal = {"scale_N_per_count": [written.scale] * channels}
        nominal |= {} if written.offset is None else {"offset_N": [written.offset] * channels}
        told = {"format": "surefoot-log", "format_version": 1, "mass_kg": written.mass, "lag_samples": 0}
        write_text(path.with_suffix(".json"), json.dumps(told | {"layout": written.feet, "nominal": nominal}))
    return path


def find_twin(folder: Path, name: str) -> Twin:
    """Find the twin of one of :data:`RECORDINGS`; CalibrationRefused if it has none."""
    with TemporaryDirectory() as kept:
        return identify(read_recording(write(RECORDINGS[name][0](folder), Path(kept) / "recording.csv")))


def rows_of(folder: Path, name: str) -> Iterator[tuple[str, ...]]:
    """Yield a row for each parameter of a recording's twin, or one for its refusal."""
    sheet = RECORDINGS[name][1]
    try:
        twin = find_twin(folder, name)
    except CalibrationRefused as refusal:
        yield (name, "refused", NOTHING, NOTHING, NOTHING, refusal.reason.partition(": ")[2])
        return
    seen = {one.name: one for one in twin.parameters}
    for what, said in sheet.items():
        if what == TESTS:
            continue
        if what not in seen:
            yield (name, what, NOTHING, said.words, "not seen", said.why)
            continue
        value, unit = seen[what].value, seen[what].unit
        fits = value.low <= said.high and value.high >= said.low
        text = f"{number(value.value)} ({span(value.low, value.high, '.3g')}) {unit}"
        verdict = NOTHING if said.words == NOTHING else Verdict.of(fits)
        yield (name, what, text, said.words, verdict, "" if fits else said.why)
    alike = ", ".join(f"{test.partition(':')[0]} {number(p, 2)}" for test, p in twin.likeness)
    why = "" if twin.alike or TESTS not in sheet else sheet[TESTS].why
    yield (name, TESTS, alike, NOTHING, Verdict.of(twin.alike, "alike" if twin.alike else "no"), why)


def recordings_table(folder: Path) -> Table:
    """Compare twins of all recordings with their data sheets."""
    rows = tuple(row for name in RECORDINGS for row in rows_of(folder, name))
    columns = ("recording", "what", "twin (90 %)", "data sheet", "fits", "why not")
    return Table("recordings", "Real instruments", columns, rows)


def main() -> None:
    """Print the table, and save it for the page."""
    folder = Path(os.environ.get("SUREFOOT_DATA", "nowhere"))
    if not (folder / "foot").is_dir():
        sys.exit("SUREFOOT_DATA names no folder that holds 'foot' and 'ft' with the recordings.")
    table = recordings_table(folder)
    Console(width=180).print(table.to_rich())
    save_tables(OUT, (table,))


if __name__ == "__main__":
    main()
