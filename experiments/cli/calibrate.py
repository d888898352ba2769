"""``surefoot calibrate`` and ``surefoot check``."""

from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer import Argument, Option

from surefoot.experiments.cli.console import REFUSED, Json, Paths, fail, one_line_errors, show
from surefoot.names import page

Topics = Annotated[Path | None, Option(help="Mapping file of ROS bags; by default the one beside the log.")]
Accept = Annotated[
    str | None, Option(help="Reason to continue with a refused log; kept in all files.", metavar="REASON")
]
Guess = Annotated[bool, Option("--guess", help="Print a proposed mapping file for the bag, and exit.")]

app = typer.Typer(help="Calibrate sensors from the logs of a robot.", no_args_is_help=True)


@app.command(epilog=f"The table: {page('log-format')}")
def walk(
    log: Annotated[Path, Argument(help="A log: .parquet, .csv or a ROS bag.")],
    method: Annotated[str, Option(help="moment, window, quasi-static, tare, none, module:name")] = "moment",
    start: Annotated[
        str | None, Option(help="Starting map: nominal, calibrated or a JSON of weights.")
    ] = None,
    out: Annotated[Path | None, Option(help="Folder for the result; by default beside the log.")] = None,
    settle: Annotated[float, Option(help="Time in s at the start that is left out of errors.")] = 0.0,
    zero_phase: Annotated[bool, Option("--zero-phase", help="Filter both ways, as in the paper.")] = False,
    stand: Annotated[float, Option(help="Standing time in s that sets the weights of window.")] = 0.0,
    split_gaps: Annotated[bool, Option("--split-gaps", help="Continue after gaps in time.")] = False,
    topics: Topics = None,
    guess: Guess = False,
    ros2: Annotated[bool, Option("--ros2", help="Also write the map as parameters of a ROS 2 node.")] = False,
    accept: Accept = None,
    as_json: Json = False,
) -> None:
    """Calibrate the foot sensors of a walk: writes forces, CoP, parameters and a report."""
    from surefoot.experiments.logs.format import LOST_ROWS, read_log
    from surefoot.experiments.study.progress import working
    from surefoot.experiments.walking.calibrate import calibrate_log

    _check_reason(accept)
    if guess:
        _guess(log, walk=True)
    with one_line_errors():
        with working("reading the log"):
            gap = float("inf") if split_gaps else LOST_ROWS
            read = read_log(log, gap, topics, feet_alone=method in ("tare", "none"))
        first, last = read.time[0], read.time[-1]
        if not 0.0 <= settle < last - first:
            fail(f"--settle must be shorter than the log's {last - first:.4g} s, got {settle:g}.")
        if stand and not 0.0 < stand < last - first:
            fail(f"--stand must be shorter than the log's {last - first:.4g} s and positive, got {stand:g}.")
        where: Any = {"folder": log.parent if out is None else out, "stem": log.stem, "file": log.name}
        where |= {"accept": accept or "", "ros2": ros2, "stand": stand}
        result = calibrate_log(read, method, start, settle=first + settle, zero_phase=zero_phase, **where)
    show(result.tables, result.files, notices=result.notices, as_json=as_json)


@app.command(epilog=f"The table: {page('weights')}")
def weights(
    weighings: Annotated[Path, Argument(help="CSV with load_kg or load_N, and raw_..._count of each cell.")],
    out: Annotated[Path | None, Option(help="JSON file of the map; the report is beside it.")] = None,
    accept: Accept = None,
    as_json: Json = False,
) -> None:
    """Fit a line or a curve to each cell's readings under known weights (CoP paper, Eqs. 1, 2)."""
    from surefoot.experiments.study.progress import working
    from surefoot.experiments.weights.calibrate import fit_weighings
    from surefoot.experiments.weights.page import write_weights_page

    _check_reason(accept)
    with one_line_errors():
        path = weighings.with_suffix(".map.json") if out is None else out
        if path.suffix == ".html":
            fail(f"--out is the JSON file of the map, and '{path}' its report; end the name in .json.")
        result = fit_weighings(weighings, path, accept or "")
        with working("drawing the report"):
            page_path = write_weights_page(path.with_suffix(".html"), result)
    files = {"map": result.path, "report": page_path}
    show([result.table], files, notices=result.notices, as_json=as_json)


