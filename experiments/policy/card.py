"""The card of a trained policy: what it is, how it was made, how well it does, and what it cannot do."""

import json
import shlex
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.controllers.policy import PolicyNetwork
from surefoot.controllers.posture import POSTURES
from surefoot.experiments.policy.controllers import controller_hash
from surefoot.experiments.policy.options import TRAINING_SEEDS
from surefoot.experiments.policy.tasks import TASKS, Task, task_in, task_named
from surefoot.experiments.policy.train import CURVE, POLICY
from surefoot.experiments.policy.view import input_names
from surefoot.experiments.study.figures import figure_at
from surefoot.experiments.study.files import write_text
from surefoot.experiments.study.tables import Frame

__all__ = ["SCORES", "WHOSE", "draw_curve", "own_scores", "write_card"]

FIGURE, CARD, SCORES = "curve.png", "card.md", "evaluation.csv"

WHOSE = ("controller", "policy file", "task", "seeds")
"""Columns of the scores' file that say whose scores they are; a card has them of one policy."""

_REWARD, _FALLS = "#0072B2", "#D55E00"
"""Colours of a learning curve; those of Okabe and Ito (2008)."""

_LAST_UPDATES = 20
"""Updates at the end of a training that a card sums up."""

_SMOOTHED = 10
"""Updates over which a learning curve is averaged."""


def draw_curve(curve: Frame, path: Path, most: float) -> Path:
    """Draw how reward, of at most ``most`` a decision, and falls went while training."""
    thousands, smooth = curve["steps"] / 1e3, curve.rolling(_SMOOTHED, min_periods=1).mean()
    with figure_at(path, 7.0, 3.0) as figure:
        left, right = figure.subplots(1, 2)
        left.plot(thousands, curve["reward_per_decision"], color=_REWARD, alpha=0.35, linewidth=1)
        left.plot(thousands, smooth["reward_per_decision"], color=_REWARD)
        left.set(xlabel="decisions / 1000", ylabel=f"reward a decision (at most {most:g})")
        right.plot(thousands, 100.0 * smooth["fell"], color=_FALLS)
        right.set(xlabel="decisions / 1000", ylabel="episodes that ended in a fall / %")
    return path


def own_scores(out: Path) -> Frame | None:
    """Return the scores of the policy that lies in a folder.

    Args:
        out: The folder.

    Returns:
        What an evaluation wrote of a controller that is this very file, on the task that it was made for;
        ``None`` if there is nothing of it: scores of an earlier policy, or of others, are not its own.

    Raises:
        FileNotFoundError: If there is no policy.
    """
    task = _task_of(PolicyNetwork.load(out / POLICY))
    try:
        scores: Frame = pd.read_csv(out / SCORES, dtype=str, keep_default_na=False)
    except (FileNotFoundError, ValueError):
        return None
    if not set(WHOSE) <= set(scores.columns):
        return None
    own = scores[
        (scores["policy file"] == controller_hash(str(out / POLICY))) & (scores["task"] == task.name)
    ]
    return own[own["controller"] == own["controller"].iloc[0]] if len(own) else None


def write_card(out: Path) -> Path:
    """Write the card of the policy in a folder, with its scores if they lie there, see :func:`own_scores`.

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
    pieces.append(_scores(own_scores(out), out, task))
    pieces.append(_limits(task))
    write_text(out / CARD, "\n".join(pieces))
    return out / CARD


def _task_of(network: PolicyNetwork) -> Task:
    name = network.notes.get("options", {}).get("task", "balance")
    return task_in(network.notes.get("task")) or task_named(str(name))


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
    last = curve.tail(_LAST_UPDATES)
    reward, fell = last["reward_per_decision"].mean(), 100 * last["fell"].mean()
    return f"""## Learning curve

![Reward and falls while training]({FIGURE})

Over the last {len(last)} of {len(curve)} updates, exploring: {reward:.2f} a decision of at most {most:g},
and {fell:.1f} % of the episodes ended in a fall. The numbers are in `{CURVE}`.
"""


def _scores(scores: Frame | None, out: Path, task: Task) -> str:
    if scores is None:
        asked = "" if task.name == next(iter(TASKS)) else f" --task {task.name}"
        command = f"surefoot evaluate {shlex.quote(str(out / POLICY))}{asked} --out {shlex.quote(str(out))}"
        return f"## Evaluation\n\nNone yet: `{command}` writes it here.\n"
    shown = scores.drop(columns=list(WHOSE))
    lines = ["| " + " | ".join(shown.columns) + " |", "|" + "---|" * len(shown.columns)]
    lines += ["| " + " | ".join(map(str, row)) + " |" for row in shown.itertuples(index=False)]
    table = "\n".join(lines)
    seeds = list(dict.fromkeys(scores["seeds"]))
    episodes = f"the episodes of the seeds {seeds[0]}, the same for all rows"
    if len(seeds) > 1:
        episodes = "episodes that are not the same for all rows"
    return f"""## Evaluation

{table}

Means with 95 % intervals over {episodes},
from the end of the quiet stand on. *Frozen*, *swapped* and *shuffled* rows are the true feet with the
policy's input held, taken from another episode, or from another episode in random order.
"""


def _limits(task: Task) -> str:
    return f"""## Limits

* It knows one robot, {task.limits}
* It was never on a real robot.
* It leaves the robot alone during the quiet stand, and is to be reset when that is over.
"""
