"""The card of a trained policy: what it is, how it was made, how well it does, and what it cannot do."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.controllers.policy import PolicyNetwork
from surefoot.controllers.posture import POSTURES
from surefoot.experiments._files import atomic_path, write_text
from surefoot.experiments.policy.env import input_names
from surefoot.experiments.policy.options import TRAINING_SEEDS
from surefoot.experiments.policy.tasks import TASKS, Task, task_named
from surefoot.experiments.policy.train import CURVE, POLICY

__all__ = ["draw_curve", "write_card"]

FIGURE, CARD, EVALUATION = "curve.png", "card.md", "evaluation.csv"


def draw_curve(curve: pd.DataFrame, path: Path, most: float) -> Path:
    """Draw how reward, of at most ``most`` a decision, and falls went while training."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"axes.grid": True, "grid.alpha": 0.3, "font.size": 9}):
        figure = Figure(figsize=(7.0, 3.0), layout="constrained")
        left, right = figure.subplots(1, 2)
        thousands = curve["steps"] / 1e3
        left.plot(thousands, curve["reward_per_decision"], color="#0072B2", alpha=0.35, linewidth=1)
        smooth = curve["reward_per_decision"].rolling(10, min_periods=1).mean()
        left.plot(thousands, smooth, color="#0072B2")
        left.set(xlabel="decisions / 1000", ylabel=f"reward a decision (at most {most:g})")
        falls = 100.0 * curve["fell"].rolling(10, min_periods=1).mean()
        right.plot(thousands, falls, color="#D55E00")
        right.set(xlabel="decisions / 1000", ylabel="episodes that ended in a fall / %")
        with atomic_path(path) as part:
            figure.savefig(part, dpi=150, format="png")
    return path


def write_card(out: Path) -> Path:
    """Write the card of the policy in a folder, with the evaluation that lies there, if one does.

    Args:
        out: The folder of a finished training.

    Raises:
        FileNotFoundError: If there is no policy.
    """
    network = PolicyNetwork.load(out / POLICY)
    curve_path = out / CURVE
    task = _task_of(network)
    most = task.most * network.hold
    pieces = [_made(network, task)]
    if curve_path.exists():
        curve = pd.read_csv(curve_path)
        draw_curve(curve, out / FIGURE, most)
        pieces.append(_curve(curve, most))
    evaluation = out / EVALUATION
    pieces.append(
        _scores(pd.read_csv(evaluation, dtype=str, keep_default_na=False) if evaluation.exists() else None)
    )
    pieces.append(_limits(task))
    write_text(out / CARD, "\n".join(pieces))
    return out / CARD


def _task_of(network: PolicyNetwork) -> Task:
    name = network.notes.get("options", {}).get("task", "balance")
    return task_named(str(name))


def _made(network: PolicyNetwork, task: Task) -> str:
    notes = network.notes
    options: dict[str, Any] = notes.get("options", {})
    shapes = " → ".join(
        str(size) for size in (sum(network.parts.values()), *(len(b) for b in network.biases))
    )
    versions = ", ".join(f"{name} {version}" for name, version in notes.get("versions", {}).items())
    sensors = options.get("sensors", "unknown")
    trained = {
        "true": "the true centre of pressure, joints and tilt from encoders and IMU with their errors",
        "randomised": "drifting, uncalibrated load cells, of severity 0 to 2",
    }.get(sensors, "feet that nobody wrote down")
    asked = {"task": task.name} if task.name != next(iter(TASKS)) else {}
    asked |= {"sensors": sensors} | {name: options.get(name) for name in ("seed", "steps")}
    command = " ".join(["surefoot train", *(f"--{name} {value}" for name, value in asked.items())])
    looks = ", ".join(f"`{part}` ({size})" for part, size in network.parts.items())
    return f"""# {task.title} for `{notes.get("task", "an unknown task")}`

| | |
|---|---|
| trained on | {trained} |
| command | `{command}` |
| decisions | {notes.get("steps", "?")}, each held for {network.hold} steps of {1e3 * network.drive.dt:g} ms |
| method | PPO of Stable-Baselines3 with state-dependent exploration |
| network | {shapes}, tanh; scaling of the inputs folded into the first layer |
| versions | {versions} |
| seeds | training draws from {TRAINING_SEEDS} on, evaluation below |
| options | `{json.dumps(options, sort_keys=True)}` |

**It looks at** {looks} of an observation, in these numbers:
{", ".join(input_names(task))}.

**It commands** the speeds of {len(POSTURES)} postures ({", ".join(POSTURES)}), up to
{network.drive.speed:g} of a full posture (0.2 rad) a second, which return with a time constant of
{network.drive.memory:g} s.
"""


def _curve(curve: pd.DataFrame, most: float) -> str:
    last = curve.tail(20)
    reward, fell = last["reward_per_decision"].mean(), 100 * last["fell"].mean()
    return f"""## Learning curve

![Reward and falls while training]({FIGURE})

Over the last {len(last)} of {len(curve)} updates, exploring: {reward:.2f} a decision of at most {most:g},
and {fell:.1f} % of the episodes ended in a fall. The numbers are in `{CURVE}`.
"""


def _scores(scores: pd.DataFrame | None) -> str:
    if scores is None:
        return "## Evaluation\n\nNone yet: `surefoot evaluate` writes it here.\n"
    lines = ["| " + " | ".join(scores.columns) + " |", "|" + "---|" * len(scores.columns)]
    lines += ["| " + " | ".join(map(str, row)) + " |" for row in scores.itertuples(index=False)]
    table = "\n".join(lines)
    return f"""## Evaluation

{table}

Means with 95 % intervals over the same episodes for all rows, from the end of the quiet stand on. *Frozen*,
*swapped* and *shuffled* rows are the true feet with the policy's input held, taken from another episode, or
from another episode in random order.
"""


def _limits(task: Task) -> str:
    return f"""## Limits

* It knows one robot, {task.limits}
* It was never on a real robot.
* It leaves the robot alone during the quiet stand, and is to be reset when that is over.
"""
