"""``surefoot evaluate``: a policy on true, drifting and calibrated feet."""

from pathlib import Path
from typing import Annotated

import typer

from surefoot.experiments._cli import console, fail

__all__ = ["evaluate"]


def evaluate(
    policy: Annotated[
        Path | None, typer.Argument(help="A policy file; the one that is shipped by default.")
    ] = None,
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
        Path | None, typer.Option(help="Folder for episodes, scores and, beside a policy, its card.")
    ] = None,
    jobs: Annotated[int, typer.Option(help="Processes that work at the same time.", min=1)] = 1,
) -> None:
    """Score a balance policy on true, drifting and calibrated feet, on the same episodes."""
    from rich.progress import track

    from surefoot.controllers.policy import PolicyNetwork
    from surefoot.experiments._files import atomic_path
    from surefoot.experiments.policy.card import EVALUATION, write_card
    from surefoot.experiments.policy.env import FEEDS
    from surefoot.experiments.policy.evaluate import COP_INPUTS, count_episodes, run_episodes
    from surefoot.experiments.policy.scores import episodes_frame, score_table
    from surefoot.experiments.policy.shipped import shipped_policy
    from surefoot.experiments.policy.train import POLICY

    inputs = COP_INPUTS if uses_cop else COP_INPUTS[:1]
    feeds, severities = feed or list(FEEDS), severity or [1.0]
    try:
        network = shipped_policy() if policy is None else PolicyNetwork.load(policy)
        numbers = range(first_seed, first_seed + seeds)
        episodes = run_episodes(network, feeds, numbers, severities, cop_inputs=inputs, jobs=jobs)
        total = count_episodes(feeds, numbers, severities, inputs)
        results = list(track(episodes, "Episodes", total, console=console))
        frame = episodes_frame(results)
        table = score_table(frame)
        console.print(table.to_rich())
        if out is not None:
            with atomic_path(out / "episodes.parquet") as part:
                frame.to_parquet(part, index=False)
            with atomic_path(out / EVALUATION) as part:
                table.to_frame().to_csv(part, index=False)
            if (out / POLICY).exists():
                typer.echo(f"Card: {write_card(out)}")
    except (ValueError, FileNotFoundError) as error:
        fail(str(error))
    except OSError as error:
        fail(f"cannot write to '{out}': {error.strerror}; give another folder with --out.")
