"""What a policy can be trained for, and what differs from one task to the next: one table."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

__all__ = ["TASKS", "Task", "task_in", "task_named"]


@dataclass(frozen=True)
class Task:
    """A task, and how a policy sees it and is trained for it."""

    name: str
    """Short name, for files and the command."""

    env_id: str
    """The environment."""

    title: str
    """What a policy for it is called."""

    scales: Mapping[str, float]
    """Parts of the state that a policy looks at besides the legs' joints, and what counts as much of each, in
    its own unit."""

    training: Mapping[str, Any]
    """Options of the environment while training: without the long stand that calibrators need, and with fewer
    pushes, by which returns differ far more than by anything that a policy tries out."""

    most: float
    """What a step can pay at most."""

    limits: str
    """What a policy for it cannot do."""

    speed: float = 1.5
    """Change of a posture per second at a full command: what a policy shakes its own feet with while it tries
    things out."""

    memory: float = 1.0
    """Time constant in s with which a posture returns."""

    hold: int = 4
    """Steps for which an action holds: a policy decides at 20 Hz, about as fast as a body can follow."""


def _table() -> dict[str, Task]:
    seen = {"tilt": 0.1, "gyroscope": 0.5, "cop_reference": 0.03, "com_reference_velocity": 0.05}
    return {
        task.name: task
        for task in (
            Task(
                "balance",
                "surefoot/NaoBalance-v0",
                "A balance policy",
                MappingProxyType(seen),
                MappingProxyType(
                    {"stand_time": 0.25, "duration": 8.0, "payload_time": (0.1, 1.5), "push_interval": 8.0}
                ),
                most=3.0,
                limits="standing on both feet on flat ground, the loads and pushes of its task, and nothing\n"
                "  else. It does not step, and a push that needs a step is a fall.",
            ),
            Task(
                "walk",
                "surefoot/NaoCarry-v0",
                "A walking policy",
                MappingProxyType({**seen, "com_reference": 0.03, "stance": 1.0, "phase": 1.0}),
                MappingProxyType(
                    {"stand_time": 0.5, "duration": 10.0, "payload_time": (0.5, 4.0), "push_interval": 10.0}
                ),
                most=6.0,
                speed=0.5,
                memory=2.0,
                limits="walking ahead on flat ground, the loads and pushes of its task, and nothing\n"
                "  else. Its feet go where the pattern puts them: a push that needs another step is a fall.",
            ),
        )
    }


TASKS: Mapping[str, Task] = MappingProxyType(_table())
"""All tasks by name; the first is the default."""


def task_named(name: str) -> Task:
    """Look a task up.

    Args:
        name: Its name.

    Raises:
        ValueError: If there is none of the name; the message lists what there is.
    """
    if name not in TASKS:
        raise ValueError(f"There is no task '{name}'. Available: {', '.join(map(repr, TASKS))}.")
    return TASKS[name]


def task_in(env_id: Any) -> Task | None:
    """Look up the task of an environment, by its id; ``None`` if there is none in it."""
    return next((task for task in TASKS.values() if task.env_id == env_id), None)
