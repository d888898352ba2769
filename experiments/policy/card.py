"""The card of a trained policy: how it was made, and its limits."""

import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, StrictUndefined

from surefoot.controllers.policy import PolicyNetwork
from surefoot.controllers.posture import POSTURES
from surefoot.experiments.policy.tasks import TASKS, TRAINING_SEEDS, find_task, task_in
from surefoot.experiments.policy.train import CURVE, POLICY
from surefoot.experiments.policy.view import input_names
from surefoot.experiments.study.figures import figure_at
from surefoot.experiments.study.tables import Frame
from surefoot.files import write_text

FIGURE, CARD = "curve.png", "card.md"
_REWARD, _FALLS = "#0072B2", "#D55E00"  # of a learning curve

_TRAINED = {
    "true": "the true centre of pressure, joints and tilt from encoders and IMU with their errors",
    "randomised": "drifting, uncalibrated load cells, of severity 0 to 2",
    "history": "drifting, uncalibrated load cells, of severity 0 to 2, and traces of their past readings",
    "blind": "no feet",
}
"""What a policy was trained on, in words."""

_LAST_UPDATES = 20  # updates at the end of a training that a card sums up
_SMOOTHED = 10  # updates over which a learning curve is averaged


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


def write_card(out: Path) -> Path:
    """Write the card of the policy in a folder; raise FileNotFoundError without one."""
    network = PolicyNetwork.load(out / POLICY)
    notes = network.notes
    options: dict[str, Any] = notes.get("options", {})
    task = task_in(notes.get("task")) or find_task(str(options.get("task", "balance")))
    curve, most = None, task.most * network.hold
    if (out / CURVE).exists():
        curve = pd.read_csv(out / CURVE)
        if not task.imitates:
            draw_curve(curve, out / FIGURE, most)
    sensors = options.get("sensors", "unknown")
    sizes = (sum(network.parts.values()), *(len(layer) for layer in network.biases))
    asked = {"task": task.name} if task.name != next(iter(TASKS)) else {}
    trained = {**asked, "sensors": sensors, **{name: options.get(name) for name in ("seed", "steps")}}
    template = files("surefoot.experiments.policy").joinpath(CARD).read_text(encoding="utf-8")
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True)
    text = environment.from_string(template).render(
        task=task,
        notes=notes,
        network=network,
        trained=_TRAINED.get(sensors, "feet that nobody wrote down"),
        train_command=" ".join(["surefoot train", *_options(trained)]),
        shapes=" → ".join(map(str, sizes)),
        versions=", ".join(f"{name} {version}" for name, version in notes.get("versions", {}).items()),
        training_seeds=TRAINING_SEEDS,
        options=json.dumps(options, sort_keys=True),
        looks=", ".join(f"`{part}` ({size})" for part, size in network.parts.items()),
        inputs=", ".join(input_names(task, blind=sensors == "blind")),
        postures=POSTURES,
        curve=curve,
        last=None if curve is None else curve.tail(_LAST_UPDATES),
        most=most,
        figure=FIGURE,
        curve_file=CURVE,
    )
    write_text(out / CARD, text)
    return out / CARD


def _options(values: Mapping[str, Any]) -> list[str]:
    return [f"--{name} {value}" for name, value in values.items()]
