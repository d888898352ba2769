"""``surefoot train``: a policy that acts on the centre of pressure."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from surefoot.experiments.cli.console import fail, one_line_errors


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
    from surefoot.experiments.policy.options import TrainOptions

    with one_line_errors(out, "what was trained until the last checkpoint is there."):
        try:
            if export is not None:
                from surefoot.experiments.policy.export import export_zip
                from surefoot.experiments.policy.train import POLICY

                export_zip(export, out / POLICY, task=task, trusted=trusted)
                typer.echo(f"Policy: {out / POLICY}")
                return
            given: dict[str, Any] = {} if steps is None else {"steps": steps}
            _train(out, TrainOptions(task=task, sensors=sensors, seed=seed, **given), restart)
        except ImportError as error:
            fail(f"training needs torch and stable-baselines3 ({error}): pip install 'surefoot[rl]'.")


def _train(out: Path, options: Any, restart: bool) -> None:
    from surefoot.experiments.policy.card import write_card
    from surefoot.experiments.policy.train import POLICY, Trainer
    from surefoot.experiments.study.progress import bars

    trainer = Trainer(out, options, restart=restart)
    if trainer.updates:
        typer.echo(f"Going on after {trainer.updates} of {options.updates} updates.")
    try:
        with bars("reward a decision {task.fields[reward]:.3f}, fell {task.fields[fell]:.0%}") as bar:
            nothing: Any = {"reward": float("nan"), "fell": float("nan")}
            task = bar.add_task("Training", total=options.updates, completed=trainer.updates, **nothing)

            def show(done: int, row: dict[str, float]) -> None:
                bar.update(task, completed=done, reward=row["reward_per_decision"], fell=row["fell"])

            trainer.run(show)
    except KeyboardInterrupt:
        fail(f"stopped; the same command goes on from the last checkpoint in '{out}'.")
    finally:
        trainer.close()
    typer.echo(f"Policy: {out / POLICY}\nCard: {write_card(out)}")
