"""The policies that come with the package."""

from importlib.abc import Traversable
from importlib.resources import as_file, files
from types import MappingProxyType

from surefoot.controllers.policy import PolicyNetwork
from surefoot.experiments.policy.tasks import task_named

__all__ = ["SHIPPED", "shipped_file", "shipped_policy"]

SHIPPED = MappingProxyType({"balance": ("true", "randomised"), "walk": ("true", "randomised")})
"""What they were trained on for each task, see :data:`surefoot.experiments.policy.options.SENSORS`."""


def shipped_file(task: str, sensors: str) -> Traversable:
    """Return the file of one, which need not exist."""
    return files("surefoot.experiments.policy").joinpath("files", f"{task}-{sensors}", "policy.npz")


def shipped_policy(sensors: str = "true", task: str = "balance") -> PolicyNetwork:
    """Return one of them.

    Args:
        sensors: What it was trained on, one of those of its task in :data:`SHIPPED`.
        task: One of :data:`surefoot.experiments.policy.tasks.TASKS`.

    Raises:
        ValueError: If there is no such policy.
    """
    shipped = SHIPPED.get(task_named(task).name, ())
    if sensors not in shipped:
        raise ValueError(
            f"There is no shipped policy '{sensors}' for the task '{task}'. Available: "
            f"{', '.join(map(repr, shipped))}."
        )
    with as_file(shipped_file(task, sensors)) as path:
        return PolicyNetwork.load(path)
