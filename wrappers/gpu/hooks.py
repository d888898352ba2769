"""Foot sensors as the hooks that manager-based simulators publish, without importing any of them.

Each function makes a class for a manager to build, over a base class that the caller brings along:

| Simulator | Hook | Base class | Made by |
|---|---|---|---|
| Isaac Lab | modifier: ``cls(cfg, data_dim, device)``, ``reset(env_ids)``, ``(data)`` | ``isaaclab.utils.modifiers.ModifierBase`` | :func:`modifier_class` |
| Isaac Lab | noise model: ``cls(cfg, num_envs, device)``, ``reset(env_ids)``, ``(data)`` | ``isaaclab.utils.noise.NoiseModel`` | :func:`noise_model_class` |
| mjlab | the same | ``mjlab.utils.noise.noise_model.NoiseModel`` | :func:`noise_model_class` |
| Isaac Lab | observation term: ``cls(cfg, env)``, ``reset(env_ids)``, ``(env)`` | ``isaaclab.managers.ManagerTermBase`` | :func:`observation_term_class` |
| mjlab | the same | none is needed | :func:`observation_term_class` |

Written against Isaac Lab 2 and 3 (``ModifierBase``, ``NoiseModel``, ``ManagerTermBase`` and
``ObservationManager`` of the extension ``isaaclab``, last read at 3.5.3), and run in mjlab 1.6.0
(``examples/mjlab_g1.py``). Their observation managers call term, modifiers and noise model in this order, then clip and scale *in place*, for each group;
Isaac Lab's environment does so twice within a step while it records, before and after the resets.

Neither a modifier nor a noise model is given the environment, and so not the step: give the module a
``counter``. A manager copies its configuration deeply, but not classes: several terms that are built from
classes over one module share its sensors.
"""  # noqa: E501

from collections.abc import Callable
from typing import Any

from torch import Tensor

from surefoot.wrappers.gpu.batch import BatchModule, RobotIds
from surefoot.wrappers.gpu.foot_sensors import FootSensorsModule

Feet = FootSensorsModule | Callable[[int, str], FootSensorsModule]
"""A module, or what makes one of the number of robots and the device when the manager asks for it."""

UNITS = ("N", "count")
"""What a hook puts out: forces by the data sheet (N, and N m of six-axis sensors), or the readings."""


def modifier_class(feet: Feet, base: type = object, *, unit: str = "N", fresh: bool = False) -> type[Any]:
    """Make a modifier of an observation that holds the true forces.

    Args:
        feet: The sensors, or a function that makes them.
        base: The simulator's base class of modifiers.
        unit: The unit of the result, one of :data:`UNITS`.
        fresh: Whether a robot gets other sensors at each reset.

    Returns:
        A class for ``ModifierCfg(func=...)``; its instances hold the sensors as ``feet``.

    Raises:
        ValueError: If the unit is none; when built, if the observation is of other robots or channels.
    """

    class FootSensorsModifier(_sensing_class(base, unit, fresh)):  # type: ignore[misc]
        """Sensors between true forces and who observes them."""

        def __init__(self, cfg: Any, data_dim: tuple[int, ...], device: str) -> None:
            super().__init__(cfg, data_dim, device)
            self.feet = _make_feet(feet, data_dim[0], device)
            if tuple(data_dim) != (self.feet.num_envs, self.feet.channels):
                raise ValueError(
                    f"The sensors read forces of shape {(self.feet.num_envs, self.feet.channels)}, but the "
                    f"observation has {tuple(data_dim)}; modify the term that holds the true forces."
                )

    return FootSensorsModifier


def noise_model_class(feet: Feet, base: type = object, *, unit: str = "N", fresh: bool = False) -> type[Any]:
    """Make a noise model of an observation that holds the true forces.

    Args:
        feet: The sensors, or a function that makes them.
        base: The simulator's base class of noise models, of which its manager asks for a subclass.
        unit: The unit of the result, one of :data:`UNITS`.
        fresh: Whether a robot gets other sensors at each reset.

    Returns:
        A class for ``NoiseModelCfg(class_type=...)`` in Isaac Lab and for
        ``class FeetCfg(NoiseModelCfg, class_type=...)`` in mjlab; its instances hold the sensors as ``feet``.

    Raises:
        ValueError: If the unit is none; when built, if the sensors are of another number of robots.
    """

    class FootSensorsNoiseModel(_sensing_class(base, unit, fresh)):  # type: ignore[misc]
        """Sensors between true forces and who observes them."""

        def __init__(self, noise_model_cfg: Any, num_envs: int, device: str) -> None:
            super().__init__(noise_model_cfg, num_envs, device)
            self.feet = _make_feet(feet, num_envs, device)

    return FootSensorsNoiseModel


def observation_term_class(
    read: Callable[[Any], Tensor], *modules: BatchModule, base: type = object, fresh: bool = False
) -> type[Any]:
    """Make an observation term of any function of the environment, and let the manager reset its modules.

    The function asks the modules with the number of the environment's step, and so gets the same answer
    however often the manager asks within it:

        def force(env):
            counts = feet(true_force(env), step=env.common_step_counter)
            return calibrator(counts, beliefs(env), step=env.common_step_counter).force

    Args:
        read: Takes the environment and hands back the observation, shape (N, ...).
        modules: The modules that it asks.
        base: The simulator's base class of terms, if its manager asks for a subclass.
        fresh: Whether sensors and calibration are fresh at each reset.

    Returns:
        A class for ``ObservationTermCfg(func=...)``.
    """

    class FeetTerm(base):  # type: ignore[misc]
        """The robots' observations of their feet."""

        def __init__(self, cfg: Any, env: Any) -> None:
            # Base classes keep these two and no more, but do not agree on which are handed to them.
            self.cfg, self._env = cfg, env
            for module in modules:
                _check_robots(module, env.num_envs)

        def reset(self, env_ids: RobotIds = None) -> None:
            for module in modules:
                module.reset(env_ids, fresh)

        def __call__(self, env: Any) -> Tensor:
            return read(env)

    return FeetTerm


def _make_feet(feet: Feet, num_envs: int, device: str) -> FootSensorsModule:
    """Make the sensors, or take those there are."""
    made = feet if isinstance(feet, FootSensorsModule) else feet(num_envs, device)
    _check_robots(made, num_envs)
    return made


def _check_robots(module: BatchModule, num_envs: int) -> None:
    if module.num_envs != num_envs:
        raise ValueError(
            f"{type(module).__name__} was made for {module.num_envs} robots, but the environment has "
            f"{num_envs}; make it with num_envs={num_envs}."
        )


def _sensing_class(base: type, unit: str, fresh: bool) -> Any:
    """Make the common part of modifiers and noise models: it reads forces in a unit."""
    if unit not in UNITS:
        raise ValueError(f"'unit' must be one of {UNITS}, got {unit!r}.")

    class Sensing(base):  # type: ignore[misc]
        feet: FootSensorsModule

        def __init__(self, *given: Any) -> None:
            if base is not object:
                super().__init__(*given)

        def reset(self, env_ids: RobotIds = None) -> None:
            self.feet.reset(env_ids, fresh)

        def __call__(self, data: Tensor) -> Tensor:
            counts = self.feet(data)
            return counts if unit == "count" else self.feet.newtons(counts)

    return Sensing
