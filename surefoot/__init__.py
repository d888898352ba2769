"""Honest models of the sensors that biped robots stand on, and calibrators that undo their errors.

``import surefoot`` needs no simulator. Where Gymnasium and MuJoCo are installed it registers the
``surefoot/...`` environments as soon as Gymnasium is imported; elsewhere it offers
:mod:`surefoot.calibration` and :mod:`surefoot.sensors` alone.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surefoot import calibration, controllers, envs, experiments, robot, sensors, wrappers

    __version__: str

__all__ = ["calibration", "controllers", "envs", "experiments", "robot", "sensors", "wrappers"]


def __getattr__(name: str) -> Any:
    """Import a subpackage when it is first asked for, and look up which version is installed."""
    if name == "__version__":
        return import_module("importlib.metadata").version("surefoot")
    if name in __all__:
        return import_module(f"surefoot.{name}")
    raise AttributeError(f"module 'surefoot' has no attribute '{name}'")


if find_spec("gymnasium") is not None and find_spec("mujoco") is not None:
    import_module("surefoot.registration").register_with_gymnasium()
