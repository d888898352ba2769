"""In-situ calibration of three real sensors, scored on samples that the fits have not seen.

    SUREFOOT_DATA=/path/to/recordings python benchmarks/in_situ_real.py          # about 5 s

* The right foot of an iCub that stands on its left and swings the right leg: 32 s at 100 Hz, raw counts, the
  factory matrix, gravity from the joints, and the foot's weight by a model.
* An ATI Gamma under 0.93 kg on a KUKA arm: 24 readings at rest in six directions, gravity from the arm's
  joints and from an accelerometer that is off by 0.08 g.

* A printed optical sensor of eight channels, a case that is lost: four loads, bare and with 0.719 kg at three
  places, in 12 postures each. A third of the loaded postures is saturated and left out. Of the rest, a
  linear response to the true wrenches leaves 30 counts RMS where the readings spread by 94. It is refused;
  accepted all the same, fits are compared on the load that they have not seen.

The recordings are not part of this package: ``$SUREFOOT_DATA/ft`` has to hold ``icub_right_foot_swing.npz``,
``kuka_ati_gamma_static.npz`` and ``printed_ft_8ch.npz``.
"""

import os
import sys
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from surefoot.calibration import CalibrationRefused
from surefoot.calibration.imu import calibrate_accelerometer, savitzky_golay
from surefoot.calibration.in_situ import (
    InSituFit,
    InSituOptions,
    InSituSet,
    KnownLimb,
    Limb,
    PaperMatrixFit,
    calibrate_in_situ,
    estimate_matrix,
    estimate_offset,
)
from surefoot.experiments.study.tables import Table, number

Floats = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
"""In m/s^2 per g."""

_TRUSTED = (0.001,) * 6
"""How far the Gamma's axes may be off, as shares: one load does not tell its scale, so the maker does."""

WINDOW = 101
"""Of the filter of order 3 in samples, 1 s: the foot swings in about two."""


def sensor_recordings_folder() -> Path | None:
    """Find the recordings: the folder that ``SUREFOOT_DATA`` names, or ``None`` where it is unset or gone."""
    name = os.environ.get("SUREFOOT_DATA")
    return Path(name) if name and (Path(name) / "ft").is_dir() else None


class FootRow(NamedTuple):
    """Errors of one calibration of the iCub's foot on the half that it has not seen.

    Attributes:
        method: Its name in tables.
        fitted: Which half was fitted, ``"first"`` or ``"second"``.
        rmse: Of the wrench in N and N m against the model's weight, shape (6,); NaN if refused.
        mass: Of the limb by the fit in kg; NaN where there is none.
        refusal: Why it was refused; empty if it was not.
    """

    method: str
    fitted: str
    rmse: Floats
    mass: float
    refusal: str = ""


class GammaRow(NamedTuple):
    """Errors of the ATI Gamma by one kind of gravity.

    Attributes:
        gravity: Where gravity came from.
        offset: Of III-B in N and N m, shape (6,).
        error: Distance of its force from that of III-B with the arm's own gravity in N.
        error_in_situ: The same of ``calibrate_in_situ`` in N; NaN if refused.
        axes: Semi-axes of the forces' ellipsoid in N, shape (3,).
        mass: Of the limb by ``calibrate_in_situ`` in kg; NaN if refused.
        held_out: RMSE of a force in N that III-B predicts in a direction that it has not seen.
        refusal: Why ``calibrate_in_situ`` refused; empty if it did not.
    """

    gravity: str
    offset: Floats
    error: float
    error_in_situ: float
    axes: Floats
    mass: float
    held_out: float
    refusal: str = ""


_SWUNG = "the foot is on a robot that balances: its limb is not quite rigid, nor its counts white"
"""Why refusals are passed."""

_FOOT: dict[str, tuple[float | None, float, bool]] = {
    "in situ, mass known to 1 %": (0.01, 0.005, False),
    "mass to 1 %, place to 0.3 mm": (0.01, 0.0003, False),
    "limb unknown": (None, 0.0, False),
    "fitted to filtered counts": (0.01, 0.005, True),
}
"""Deviations of the limb's mass (as a share) and of its place in m, and whether counts are filtered."""


