"""Any MuJoCo environment with sensors in its feet: the same episodes, and the truth beside them."""

import warnings
from collections.abc import Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import ArrayLike

from surefoot.envs.instrumentation.drawing import RobotDrawing
from surefoot.envs.instrumentation.feet import check_names
from surefoot.envs.instrumentation.made import Made, make
from surefoot.envs.instrumentation.means import MeanTruth
from surefoot.envs.instrumentation.reader import FeetReader, SensorReader
from surefoot.envs.instrumentation.replaced import ReplacedModel
from surefoot.envs.instrumentation.spec import Instrumentation, refuse_taken
from surefoot.envs.instrumentation.swap import find_description, find_holder, put_in, swap_in
from surefoot.envs.instrumentation.trial import find_notice, measure_duration


class InstrumentedEnv(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Any MuJoCo environment of a robot with feet, with the truth about them beside it.

    Observation, reward and termination stay the environment's, bit for bit. Sensors are added to its model
    (``unwrapped.model`` and ``unwrapped.data`` are replaced) if the environment does not notice: copies are
    stepped with and without them, and must show the same to the last bit
    (:func:`~surefoot.envs.instrumentation.trial.find_notice`). Then every substep of a control step is read,
    from MuJoCo's own history of the sensors. The model is left alone if the environment would notice, refers
    to it elsewhere (also in a closure), or has no description of it. The same quantities are then computed
    beside it, **once per control step**, at its end. :attr:`untouched` has the reason, and a warning gives it
    once.

    Changes that other code makes, between two calls, to the model that was replaced are carried over.

    ``info["surefoot"]["truth"]`` holds means over the control step, see
    :func:`~surefoot.envs.instrumentation.means.mean_truth`.

    Args:
        env: An environment whose ``unwrapped`` has ``model`` and ``data``, such as Gymnasium's ``MujocoEnv``.
        feet: Names of the feet's bodies in order; None for the two lowest leaves, the left one first.
        cells: Places of the load cells in the sole's frame in m, front-left, front-right, rear-left,
            rear-right, shape (4, 2), by the foot's body; by default they are in the sole's corners.
        margin: Distance in m of cells in the corners from the sole's edges.
        soles: ``True`` adds a flat sole under each foot that has no area. A mapping from bodies of feet to
            (length, width, thickness) in m chooses the size. **This changes the dynamics**: the feet touch
            elsewhere, and the numbers of later geoms change.
        spec: The robot's description, by default the file ``unwrapped.fullpath``: a file, or a
            ``mujoco.MjSpec``, but then the wrapper's own ``spec`` cannot be pickled or written as JSON.
        in_place: Whether to put sensors into the environment's model; None to decide.
        visuals: Whether to keep visual meshes, which take most of a humanoid's memory; otherwise boxes of
            their size replace them. None keeps them if the environment is drawn (``render_mode``).
        prefix: The beginning of the names of added sites and sensors.

    Attributes:
        truth: The feet's loads in the S substeps of the last control step, one row each; a single row if it
            is computed beside the environment. After a reset all rows are those of the initial state.
        tells: Whether ``info`` contains the truth; a wrapper that reads :attr:`truth` may turn this off.
        drawing: The drawing by the robot's maker.
        joint_names: The hinge joints that encoders measure.
        instrumentation: The instrumented description, which copies share; None if the model was left alone.
        untouched: Why the model was left alone; empty if it was not.
        seldom: Whether only one of several substeps of a control step is read; calibrators then assume more
            noise.

    Environments of dm_control, which hold their robot as ``unwrapped.physics``, are never changed: the same
    quantities are computed beside them.

    Raises:
        TypeError: If the environment does not run on MuJoCo, ``feet`` are no names, or ``cells`` or ``soles``
            name no feet.
        ValueError: If feet cannot be found, a body does not exist, names are taken, cells are asked for on a
            foot without area, or the description is of another robot.

    Warns:
        UserWarning: If the feet are read only once per control step of several substeps, unless that was
            asked for (``in_place=False``), or if a step has more physics steps than expected.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        feet: Sequence[str] | None = None,
        *,
        cells: Mapping[str, ArrayLike] | None = None,
        margin: float = 0.005,
        soles: bool | Mapping[str, Sequence[float]] = False,
        spec: str | Path | mujoco.MjSpec | None = None,
        in_place: bool | None = None,
        visuals: bool | None = None,
        prefix: str = "surefoot/",
    ) -> None:
        _check_types(feet, cells, soles)
        # An MjSpec cannot be copied deeply; everything else is recorded as a copy.
        gym.utils.RecordConstructorArgs.__init__(
            self,
            _disable_deepcopy=True,
            feet=None if feet is None else list(feet),
            cells=None if cells is None else {body: np.asarray(p).tolist() for body, p in cells.items()},
            margin=margin,
            soles={body: list(size) for body, size in soles.items()} if isinstance(soles, Mapping) else soles,
            spec=str(spec) if isinstance(spec, Path) else spec,
            in_place=in_place,
            visuals=visuals,
            prefix=prefix,
        )
        gym.Wrapper.__init__(self, env)
        self._base = base = cast(Any, _holder(env))
        _refuse(env, base, prefix)
        foreign = isinstance(base, _Physics)
        description = _describe(base, foreign, soles, spec, in_place)
        given: dict[str, Any] = {"cells": cells, "margin": margin, "prefix": prefix}
        unknown = "there is no description of it: give InstrumentedEnv a 'spec'"
        self.untouched = "dm_control's physics holds it" if foreign else unknown
        self.instrumentation: Instrumentation | None = None
        holder = "" if foreign else find_holder(env)
        self._replaced: ReplacedModel | None = None
        samples = self._substeps = _count_substeps(base, may_copy=not (foreign or holder))
        if in_place is False:
            self.untouched = "in_place=False"
        elif description is not None:
            boxes = not (getattr(env, "render_mode", None) if visuals is None else visuals)
            made = make(description, base.model, feet, soles=soles, boxes=boxes, samples=samples, **given)
            self._instrument(made, holder, prefix, named=spec is not None, forced=bool(soles or in_place))
        self._reader: SensorReader | FeetReader
        if self.instrumentation is not None:
            self._reader = SensorReader(base.model, base.data, self.instrumentation, samples)
        else:
            self._reader = FeetReader(base.model, base.data, feet, **given)
        self.drawing: RobotDrawing = (self.instrumentation or self._reader).drawing
        self.seldom = self.instrumentation is None and samples > 1
        if self.seldom and in_place is not False:
            warnings.warn(_warn_of_aliasing(env, self.untouched, samples), stacklevel=2)
        self._model: mujoco.MjModel = base.model
        self._data: mujoco.MjData = base.data
        self.joint_names = self.drawing.joint_names
        self.truth = self._reader.now()
        self._mean_truth = MeanTruth(self.truth.layout)
        self.tells, self._warned = True, False

    def _instrument(self, made: Made, holder: str, prefix: str, *, named: bool, forced: bool) -> None:
        """Put a model with sensors into the environment, or report in ``untouched`` why it is left alone.

        ``holder`` is the attribute, if any, through which the environment refers to its present model.
        """
        if made.different and (named or forced):
            raise ValueError(f"The description is not that of the environment's robot: {made.different}.")
        if holder and forced:
            raise ValueError(f"The environment's model cannot be replaced: {_find_view_of_model(holder)}.")
        if made.model is None:
            self.untouched = f"its file is of another robot: {made.different}"
        elif holder:
            self.untouched = _find_view_of_model(holder)
        else:
            self.untouched = "" if forced else find_notice(self.env, made.model)
            self.instrumentation = None if self.untouched else made.instrumentation
            chosen = made.boxed if self.untouched else made.model
            if chosen is not None:
                replaced = ReplacedModel(self._base.model, prefix)
                swap_in(self._base, copy(chosen))
                self._replaced = replaced if replaced.follow() else None

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_rng": self.unwrapped._np_random, "_replaced": None}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        rng = kept.pop("_rng")
        self.__dict__.update(kept)
        if self._base.model is not self._model:
            if isinstance(self._base, _Physics):
                raise TypeError(
                    "dm_control's physics was copied to another model, which nobody watches: copy the "
                    "environment alone, and put InstrumentedEnv around the copy."
                )
            # Gymnasium's environments are copied by making them again: a copy goes on where this one is.
            put_in(self._base, self._model, self._data)
            self.unwrapped._np_random = rng

    @property
    def model(self) -> mujoco.MjModel:
        """The robot that is simulated."""
        return self._model

    @property
    def data(self) -> mujoco.MjData:
        """Its state."""
        return self._data

    @property
    def dt(self) -> float:
        """Duration of a step in s."""
        return self._substeps * float(self._base.model.opt.timestep)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode, and read the state in which it starts.

        Raises:
            RuntimeError: If the environment has made another model, or changed the one that was replaced.
        """
        self._carry_over()
        with self._reader.still():
            observation, info = self.env.reset(seed=seed, options=options)
        self._check_model()
        self.truth = self._reader.now()
        return observation, self._with_truth(info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and read the truth."""
        if self._replaced is not None:
            self._carry_over()
        start = self._data.time
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._replaced is not None or self._base.data is not self._data:
            self._check_model()
        self.truth = self._reader.after_step()
        passed = (self._data.time - start) / self._model.opt.timestep
        if passed > self._substeps + 0.5 and not (self._warned or self.seldom):
            self._warn_of_longer_step(round(passed))
        return observation, reward, terminated, truncated, self._with_truth(info)

    def _with_truth(self, info: dict[str, Any]) -> dict[str, Any]:
        told = {"truth": self._mean_truth(self.truth.rows)} if self.tells else None
        return info if told is None else {**info, "surefoot": told}

    def _carry_over(self) -> None:
        """Copy to the simulated model what a script has changed in the one that it replaced."""
        if self._replaced is not None:
            self._replaced.carry_over(self._model)

    def _check_model(self) -> None:
        """Follow the environment to other data; raise RuntimeError if it uses or changes another model."""
        base, name = self._base, type(self._base).__name__
        other_data = base.data is not self._data
        if base.model is not self._model or (other_data and base.data.model is not self._model):
            raise RuntimeError(
                f"{name} has made another model at a reset, so that its feet are not measured any more. Let "
                "it change the numbers of its model instead, or wrap it again after each reset."
            )
        if other_data:
            self._data = base.data
            if not isinstance(base, _Physics):
                put_in(base, self._model, self._data)  # in its renderer
            self._reader.watch(self._data)
        if self._replaced is not None and (changed := list(self._replaced.changes())):
            raise RuntimeError(
                f"{name} has changed {changed} of the model with which it was made. Sensors were put into a "
                "copy, which is simulated, so the change has no effect. Leave its model alone, "
                "InstrumentedEnv(env, in_place=False), or let it change its attribute 'model'."
            )

    def _warn_of_longer_step(self, passed: int) -> None:
        """Warn once that a step has more physics steps than are read."""
        self._warned = True
        warnings.warn(
            f"A step of {self.env} took {passed} physics steps, and {self._substeps} were expected: the "
            "truth covers the last of them only. Put wrappers that repeat steps around InstrumentedEnv.",
            stacklevel=3,
        )


