"""Honest models of the sensors that biped robots stand on, and calibrators that undo their errors.

``import surefoot`` needs no simulator. Where Gymnasium and MuJoCo are installed it registers the
``surefoot/...`` environments as soon as Gymnasium is imported; elsewhere it offers
:mod:`surefoot.calibration` and :mod:`surefoot.sensors` alone.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from surefoot.extras import not_installed

if TYPE_CHECKING:
    from surefoot import calibration, controllers, envs, experiments, robot, sensors, wrappers
    from surefoot.experiments.evaluate import evaluate

    __version__: str

__all__ = ["calibration", "controllers", "envs", "evaluate", "experiments", "robot", "sensors", "wrappers"]


def __getattr__(name: str) -> Any:
    """Import a subpackage, or `evaluate`, when it is first asked for, and look up the installed version."""
    if name == "__version__":
        return import_module("importlib.metadata").version("surefoot")
    if name == "evaluate":
        try:
            return import_module("surefoot.experiments.evaluate").evaluate
        except ModuleNotFoundError as missing:
            raise not_installed("surefoot.evaluate", missing, "experiments") from None
    if name in __all__:
        return import_module(f"surefoot.{name}")
    raise AttributeError(f"module 'surefoot' has no attribute '{name}'")


if find_spec("gymnasium") is not None and find_spec("mujoco") is not None:
    import_module("surefoot.registration").register_with_gymnasium()