def icub_foot(folder: Path, methods: Collection[str] = tuple(_FOOT)) -> list[FootRow]:
    """Calibrate the iCub's foot on one half of its recording and score it on all samples of the other.

    Counts are filtered in each half by itself, and filtered counts are scored. The true wrench is
    the weight of the model's foot.

    Args:
        folder: The folder that holds ``ft/``.
        methods: Keys of ``_FOOT``, which are compared with the factory matrix.
    """
    with np.load(folder / "ft" / "icub_right_foot_swing.npz") as file:
        time, raw, gravity = file["t"], file["raw"], file["gravity"]
        factory, mass = file["factory_matrix"], float(file["expected_mass"])
        moment = file["expected_mass_com"].mean(axis=0)
    halves = {"first": slice(0, len(raw) // 2), "second": slice(len(raw) // 2, None)}
    smooth = np.concatenate([savitzky_golay(raw[half], WINDOW) for half in halves.values()])
    weight = np.hstack([mass * gravity, np.cross(moment, gravity)])
    rows = []
    for fitted, half in halves.items():
        (other,) = (part for name, part in halves.items() if name != fitted)

        def score(matrix: Floats, offset: Floats, other: slice = other) -> Floats:
            error = (smooth[other] - offset) @ matrix.T - weight[other]
            return np.asarray(np.sqrt(np.mean(error**2, axis=0)))

        by_model = np.mean(smooth[half] - weight[half] @ np.linalg.pinv(factory).T, axis=0)
        rows.append(FootRow("factory matrix, offset by the model", fitted, score(factory, by_model), np.nan))
        # The foot swings so nearly in a plane that III-B refuses it at its default of 1 %.
        found = estimate_offset(smooth[half], gravity[half], minimum_spread=0.003).offset
        rows.append(FootRow("factory matrix, offset by III-B", fitted, score(factory, found), np.nan))
        for name in methods:
            mass_std, com_std, filtered = _FOOT[name]
            known = None
            if mass_std is not None:
                known = KnownLimb(mass, mass_std * mass, moment / mass, com_std)
            counts = (smooth if filtered else raw)[half]
            fit = calibrate_in_situ(
                [InSituSet(counts, gravity[half], time=time[half], name="swing")],
                factory_matrix=factory,
                limb=known,
                options=InSituOptions(drift=False),
                refuse=False,
                accept=_SWUNG,
            )
            reached = score(fit.matrix, fit.offset)
            rows.append(FootRow(name, fitted, reached, fit.limb.mass, refusal_of(fit)))
    return rows


def gamma_on_arm(folder: Path) -> list[GammaRow]:
    """Find the offset and the load of the ATI Gamma with gravity from three sources.

    ``calibrate_in_situ`` gets the identity as factory matrix: the recording holds wrenches, not counts. The
    accelerometer's axes are not the sensor's, so that their rotation is estimated as well.

    Args:
        folder: The folder that holds ``ft/``.
    """
    with np.load(folder / "ft" / "kuka_ati_gamma_static.npz") as file:
        wrench, specific_force, kinematic = file["wrench"], file["accel_g"], file["gravity"]
    size = float(np.mean(np.linalg.norm(kinematic, axis=1)))
    fitted = calibrate_accelerometer(specific_force, gravity=1.0).correct(specific_force)
    sources = {
        "the arm's joints": kinematic,
        "accelerometer as it reads": -STANDARD_GRAVITY * specific_force,
        "accelerometer calibrated first": -STANDARD_GRAVITY * fitted,
    }
    _, direction = np.unique(np.rint(kinematic / size), axis=0, return_inverse=True)
    reference = estimate_offset(wrench, kinematic).offset
    rows = []
    for name, gravity in sources.items():
        found = estimate_offset(wrench, gravity)
        fit = calibrate_in_situ(
            [InSituSet(wrench, gravity, name="Gamma")],
            factory_matrix=np.eye(6),
            options=InSituOptions(estimate_rotation=gravity is not kinematic, factory_std=_TRUSTED),
            refuse=False,
        )
        rows.append(
            GammaRow(
                gravity=name,
                offset=found.offset,
                error=float(np.linalg.norm((found.offset - reference)[:3])),
                error_in_situ=float(np.linalg.norm((fit.offset - reference)[:3])),
                axes=semi_axes(wrench, gravity, size),
                mass=fit.limb.mass,
                held_out=_predict(wrench, gravity, direction),
                refusal=refusal_of(fit),
            )
        )
    return rows


def semi_axes(wrench: Floats, gravity: Floats, size: float) -> Floats:
    """Semi-axes in N of the ellipsoid that forces of shape (n, 6) lie on, for gravity of a size in m/s^2."""
    centred = gravity - gravity.mean(axis=0)
    slope = np.linalg.lstsq(centred, wrench[:, :3] - wrench[:, :3].mean(axis=0), rcond=None)[0]
    return np.asarray(size * np.linalg.svd(slope, compute_uv=False), dtype=np.float64)


def _predict(wrench: Floats, gravity: Floats, direction: NDArray[np.intp]) -> float:
    """RMSE in N of forces in each direction by III-B of the other directions."""
    square = 0.0
    for left_out in np.unique(direction):
        rest = direction != left_out
        fit = estimate_offset(wrench[rest], gravity[rest])
        expected = fit.offset + gravity[~rest] @ (fit.basis @ fit.response).T
        square += float(np.sum((expected - wrench[~rest])[:, :3] ** 2))
    return float(np.sqrt(square / (3 * len(wrench))))


def refusal_of(fit: InSituFit) -> str:
    """First reason why a fit was refused; empty if it was not, or if that was passed."""
    return fit.refusals[0].reason if fit.refusals and not fit.accepted else ""


def foot_table(folder: Path) -> Table:
    """Make the table of each calibration's errors on the iCub's foot."""
    rows = icub_foot(folder)
    return Table(
        name="in_situ_icub_foot",
        title="iCub, right foot: RMSE on the half that was not fitted",
        columns=("method", "fitted", "Fx N", "Fy N", "Fz N", "Tx N m", "Ty N m", "Tz N m", "limb kg"),
        rows=tuple(
            (row.method, row.fitted, *(number(value) for value in row.rmse), number(row.mass)) for row in rows
        ),
        note=refusals_note({f"{row.method}, {row.fitted} half": row.refusal for row in rows}),
    )


def gamma_table(folder: Path) -> Table:
    """Make the table of the ATI Gamma's offset by each kind of gravity."""
    rows = gamma_on_arm(folder)
    return Table(
        name="in_situ_gamma",
        title="KUKA arm with an ATI Gamma: offset of the force against that with gravity from the joints",
        columns=("gravity from", "III-B N", "in situ N", "semi-axes N", "limb kg", "unseen direction N"),
        rows=tuple(
            (
                row.gravity,
                number(row.error),
                number(row.error_in_situ),
                ", ".join(number(axis) for axis in row.axes),
                number(row.mass),
                number(row.held_out),
            )
            for row in rows
        ),
        note=refusals_note({row.gravity: row.refusal for row in rows}),
    )


def refusals_note(reasons: dict[str, str]) -> str:
    return " ".join(f"Refused ({name}): {reason}" for name, reason in reasons.items() if reason)


_LOST = "to see what comes out of a sensor that is not linear"
"""Why refusals are passed; unknowns that stay open are refused all the same."""

_LOADS = ("bare", "mass at (+, +)", "mass at (-, +)", "mass at (-, -)")


class OpticalRow(NamedTuple):
    """One method on the printed sensor.

    Attributes:
        method: Its name in tables.
        mass: Of the bare base by all four loads in kg, 0.309 by a scale; NaN if it has none.
        com_error: How far its centre of mass is off in m.
        force: RMSE of a force in N in each load that was left out, with its offset by III-B, shape (4,); NaN
            where the other loads were refused: without the bare one all masses are alike.
    """

    method: str
    mass: float
    com_error: float
    force: Floats

    @property
    def loaded(self) -> float:
        """RMSE of a force in N over the loads with a mass."""
        return float(np.sqrt(np.mean(self.force[1:] ** 2)))


def load_optical(folder: Path) -> tuple[list[InSituSet], list[Floats], Limb]:
    """Load one set a load, NaN where it is saturated, the true wrenches, (12, 6) each, and the base."""
    sets, wrenches = [], []
    with np.load(folder / "ft" / "printed_ft_8ch.npz") as file:
        bare, place = float(file["total_mass_0"]), file["total_com_0"].astype(np.float64)
        for load, name in enumerate(_LOADS):
            mass, com = float(file[f"total_mass_{load}"]), file[f"total_com_{load}"]
            gravity, raw = file[f"gravity_{load}"], file[f"raw_mean_{load}"].copy()
            raw[file[f"saturated_{load}"]] = np.nan
            added = (mass * com - bare * place) / (mass - bare) if load else np.zeros(3)
            sets.append(InSituSet(raw, gravity, mass - bare, added, name=name))
            wrenches.append(np.hstack([mass * gravity, np.cross(mass * com, gravity)]))
    return sets, wrenches, Limb(bare, bare * place)


def optical_sensor(folder: Path) -> list[OpticalRow]:
    """Calibrate on all loads, and on three of four to predict the one left out."""
    sets, wrenches, base = load_optical(folder)
    known = KnownLimb(base.mass, 0.01 * base.mass, base.com, 0.001)
    methods: dict[str, Callable[[Sequence[InSituSet]], InSituFit | PaperMatrixFit]] = {
        "paper (III-B, III-C)": _by_paper,
        "in situ": lambda chosen: calibrate_in_situ(chosen, accept=_LOST),
        "in situ, base known to 1 %": lambda chosen: calibrate_in_situ(chosen, limb=known, accept=_LOST),
    }
    rows = []
    for name, method in methods.items():
        limb, force = method(sets).limb, np.full(len(sets), np.nan)
        for load, unseen in enumerate(sets):
            with suppress(CalibrationRefused):
                matrix = method([one for one in sets if one is not unseen]).matrix
                offset = estimate_offset(unseen.raw, unseen.gravity).offset
                off = (unseen.raw - offset) @ matrix.T - wrenches[load]
                force[load] = np.sqrt(np.nanmean(off[:, :3] ** 2))
        rows.append(OpticalRow(name, limb.mass, float(np.linalg.norm(limb.com - base.com)), force))
    whole = [np.isfinite(one.raw).all(axis=1) for one in sets]
    zero = [np.sqrt(np.mean(w[seen, :3] ** 2)) for w, seen in zip(wrenches, whole, strict=True)]
    return [*rows, OpticalRow("zero", np.nan, np.nan, np.array(zero))]


def _by_paper(sets: Sequence[InSituSet]) -> PaperMatrixFit:
    offsets = np.array([estimate_offset(one.raw, one.gravity).offset for one in sets])
    # By the noise that is seen, its own check finds no unknown determined.
    return estimate_matrix(sets, offsets, tolerance=1e-9, noise_margin=0.0)


def optical_table(folder: Path) -> Table:
    """Make the table of each method's predictions of the printed sensor's loads."""
    refusals = calibrate_in_situ(load_optical(folder)[0], accept=_LOST).refusals
    return Table(
        name="in_situ_optical",
        title="Printed sensor: RMSE of forces of the load that was not fitted",
        columns=("method", "base kg", "place cm", "loaded N", "bare N"),
        rows=tuple(
            (row.method, *map(number, (row.mass, 100.0 * row.com_error, row.loaded, row.force[0])))
            for row in optical_sensor(folder)
        ),
        note="Refused: " + " Then: ".join(refusal.reason for refusal in refusals),
    )


def main() -> None:
    folder = sensor_recordings_folder()
    if folder is None:
        sys.exit(
            "SUREFOOT_DATA names no folder that holds 'ft' with the recordings of real sensors; they are not "
            "part of this package. Set it as the head of this file says."
        )
    for table in (foot_table, gamma_table, optical_table):
        Console().print(table(folder).to_rich())


if __name__ == "__main__":
    main()