def _count_substeps(base: Any, may_copy: bool) -> int:
    """Count the physics steps in a control step of an innermost environment.

    Where the attributes ``dt`` and ``frame_skip`` do not confirm each other, a copy is stepped and its clock
    is read: many environments have the duration of a physics step as ``dt``, and some have neither. Without a
    copy ``dt`` is the control step, unless it equals the physics step.
    """
    timestep = float(base.model.opt.timestep)
    skip, dt = (_number(getattr(base, name, None)) for name in ("frame_skip", "dt"))
    of_dt = round(dt / timestep)
    confirmed = 0 < of_dt == skip
    if not confirmed and may_copy and (passed := round(measure_duration(base) / timestep)) > 0:
        return passed
    return max(of_dt if of_dt > 1 else round(skip), 1)


def _number(value: Any) -> float:
    """Return an attribute as a finite number, 0 if it is not one."""
    return float(value) if isinstance(value, int | float | np.number) and np.isfinite(value) else 0.0


def _warn_of_aliasing(env: Any, reason: str, substeps: int) -> str:
    """Return the warning that the feet are read only once per control step."""
    return (
        f"The feet of {env} are read once a control step, at its end, and not in each of its {substeps} "
        f"substeps ({reason}): contact forces that change within a step are aliased; real sensors average."
    )


