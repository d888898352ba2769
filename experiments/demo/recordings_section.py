"""The report's section on real recordings: what came of them, or how to get them."""

from pathlib import Path

import pandas as pd

from surefoot.experiments.real_recordings import recordings_folder, study
from surefoot.experiments.study.files import atomic_path
from surefoot.experiments.study.page import Section
from surefoot.experiments.study.tables import Frame, Table, number

__all__ = ["recordings_section"]

_ABSENT = """
    This report holds none: the recordings may not be handed on with the package. Set SUREFOOT_DATA to a
    folder that holds foot/wii_board_18min.npz, foot/caltester_FP1_600hz.npz and foot/kistler2_600hz.npz
    and run the demo again; they are made from public recordings of a balance board
    (corkine/BalanceBoardDataAnalysis) and of two force plates (sample 15 of c3d.org, and
    pyomeca/ezc3d-testFiles)."""

_PRESENT = """
    Three real plates whose four corner cells were recorded one by one: a person who stands quietly on a
    balance board, a loaded pole that is rocked about a fixed tip on a force plate, and an empty force
    plate whose zeros have moved. Gains (10 %) and offsets (3 % of the weight) were put onto the
    recorded cells; the same calibrators as above were told the weight and the centre of pressure of the
    record before, and when nothing stood on the plate. Scored is against the record itself, so that a
    plate's own errors are in both. Figures are root mean squares over five draws;
    tables/real_recordings.csv holds each kind of error by itself."""


def recordings_section(folder: Path | None) -> Section:
    """Run the real recordings, where they are, and lay out what came of them.

    Args:
        folder: The report's folder, where all rows are saved; ``None`` saves nothing.
    """
    where = recordings_folder()
    if where is None:
        commands = ("SUREFOOT_DATA=/path/to/recordings surefoot demo",)
        return Section("recordings", "Real recordings", (" ".join(_ABSENT.split()),), commands=commands)
    rows: Frame = pd.DataFrame(study(where))
    if folder is not None:
        with atomic_path(folder / "tables" / "real_recordings.csv") as part:
            rows.to_csv(part, index=False)
    return Section(
        "recordings",
        "Real recordings",
        (" ".join(_PRESENT.split()),),
        findings=_findings(rows),
        tables=(_table(rows, "nothing"), _table(rows, "both")),
    )


def _table(rows: Frame, injected: str) -> Table:
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


def _findings(rows: Frame) -> tuple[str, ...]:
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
