"""``surefoot evaluate``: controllers on true, drifting and calibrated feet."""

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


def evaluate(
    ctx: typer.Context,
    controllers: Annotated[Names, Argument(help=f"{CONTROLLERS}; the shipped policy by default.")] = None,
    task: Annotated[str, Option(help="balance, walk, balance-hard or walk-hard.")] = "balance",
    feed: Feeds = None,
    severity: Annotated[
        Numbers, Option(help="How bad the sensors are; again for more. 1 by default.")
    ] = None,
    seeds: Annotated[int, Option(help="Episodes of each.", min=1)] = 50,
    first_seed: Annotated[int, Option(help="Seed of the first of them.", min=0)] = 20_000,
    uses_cop: Annotated[bool, Option("--uses-cop", help="Also freeze, swap and shuffle the CoP.")] = False,
    out: Annotated[Path | None, Option(help="Folder for the results; an interrupted one goes on.")] = None,
    page_of: Annotated[Names, Option(help="Only a page of FILE or CONTROLLER=FILE; again for more.")] = None,
    jobs: Jobs = 1,
    as_json: Json = False,
) -> None:
    """Score controllers on true, drifting and calibrated feet, on the same episodes."""
    from surefoot.experiments.episodes.episode import COP_INPUTS
    from surefoot.experiments.episodes.plan import evaluation_plan
    from surefoot.experiments.episodes.rows import in_order
    from surefoot.experiments.episodes.run import run_plan

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
        "cop_inputs": COP_INPUTS if uses_cop else (),
    }
    chosen = {name: value for name, value in given.items() if value}
    with one_line_errors(out, "give another folder with --out, or make room."):
        plan = evaluation_plan(seeds=seeds, first_seed=first_seed, task=task, **chosen)
        results = run_plan(plan, out, jobs=jobs, retry_failed=True)
        _report(in_order(results.rows, chosen.get("controllers", ())), out, as_json)


def _was_given(ctx: typer.Context, name: str) -> bool:
    """Return whether the command names something that is to be run."""
    source = ctx.get_parameter_source(name)
    return name not in ("page_of", "out", "as_json") and source is not None and source.name != "DEFAULT"


def _page_of(named: list[str], out: Path | None, as_json: bool) -> None:
    import pandas as pd

    from surefoot.experiments.episodes.rows import read_episodes

    if out is None:
        fail("--page-of needs a folder for the page; give one with --out.")
    with one_line_errors(out):
        # A path that holds a '=' is a path if it is there.
        parts = [("", "", text) if Path(text).exists() else text.rpartition("=") for text in named]
        frames = [read_episodes(Path(path), controller) for controller, _, path in parts]
        _report(pd.concat(frames, ignore_index=True), out, as_json)


def _report(frame: Any, out: Path | None, as_json: bool) -> None:
    """Print the scores and, into a folder, write them, a page, and the card of a policy that they are of."""
    from surefoot.experiments.episodes.page import check_episodes, write_evaluation
    from surefoot.experiments.episodes.tables import score_table
    from surefoot.experiments.policy.card import own_scores, write_card
    from surefoot.experiments.policy.train import POLICY
    from surefoot.experiments.study.progress import working

    frame, failed = check_episodes(frame)
    files: dict[str, Path] = {}
    if out is not None:
        with working("drawing the page"):
            files["page"] = write_evaluation(frame, failed, out).page
        if (out / POLICY).is_file() and own_scores(out) is not None:
            files["card"] = write_card(out)
    show([score_table(frame)], files, as_json=as_json)
