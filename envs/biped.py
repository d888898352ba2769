"""A biped under position control that follows its own commands: the common part of all its tasks."""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.envs.command import Command
from surefoot.envs.instrumentation.means import mean_truth
from surefoot.envs.numbers import ONE, Number, Numbers
from surefoot.envs.observation import FeetObserver, Observation, Places
from surefoot.envs.options import check_action, positive
from surefoot.envs.prelude import Player, Prelude


class BipedEnv(gym.Env[Observation, NDArray[np.float32]]):
    """One robot, or all those of a :class:`~surefoot.envs.batch.BatchVectorEnv`, which arrays have in front.

    Args:
        model: The robot, one motor a joint target.
        places: Where its sensors are in a row of sensor data.
        substeps: Simulation steps of one control step.
        legs: Numbers of the motors of an action, the L leg motors.
        leg_motors: Their names.
        force_bound: Largest force of a cell that is shown, in N.
        duration: Length of an episode in s, or ``None`` for no end.
        action_scale: The change of a target by a full action, in rad.
        prelude: The robot's motion before each episode, or the path of its file.

    Raises:
        ValueError: If an option is out of its range, naming it.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    truth: Any
    command: Command

    _numbers: Numbers = ONE
    """Whether this is one robot, or many."""

    _quiet_ticks = 0
    """Control steps at the beginning of an episode in which residuals are checked, and not applied."""

    _correction: Any = 0.0
    """What is added to the targets of the leg motors beside the residual, in rad."""

    _fastest: Any = np.inf
    """How far targets move in a step at most, in rad."""

    _neutral: str
    """What an action of zeros does, for messages."""

    def __init__(
        self,
        model: mujoco.MjModel,
        places: Places,
        *,
        substeps: int,
        legs: slice | NDArray[np.intp],
        leg_motors: Sequence[str],
        force_bound: float,
        duration: float | None,
        action_scale: float,
        prelude: Prelude | str | PathLike[str] | None,
    ) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self._places, self._substeps, self._legs = places, substeps, legs
        self._leg_names = tuple(leg_motors)
        self._action_scale = positive("action_scale", action_scale)
        self._steps = None if duration is None else max(round(positive("duration", duration) / self.dt), 1)
        self.prelude = Player(prelude, [model.actuator(i).name for i in range(model.nu)], self.dt)
        limited = model.actuator_ctrllimited.astype(bool)
        self._low, self._high = np.where(limited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
        self._fraction = np.arange(1, substeps + 1)[:, None] / substeps
        self._observer = FeetObserver(places, force_bound)
        self.observation_space, self.state_layout = self._observer.space, self._observer.state_layout
        self.action_space = spaces.Box(-1.0, 1.0, (len(self._leg_names),), dtype=np.float32)
        self._target: NDArray[np.float64]
        self._row: Any
        self._tick: Any = None

    @property
    def dt(self) -> float:
        """Duration of a step in s."""
        return self._substeps * float(self.model.opt.timestep)

    def _command(self, tick: Any) -> Command:
        """Return the command at control step ``tick`` of this episode, 0 at its start.

        During a step the targets move to the ``joint_target`` of its end. The chance of an episode is
        drawn in :meth:`_start`. Steps may exceed the pattern's length.
        """
        raise NotImplementedError

    def _start(self, options: dict[str, Any]) -> None:
        """Prepare an episode: called at every reset, after seeding and before ``_command(0)``."""

    def _place(self) -> None:
        """Put the robot where an episode begins; its command is known."""
        raise NotImplementedError

    def _join(self, robots: Sequence[Any]) -> None:
        """Take over the draws of robots' episodes, for :meth:`_command` to command all of them."""

    def _disturb(self, data: Any, tick: int, prepares: bool) -> bool:
        """Disturb one robot before the step that leads to ``tick``; return whether its model has changed."""
        return False

    def _read(self, rows: NDArray[np.float64]) -> Any:
        """Return the truth of a control step, of sensor data of shape (..., S, columns)."""
        raise NotImplementedError

    def _pay(self, pressed: dict[str, Any], residual: NDArray[np.float64]) -> dict[str, Any]:
        """Return the terms of a reward, each 0 where a simulation that blew up makes it no number."""
        where = self._numbers.where
        terms = self._reward(pressed, residual)
        return {name: where(abs(term) < np.inf, term, 0.0) for name, term in terms.items()}

    def _reward(
        self, pressed: dict[str, NDArray[np.float64]], action: NDArray[np.float64]
    ) -> dict[str, Number]:
        """Return the terms of a step's reward, which is their sum, by name."""
        raise NotImplementedError

    def _fallen(self) -> Any:
        """Return whether the robot has fallen."""
        raise NotImplementedError

    def _reward_cop(self, pressed: dict[str, NDArray[np.float64]], width: float) -> Number:
        """Return exp(-(e / width)^2), e the distance of the CoP from its reference in m; 0 without a CoP."""
        m = self._numbers
        (x, y), (reference_x, reference_y) = m.parts(pressed["cop_world"]), m.parts(self.command.cop)
        x, y = x - reference_x, y - reference_y
        return m.where(pressed["cop_valid"][..., 0], m.exp(-(x * x + y * y) / width**2), 0.0)

    def _effort(self, action: NDArray[np.float64]) -> Number:
        """Return the cost of an action: -0.1 times its mean square."""
        return -0.1 * self._numbers.parts(np.vecdot(action, action)) / action.shape[-1]

    def _check_action(self, action: Any, robots: tuple[int, ...] = ()) -> NDArray[np.float64]:
        return check_action(action, self._leg_names, "a residual for each leg motor", self._neutral, robots)

    def _targets(self, residual: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the motors' targets at the substeps of a control step, shape (..., S, M), in rad."""
        target = self.command.joint_target.astype(np.float64)
        target[..., self._legs] += self._action_scale * residual + self._correction
        target = np.minimum(np.maximum(target, self._low), self._high)
        move = np.minimum(np.maximum(target - self._target, -self._fastest), self._fastest)
        targets: NDArray[np.float64] = self._target[..., None, :] + self._fraction * move[..., None, :]
        return targets

    def _observe(
        self, rows: NDArray[np.float64], qvel: NDArray[np.float64]
    ) -> tuple[Observation, dict[str, NDArray[np.float64]], dict[str, NDArray[np.float64]]]:
        """Take in a control step: sensor data, shape (..., S, columns), and ``qvel`` of its last row.

        Returns:
            The observation and the centre of pressure of the last row, and the truth for ``info``.
        """
        self.truth = self._read(rows)
        last = rows[..., -1, :]
        self._row = self._numbers.parts(last)
        observation, pressed = self._observer.observe(last, self._row, qvel, self.command)
        return observation, pressed, mean_truth(rows, self._places.feet, self._numbers)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the robot where its episode begins.

        Args:
            seed: Seeds all that the environment draws.
            options: Handed to the task.
        """
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self._start(options or {})
        self._tick = 0
        self.command = self._command(0)
        self.prelude.begin(self.command)
        self._target = np.clip(self.command.joint_target, self._low, self._high)
        self.data.ctrl[:] = self._target
        self._place()
        mujoco.mj_forward(self.model, self.data)
        self._observer.reset()
        rows = np.tile(self.data.sensordata, (self._substeps, 1))
        observation, _, truth = self._observe(rows, self.data.qvel)
        return observation, {"surefoot": {"truth": truth}}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Go on for one control step.

        Args:
            action: Residuals on the leg motors' targets as shares of ``action_scale``, shape (L,).

        Raises:
            ValueError: If the action has another shape or is not finite.
            gymnasium.error.ResetNeeded: If the environment has not been reset.
        """
        if self._tick is None:
            raise gym.error.ResetNeeded("Call reset() before the first step().")
        residual = self._check_action(action)
        prepares = self.prelude.playing
        if self._tick < self._quiet_ticks and not prepares:
            residual = np.zeros_like(residual)
        if not prepares:
            self._tick += 1
        self.command = self.prelude.next() if prepares else self._command(self._tick)
        targets = self._targets(residual)

        model, data, mj_step = self.model, self.data, mujoco.mj_step
        sensordata, ctrl = data.sensordata, data.ctrl
        rows = np.empty((self._substeps, model.nsensordata))
        self._disturb(data, self._tick, prepares)
        for row, substep_target in zip(rows[:-1], targets[:-1], strict=True):
            ctrl[:] = substep_target
            mj_step(model, data)
            row[:] = sensordata
        qvel = data.qvel.copy()
        ctrl[:] = self._target = targets[-1]
        mj_step(model, data)
        rows[-1] = sensordata

        observation, pressed, truth = self._observe(rows, qvel)
        terms = self._pay(pressed, residual)
        truncated = self._steps is not None and self._tick >= self._steps
        info = {"surefoot": {"truth": truth}, **terms}
        return observation, sum(terms.values()), self._fallen(), truncated, info
