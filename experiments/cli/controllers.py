"""``surefoot train`` and ``surefoot evaluate``: train policies, and compare them on different feet."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from surefoot.experiments.cli.console import (
    CONTROLLERS,
    Jobs,
    Json,
    Names,
    Numbers,
    fail,
    one_line_errors,
    show,
)


def train(
    out: Annotated[Path, Option(help="Folder; a stopped training continues.")] = Path("out/policy"),
    task: Annotated[str, Option(help="balance, walk, balance-hard, walk-hard or lean.")] = "balance",
    sensors: Annotated[
        str, Option(help="Feet trained on: true, randomised (drifting); for lean also history, blind.")
    ] = "true",
    seed: Annotated[int, Option(help="Seed of all random numbers.", min=0, max=999)] = 0,
    steps: Annotated[
        int | None, Option(help="Total number of decisions; the task's own by default.", min=1)
    ] = None,
    restart: Annotated[bool, Option("--restart", help="Start again, even in a used folder.")] = False,
    export: Annotated[Path | None, Option(help="Only convert this Stable-Baselines3 zip.")] = None,
    trusted: Annotated[bool, Option("--trusted", help="Trust the zip, whose code is run.")] = False,
) -> None:
    """Train a policy by PPO, or for lean by imitation, and write it with its learning curve and a card."""
    from surefoot.experiments.policy.tasks import TrainOptions, find_task

    with one_line_errors(out, "the training up to the last checkpoint is kept."):
        try:
            if export is not None:
                from surefoot.experiments.policy.train import POLICY
                from surefoot.experiments.policy.view import export_zip

                export_zip(export, out / POLICY, task=task, trusted=trusted)
                typer.echo(f"Policy: {out / POLICY}")
                return
            given: dict[str, Any] = {} if steps is None else {"steps": steps}
            given |= {"task": task, "sensors": sensors, "seed": seed}
            if find_task(task).imitates:
                _imitate(out, given)
            else:
                _train(out, TrainOptions(**given), restart)
        except ImportError as error:
            fail(f"training needs torch and stable-baselines3 ({error}): pip install 'surefoot[rl]'.")


def _imitate(out: Path, options: dict[str, Any]) -> None:
    from surefoot.experiments.policy.card import write_card
    from surefoot.experiments.policy.imitate import POLICY, Imitation, imitate
    from surefoot.experiments.study.progress import bars

    wanted = Imitation(**options)
    with bars("return {task.fields[reward]:.3f}, fell {task.fields[fell]:.0%}") as bar:
        nothing: Any = {"reward": float("nan"), "fell": float("nan")}
        task = bar.add_task("Training", total=wanted.rounds, **nothing)

        def show(done: int, row: dict[str, float]) -> None:
            bar.update(task, completed=done, reward=row["return"], fell=row["fell"])

        imitate(out, wanted, show)
    typer.echo(f"Policy: {out / POLICY}\nCard: {write_card(out)}")


def _train(out: Path, options: Any, restart: bool) -> None:
    from surefoot.experiments.policy.card import write_card
    from surefoot.experiments.policy.train import BOARD, POLICY, Trainer
    from surefoot.experiments.study.progress import bars

    board = find_spec("tensorboard") is not None
    trainer = Trainer(out, options, restart=restart)
    if trainer.updates:
        typer.echo(f"Continuing after {trainer.updates} of {options.updates} updates.")
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
        fail(f"stopped; the same command continues from the last checkpoint in '{out}'.")
    finally:
        trainer.close()
    typer.echo(f"Policy: {out / POLICY}\nCard: {write_card(out)}")


Policies = Annotated[
    Names, Argument(help=f"{CONTROLLERS}; a .zip of Stable-Baselines3; NAME=POLICY; repeatable.")
]
Feeds = Annotated[
    Names,
    Option("--feed", help="true, raw, weights, tare, quasi-static, window, moment or module:name."),
]
Severities = Annotated[
    Numbers, Option("--severity", help="Factor of the errors; repeatable; by default 0.5, 1, 2, 3.")
]
Faults = Annotated[Names, Option("--fault", help="Fault, dies=0.02, or with its time; repeatable.")]
Scenarios = Annotated[Names, Option(help="payload=1.5, slope=3, friction=0.3, soft=0.05, push=2; repeatable")]


def evaluate(
    ctx: typer.Context,
    env: Annotated[str | None, Argument(help="Id of an environment, or module:function.")] = None,
    policies: Policies = None,
    feeds: Feeds = None,
    severities: Severities = None,
    faults: Faults = None,
    seeds: Annotated[int | None, Option(help="Episodes per combination; by default 50.", min=1)] = None,
    first_seed: Annotated[int | None, Option(help="First seed; by default 20000.", min=0)] = None,
    cells: Annotated[str | None, Option(help="Name or .toml file of a preset of the foot sensors.")] = None,
    soles: Annotated[bool, Option("--soles", help="Flat soles for feet without area.")] = False,
    env_options: Annotated[Names, Option("--option", help="Option of the environment, NAME=VALUE.")] = None,
    scenario: Scenarios = None,
    observe: Annotated[Names, Option(help="Parts for the policy, or module:function.")] = None,
    wrap: Annotated[str | None, Option(help="Wrapper that was used in training, module:Class.")] = None,
    statistics: Annotated[str | None, Option(help="Pickle file of VecNormalize.")] = None,
    trusted: Annotated[bool, Option("--trusted", help="Trust pickles, whose code is run.")] = False,
    settle: Annotated[float | None, Option(help="Time in s before the policy acts.", min=0.0)] = None,
    duration: Annotated[float | None, Option(help="Longest duration of an episode in s.", min=0.0)] = None,
    metrics: Annotated[Names, Option("--metric", help="Entry of info whose mean becomes a column.")] = None,
    config: Annotated[Path | None, Option(help="TOML or JSON file; options override its values.")] = None,
    out: Annotated[Path, Option(help="Folder; a stopped run continues.")] = Path("out/evaluate"),
    case: Annotated[int | None, Option(help="Only repeat this episode of the folder.", min=0)] = None,
    video: Annotated[Path | None, Option(help="Also film that episode into this .mp4.")] = None,
    jobs: Jobs = 2,
    backend: Annotated[str, Option(help="Backend of joblib: loky, dask or ray.")] = "loky",
    address: Annotated[str | None, Option(help="Address of the dask scheduler.")] = None,
    any_version: Annotated[bool, Option("--any-version", help="Continue rows of other versions.")] = False,
    as_json: Json = False,
) -> None:
    """Evaluate policies with true, drifting and calibrated foot sensors on the same episodes."""
    from surefoot.experiments.evaluate.command import Wanted, find_backend, load_config

    if video is not None and (case is None or video.suffix != ".mp4"):
        fail(f"--video films one episode into an .mp4: give --case and such a name, got '{video}'.")
    with one_line_errors(out, "finished episodes are kept."):
        given = {
            name: value
            for name, value in ctx.params.items()
            if name in Wanted.__dataclass_fields__ and value not in (None, False, [], ())
        }
        wanted = Wanted.of({**load_config(config, out, case is not None and not given), **given})
        if case is not None:
            _repeat(wanted, out, case, video, trusted, as_json)
            return
        how: Any = {"jobs": jobs if backend == "loky" else None, "any_version": any_version}
        with find_backend(backend, address):
            try:
                results = wanted.run(out, trusted=trusted, **how)
            except TypeError as error:  # no environment on MuJoCo, or an option that it does not take
                fail(str(error))
    _report(results, as_json)


def _report(results: Any, as_json: bool) -> None:
    from surefoot.experiments.evaluate.page import write_page
    from surefoot.experiments.study.progress import working

    failed = len(results.failed)
    if failed == len(results.rows):
        last = results.failed["error"].iloc[0].splitlines()[-1]
        fail(f"all {failed} episodes failed, the first with '{last}'.", 1)
    with working("drawing the page"):
        report = write_page(results, results.folder)
    kept = len(results.rows) - results.computed
    said = f"{results.answer}\n{results.computed} episodes run, {kept} were there, {failed} failed."
    episodes = {"run": results.computed, "were there": kept, "failed": failed}
    shown = [table for table in report.tables if table.name.startswith("scores")]
    show(shown, {"page": report.page}, said=said, answer=results.answer, episodes=episodes, as_json=as_json)
    if failed:
        raise typer.Exit(1)


def _repeat(wanted: Any, out: Path, case: int, video: Path | None, trusted: bool, as_json: bool) -> None:
    """Repeat one episode, and report whether the result is identical."""
    from surefoot.experiments.evaluate.command import film_case
    from surefoot.experiments.evaluate.episode import OUTCOME
    from surefoot.experiments.evaluate.grid import load_evaluation, repeat
    from surefoot.experiments.study.progress import working
    from surefoot.experiments.study.tables import Verdict, table_of

    with working(f"running case {case} again") as then:
        results = load_evaluation(wanted.plan(trusted=trusted), out)
        repeated = repeat(results, case)
        then("filming it")
        files = {} if video is None else {"film": film_case(results, case, video)}
    columns: dict[str, Any] = {
        "outcome": lambda name: name,
        "now": lambda name: _exact(repeated.now[name]),
        "then": lambda name: _exact(repeated.then[name]),
        "same": lambda name: Verdict.of(name not in repeated.different),
    }
    names = [name for name in (*OUTCOME, "error") if repeated.now[name] != "" or name in repeated.different]
    said = "Different." if repeated.different else "Identical."
    if repeated.other_versions:
        said = f"Versions: {', '.join(repeated.other_versions)}\n{said}"
    facts: Any = {"identical": not repeated.different, "versions": repeated.other_versions}
    table = table_of("repeated", "The episode, to the last digit", columns, names)
    show([table], files, said=said, as_json=as_json, **facts)
    if repeated.different:
        raise typer.Exit(1)


def _exact(value: Any) -> Any:
    from surefoot.experiments.study.tables import Valued

    return Valued.of(str(value), value)
