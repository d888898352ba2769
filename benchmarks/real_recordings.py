"""Calibrators on real plates whose four corner cells were recorded one by one, with errors put in by hand.

A board or a plate is one foot on four cells. Gains and offsets are put onto the recorded cells, and the
calibrators get

* the person's weight as a constant, or for the rocked pole the plate's own summed force as its motion,
* the centre of pressure of the record before the errors were put in,
* when nothing stood on the plate.

Scored is against the record itself, for what no record knows better: a plate's own errors are in both. The
same recordings, and an iCub that sways on both feet, are scored as the walks of ``surefoot compare walking``
are (``--arena``).

    SUREFOOT_DATA=/path/to/recordings python benchmarks/real_recordings.py           # about a minute
    SUREFOOT_DATA=/path/to/recordings python benchmarks/real_recordings.py --arena --seeds 20

``$SUREFOOT_DATA/foot`` has to hold ``wii_board_18min.npz``, ``caltester_FP1_600hz.npz`` and
``kistler2_600hz.npz`` (and for the arena ``icub_com-sinusoid.npz``), made from public recordings of a balance
board (corkine/BalanceBoardDataAnalysis) and of two force plates (sample 15 of c3d.org, and
pyomeca/ezc3d-testFiles); they are not part of this package.
"""

import argparse
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich.console import Console

from surefoot.calibration import (
    GRAVITY,
    CalibrationRefused,
    FeetLayout,
    FootLayout,
    Parameters,
    QuietStanding,
    Reference,
    replay,
    standing_start,
    zero_phase,
)
from surefoot.calibration import METHODS as ONLINE_METHODS
from surefoot.experiments.arena.options import TRUE_MAP
from surefoot.experiments.arena.replay import play
from surefoot.experiments.arena.score import score_run
from surefoot.experiments.arena.streams import Stream
from surefoot.experiments.logs.format import Log, LogTruth
from surefoot.experiments.study.tables import Frame, Table, number, with_interval
from surefoot.experiments.walks.score import held

Floats = NDArray[np.float64]

RATE = 80.0
"""Samples per second that all recordings are brought to: the rate of the CoP paper's cells."""

DRAWS = 4
"""How often errors are drawn; a row of the table is the root mean square over the draws."""

_STREAM = 0x5EA1


