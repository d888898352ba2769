"""The policies that come with the package."""

from importlib.resources import as_file, files
from types import MappingProxyType

from surefoot.controllers.policy import PolicyNetwork
from surefoot.experiments.policy.tasks import task_named

__all__ = ["SHIPPED", "shipped_policy"]

SHIPPED = MappingProxyType({"balance": ("true", "randomised"), "walk": ("true", "randomised")})
"""What they were trained on for each task, see :data:`surefoot.experiments.policy.options.SENSORS`."""


def shipped_policy(sensors: str = "true", task: str = "balance") -> PolicyNetwork:
    """Load one.

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
    with as_file(
        files("surefoot.experiments.policy").joinpath("files", f"{task}-{sensors}", "policy.npz")
    ) as path:
        return PolicyNetwork.load(path)
