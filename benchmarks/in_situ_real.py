"""In-situ calibration of three real sensors, on samples that the fits have not seen.

    SUREFOOT_DATA=/path/to/recordings python benchmarks/in_situ_real.py          # about 10 s

The recordings are not part of this package: ``$SUREFOOT_DATA/ft`` has to hold ``icub_right_foot_swing.npz``,
``kuka_ati_gamma_static.npz`` and ``printed_ft_8ch.npz``.
"""

import sys
from pathlib import Path

from rich.console import Console

from surefoot.experiments.in_situ.optical import LOADED, load_optical, optical_refusals, optical_sensor
from surefoot.experiments.in_situ.recordings import gamma_on_arm, icub_foot, sensor_recordings_folder
from surefoot.experiments.study.tables import Table, number


def foot_table(folder: Path) -> Table:
    """Lay out what each calibration leaves of the iCub's foot."""
    rows = icub_foot(folder)
    return Table(
        name="in_situ_icub_foot",
        title="iCub, right foot: RMSE on the half that was not fitted",
        columns=("method", "fitted", "Fx N", "Fy N", "Fz N", "Tx N m", "Ty N m", "Tz N m", "limb kg"),
        rows=tuple(
            (row.method, row.fitted, *(number(value) for value in row.rmse), number(row.mass)) for row in rows
        ),
        note=_refusals({f"{row.method}, {row.fitted} half": row.refusal for row in rows}),
    )


def gamma_table(folder: Path) -> Table:
    """Lay out what each kind of gravity makes of the ATI Gamma's offset."""
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
        note=_refusals({row.gravity: row.refusal for row in rows}),
    )


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


def _refusals(reasons: dict[str, str]) -> str:
    return " ".join(f"Refused ({name}): {reason}" for name, reason in reasons.items() if reason)


def main() -> None:
    folder = sensor_recordings_folder()
    if folder is None:
        sys.exit(
            "SUREFOOT_DATA names no folder that holds 'ft' with the recordings of real sensors; they are not "
            "part of this package. Set it as the head of this file says."
        )
    console = Console()
    for table in (foot_table, gamma_table, optical_table):
        console.print(table(folder).to_rich())


if __name__ == "__main__":
    main()