class Recording(NamedTuple):
    """One plate over time, at the rate of :data:`RATE`; what is put in is not in it yet.

    Attributes:
        name: What tables call it.
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
        return float(self.vgrf[self.loaded].mean()) if self.loaded.any() else 100.0

    def reference(self) -> Reference:
        """Say what the calibrators are told as the beliefs of a robot."""
        samples = len(self.force)
        zero = np.zeros((samples, 3))
        moving = np.where(self.loaded & self.still, 0.0, 1.0)[:, None]
        acceleration = zero.copy()
        acceleration[:, 2] = np.where(self.loaded, self.vgrf / self.weight - 1.0, 0.0) * GRAVITY
        cop = np.where(self.loaded[:, None], self.cop, 0.0)
        return Reference(
            com=np.column_stack([cop, np.full(samples, 1.0)]),
            com_acceleration=acceleration,
            angular_momentum_rate=zero,
            position_sole=zero[:, None],
            R_level_sole=np.broadcast_to(np.eye(3), (samples, 1, 3, 3)),
            stance=self.loaded[:, None],
            swing=self.empty[:, None],
            accelerometer=acceleration + np.array([0.0, 0.0, GRAVITY]),
            gyroscope=zero + moving,
        )


INJECTED: Mapping[str, tuple[float, float]] = {
    "nothing": (0.0, 0.0),
    "gains 10 %": (0.1, 0.0),
    "offsets 3 % of the weight": (0.0, 0.03),
    "both": (0.1, 0.03),
}
"""Standard deviations of what is put in: gains, and offsets in weights."""

_WIDE = {"standing_scale_std": 0.1, "standing_offset_std": 0.03}

METHODS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "none": ("none", {}),
    "tare": ("tare", {}),
    "standing start": ("none", {}),
    "moment": ("moment", {}),
    "window": ("window", {**_WIDE, "standing_patience": 3.0}),
    "window, weight alone": ("window", {**_WIDE, "cop_weight": 0.0, "standing_start": False}),
}
"""Calibrators by the names in the table: a method and its options."""


_SCORED = ("CoP ahead", "CoP sideways", "vertical force", "single cells")
_NEGLIGIBLE = (5e-4, 5e-4, 0.5, 0.5)
"""Changes of the scores, in m and N, that are not worth a word."""


def recordings_folder() -> Path | None:
    """Find the recordings: the folder that ``SUREFOOT_DATA`` names, or ``None`` where it is unset or gone."""
    name = os.environ.get("SUREFOOT_DATA")
    return Path(name) if name and (Path(name) / "foot").is_dir() else None


def study(folder: Path) -> list[dict[str, Any]]:
    """Run all calibrators on all recordings.

    Args:
        folder: The folder that holds ``foot/``.

    Returns:
        One row for each recording, calibrator and kind of error: ``recording``, ``method``, ``injected``,
        ``cop_ml_mm``, ``cop_ap_mm`` (NaN where nothing stands on the plate), ``vgrf_n``, ``cell_n`` (root
        mean squares) and ``sentence``.
    """
    return [row for load in (wii_board, rocked_pole, drifting_zeros) for row in study_recording(load(folder))]


def study_recording(recording: Recording) -> list[dict[str, Any]]:
    """Run all calibrators on one recording; see :func:`study`."""
    cases = _draw(recording)
    scores = {name: _score(recording, cases, name) for name in METHODS}
    rows = []
    for i, injected in enumerate(INJECTED):
        for method, by_case in scores.items():
            if by_case is None:
                continue
            cop_ap, cop_ml, vgrf, cell = by_case[i]
            raw = scores["none"]
            assert raw is not None
            rows.append(
                {
                    "recording": recording.name,
                    "method": method,
                    "injected": injected,
                    "cop_ml_mm": 1e3 * cop_ml,
                    "cop_ap_mm": 1e3 * cop_ap,
                    "vgrf_n": vgrf,
                    "cell_n": cell,
                    "sentence": _sentence(method, by_case[i], raw[i]),
                }
            )
    return rows


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


def rocked_pole(folder: Path) -> Recording:
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


def drifting_zeros(folder: Path) -> Recording:
    """Load the end of a force plate's record: nothing stands on it, and its zeros stand elsewhere."""
    with np.load(folder / "foot" / "kistler2_600hz.npz") as file:
        cells, rate = file["plate0_N"][4:, :-20].T.astype(np.float64), float(file["rate_hz"])
        layout = _plate(float(file["a_m"]), float(file["b_m"]))
    force = _resample(cells, rate)[round(28 * RATE) :]
    nothing = np.zeros(len(force), dtype=np.bool_)
    return Recording(
        name="empty force plate",
        layout=layout,
        force=force,
        vgrf=np.zeros(len(force)),
        cop=np.zeros((len(force), 2)),
        loaded=nothing,
        empty=~nothing,
        still=False,
        judged=np.arange(len(force)) > 2 * RATE,
    )


def _draw(recording: Recording) -> tuple[Floats, Floats]:
    """Draw gains and offsets in N of all cases, shapes (cases, draws, 4)."""
    rng = np.random.default_rng(_STREAM)
    spread = np.array(list(INJECTED.values()))[:, :, None, None]
    drawn = rng.normal(size=(len(INJECTED), 2, DRAWS, 4)) * spread
    return 1.0 + drawn[:, 0], drawn[:, 1] * recording.weight


