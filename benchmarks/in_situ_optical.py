"""In-situ calibration of a printed optical sensor of eight channels: a hard case, and one that is lost.

    SUREFOOT_DATA=/path/to/recordings python benchmarks/in_situ_optical.py       # about 5 s

Four loads, bare and with 0.719 kg at three places, were held in 12 postures each. A third of the loaded
postures is saturated and left out. Of what is left, a linear response to the true wrenches leaves 30 counts
RMS where the readings spread by 94, and parabolas do not predict better. The defaults refuse such data; with
wide tolerances the fits are compared on the load that they have not seen, beside what one could reach who
knew all wrenches.

The recording is not part of this package: ``$SUREFOOT_DATA/ft`` has to hold ``printed_ft_8ch.npz``.
"""

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from surefoot.calibration import CalibrationRefused
from surefoot.calibration.in_situ import (
    InSituSet,
    KnownLimb,
    calibrate_in_situ,
    estimate_matrix,
    estimate_offset,
)
from surefoot.experiments.study.tables import Table, number

Floats = NDArray[np.float64]

_NAMES = ("bare", "mass at (+, +)", "mass at (-, +)", "mass at (-, -)")

LOADED = _NAMES[1:]
"""Loads that can be left out: without the bare one all masses are alike, and only a known base tells more."""

_LOST = "to see what comes out of a sensor that is not linear"
"""Why refusals are passed; what is open is refused all the same."""

_RIDGE = 0.1
"""Weight of the ridge of a regression on standardised readings, of their variance."""


class HeldOut(NamedTuple):
    """What is left of the wrench in a load that was not fitted.

    Attributes:
        load: Which one was left out.
        force: RMSE of a component in N, with the offset by III-B in this load's own postures; NaN if there
            is none.
        torque: The same in N m.
        force_other: RMSE in N with the mean offset of the loads that were fitted.
        refusal: Why there is none.
    """

    load: str
    force: float
    torque: float
    force_other: float
    refusal: str = ""


class OpticalRow(NamedTuple):
    """One method.

    Attributes:
        method: What tables call it.
        mass: Of the bare base by all four loads in kg, 0.309 by a scale; NaN if it has none.
        com_error: How far its centre of mass is off in m.
        held_out: One a load.
    """

    method: str
    mass: float
    com_error: float
    held_out: tuple[HeldOut, ...]

    def rmse(self, loads: Sequence[str]) -> tuple[float, float, float]:
        """Root mean squares over loads: force, torque, force with the other loads' offset."""
        part = [one for one in self.held_out if one.load in loads]
        square = np.mean([[one.force**2, one.torque**2, one.force_other**2] for one in part], axis=0)
        force, torque, other = (float(value) for value in np.sqrt(square))
        return force, torque, other


class Optical(NamedTuple):
    """The recording.

    Attributes:
        sets: One a load, NaN where it is saturated; what was added is told.
        wrenches: The true ones in N and N m, shape (12, 6) each.
        base: True mass of the base in kg and its centre of mass in m, shape (3,).
    """

    sets: tuple[InSituSet, ...]
    wrenches: tuple[Floats, ...]
    base: tuple[float, Floats]


class _Map(NamedTuple):
    matrix: Floats
    offsets: Floats
    mass: float
    com: Floats


_Method = Callable[[Sequence[InSituSet]], _Map]


def load_optical(folder: Path) -> Optical:
    """Load the recording.

    Args:
        folder: The folder that holds ``ft/``.
    """
    sets, wrenches = [], []
    with np.load(folder / "ft" / "printed_ft_8ch.npz") as file:
        base = float(file["total_mass_0"]), file["total_com_0"].astype(np.float64)
        for load in range(4):
            mass, com = float(file[f"total_mass_{load}"]), file[f"total_com_{load}"]
            gravity, raw = file[f"gravity_{load}"], file[f"raw_mean_{load}"].copy()
            raw[file[f"saturated_{load}"]] = np.nan
            added = mass - base[0]
            place = (mass * com - base[0] * base[1]) / added if added > 0.0 else np.zeros(3)
            sets.append(InSituSet(raw, gravity, added, place, name=_NAMES[load]))
            wrenches.append(np.hstack([mass * gravity, np.cross(mass * com, gravity)]))
    return Optical(tuple(sets), tuple(wrenches), base)


def optical_refusals(recording: Optical) -> list[str]:
    """Say all that is refused."""
    return [refusal.reason for refusal in calibrate_in_situ(recording.sets, accept=_LOST).refusals]


