"""``surefoot train``: a policy that acts on the centre of pressure."""

from dataclasses import asdict
from importlib.util import find_spec
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
    wandb: Annotated[
        str | None, Option(help="Also log to this project of Weights & Biases.", metavar="PROJECT")
    ] = None,
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
            _train(out, TrainOptions(task=task, sensors=sensors, seed=seed, **given), restart, wandb)
        except ImportError as error:
            fail(f"training needs torch and stable-baselines3 ({error}): pip install 'surefoot[rl]'.")


def _train(out: Path, options: Any, restart: bool, project: str | None) -> None:
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
        callbacks = [] if project is None else [_wandb(project, out, options)]
        with bars("reward a decision {task.fields[reward]:.3f}, fell {task.fields[fell]:.0%}") as bar:
            nothing: Any = {"reward": float("nan"), "fell": float("nan")}
            task = bar.add_task("Training", total=options.updates, completed=trainer.updates, **nothing)

            def show(done: int, row: dict[str, float]) -> None:
                bar.update(task, completed=done, reward=row["reward_per_decision"], fell=row["fell"])

            trainer.run(show, board=board, callbacks=callbacks)
    except KeyboardInterrupt:
        fail(f"stopped; the same command goes on from the last checkpoint in '{out}'.")
    finally:
        trainer.close()
    typer.echo(f"Policy: {out / POLICY}\nCard: {write_card(out)}")


def _wandb(project: str, out: Path, options: Any) -> Any:
    """Begin a run of Weights & Biases, which is sent the same as TensorBoard; return its callback."""
    try:
        import tensorboard  # noqa: F401
        import wandb
        from wandb.integration.sb3 import WandbCallback
    except ImportError as error:
        fail(f"--wandb needs {error.name}, which is missing: pip install wandb tensorboard.")
    wandb.init(project=project, name=out.name, config=asdict(options), dir=str(out), sync_tensorboard=True)
    return WandbCallback()
