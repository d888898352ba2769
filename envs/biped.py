"""A biped under position control that follows its own commands: the common part of all its tasks.

A task is a few functions of a robot's :class:`State`, which change nothing: :meth:`BipedEnv.command_at`,
``targets``, ``look``, ``correct``, ``reward`` and ``fallen``. :class:`BipedEnv` calls them for one robot,
:class:`~surefoot.envs.batch.BatchVectorEnv` for all of its robots, with these in front of each array.
"""

from collections.abc import Callable, Sequence
from copy import deepcopy
from math import inf
from os import PathLike
from typing import Any, NamedTuple, Self

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.command import Command
from surefoot.envs.instrumentation.means import MeanTruth
from surefoot.envs.instrumentation.robot import RowLayout
from surefoot.envs.observation import FeetObserver, Look, Observation, Places, Seen
from surefoot.envs.options import check_action, positive
from surefoot.envs.prelude import Player, Prelude
from surefoot.envs.rendering import DrawnEnv


class State(NamedTuple):
    """Where a robot is in its episode, besides MuJoCo's own state; of many robots, with these in front."""

    plan: Any  # what the episode has drawn to be commanded; each task has its own kind
    tick: Any  # control steps since the episode began
    command: Command  # the robot's present command to itself
    target: Floats  # of the motors at the end of the last step in rad, shape (..., M)
    correction: Any  # what the next step adds to the leg motors' targets beside the residual in rad
    cop_held: Floats  # last valid centres of pressure, as in :class:`Look`


class Fall(NamedTuple):
    """When a robot has fallen."""

    up: tuple[float, float, float]  # the vertical in the torso's axes while it stands, shape (3,)
    lowest_up: float  # cosine of the largest angle between that and the present vertical
    lowest_height: float  # lowest height of the torso's origin in m