def _score(recording: Recording, cases: tuple[Floats, Floats], name: str) -> Floats | None:
    """Score one calibrator in all cases: (AP, ML, Fz, cell), shape (cases, 4); None if it does not apply."""
    gain, offset = (part.reshape(-1, 4) for part in cases)
    raw = recording.force[:, None] * gain + offset
    reference = recording.reference()
    start = None
    if name == "standing start":
        start = _standing(recording, raw, reference)
        if start is None:
            return None
    elif name.startswith("window") and not recording.loaded.any():
        return None
    method, options = METHODS[name]
    if start is None:
        known: dict[str, Any] = {"mass": recording.weight / GRAVITY, "lag": 0, **options}
        drawn = raw.swapaxes(0, 1)
        found = [replay(recording.layout, method, one, reference, 1.0 / RATE, **known) for one in drawn]
        force = np.stack([estimate.force for estimate in found], axis=1)
    else:
        force = start.scale * raw + start.offset
    truth = recording.force if recording.loaded.any() else np.zeros_like(recording.force)
    judged = recording.judged
    cop = _cop(recording.layout, force)[judged] - recording.cop[judged][:, None]
    cell = (force - truth[:, None])[judged]
    shape = (len(INJECTED), DRAWS)
    squares = [
        np.mean(cop[..., 0] ** 2, axis=0),
        np.mean(cop[..., 1] ** 2, axis=0),
        np.mean(cell.sum(axis=-1) ** 2, axis=0),
        np.mean(cell**2, axis=(0, -1)),
    ]
    if not recording.loaded.any():
        squares[0] = squares[1] = np.full(len(gain), np.nan)
    scores: Floats = np.sqrt(np.stack([part.reshape(shape).mean(axis=1) for part in squares], axis=-1))
    return scores


def _standing(recording: Recording, raw: Floats, reference: Reference) -> Parameters | None:
    """Fit every draw's standing start on the first seconds of standing, shape (draws, 4); None if refused."""
    if not recording.still:
        return None
    first = int(np.argmax(recording.loaded))
    part = slice(first, first + round(8 * RATE))
    standing = QuietStanding(
        layout=recording.layout,
        mass=recording.weight / GRAVITY,
        start=Parameters(np.ones(4), np.zeros(4)),
        offset_std=0.03 * recording.weight,
        force_noise=0.05 * recording.weight,
        cop_noise=0.01,
    )
    told = Reference(*(field[part] for field in reference))
    try:
        fits = [
            standing_start(standing, raw[part, i], told, 1.0 / RATE).correction for i in range(raw.shape[1])
        ]
    except CalibrationRefused:
        return None
    return Parameters(np.stack([fit.scale for fit in fits]), np.stack([fit.offset for fit in fits]))


def _sentence(method: str, score: Floats, raw: Floats) -> str:
    """Say in words what a row shows against the readings as they are."""
    if method == "none":
        return "What the errors do to the readings."
    change = [
        np.sign(now - before) if abs(now - before) > max(0.1 * before, floor) else 0.0
        for now, before, floor in zip(score, raw, _NEGLIGIBLE, strict=True)
    ]
    better = [name for name, sign in zip(_SCORED, change, strict=True) if sign < 0]
    worse = [name for name, sign in zip(_SCORED, change, strict=True) if sign > 0]
    if not better and not worse:
        return "Nothing changes."
    parts = []
    if better:
        parts.append(f"better: {', '.join(better)}")
    if worse:
        parts.append(f"worse: {', '.join(worse)}")
    text = "; ".join(parts)
    return text[0].upper() + text[1:] + "."


def _one_foot(name: str, position: Floats) -> FeetLayout:
    return FeetLayout((FootLayout.load_cells(name, position, [f"cell-{i + 1}" for i in range(4)]),))


def _plate(a: float, b: float) -> FeetLayout:
    """Lay out a Kistler plate: cells 1 to 4 go round it from (+a, +b)."""
    return _one_foot("plate", np.array([(a, b), (-a, b), (-a, -b), (a, -b)]))


def _cop(layout: FeetLayout, force: Floats) -> Floats:
    """Find the centre of pressure where there is force, NaN elsewhere, shape (..., 2)."""
    position = layout.feet[0].position_cell_sole
    assert position is not None
    total = force.sum(axis=-1, keepdims=True)
    safe = np.where(total > 5.0, total, np.nan)
    cop: Floats = (force @ position[:, :2]) / safe
    return cop


def _resample(values: Floats, rate: float) -> Floats:
    """Bring an evenly sampled log to :data:`RATE`, what is faster than half of it taken out before."""
    smooth = zero_phase(values, 0.35 * RATE, 1.0 / rate)
    time, even = np.arange(len(values)) / rate, np.arange(0.0, (len(values) - 1) / rate, 1.0 / RATE)
    return np.column_stack([np.interp(even, time, column) for column in smooth.T])


