"""The policies that come with the package."""

from importlib.resources import as_file, files

from surefoot.controllers.policy import PolicyNetwork

__all__ = ["SHIPPED", "shipped_policy"]

SHIPPED = ("true", "randomised")
"""What they were trained on, see :data:`surefoot.experiments.policy.options.SENSORS`."""


def shipped_policy(sensors: str = "true") -> PolicyNetwork:
    """Load one.

    Args:
        sensors: One of :data:`SHIPPED`.

    Raises:
        ValueError: If there is no such policy.
    """
    if sensors not in SHIPPED:
        raise ValueError(
            f"There is no shipped policy '{sensors}'. Available: {', '.join(map(repr, SHIPPED))}."
        )
    with as_file(
        files("surefoot.experiments.policy").joinpath("files", f"balance-{sensors}", "policy.npz")
    ) as path:
        return PolicyNetwork.load(path)