class BipedEnv(DrawnEnv):
    """One robot and its task; ValueError names an option that is out of its range.

    The model has one motor a joint target; ``layout`` says where its sensors are in a row of sensor data, in
    which the angles of ``joint_names`` stand in this order; an action moves the L motors ``legs``, whose
    names are ``leg_motors``, by ``action_scale`` rad at most. Forces of cells are shown up to ``force_bound``
    N. An episode has a duration in s, or ``None`` for no end, and begins after the prelude, or that of a
    file.

    ``quiet_ticks`` are the control steps at its beginning in which residuals are checked, and not applied; at
    ``last_tick`` it is truncated, None for never; ``fastest`` is how far targets move in a step at most, in
    rad; ``varied`` are fields of the model that ``place`` and ``disturb`` change; ``shared`` attributes are
    those that :meth:`another` has in common with this one; ``began`` is called at the end of each reset.
    """

    truth: Any
    state: State

    quiet_ticks = 0
    fastest: Any = np.inf
    varied: tuple[str, ...] = ()
    shared: tuple[str, ...] = ("model", "data", "observer", "mean_truth", "observation_space", "_renderer")
    began: Callable[[], None] | None = None

    _neutral: str  # what an action of zeros does, for messages

    def __init__(
        self,
        model: mujoco.MjModel,
        layout: RowLayout,
        joint_names: Sequence[str],
        *,
        substeps: int,
        legs: slice | NDArray[np.intp],
        leg_motors: Sequence[str],
        force_bound: float,
        fall: Fall,
        duration: float | None,
        action_scale: float,
        prelude: Prelude | str | PathLike[str] | None,
    ) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.substeps, self._legs, self._fall = substeps, legs, fall
        self._leg_names = tuple(leg_motors)
        self._action_scale = positive("action_scale", action_scale)
        self.last_tick = None if duration is None else max(round(positive("duration", duration) / self.dt), 1)
        self.prelude = Player(prelude, [model.actuator(i).name for i in range(model.nu)], self.dt)
        limited = model.actuator_ctrllimited.astype(bool)
        self._low, self._high = np.where(limited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
        self._fraction = np.arange(1, substeps + 1)[:, None] / substeps
        self.joint_names = tuple(joint_names)
        self._joint_dofs = np.array([model.joint(name).dofadr[0] for name in self.joint_names])
        self.observer = FeetObserver(Places(layout, self._joint_dofs), force_bound)
        self.mean_truth = MeanTruth(layout)
        self.observation_space, self.state_layout = self.observer.space, self.observer.state_layout
        self.action_space = spaces.Box(-1.0, 1.0, (len(self._leg_names),), dtype=np.float32)

    @property
    def dt(self) -> float:
        """Duration of a step in s."""
        return self.substeps * float(self.model.opt.timestep)

    @property
    def command(self) -> Command:
        """The robot's present command to itself."""
        return self.state.command

    def another(self) -> Self:
        """Return an environment of the same options in the same model and data.

        One of both is in an episode at a time; who uses them keeps what an episode changes. An attribute that
        is a view of MuJoCo's memory is one of the same memory.
        """
        parts = [getattr(self, name) for name in self.shared]
        parts += [part for part in vars(self).values() if _is_of_mujoco(part)]
        return deepcopy(self, {id(part): part for part in parts})

    def draw(self, options: dict[str, Any]) -> Any:
        """Draw an episode's plan, and what disturbs it; called at every reset, after seeding."""

    def place(self, command: Command, target: Floats) -> None:
        """Put the robot where an episode begins, with its first command and targets."""
        raise NotImplementedError

    def disturb(self, data: Any, tick: int, prepares: bool) -> bool:
        """Disturb one robot before the step that leads to ``tick``; return whether its model has changed."""
        return False

    @staticmethod
    def join(plans: Sequence[Any]) -> Any:
        """Put plans of many robots into one."""
        return plans[0]

    def command_at(self, plan: Any, tick: Any) -> Command:
        """Return the command at a control step of an episode, 0 at its start; of N robots at ticks (N,).

        During a step the targets move to the ``joint_target`` of its end. Steps may exceed the plan's length.
        """
        raise NotImplementedError

    def read(self, rows: Floats) -> Any:
        """Return the truth of a control step, of sensor data of shape (..., S, columns)."""
        raise NotImplementedError

    def correct(self, truth: Any, command: Command) -> Any:
        """Return the ``correction`` of :class:`State` that a control step ends with."""
        return 0.0

    def reward(self, seen: Seen) -> dict[str, float]:
        """Return the terms of the reward of one robot's step, which is their sum, by name."""
        raise NotImplementedError

    def fallen(self, seen: Seen) -> bool:
        """Return whether one robot has fallen."""
        fall = self._fall
        up = seen.up_x * fall.up[0] + seen.up_y * fall.up[1] + seen.up_z * fall.up[2]
        return not (up > fall.lowest_up and seen.height > fall.lowest_height)

    def check_action(self, action: Any, robots: tuple[int, ...] = ()) -> Floats:
        """Return residuals on leg motors' targets as shares of ``action_scale``, (..., L), or ValueError."""
        return check_action(action, self._leg_names, "a residual for each leg motor", self._neutral, robots)

    def targets(self, state: State, residual: Floats) -> Floats:
        """Return the motors' targets at the substeps of a control step, shape (..., S, M), in rad."""
        target = state.command.joint_target.astype(np.float64)
        target[..., self._legs] += self._action_scale * residual + state.correction
        target = np.minimum(np.maximum(target, self._low), self._high)
        move = np.minimum(np.maximum(target - state.target, -self.fastest), self.fastest)
        targets: Floats = state.target[..., None, :] + self._fraction * move[..., None, :]
        return targets

    def judge(self, seen: Sequence[float]) -> tuple[dict[str, float], bool]:
        """Return the terms of one robot's reward and whether it has fallen, of the numbers of :class:`Seen`.

        A term is 0 where a simulation that blew up makes it no number.
        """
        own = Seen._make(seen)
        terms = self.reward(own)
        for name, term in terms.items():
            if not abs(term) < inf:
                terms[name] = 0.0
        return terms, self.fallen(own)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the robot where its episode begins; the task takes the options."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        plan = self.draw(options or {})
        command = self.command_at(plan, 0)
        self.prelude.begin(command)
        target = np.clip(command.joint_target, self._low, self._high)
        self.data.ctrl[:] = target
        self.place(command, target)
        mujoco.mj_forward(self.model, self.data)
        rows = np.tile(self.data.sensordata, (self.substeps, 1))
        look = self._end_step(State(plan, 0, command, target, 0.0, np.zeros((3, 2))), rows, self.data.qvel)
        if self.began is not None:
            self.began()
        self._show()
        return look.observation, {"surefoot": {"truth": self.mean_truth(rows)}}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Go on for one control step, with residuals as shares of ``action_scale``, shape (L,).

        ValueError if the action has another shape or is not finite, ResetNeeded before the first reset.
        """
        if not hasattr(self, "state"):
            raise gym.error.ResetNeeded("Call reset() before the first step().")
        residual, state = self.check_action(action), self.state
        prepares, tick = self.prelude.playing, state.tick
        if tick < self.quiet_ticks and not prepares:
            residual = np.zeros_like(residual)
        if prepares:
            state = state._replace(command=self.prelude.next())
        else:
            state = state._replace(tick=tick + 1, command=self.command_at(state.plan, tick + 1))
        targets = self.targets(state, residual)

        model, data, mj_step = self.model, self.data, mujoco.mj_step
        sensordata, ctrl = data.sensordata, data.ctrl
        rows = np.empty((self.substeps, model.nsensordata))
        self.disturb(data, state.tick, prepares)
        for row, substep_target in zip(rows[:-1], targets[:-1], strict=True):
            ctrl[:] = substep_target
            mj_step(model, data)
            row[:] = sensordata
        qvel = data.qvel.copy()
        ctrl[:] = targets[-1]
        mj_step(model, data)
        rows[-1] = sensordata

        look = self._end_step(state._replace(target=targets[-1]), rows, qvel)
        terms, fallen = self.judge([*look.seen.tolist(), effort(residual).item()])
        truncated = self.last_tick is not None and state.tick >= self.last_tick
        info = {"surefoot": {"truth": self.mean_truth(rows)}, **terms}
        self._show()
        return look.observation, sum(terms.values()), fallen, truncated, info

    def _end_step(self, state: State, rows: Floats, qvel: Floats) -> Look:
        look = self.observer.look(rows, qvel, state.command, state.cop_held)
        self.truth = self.read(rows)
        correction = self.correct(self.truth, state.command)
        self.state = state._replace(correction=correction, cop_held=look.cop_held)
        return look


def _is_of_mujoco(part: Any) -> bool:
    """Return whether an attribute is a view of memory that is no array's own."""
    while isinstance(part, np.ndarray):
        if part.base is None:
            return False
        if not isinstance(part.base, np.ndarray):
            return True
        part = part.base
    return False


def effort(residual: Floats) -> Any:
    """Return the reward of actions, -0.1 times their mean square, shape (...)."""
    return -0.1 * np.vecdot(residual, residual) / residual.shape[-1]
