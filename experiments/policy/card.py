"""The card of a trained policy: what it is, how it was made, how well it does, and what it cannot do."""

import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.controllers.policy import PolicyNetwork
from surefoot.controllers.posture import POSTURES
from surefoot.experiments.policy.controllers import controller_hash
from surefoot.experiments.policy.env import input_names
from surefoot.experiments.policy.options import TRAINING_SEEDS
from surefoot.experiments.policy.origin import Origin
from surefoot.experiments.policy.scores import controllers_of, score_table, seeds_text
from surefoot.experiments.policy.tasks import TASKS, Task, task_in, task_named
from surefoot.experiments.policy.train import CURVE, POLICY
from surefoot.experiments.study.files import atomic_path, write_text
from surefoot.experiments.study.tables import Frame

__all__ = ["draw_curve", "own_scores", "write_card", "write_scores"]

FIGURE, CARD, EVALUATION = "curve.png", "card.md", "evaluation.csv"

_WHOSE = ("controller", "policy file", "task", "seeds")
"""Columns of the scores' file that say whose scores they are; a card has them of one policy."""


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


def write_scores(out: Path, frame: Frame, origins: Mapping[str, Origin]) -> Path:
    """Write the scores of an evaluation into a folder, with whose they are.

    Args:
        out: The folder.
        frame: Of :func:`~surefoot.experiments.policy.scores.episodes_frame`, of one task.
        origins: What is known of the controllers.
    """
    parts = []
    for name in controllers_of(frame):
        own = frame[frame["controller"] == name]
        scores = score_table(own).to_frame()
        rows = own.groupby(["feed", "cop_input", "severity"], sort=False)["seed"]
        whose = (
            name,
            origins.get(name, Origin()).file,
            own["task"].iloc[0],
            [seeds_text(s) for _, s in rows],
        )
        for place, (column, value) in enumerate(zip(_WHOSE, whose, strict=True)):
            scores.insert(place, column, value)
        parts.append(scores)
    with atomic_path(out / EVALUATION) as path:
        pd.concat(parts).to_csv(path, index=False)
    return out / EVALUATION


def own_scores(out: Path) -> Frame | None:
    """Read the scores of the policy that lies in a folder.

    Args:
        out: The folder.

    Returns:
        What :func:`write_scores` wrote of a controller that is this very file, on the task that it was made
        for; ``None`` if there is nothing of it: scores of an earlier policy, or of others, are not its own.

    Raises:
        FileNotFoundError: If there is no policy.
    """
    task = _task_of(PolicyNetwork.load(out / POLICY))
    try:
        scores: Frame = pd.read_csv(out / EVALUATION, dtype=str, keep_default_na=False)
    except (FileNotFoundError, ValueError):
        return None
    if not set(_WHOSE) <= set(scores.columns):
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
    last = curve.tail(20)
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
    shown = scores.drop(columns=list(_WHOSE))
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