def _surely(condition: NDArray[np.bool_], margin: float) -> NDArray[np.bool_]:
    """Keep of a condition only what is further than a margin in s from where it does not hold."""
    reach = round(margin * RATE)
    broken = np.convolve(~condition, np.ones(2 * reach + 1), mode="same") > 0.5
    return condition & ~broken


ARENA_SCALE_STD = 0.1
"""Standard deviation of the scales' errors that the arena puts in."""

ARENA_OFFSET_SHARE = 0.03
"""Standard deviation of the offsets that the arena puts in, in weights."""

_ARENA_STREAM = 0x5EA2

_FOOT_LENGTH = {"foot_length": 0.17}
# Eight seconds are too short to wait for a standing start that does not come.
_IMPATIENT = {name: {"standing_patience": 3.0} for name in ("window", "quasi-static")}


def icub_feet(folder: Path) -> Recording:
    """Load the iCub that sways over both feet: two channels, the vertical force on each foot.

    Neither moments nor the soles' places were recorded, so that only the total is given, as a constant: both
    feet are put at one place, where no centre of pressure can be wrong.
    """
    with np.load(folder / "foot" / "icub_com-sinusoid.npz") as file:
        time, feet = file["t_s"], np.column_stack([file["left_fz_N"], file["right_fz_N"]])
    even = np.arange(time[0], time[-1], 1.0 / RATE)
    force = np.column_stack([np.interp(even, time, foot) for foot in feet.T])
    up = np.zeros((6, 1))
    up[2] = 1.0
    layout = FeetLayout(tuple(FootLayout(name, up, ("fz",)) for name in ("left", "right")))
    everywhere = np.ones(len(even), dtype=np.bool_)
    return Recording(
        name="iCub",
        layout=layout,
        force=force,
        vgrf=np.full(len(even), force.sum(axis=1).mean()),
        cop=np.zeros((len(even), 2)),
        loaded=everywhere,
        empty=~everywhere,
        still=False,
        judged=np.arange(len(even)) > 10 * RATE,
    )


RECORDINGS: Mapping[str, tuple[Callable[[Path], Recording], Mapping[str, Any], Mapping[str, Any]]] = {
    "board": (wii_board, {}, {}),
    "pole": (rocked_pole, {}, _IMPATIENT),
    "empty-plate": (drifting_zeros, {}, {}),
    "icub": (icub_feet, _FOOT_LENGTH, {}),
}
"""Recordings of the arena: what loads each, options of all methods, and options of single methods."""


def recording_streams(folder: Path, name: str, seeds: range) -> list[Stream]:
    """Put errors onto a recording, once a seed.

    Args:
        folder: The folder that holds ``foot/``.
        name: A key of :data:`RECORDINGS`.
        seeds: Of the draws.

    Returns:
        One stream a seed.
    """
    recording = RECORDINGS[name][0](folder)
    return [_stream(recording, seed) for seed in seeds]


def _stream(recording: Recording, seed: int) -> Stream:
    rng = np.random.default_rng([_ARENA_STREAM, seed])
    samples, channels = recording.force.shape
    gain = 1.0 + ARENA_SCALE_STD * rng.standard_normal(channels)
    offset = ARENA_OFFSET_SHARE * recording.weight * rng.standard_normal(channels)
    feet = len(recording.layout.feet)
    soles = np.zeros((samples, feet, 3))
    level = np.broadcast_to(np.eye(3), (samples, feet, 3, 3))
    time = np.arange(samples) / RATE
    empty = not recording.loaded.any()
    log = Log(
        time=time,
        raw=recording.force * gain + offset,
        reference=_told(recording),
        layout=recording.layout,
        mass=recording.weight / GRAVITY,
        nominal=Parameters(np.ones(channels), np.zeros(channels)),
        calibrated=None,
        dt=1.0 / RATE,
        lag=0,
        seed=seed,
        truth=LogTruth(
            force=np.zeros_like(recording.force) if empty else held(recording.force),
            position_sole=soles,
            R_world_sole=level,
            scale=np.broadcast_to(1.0 / gain, (samples, channels)),
            offset=np.broadcast_to(-offset / gain, (samples, channels)),
        ),
        about={"recording": recording.name},
    )
    there = recording.judged & np.isfinite(recording.force).all(axis=1)
    placed = all(foot.position_cell_sole is not None for foot in recording.layout.feet)
    return Stream(
        log=log,
        seed=seed,
        judged=there,
        began=float(time[np.argmax(recording.loaded)]) if not empty else 0.0,
        # Told and scored by one place; a layout without places has no centre of pressure to score.
        cop=recording.cop if placed else np.full((samples, 2), np.nan),
    )


