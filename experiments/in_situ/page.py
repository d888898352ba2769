"""The page of the simulated in-situ experiment, with its figures."""

from pathlib import Path
from typing import Any

import numpy as np

from surefoot.calibration.in_situ import estimate_offset
from surefoot.experiments.force_torque.figures import COUNTS, FORCES, Cloud, Panel, draw_ellipsoids
from surefoot.experiments.in_situ.cases import DRAWN
from surefoot.experiments.in_situ.claims import summary_findings
from surefoot.experiments.in_situ.methods import METHODS
from surefoot.experiments.in_situ.study import InSituStudyOptions, InSituStudyResults, run_in_situ_study
from surefoot.experiments.in_situ.tables import all_tables
from surefoot.experiments.study.figures import Look, figure_at, grid_of, look_of
from surefoot.experiments.study.page import (
    Report,
    ReportFigure,
    Section,
    Words,
    failure_section,
    publish,
    repeat_section,
)
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.tables import Frame, plural

_say = Words("in_situ")
_LOOKS = {"measurement": "moment", "no-loop": "tare", "paper": "window", "manufacturer": "none"}
"""Whose colours and markers the methods have in figures."""


def compare_in_situ(options: InSituStudyOptions) -> Report:
    """Run the study and write its page; StudyError if the folder is in use or the disk full."""
    results = run_in_situ_study(options)
    with working("drawing the report"):
        return write_in_situ_study_page(results)


def write_in_situ_study_page(results: InSituStudyResults) -> Report:
    """Draw the figures, save the tables as CSV, and write ``report.html``; return it with all tables."""
    tables, options = all_tables(results), results.options
    folder = options.out / "figures"

    def section(name: str, title: str, text: str = "", **more: Any) -> Section:
        shown = {"tables": (tables[name],)} if name in tables else {}
        return Section(name, title, (text,) if text else (), **shown | more)

    limb = (
        ReportFigure(
            _draw_limb(folder / "limb.svg", results.fits), "Weight of the limb", _say("figure_limb")
        ),
    )
    spheres: dict[str, Any] = {"tables": tuple(tables[f"table{number}"] for number in (1, 2, 3))}
    spheres["figures"] = _ellipsoids(folder, results.shown) if len(results.shown) else ()
    quick = " --quick" if options.quick else ""
    command = f"surefoot compare in-situ --seeds {options.seeds}{quick} --jobs {options.jobs}"
    sections = (
        section("targets", "In short", findings=tuple(summary_findings(results))),
        section("spheres", "Spheres, masses, places", _say("spheres"), **spheres),
        section("limb", "Weight of the limb", _say("limb"), figures=limb),
        section("bound", "As sure as right", _say("bound")),
        section("motion", "Without waiting for rest", _say("motion")),
        section("exact", "The paper's method without noise"),
        *failure_section(results.failures),
        repeat_section(_say("repeat"), (f"{command} --out {options.out}",), results.seconds),
    )
    amount = _say(
        "amount",
        seeds=plural(options.seeds, "seed"),
        rate=options.rate,
        moving=plural(min(options.seeds, options.moving_seeds), "seed"),
    )
    title = "In-situ calibration of six-axis sensors, simulated"
    return publish(options.out, title, (_say("introduction"), amount), sections, prefix="page_")


def _ellipsoids(folder: Path, shown: Frame) -> tuple[ReportFigure, ...]:
    """Draw the paper's Figs. 5 and 6: counts with the offset in the middle, and forces by two matrices."""
    counts, forces = [], []
    for _, row in shown.iterrows():
        raw, gravity = _points(row["raw"]), _points(row["gravity"])
        title = f"{row['sensor']}, set {row['set']}"
        fit = estimate_offset(raw, gravity)
        cloud = Cloud(fit.coordinates(raw), gravity, look_of("none"), mark=fit.coordinates(fit.offset))
        counts.append(Panel(f"{title}: {100.0 * fit.affine_residual:.2f} % off", [cloud]))
        found = {method: row[f"force_{method}"] for method in DRAWN if len(row[f"force_{method}"])}
        clouds = [Cloud(_points(force), gravity, _look(method)) for method, force in found.items()]
        forces.append(Panel(title, clouds))
    return (
        ReportFigure(draw_ellipsoids(folder / "raw.png", counts, COUNTS), "Figure 5", _say("figure_5")),
        ReportFigure(draw_ellipsoids(folder / "force.png", forces, FORCES), "Figure 6", _say("figure_6")),
    )


def _points(nested: object) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return points of a table's cell, shape (n, k)."""
    return np.stack([np.asarray(point, dtype=np.float64) for point in nested])  # type: ignore[attr-defined]


def _draw_limb(path: Path, fits: Frame) -> Path:
    """Draw the error of the limb's weight of every seed, by sensor and method."""
    sensors = list(dict.fromkeys(fits["sensor"]))
    ticks = {"measurement": "measurement\nspace", "no-loop": "without\nhysteresis", "paper": "III-B, III-C"}
    with figure_at(path, 9.0, 3.2) as figure:
        for axes, sensor in zip(grid_of(figure, 1, len(sensors))[0], sensors, strict=True):
            axes.axhspan(-1.0, 1.0, color="#000000", alpha=0.08, linewidth=0)
            for place, method in enumerate(ticks):
                chosen = (fits["sensor"] == sensor) & (fits["method"] == method)
                errors = 100.0 * fits[chosen]["limb_error"].dropna()
                spread = np.linspace(-0.25, 0.25, len(errors)) if len(errors) > 1 else np.zeros(len(errors))
                look = _look(method)
                axes.plot(place + spread, errors, look.marker, color=look.colour, markersize=3.5)
            axes.set_xticks(range(len(ticks)), list(ticks.values()))
            axes.set_title(sensor)
            axes.axhline(0.0, color="#000000", linewidth=0.6)
        figure.supylabel("limb's weight, error (%)", fontsize=9.5)
    return path


def _look(method: str) -> Look:
    return look_of(_LOOKS[method])._replace(label=METHODS[method])