def optical_sensor(recording: Optical) -> list[OpticalRow]:
    """Calibrate on all loads, and on three of four to predict the one left out.

    Args:
        recording: The recording.
    """
    mass, com = recording.base
    methods: dict[str, _Method] = {
        "paper (III-B, III-C)": _paper,
        "in situ": lambda sets: _ours(sets, None),
        "in situ, base known to 1 %": lambda sets: _ours(sets, KnownLimb(mass, 0.01 * mass, com, 0.001)),
    }
    rows = []
    for name, method in methods.items():
        whole = method(recording.sets)
        held_out = tuple(_held_out(recording, method, load) for load in range(len(recording.sets)))
        error = float(np.linalg.norm(whole.com - com))
        rows.append(OpticalRow(name, whole.mass, error, held_out))
    for name, squares, ridge in (
        ("told all wrenches: linear", False, 0.0),
        ("told all wrenches: linear, ridge", False, _RIDGE),
        ("told all wrenches: with squares, ridge", True, _RIDGE),
        ("told nothing: zero", False, np.inf),
    ):
        held_out = tuple(_regression(recording, load, squares, ridge) for load in range(len(recording.sets)))
        rows.append(OpticalRow(name, np.nan, np.nan, held_out))
    return rows


def _paper(sets: Sequence[InSituSet]) -> _Map:
    offsets = np.array([estimate_offset(one.raw, one.gravity).offset for one in sets])
    # By the noise that is seen, its own check finds no unknown determined.
    fit = estimate_matrix(sets, offsets, tolerance=1e-9, noise_margin=0.0)
    return _Map(fit.matrix, offsets, fit.limb.mass, fit.limb.com)


def _ours(sets: Sequence[InSituSet], limb: KnownLimb | None) -> _Map:
    fit = calibrate_in_situ(sets, limb=limb, accept=_LOST)
    return _Map(fit.matrix, fit.offsets, fit.limb.mass, fit.limb.com)


def _held_out(recording: Optical, method: _Method, load: int) -> HeldOut:
    unseen = recording.sets[load]
    try:
        found = method([one for i, one in enumerate(recording.sets) if i != load])
    except CalibrationRefused as refusal:
        return HeldOut(unseen.name, np.nan, np.nan, np.nan, refusal.reason)
    own = estimate_offset(unseen.raw, unseen.gravity).offset
    force, torque = _rmse((unseen.raw - own) @ found.matrix.T - recording.wrenches[load])
    other, _ = _rmse((unseen.raw - found.offsets.mean(axis=0)) @ found.matrix.T - recording.wrenches[load])
    return HeldOut(unseen.name, force, torque, other)


def _regression(recording: Optical, load: int, squares: bool, ridge: float) -> HeldOut:
    """Regress true wrenches on readings: nobody knows so much, and nothing of this form does much better."""
    unseen = recording.sets[load]
    true = recording.wrenches[load][_whole(unseen)]
    if ridge == np.inf:
        force, torque = _rmse(true)
        return HeldOut(unseen.name, force, torque, force)
    known = [i for i in range(len(recording.sets)) if i != load]
    X = np.concatenate([_features(recording.sets[i], squares) for i in known])
    Y = np.concatenate([recording.wrenches[i][_whole(recording.sets[i])] for i in known])
    level, spread, middle = X.mean(axis=0), X.std(axis=0), Y.mean(axis=0)
    Z = (X - level) / spread
    slope = np.linalg.solve(Z.T @ Z + ridge * len(Z) * np.eye(Z.shape[1]), Z.T @ (Y - middle))
    predicted = (_features(unseen, squares) - level) / spread @ slope + middle
    force, torque = _rmse(predicted - true)
    return HeldOut(unseen.name, np.nan, torque, force)


def _whole(one: InSituSet) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(one.raw).all(axis=1))


def _features(one: InSituSet, squares: bool) -> Floats:
    """Readings, and their squares about the middle of their range, of the samples that are whole."""
    counts = one.raw[_whole(one)]
    return np.hstack([counts, ((counts - 300.0) / 100.0) ** 2]) if squares else counts


def _rmse(error: Floats) -> tuple[float, float]:
    """RMSE of a force and of a torque over the samples that are whole."""
    force, torque = np.nanmean(error[:, :3] ** 2), np.nanmean(error[:, 3:] ** 2)
    return float(np.sqrt(force)), float(np.sqrt(torque))


def optical_table(folder: Path) -> Table:
    """Lay out what each method predicts of the printed sensor's loads."""
    recording = load_optical(folder)
    lines = []
    for row in optical_sensor(recording):
        force, torque, other = row.rmse(LOADED)
        bare = row.rmse(("bare",))[2]
        cells = (row.mass, 100.0 * row.com_error, force, torque, other, bare)
        lines.append((row.method, *(number(cell) for cell in cells)))
    return Table(
        name="in_situ_optical",
        title=f"Printed sensor: RMSE on the load that was not fitted (base: {recording.base[0]} kg)",
        columns=("method", "base kg", "place cm", "force N", "torque N m", "offset of others N", "bare N"),
        rows=tuple(lines),
        note="Refused by default: " + " Then: ".join(optical_refusals(recording)),
    )


def main() -> None:
    folder = Path(os.environ.get("SUREFOOT_DATA") or ".")
    if not (folder / "ft" / "printed_ft_8ch.npz").is_file():
        sys.exit("SUREFOOT_DATA names no folder with 'ft/printed_ft_8ch.npz'; it is not part of surefoot.")
    Console().print(optical_table(folder).to_rich())


if __name__ == "__main__":
    main()
