"""``surefoot train``, ``evaluate``, ``sweep`` and ``replay``: controllers, and their feet."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from surefoot.experiments.cli.console import (
    CONTROLLERS,
    Feeds,
    Jobs,
    Json,
    Names,
    Numbers,
    fail,
    one_line_errors,
    show,
)


def train(
    out: Annotated[Path, Option(help="Folder; one that was stopped there goes on.")] = Path("out/policy"),
    task: Annotated[str, Option(help="balance, walk, balance-hard or walk-hard.")] = "balance",
    sensors: Annotated[str, Option(help="CoP trained on: true, or randomised (drifting).")] = "true",
    seed: Annotated[int, Option(help="Of everything random.", min=0, max=999)] = 0,
    steps: Annotated[int | None, Option(help="Decisions in all; 160 000 by default.", min=1)] = None,
    restart: Annotated[bool, Option("--restart", help="Start again, whatever the folder holds.")] = False,
    export: Annotated[Path | None, Option(help="Only turn this Stable-Baselines3 zip into a policy.")] = None,
    trusted: Annotated[bool, Option("--trusted", help="Trust the zip's maker: pickled code runs.")] = False,
) -> None:
    """Train a policy by PPO, and write it with its learning curve and a card."""
    from surefoot.experiments.policy.tasks import TrainOptions

    with one_line_errors(out, "what was trained until the last checkpoint is there."):
        try:
            if export is not None:
                from surefoot.experiments.policy.train import POLICY
                from surefoot.experiments.policy.view import export_zip

                export_zip(export, out / POLICY, task=task, trusted=trusted)
                typer.echo(f"Policy: {out / POLICY}")
                return
            given: dict[str, Any] = {} if steps is None else {"steps": steps}
            _train(out, TrainOptions(task=task, sensors=sensors, seed=seed, **given), restart)
        except ImportError as error:
            fail(f"training needs torch and stable-baselines3 ({error}): pip install 'surefoot[rl]'.")


def _train(out: Path, options: Any, restart: bool) -> None:
    from surefoot.experiments.policy.card import write_card
    from surefoot.experiments.policy.train import BOARD, POLICY, Trainer
    from surefoot.experiments.study.progress import bars

    board = find_spec("tensorboard") is not None
    trainer = Trainer(out, options, restart=restart)
    if trainer.updates:
        typer.echo(f"Going on after {trainer.updates} of {options.updates} updates.")
    if board:
        typer.echo(f"Curves: tensorboard --logdir {out / BOARD}")
    try:
        with bars("reward a decision {task.fields[reward]:.3f}, fell {task.fields[fell]:.0%}") as bar:
            nothing: Any = {"reward": float("nan"), "fell": float("nan")}
            task = bar.add_task("Training", total=options.updates, completed=trainer.updates, **nothing)

            def show(done: int, row: dict[str, float]) -> None:
                bar.update(task, completed=done, reward=row["reward_per_decision"], fell=row["fell"])

            trainer.run(show, board=board)
    except KeyboardInterrupt:
        fail(f"stopped; the same command goes on from the last checkpoint in '{out}'.")
    finally:
        trainer.close()
    typer.echo(f"Policy: {out / POLICY}\nCard: {write_card(out)}")


def evaluate(
    ctx: typer.Context,
    controllers: Annotated[Names, Argument(help=f"{CONTROLLERS}; the shipped policy by default.")] = None,
    task: Annotated[str, Option(help="balance-hard, walk-hard, balance or walk.")] = "balance-hard",
    feed: Feeds = None,
    severity: Annotated[
        Numbers, Option(help="How bad the sensors are; again for more. 1 by default.")
    ] = None,
    seeds: Annotated[int, Option(help="Episodes of each.", min=1)] = 50,
    first_seed: Annotated[int, Option(help="Seed of the first of them.", min=0)] = 20_000,
    out: Annotated[Path | None, Option(help="Folder for page and results; else only a table.")] = None,
    page_of: Annotated[Names, Option(help="Only a page of FILE or CONTROLLER=FILE; again for more.")] = None,
    jobs: Jobs = 1,
    as_json: Json = False,
) -> None:
    """Score controllers on true, drifting and calibrated feet, on the same episodes."""
    from surefoot.experiments.episodes.plan import evaluation_plan
    from surefoot.experiments.episodes.run import run_plan, sort_episodes

    if page_of:
        if given_too := [name for name in ctx.params if _was_given(ctx, name)]:
            what = given_too[0].replace("_", "-")
            what = what if what == "controllers" else f"--{what}"
            fail(f"--page-of runs nothing, and {what} says what to run: give one of the two.")
        _page_of(page_of, out, as_json)
        return
    given: dict[str, Any] = {
        "controllers": tuple(controllers or ()),
        "feeds": tuple(feed or ()),
        "severities": tuple(severity or ()),
    }
    chosen = {name: value for name, value in given.items() if value}
    with one_line_errors(out, "give another folder with --out, or make room."):
        plan = evaluation_plan(seeds=seeds, first_seed=first_seed, task=task, **chosen)
        results = run_plan(plan, out, jobs=jobs)
        _report(sort_episodes(results.rows, chosen.get("controllers", ())), out, as_json)


def _was_given(ctx: typer.Context, name: str) -> bool:
    source = ctx.get_parameter_source(name)
    return name not in ("page_of", "out", "as_json") and source is not None and source.name != "DEFAULT"


def _page_of(named: list[str], out: Path | None, as_json: bool) -> None:
    import pandas as pd

    from surefoot.experiments.episodes.run import read_episodes

    if out is None:
        fail("--page-of needs a folder for the page; give one with --out.")
    with one_line_errors(out):
        # A path that holds a '=' is a path if it is there.
        parts = [("", "", text) if Path(text).exists() else text.rpartition("=") for text in named]
        frames = [read_episodes(Path(path), controller) for controller, _, path in parts]
        _report(pd.concat(frames, ignore_index=True), out, as_json)


def _report(frame: Any, out: Path | None, as_json: bool) -> None:
    """Print the scores and, into a folder, write them and a page."""
    from surefoot.experiments.episodes.page import check_episodes, write_evaluation
    from surefoot.experiments.episodes.tables import score_table
    from surefoot.experiments.study.progress import working

    frame, failed = check_episodes(frame)
    files: dict[str, Path] = {}
    if out is not None:
        with working("drawing the page"):
            files["page"] = write_evaluation(frame, failed, out).page
    title = f"{frame['scenario'].iloc[0]}: feet of different kinds"
    show([score_table(frame, title=title)], files, as_json=as_json)


def sweep(
    plan: Annotated[Path | None, Argument(help="TOML of a sweep; options replace its values.")] = None,
    controller: Annotated[Names, Option(help=f"{CONTROLLERS}; again for more.")] = None,
    feed: Feeds = None,
    scenario: Annotated[Names, Option(help="A scenario; again for more; else speed-0.04.")] = None,
    severity: Annotated[
        Numbers, Option(help="Factor of the cells' errors; again for more; else 1 and 3.")
    ] = None,
    seeds: Annotated[int | None, Option(help="Episodes of each combination; else 10.", min=1)] = None,
    first_seed: Annotated[int | None, Option(help="The first of the seeds; else 0.", min=0)] = None,
    duration: Annotated[float | None, Option(help="Longest duration of an episode in s.")] = None,
    out: Annotated[Path, Option(help="Folder of the sweep; an interrupted one goes on.")] = Path("out/sweep"),
    jobs: Annotated[int, Option(help="Episodes that are run at the same time here.", min=1)] = 2,
    any_version: Annotated[bool, Option("--any-version", help="Go on with other versions' results.")] = False,
    scenarios: Annotated[bool, Option("--scenarios", help="List the scenarios, and end.")] = False,
    as_json: Json = False,
) -> None:
    """Sweep controllers over feeds, scenarios, severities and seeds, and report."""
    from surefoot.experiments.episodes.page import write_sweep
    from surefoot.experiments.episodes.plan import plan_from_toml
    from surefoot.experiments.episodes.run import run_plan
    from surefoot.experiments.study.progress import working

    if scenarios:
        show([_scenario_table()], {}, as_json=as_json)
        return
    given: dict[str, Any] = {
        "controllers": tuple(controller or ()),
        "feeds": tuple(feed or ()),
        "scenarios": tuple(scenario or ()),
        "severities": tuple(severity or ()),
        "seeds": seeds,
        "first_seed": first_seed,
        "duration": duration,
    }
    changes = {name: value for name, value in given.items() if value not in ((), None)}
    with one_line_errors(out, "what is finished is kept."):
        chosen = plan_from_toml(plan, **changes)
        results = run_plan(chosen, out, jobs=jobs, any_version=any_version)
        with working("drawing the report"):
            report = write_sweep(results)
    kept = len(results.rows) - results.computed
    episodes = {"run": results.computed, "were there": kept, "failed": len(results.failed)}
    said = f"{results.computed} episodes run, {kept} were there, {len(results.failed)} failed."
    show(report.tables, {"report": report.page}, said=said, episodes=episodes, as_json=as_json)
    if len(results.failed) == len(results.rows):
        raise typer.Exit(1)


def replay(
    results: Annotated[Path, Argument(help="Folder of a sweep or an evaluation, or its episodes.parquet.")],
    case: Annotated[int, Option(help="Number of the episode.", min=0)],
    video: Annotated[Path | None, Option(help="Film it into this .mp4 as well.")] = None,
    as_json: Json = False,
) -> None:
    """Run one episode again, and say whether it comes out the same to the last digit."""
    from surefoot.experiments.episodes.episode import OUTCOME
    from surefoot.experiments.episodes.run import replay_episode
    from surefoot.experiments.study.progress import working
    from surefoot.experiments.study.tables import Verdict, table_of
    from surefoot.experiments.walks.video import film_episode

    if video is not None and video.suffix != ".mp4":
        fail(f"'{video}' must end in .mp4.")
    with one_line_errors(), working(f"running case {case} again") as then:
        replayed = replay_episode(results, case)
        then("filming it")
        files = {} if video is None else {"film": film_episode(video, replayed.episode)}
    columns: dict[str, Any] = {
        "outcome": lambda name: name,
        "now": lambda name: _exact(replayed.now[name]),
        "then": lambda name: _exact(replayed.then[name]),
        "same": lambda name: Verdict.of(name not in replayed.different),
    }
    names = [name for name in (*OUTCOME, "error") if replayed.now[name] != "" or name in replayed.different]
    said = "Different." if replayed.different else "Identical."
    if replayed.other_versions:
        said = f"Versions: {', '.join(replayed.other_versions)}\n{said}"
    facts: Any = {"identical": not replayed.different, "versions": replayed.other_versions}
    table = table_of("replay", "The episode, to the last digit", columns, names)
    show([table], files, said=said, as_json=as_json, **facts)
    if replayed.different:
        raise typer.Exit(1)


def _exact(value: Any) -> Any:
    from surefoot.experiments.study.tables import Valued

    return Valued.of(str(value), value)


def _scenario_table() -> Any:
    from surefoot.experiments.episodes.plan import find_scenario
    from surefoot.experiments.study.tables import Table
    from surefoot.experiments.walks.scenarios import SCENARIOS

    rows = []
    for name in SCENARIOS:
        try:
            rows.append((name, find_scenario(name).title))
        except ValueError:
            continue
    return Table("scenarios", "Scenarios of a sweep", ("scenario", "what it is"), tuple(rows))