@app.command(epilog=f"The table: {page('in-situ-log')}")
def ft(
    logs: Annotated[Paths, Argument(help="A log, or one file per set.")] = None,
    config: Annotated[Path | None, Option(help="TOML; by default the one beside the first log.")] = None,
    sample: Annotated[bool, Option("--sample", help="Calibrate the sample of surefoot.")] = False,
    raw: Annotated[str | None, Option(help="Columns of the channels, separated by commas.")] = None,
    specific_force: Annotated[
        str | None, Option(help="Columns x,y,z of the accelerometer; up at rest.")
    ] = None,
    gravity: Annotated[str | None, Option(help="Columns x,y,z of gravity instead; down.")] = None,
    time: Annotated[str | None, Option(help="Column of time.")] = None,
    set_: Annotated[str | None, Option("--set", help="Column with the name of the set.")] = None,
    out: Annotated[Path | None, Option(help="Folder for the result; by default beside the log.")] = None,
    keep_matrix: Annotated[
        bool, Option("--keep-matrix", help="Keep the maker's matrix; fit the rest.")
    ] = False,
    accept: Accept = None,
    topics: Topics = None,
    guess: Guess = False,
    as_json: Json = False,
) -> None:
    """Calibrate a built-in six-axis F/T sensor from readings, gravity and known masses."""
    from surefoot.experiments.force_torque.calibrate import SAMPLE, calibrate_in_situ_log
    from surefoot.experiments.force_torque.config import config_beside, read_config

    _check_reason(accept)
    if bool(logs) == sample:
        fail("give the log of a sensor, or --sample for the one that ships with surefoot.")
    paths = [SAMPLE] if sample else list(logs or ())
    if guess:
        _guess(paths[0], walk=False)
    folder = out if out is not None else (Path("out/in-situ") if sample else paths[0].parent)
    with one_line_errors():
        given = read_config(config) if config is not None else config_beside(paths[0])
        vectors = {"raw": raw, "specific_force": specific_force, "gravity": gravity}
        parts = {
            key: None if names is None else tuple(name.strip() for name in names.split(","))
            for key, names in vectors.items()
        }
        given = given.override(time=time, set=set_, **parts)
        if keep_matrix:
            given = given.model_copy(update={"fit": given.fit.model_copy(update={"keep_matrix": True})})
        options: Any = {"folder": folder, "accept": accept or "", "topics": topics}
        result = calibrate_in_situ_log(paths, given, **options)
    show(result.tables, result.files, notices=result.notices, as_json=as_json)


@app.command()
def motion(
    robot: Annotated[str, Argument(help="nao, g1, t1, op3, or path of an MJCF file with robot and floor.")],
    budget: Annotated[float, Option(help="Longest duration in s.")] = 40.0,
    goal: Annotated[str, Option(help="cop, or channel for the force of the worst channel.")] = "cop",
    enough: Annotated[float, Option(help="Stop at this deviation: mm of CoP, or N of a channel.")] = 0.0,
    torque: Annotated[float, Option(help="Largest share of the torque of a leg motor.")] = 0.95,
    margin: Annotated[float, Option(help="Least CoP margin to the edge, share of half the sole.")] = 0.12,
    out: Annotated[Path | None, Option(help="CSV file of the motion; by default <robot>_motion.csv.")] = None,
    as_json: Json = False,
) -> None:
    """Plan a motion that calibrates the feet of a robot: joint targets over time."""
    from surefoot.experiments.motion import Limits, plan_motion

    path = Path(f"{Path(robot).stem}_motion.csv") if out is None else out
    with one_line_errors(path):
        least = enough / 1e3 if goal == "cop" else enough
        planned = plan_motion(robot, budget, goal=goal, enough=least, limits=Limits(torque, margin))
        planned.prelude.write(path)
    show(planned.tables, {"motion": path}, as_json=as_json)


def _check_reason(accept: str | None) -> None:
    if accept is not None and not accept.strip():
        fail("--accept needs the reason to continue, which is stored in every file.")


def _guess(log: Path, *, walk: bool) -> NoReturn:
    """Print a proposed mapping file for a bag, and exit."""
    from surefoot.experiments.logs.guess import guess_topics
    from surefoot.experiments.study.progress import working

    with one_line_errors():
        with working("reading the bag"):
            topics = guess_topics(log, walk=walk)
        typer.echo(topics, nl=False)
    raise typer.Exit


AnyLog = Annotated[
    Path, Argument(help="A walk, sets of a six-axis sensor, weighings, bare channels, or a bag.")
]
Page = Annotated[Path | None, Option(help="HTML file of the report; by default beside the log.")]


def check(
    log: AnyLog,
    out: Page = None,
    preset: Annotated[
        Path | None, Option(help="Write noise, drift, resolution and clock as a preset.")
    ] = None,
    topics: Topics = None,
    as_json: Json = False,
) -> None:
    """Report the flaws of a log: since when, how certain, and which measurement would confirm each."""
    from surefoot.experiments.instrument.check import check_log, words_of
    from surefoot.experiments.instrument.page import write_check_page
    from surefoot.experiments.instrument.preset import write_preset
    from surefoot.experiments.study.progress import working

    if preset is not None and preset.suffix != ".toml":
        fail(f"--preset must end in .toml, got '{preset}'.")
    with one_line_errors():
        checked = check_log(log, topics)
        files = {} if preset is None else {"preset": write_preset(preset, checked.recording, checked.facts)}
        files["page"] = log.with_suffix(".check.html") if out is None else out
        with working("drawing the page"):
            write_check_page(files["page"], checked)
    facts = {"sound": checked.sound, "kind": checked.recording.kind}
    tables = checked.tables if as_json else checked.tables[1:]
    notices, said = checked.recording.notices, words_of(checked)
    show(tables, files, notices=notices, said=said, as_json=as_json, **facts)
    if not checked.sound:
        raise typer.Exit(REFUSED)
