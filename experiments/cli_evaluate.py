"""``surefoot evaluate``: controllers on true, drifting and calibrated feet."""

from pathlib import Path
from typing import Annotated, Any

import typer

from surefoot.experiments._cli import console, fail

__all__ = ["evaluate"]


def evaluate(
    controllers: Annotated[
        list[str] | None,
        typer.Argument(
            help="shipped, shipped-randomised, stabiliser, zero, a policy file .npz, or module:function, "
            "which is imported and run; the shipped policy by default."
        ),
    ] = None,
    task: Annotated[str, typer.Option(help="balance or walk.")] = "balance",
    feed: Annotated[
        list[str] | None,
        typer.Option(
            help="true, none (drifting raw), bench, quasi-static, window or surefoot; again for more."
        ),
    ] = None,
    severity: Annotated[
        list[float] | None, typer.Option(help="How bad the feet's sensors are; again for more. 1 by default.")
    ] = None,
    seeds: Annotated[int, typer.Option(help="Episodes of each.", min=2)] = 50,
    first_seed: Annotated[int, typer.Option(help="Seed of the first of them.", min=0)] = 20_000,
    uses_cop: Annotated[
        bool, typer.Option("--uses-cop", help="Also freeze, swap and shuffle the CoP that it is given.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for episodes, scores, a page and, beside a policy, its card; an interrupted "
            "evaluation goes on."
        ),
    ] = None,
    page_of: Annotated[
        list[str] | None,
        typer.Option(
            help="Run nothing: make a page in --out of episodes that are there, FILE or CONTROLLER=FILE; "
            "again for more."
        ),
    ] = None,
    jobs: Annotated[int, typer.Option(help="Processes that work at the same time.", min=1)] = 1,
) -> None:
    """Score controllers on true, drifting and calibrated feet, on the same episodes."""
    from rich.progress import track

    from surefoot.experiments.policy.evaluate import COP_INPUTS
    from surefoot.experiments.policy.evaluation import Evaluation, EvaluationFolder, made_with

    if page_of:
        _page_of(page_of, out)
        return
    given: dict[str, Any] = {
        "controllers": tuple(controllers or ()),
        "feeds": tuple(feed or ()),
        "severities": tuple(severity or ()),
        "cop_inputs": COP_INPUTS if uses_cop else (),
    }
    chosen = {name: value for name, value in given.items() if value}
    try:
        evaluation = Evaluation(seeds=seeds, first_seed=first_seed, task=task, **chosen)
        with EvaluationFolder(out, evaluation).opened() as folder:
            for _ in track(folder.run(jobs), "Episodes", folder.missing, console=console):
                pass
        _report(folder.frame, out, made_with(out) if out is not None else "")
    except KeyboardInterrupt:
        kept = "" if out is None else f" What is finished is kept in '{out}', and the same command goes on."
        typer.echo(f"Stopped.{kept}", err=True)
        raise typer.Exit(130) from None
    except (ValueError, FileNotFoundError) as error:
        fail(str(error))
    except OSError as error:
        fail(f"cannot write to '{out}': {error.strerror}; give another folder with --out, or make room.")


def _page_of(named: list[str], out: Path | None) -> None:
    import pandas as pd

    from surefoot.experiments.policy.evaluation import made_with, read_episodes

    if out is None:
        fail("--page-of needs a folder for the page; give one with --out.")
    try:
        # A path that holds a '=' is a path if it is there.
        parts = [("", "", text) if Path(text).exists() else text.rpartition("=") for text in named]
        frames = [read_episodes(Path(path), controller) for controller, _, path in parts]
        versions = dict.fromkeys(made_with(Path(path)) for _, _, path in parts)
        _report(pd.concat(frames, ignore_index=True), out, "; ".join(filter(None, versions)))
    except (ValueError, FileNotFoundError) as error:
        fail(str(error))
    except OSError as error:
        fail(f"cannot write to '{out}': {error.strerror}; give another folder with --out.")


def _report(frame: Any, out: Path | None, versions: str) -> None:
    """Print the scores and, into a folder, write them, a page, and the card of a policy that lies there."""
    from surefoot.experiments._files import atomic_path
    from surefoot.experiments.controllers_by_name import trained_on
    from surefoot.experiments.policy.card import EVALUATION, write_card
    from surefoot.experiments.policy.page import EvaluationPage
    from surefoot.experiments.policy.scores import controllers_of, score_table
    from surefoot.experiments.policy.train import POLICY

    trained = {name: trained_on(name) for name in controllers_of(frame)}
    page = EvaluationPage(frame, trained, versions)
    table = score_table(frame)
    console.print(table.to_rich())
    if out is None:
        return
    with atomic_path(out / EVALUATION) as part:
        table.to_frame().to_csv(part, index=False)
    if (out / POLICY).exists():
        typer.echo(f"Card: {write_card(out)}")
    typer.echo(f"Page: {page.write(out)}")