def _describe(
    base: Any, foreign: bool, soles: Any, spec: str | Path | mujoco.MjSpec | None, in_place: bool | None
) -> mujoco.MjSpec | None:
    """Return the description of an environment's robot, if any; refuse options that need one without it."""
    if foreign and (soles or in_place or spec is not None):
        raise ValueError(
            "'soles', 'spec' and 'in_place' change the model, which dm_control's physics cannot "
            "exchange: leave them out, and put what is needed into the task's own MJCF."
        )
    description = None if foreign else find_description(spec, base)
    if description is None and (soles or in_place):
        raise ValueError(
            f"'{'soles' if soles else 'in_place'}' changes the model, for which its description is "
            "needed: give 'spec', a file or a mujoco.MjSpec."
        )
    if soles and in_place is False:
        raise ValueError("'soles' changes the model: leave 'in_place' alone.")
    return description


def _check_types(feet: Any, cells: Any, soles: Any) -> None:
    """Raise TypeError if options do not name feet."""
    if feet is not None:
        check_names(feet)
    if cells is not None and not isinstance(cells, Mapping):
        raise TypeError(
            "'cells' must map the bodies of feet to places of four cells, {'left_foot': [(x, y), ...], ...}; "
            f"got a {type(cells).__name__}."
        )
    if not isinstance(soles, (bool, np.bool_, Mapping)):
        raise TypeError(
            "'soles' must be True, or map the bodies of feet to (length, width, thickness) in m; "
            f"got a {type(soles).__name__}."
        )