def _told(recording: Recording) -> Reference:
    """Say what the methods are told, with as many feet as the layout has."""
    told = recording.reference()
    feet = len(recording.layout.feet)
    if feet == 1:
        return told
    each = {
        name: np.repeat(getattr(told, name), feet, axis=1)
        for name in ("position_sole", "R_level_sole", "stance", "swing")
    }
    return told._replace(**each)


def arena_table(folder: Path, name: str, seeds: int) -> Table:
    """Score all methods on one recording as the arena scores walks."""
    _, options, by_method = RECORDINGS[name]
    streams = recording_streams(folder, name, range(seeds))
    rows = []
    for method in (TRUE_MAP, *ONLINE_METHODS):
        played = play(streams, method, **{**options, **by_method.get(method, {})})
        runs = pd.DataFrame([score_run(*pair) for pair in zip(streams, played, strict=True)])
        values = [with_interval(runs["cop"], 1e3), *(with_interval(runs[key]) for key in ("vgrf", "cell"))]
        rows.append((method, *values, f"{int(runs['worse_vgrf'].sum())} of {len(runs)}"))
    columns = ("method", "CoP (mm)", "vGRF (N)", "cell (N)", "vGRF ends worse")
    return Table(f"recording_{name}", f"Recording '{name}': means and 95 % intervals", columns, tuple(rows))


def plate_table(rows: Frame, injected: str) -> Table:
    part = rows[rows["injected"] == injected]
    cells = tuple(
        (
            row.recording,
            row.method,
            number(row.cop_ap_mm),
            number(row.cop_ml_mm),
            number(row.vgrf_n),
            number(row.cell_n),
            row.sentence,
        )
        for row in part.itertuples()
    )
    columns = (
        "recording",
        "method",
        "CoP ahead (mm)",
        "CoP sideways (mm)",
        "vertical force (N)",
        "single cell (N)",
        "against the readings as they are",
    )
    what = {"nothing": "nothing put in", "both": "gains 10 % and offsets 3 % of the weight put in"}[injected]
    return Table(f"recordings_{injected}", f"Real plates, {what}", columns, cells)


def plate_findings(rows: Frame) -> tuple[str, ...]:
    """Say for every calibrator where it leaves the centre of pressure worse than it found it."""
    keys = ["recording", "injected"]
    raw = rows[rows["method"] == "none"].set_index(keys)
    said = []
    for method in dict.fromkeys(rows["method"]):
        if method == "none":
            continue
        part = rows[rows["method"] == method].set_index(keys)
        ratio = part[["cop_ap_mm", "cop_ml_mm"]] / raw.loc[part.index, ["cop_ap_mm", "cop_ml_mm"]]
        ratio = ratio.to_numpy().ravel()
        ratio = ratio[(ratio == ratio) & (ratio < float("inf"))]
        if not len(ratio):
            continue
        worse, better = int((ratio > 1.1).sum()), int((ratio < 0.9).sum())
        said.append(
            f"{method}: of {len(ratio)} errors of the centre of pressure (recording, kind of error, axis) "
            f"{better} are more than 10 % smaller than the readings' own, and {worse} more than 10 % larger."
        )
    return tuple(said)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arena", action="store_true", help="score as the walks of compare walking are")
    parser.add_argument("--seeds", type=int, default=4, help="draws of the arena's errors")
    options = parser.parse_args()
    folder = recordings_folder()
    if folder is None:
        sys.exit("SUREFOOT_DATA names no folder that holds 'foot' with the recordings of plates.")
    console = Console(width=160)
    if options.arena:
        for name in RECORDINGS:
            console.print(arena_table(folder, name, options.seeds).to_rich())
        return
    rows = pd.DataFrame(study(folder))
    for injected in ("nothing", "both"):
        console.print(plate_table(rows, injected).to_rich())
    console.print("\n".join(plate_findings(rows)))


if __name__ == "__main__":
    main()
