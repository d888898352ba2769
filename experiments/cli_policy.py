"""``surefoot train`` and ``surefoot evaluate``: the balance policy."""

from pathlib import Path
from typing import Annotated, Any

import typer

from surefoot.experiments._cli import console, fail

__all__ = ["evaluate", "train"]


def train(
    out: Annotated[
        Path, typer.Option(help="Folder of the training; one that was stopped there goes on.")
    ] = Path("out/policy"),
    sensors: Annotated[
        str, typer.Option(help="CoP trained on: true, or randomised (drifting sensors of every severity).")
    ] = "true",
    seed: Annotated[int, typer.Option(help="Of everything random.", min=0, max=999)] = 0,
    steps: Annotated[int | None, typer.Option(help="Decisions in all; 160 000 by default.", min=1)] = None,
    restart: Annotated[bool, typer.Option("--restart", help="Forget what the folder holds.")] = False,
    export: Annotated[
        Path | None,
        typer.Option(help="Train nothing: turn this Stable-Baselines3 zip into a policy file in --out."),
    ] = None,
    trusted: Annotated[
        bool, typer.Option("--trusted", help="The zip's maker is trusted: opening it runs pickled code.")
    ] = False,
) -> None:
    """Train a balance policy by PPO, and write it with its learning curve and a card."""
    from surefoot.experiments.policy_options import TrainOptions

    try:
        if export is not None:
            from surefoot.experiments.policy_export import export_zip
            from surefoot.experiments.policy_train import POLICY

            export_zip(export, out / POLICY, trusted=trusted)
            typer.echo(f"Policy: {out / POLICY}")
            return
        given: dict[str, Any] = {} if steps is None else {"steps": steps}
        options = TrainOptions(sensors=sensors, seed=seed, **given)
        _train(out, options, restart)
    except (ValueError, FileNotFoundError) as error:
        fail(str(error))
    except ImportError as error:
        fail(f"training needs torch and stable-baselines3 ({error}): pip install 'surefoot[rl]'.")
    except OSError as error:
        fail(
            f"cannot write to '{out}': {error.strerror}; what was trained until the last checkpoint is there."
        )


def _train(out: Path, options: Any, restart: bool) -> None:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from surefoot.experiments.policy_card import write_card
    from surefoot.experiments.policy_train import POLICY, Trainer, forget

    if restart:
        forget(out)
    trainer = Trainer(out, options)
    if trainer.updates:
        console.print(f"Going on after {trainer.updates} of {options.updates} updates.")
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("reward a decision {task.fields[reward]:.3f}, fell {task.fields[fell]:.0%}"),
    )
    try:
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(
                "Training",
                total=options.updates,
                completed=trainer.updates,
                reward=float("nan"),
                fell=float("nan"),
            )
            trainer.run(
                lambda done, row: bar.update(
                    task, completed=done, reward=row["reward_per_decision"], fell=row["fell"]
                )
            )
    except KeyboardInterrupt:
        fail(f"stopped; the same command goes on from the last checkpoint in '{out}'.")
    finally:
        trainer.close()
    typer.echo(f"Policy: {out / POLICY}\nCard: {write_card(out)}")


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
    from surefoot.experiments.policy_card import EVALUATION, write_card
    from surefoot.experiments.policy_env import FEEDS
    from surefoot.experiments.policy_evaluate import COP_INPUTS, count_episodes, run_episodes
    from surefoot.experiments.policy_scores import episodes_frame, score_table
    from surefoot.experiments.policy_shipped import shipped_policy
    from surefoot.experiments.policy_train import POLICY

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