class _Physics:
    """The robot of a dm_control environment, with the attributes of one of Gymnasium's environments."""

    def __init__(self, env: Any) -> None:
        self._env = env

    @property
    def model(self) -> Any:
        return self._env.physics.model.ptr

    @property
    def data(self) -> Any:
        return self._env.physics.data.ptr

    @property
    def dt(self) -> float:
        return float(self._env.control_timestep())


def _holder(env: gym.Env[Any, Any]) -> Any:
    """Return the environment whose ``model`` and ``data`` are the robot."""
    base = cast(Any, env.unwrapped)
    physics = getattr(base, "physics", None)
    foreign = not hasattr(base, "model") and hasattr(getattr(physics, "model", None), "ptr")
    return _Physics(base) if foreign else base


def _refuse(env: gym.Env[Any, Any], base: Any, prefix: str) -> None:
    """Raise an error if an environment is not on MuJoCo or is instrumented already."""
    model, data = getattr(base, "model", None), getattr(base, "data", None)
    if not isinstance(model, mujoco.MjModel) or not isinstance(data, mujoco.MjData):
        has = ", ".join(
            f"no '{name}'" if value is None else f"a {type(value).__name__} as '{name}'"
            for name, value in (("model", model), ("data", data))
        )
        raise TypeError(
            "InstrumentedEnv needs an environment on MuJoCo, whose unwrapped.model is a mujoco.MjModel and "
            "unwrapped.data a mujoco.MjData, or whose unwrapped.physics is dm_control's; "
            f"{type(env.unwrapped).__name__} has {has}. Give an environment of your own these two attributes."
        )
    below: Any = env
    while isinstance(below, gym.Wrapper):
        if isinstance(below, InstrumentedEnv):
            raise ValueError(f"{env} is instrumented already: use it as it is.")
        below = below.env
    kinds = ((mujoco.mjtObj.mjOBJ_SENSOR, model.nsensor), (mujoco.mjtObj.mjOBJ_SITE, model.nsite))
    refuse_taken({mujoco.mj_id2name(model, kind, i) or "" for kind, n in kinds for i in range(n)}, prefix)


def _find_view_of_model(holder: str) -> str:
    """Return why a model cannot be replaced of which an attribute holds a view."""
    return f"{holder} holds a view of it, which would go on showing the old one"
