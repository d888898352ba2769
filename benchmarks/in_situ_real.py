"""In-situ calibration of three real sensors, scored on samples that the fits have not seen.

    SUREFOOT_DATA=/path/to/recordings python benchmarks/in_situ_real.py          # about 5 s

* The right foot of an iCub that stands on its left and swings the right leg: 32 s at 100 Hz, raw counts, the
  factory matrix, gravity from the joints, and the foot's weight by a model.
* An ATI Gamma under 0.93 kg on a KUKA arm: 24 readings at rest in six directions, gravity from the arm's
  joints and from an accelerometer that is off by 0.08 g.
* A printed optical sensor of eight channels: four loads, bare and with 0.719 kg at three places, in 12
  postures each. A third of the loaded postures is saturated and left out. Of the rest, a linear response to
  the true wrenches leaves 30 counts RMS where the readings spread by 94: it is to be refused.

The recordings are not part of this package: ``$SUREFOOT_DATA/ft`` has to hold ``icub_right_foot_swing.npz``,
``kuka_ati_gamma_static.npz`` and ``printed_ft_8ch.npz``.
"""

import os
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration.imu import calibrate_accelerometer, savitzky_golay
from surefoot.calibration.in_situ import (
    InSituFit,
    InSituOptions,
    InSituSet,
    KnownLimb,
    calibrate_in_situ,
    estimate_offset,
)
from surefoot.experiments.force_torque.validation import force_ellipsoid

STANDARD_GRAVITY = 9.80665  # in m/s^2 per g
_TRUSTED = (0.001,) * 6
"""How far the Gamma's axes may be off, as shares: one load does not tell its scale, so the maker does."""

AXES = ("Fx N", "Fy N", "Fz N", "Tx N m", "Ty N m", "Tz N m")

WINDOW = 101  # of the filter of order 3 in samples, 1 s: the foot swings in about two


def sensor_recordings_folder() -> Path | None:
    """Find the recordings: the folder that ``SUREFOOT_DATA`` names, or ``None`` where it is unset or gone."""
    name = os.environ.get("SUREFOOT_DATA")
    return Path(name) if name and (Path(name) / "ft").is_dir() else None


_SWUNG = "the foot is on a robot that balances: its limb is not quite rigid, nor its counts white"
"""Why refusals are passed."""

_FOOT: dict[str, tuple[float | None, float, bool]] = {
    "in situ, mass known to 1 %": (0.01, 0.005, False),
    "mass to 1 %, place to 0.3 mm": (0.01, 0.0003, False),
    "limb unknown": (None, 0.0, False),
    "fitted to filtered counts": (0.01, 0.005, True),
}
"""Deviations of the limb's mass (as a share) and of its place in m, and whether counts are filtered."""


def icub_foot(folder: Path, methods: Collection[str] = tuple(_FOOT)) -> pd.DataFrame:
    """Calibrate the iCub's foot on one half of its recording and score it on all samples of the other.

    Counts are filtered in each half by itself, and filtered counts are scored. The true wrench is the weight
    of the model's foot. By method, one of ``_FOOT`` beside the factory matrix, and by the half that was
    fitted, ``"first"`` or ``"second"``: the RMSE of the wrench in N and N m, the limb's mass in kg, and why
    the fit was refused.
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

        def score(
            method: str, matrix: Floats, offset: Floats, mass: float = np.nan, refusal: str = "",
            other: slice = other, fitted: str = fitted,
        ) -> dict[str, Any]:  # fmt: skip
            error = (smooth[other] - offset) @ matrix.T - weight[other]
            rmse = dict(zip(AXES, np.sqrt(np.mean(error**2, axis=0)), strict=True))
            return {"method": method, "fitted": fitted, **rmse, "limb kg": mass, "refused": refusal}

        by_model = np.mean(smooth[half] - weight[half] @ np.linalg.pinv(factory).T, axis=0)
        rows.append(score("factory matrix, offset by the model", factory, by_model))
        # The foot swings so nearly in a plane that III-B refuses it at its default of 1 %.
        found = estimate_offset(smooth[half], gravity[half], minimum_spread=0.003).offset
        rows.append(score("factory matrix, offset by III-B", factory, found))
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
            rows.append(score(name, fit.matrix, fit.offset, fit.limb.mass, refusal_of(fit)))
    return pd.DataFrame(rows).set_index(["method", "fitted"])


def gamma_on_arm(folder: Path) -> pd.DataFrame:
    """Find the offset and the load of the ATI Gamma with gravity from three sources.

    ``calibrate_in_situ`` gets the identity as factory matrix: the recording holds wrenches, not counts. The
    accelerometer's axes are not the sensor's, so that their rotation is estimated as well.

    By the source of gravity: the distance of the offset's force from that of III-B with the arm's own gravity
    in N, by III-B and by ``calibrate_in_situ``; semi-axes of the forces' ellipsoid in N; the limb's mass in
    kg; and the RMSE of a force in N that III-B predicts in a direction that it has not seen.
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
            {
                "gravity from": name,
                "III-B N": float(np.linalg.norm((found.offset - reference)[:3])),
                "in situ N": float(np.linalg.norm((fit.offset - reference)[:3])),
                "semi-axes N": force_ellipsoid(wrench[:, :3], gravity).semi_axes.round(2).tolist(),
                "limb kg": fit.limb.mass,
                "unseen direction N": _predict(wrench, gravity, direction),
                "refused": refusal_of(fit),
            }
        )
    return pd.DataFrame(rows).set_index("gravity from")


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


_LOADS = ("bare", "mass at (+, +)", "mass at (-, +)", "mass at (-, -)")


def load_optical(folder: Path) -> list[InSituSet]:
    """Load one set a load, NaN where it is saturated."""
    sets = []
    with np.load(folder / "ft" / "printed_ft_8ch.npz") as file:
        bare, place = float(file["total_mass_0"]), file["total_com_0"].astype(np.float64)
        for load, name in enumerate(_LOADS):
            mass, com = float(file[f"total_mass_{load}"]), file[f"total_com_{load}"]
            gravity, raw = file[f"gravity_{load}"], file[f"raw_mean_{load}"].copy()
            raw[file[f"saturated_{load}"]] = np.nan
            added = (mass * com - bare * place) / (mass - bare) if load else np.zeros(3)
            sets.append(InSituSet(raw, gravity, mass - bare, added, name=name))
    return sets


def main() -> None:
    folder = sensor_recordings_folder()
    if folder is None:
        sys.exit(
            "SUREFOOT_DATA names no folder that holds 'ft' with the recordings of real sensors; they are not "
            "part of this package. Set it as the head of this file says."
        )
    print(icub_foot(folder).to_string(), "\n\n", gamma_on_arm(folder).to_string(), "\n", sep="")
    print("The printed sensor:", *calibrate_in_situ(load_optical(folder), refuse=False).refusals)


if __name__ == "__main__":
    main()
