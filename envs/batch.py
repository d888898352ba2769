"""Many robots of one task at once, stepped by MuJoCo's threads.

Each robot has an environment that draws its episodes. Within an episode the task's functions are called for
all robots at once, on a :class:`~surefoot.envs.biped.State` whose arrays have the robots as first axis, and
:class:`mujoco.batch.Batch` replaces ``mj_step``. The environments share one model and one data. The batch
holds MuJoCo's states, and the fields of the model in which robots differ.
"""

import copy
from collections.abc import Iterable, Mapping
from functools import partial
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.checks import check_count
from surefoot.envs.biped import BipedEnv, State, effort
from surefoot.envs.command import Command
from surefoot.envs.exercise.env import ExerciseEnv
from surefoot.envs.nao.stand import NaoStandEnv
from surefoot.envs.nao.walk import NaoWalkEnv
from surefoot.envs.observation import Look, Observation
from surefoot.envs.options import check_render_mode
from surefoot.native import cores

PHYSICS = mujoco.mjtState.mjSTATE_INTEGRATION  # the state that determines MuJoCo's next step
RECORD = ("sensordata", "qvel")  # fields that are recorded at each substep


class BatchVectorEnv(SyncVectorEnv):
    """N robots of one task, with the results of a ``SyncVectorEnv`` of its environments, in less time.

    Seeds, spaces, resets and infos are those of Gymnasium's ``SyncVectorEnv`` in each of its autoreset modes.
    ``get_attr`` returns attributes of the robots' environments, ``model`` and ``data`` as copies. A value set
    by ``set_attr`` takes effect at the robot's next episode.

    A robot whose simulation diverges stands still until its step is over, whereas MuJoCo resets a single one
    at once.

    Args:
        task: A subclass of :class:`BipedEnv`.
        num_envs: Number of robots N.
        threads: Number of threads that step MuJoCo; 0 for one per core.
        autoreset_mode: When a robot whose episode is over is reset: in the next step, in the same step (with
            ``"final_obs"`` and ``"final_info"`` in the infos), or only by ``reset``.
        **options: Of the task.

    Attributes:
        state: State of all episodes, with the robots as first axis of each array.
        truth: The truth of their last step, in the same form.
        mean_truth: Its means (:class:`~surefoot.envs.instrumentation.means.MeanTruth`).
        ended: The last ``truth`` and ``command`` of robots that were reset within the last step, by index.

    Raises:
        ValueError: If there is no robot, or an option is out of its range.
        ImportError: If this MuJoCo is older than 3.17 and has no ``mujoco.batch``.
    """

    envs: list[BipedEnv]  # type: ignore[assignment]

    _derives = frozenset(getattr(mujoco.MjModel, "_setconst_inputs", ()))
    """Fields of a model from which MuJoCo derives others, as listed by ``mujoco.batch``."""

    def __init__(
        self,
        task: type[BipedEnv],
        num_envs: int = 1,
        *,
        threads: int = 0,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> None:
        try:
            from mujoco.batch import Batch
        except ImportError as error:
            raise ImportError(
                f"BatchVectorEnv needs mujoco.batch, and MuJoCo {mujoco.__version__} has none; install "
                "MuJoCo 3.17 or later, or make the environments with vectorization_mode='sync'."
            ) from error
        check_render_mode(options.get("render_mode"), ["rgb_array"])
        num_envs, threads = check_count("num_envs", num_envs, 1), check_count("threads", threads, 0)
        try:
            autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = [mode.value for mode in AutoresetMode]
            raise ValueError(f"'autoreset_mode' must be one of {modes}, got {autoreset_mode!r}.") from None
        made: list[BipedEnv] = []

        def one() -> BipedEnv:
            made.append(made[0].another() if made else task(**options))
            return made[-1]

        super().__init__([one] * num_envs, autoreset_mode=autoreset_mode)
        for i, env in enumerate(made):
            env.began = partial(self._take, i)
        self.ended: dict[int, SimpleNamespace] = {}
        self._task, model = made[0], made[0].model
        self._drawn = {name: getattr(model, name).copy() for name in self._task.varied}
        self._fixed = _bytes_of(model)
        self._rows = np.empty((num_envs, self._task.substeps, model.nsensordata))
        self._qvel = np.empty((num_envs, self._task.substeps, model.nv))
        self._threads = threads or cores()
        self.state: State | None = None
        self._plans: list[Any] = [None] * num_envs
        self._batch = Batch(model, num_envs, threads)
        self._varied = {name: self._batch.expand(name) for name in self._task.varied}
        # Each robot's pushes write into its row of the forces of all robots.
        self._pushed = [SimpleNamespace(xfrc_applied=force) for force in self._batch.xfrc_applied]

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Reset all robots, or those of ``options["reset_mask"]``.

        A single seed is increased by one for each robot; a list holds one seed per robot.
        """
        mask = (options or {}).get("reset_mask")
        _, infos = super().reset(seed=seed, options=options)
        self._begin(np.ones(self.num_envs, dtype=bool) if mask is None else mask)
        return self._look().observation, infos

    def __getstate__(self) -> dict[str, Any]:
        """Refuse copies and pickles."""
        raise TypeError(
            "A BatchVectorEnv has no copies, since MuJoCo's Batch has none; make one that can be copied by "
            "gym.make_vec(..., vectorization_mode='sync')."
        )

    @property
    def command(self) -> Command:
        """The robots' present commands, with the robots as first axis of each array."""
        return self._present.command

    @property
    def _present(self) -> State:
        assert self.state is not None
        return self.state

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observation, Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step all robots. In the mode ``NEXT_STEP`` robots whose episode is over are reset instead.

        Actions are residuals on the leg motors' targets as shares of ``action_scale``, shape (N, 11), or
        ValueError. ResetNeeded if the environment has not been reset, or, in the mode ``DISABLED``, robots
        whose episode is over have not.
        """
        task, mode = self._task, self.autoreset_mode
        starting = self._starting()
        stepping = ~starting
        residual = task.check_action(actions, (self.num_envs,))
        self._act(residual, stepping)
        if starting.any():
            self._restart(starting)
        look = self._look()
        judged = [task.judge(seen) for seen in np.c_[look.seen, effort(residual)].tolist()]
        terms = {name: np.array([paid[name] for paid, _ in judged]) for name in judged[0][0]}
        rewards = np.where(stepping, sum(terms.values()), 0.0)
        terminated = np.array([fallen for _, fallen in judged]) & stepping
        truncated = stepping & (task.last_tick is not None and self._present.tick >= task.last_tick)
        self._autoreset_envs = done = terminated | truncated
        infos: dict[str, Any] = {}
        self.ended = {}
        if mode is AutoresetMode.SAME_STEP and done.any():
            infos, stepping = self._end(done, look, terms), ~done
            look = self._look()
        everyone = np.ones(self.num_envs, dtype=bool)
        infos |= _gather_infos(self.mean_truth, terms, everyone, stepping)
        return look.observation, rewards, terminated, truncated, infos

    def _starting(self) -> NDArray[np.bool_]:
        """Return the robots that are reset in this step instead, shape (N,), errors as in :meth:`step`."""
        over, mode = self._autoreset_envs, self.autoreset_mode
        if self.state is None:
            raise ResetNeeded("Call reset() before the first step().")
        if mode is AutoresetMode.DISABLED and over.any():
            raise ResetNeeded(
                f"The episodes of robots {np.flatnonzero(over).tolist()} are over, and autoreset_mode is "
                'DISABLED; call reset(options={"reset_mask": terminations | truncations}) first.'
            )
        return over if mode is AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, dtype=bool)

    def _act(self, residual: Floats, stepping: NDArray[np.bool_]) -> None:
        """Plan and simulate a control step."""
        task, state = self._task, self._present
        prepares = np.zeros(self.num_envs, dtype=bool)
        if task.prelude.duration:
            prepares[:] = [env.prelude.playing for env in self.envs]
        residual[(state.tick < task.quiet_ticks) & ~prepares] = 0.0
        state.tick[...] += ~prepares
        self._set_commands(..., task.command_at(state.plan, state.tick))
        for i in np.flatnonzero(prepares & stepping).tolist():
            self._set_commands(i, self.envs[i].prelude.next())
        targets = task.targets(state, residual)
        self._disturb(stepping, prepares)
        state.target[...] = targets[:, -1]
        if stepping.all():
            out = {"sensordata": self._rows, "qvel": self._qvel}
            self._batch.rollout(task.substeps, targets, record=RECORD, out=out)
        else:
            who = np.flatnonzero(stepping)
            recorded = self._batch.rollout(task.substeps, targets[who], record=RECORD, ids=who)
            self._rows[who], self._qvel[who] = recorded["sensordata"], recorded["qvel"]

    def _end(self, done: NDArray[np.bool_], look: Look, terms: Mapping[str, Any]) -> dict[str, Any]:
        """Reset robots in the step in which their episodes end; return their last infos."""
        finals = np.full(self.num_envs, None)
        for i in np.flatnonzero(done).tolist():
            finals[i] = {key: part[i].copy() for key, part in look.observation.items()}
            self.ended[i] = SimpleNamespace(truth=self._truth_of(i), command=self._command_of(i))
        told = _gather_infos(self.mean_truth, terms, done, done)
        self._restart(done)
        return _add_masks({"final_obs": finals, "final_info": told}, done)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Call a method of the robots' environments, or get an attribute, in their present states."""
        results = []
        try:
            for i, env in enumerate(self.envs):
                self._bring(i)
                found = env.get_wrapper_attr(name)
                result = found(*args, **kwargs) if callable(found) else found
                shared = result is env.model or result is env.data or isinstance(result, np.ndarray)
                results.append(copy.copy(result) if shared else result)
        finally:
            self._restore()
        return tuple(results)

    def render(self) -> tuple[Any, ...]:
        """Return one frame (height, width, 3) per robot."""
        return self.call("render")

    def _restart(self, starting: NDArray[np.bool_]) -> None:
        """Reset robots."""
        for i in np.flatnonzero(starting).tolist():
            self.envs[i].reset()
        self._begin(starting)

    def _begin(self, starting: NDArray[np.bool_]) -> None:
        """Take over the robots whose environments have just been reset."""
        states = [env.state for env in self.envs]
        if self.state is None:
            self._check_fixed()
            command = Command._make(np.array([part] * self.num_envs) for part in states[0].command)
            parts = (np.array([part] * self.num_envs) for part in states[0][3:])
            self.state = State(None, np.zeros(self.num_envs, dtype=np.int64), command, *parts)
        for i in np.flatnonzero(starting).tolist():
            self.state.tick[i], self.state.target[i], self.state.cop_held[i] = 0, states[i].target, 0.0
            self._set_commands(i, states[i].command)
            self._plans[i] = states[i].plan
            # The present truth is that of all robots; the first environment describes its columns.
            self.envs[i].truth = self._task.truth
        self.state = self.state._replace(plan=self._task.join(self._plans))

    def _set_commands(self, robots: Any, command: Command) -> None:
        rows: Any
        for rows, part in zip(self.command, command, strict=True):
            rows[robots] = part

    def _disturb(self, stepping: NDArray[np.bool_], prepares: NDArray[np.bool_]) -> None:
        """Apply the pushes and payloads that the robots' environments have drawn."""
        ticks, prepare = self._present.tick.tolist(), prepares.tolist()
        for i in np.flatnonzero(stepping).tolist():
            if self.envs[i].disturb(self._pushed[i], ticks[i], prepare[i]):
                self._take_model(i, self._changes())
                self._restore()

    def _look(self) -> Look:
        """Evaluate the robots' last control step."""
        task, state = self._task, self._present
        look = task.observer.look(self._rows, self._qvel[:, -2], state.command, state.cop_held, self._threads)
        self.truth, self.mean_truth = task.read(self._rows), task.mean_truth(self._rows, self._threads)
        correction = task.correct(self.truth, state.command)
        self.state = state._replace(correction=correction, cop_held=look.cop_held)
        keys: Any = self.single_observation_space
        return look._replace(observation={key: look.observation[key] for key in keys})

    def _take(self, robot: int) -> None:
        """Copy a robot from the model and the data in which it has just been reset."""
        model, data = self._task.model, self._task.data
        mujoco.mj_getState(model, data, self._batch.state[robot], PHYSICS)
        self._rows[robot], self._qvel[robot] = data.sensordata, data.qvel
        self._take_model(robot, self._task.varied)
        self._restore()

    def _take_model(self, robot: int, names: Iterable[str]) -> None:
        """Keep fields of the model for one robot."""
        derived = False
        for name in names:
            row, field = self._varied[name][robot], getattr(self._task.model, name)
            derived |= name in self._derives and not np.array_equal(row, field)
            row[...] = field
        if derived:
            self._batch.set_const([robot])

    def _changes(self) -> list[str]:
        """Return the names of the fields of the model that differ from the initial ones."""
        return [name for name, own in self._drawn.items() if (getattr(self._task.model, name) != own).any()]

    def _restore(self) -> None:
        """Restore the shared model to its initial values."""
        model, changed = self._task.model, self._changes()
        for name in changed:
            getattr(model, name)[...] = self._drawn[name]
        if not self._derives.isdisjoint(changed):
            mujoco.mj_setConst(model, mujoco.MjData(model))

    def _check_fixed(self) -> None:
        """Raise ValueError if the first reset has changed a field of the model that all robots share."""
        before, now = self._fixed, _bytes_of(self._task.model)
        changed = [name for name, field in now.items() if field != before[name]]
        if changed:
            task = type(self._task).__name__
            raise ValueError(
                f"{task} changes {changed} of the model at a reset, of which its robots have one for all; "
                f"name them in '{task}.varied', beside {self._task.varied}."
            )
        self._fixed = {}

    def _bring(self, robot: int) -> None:
        """Set the model, the data and a robot's environment to the robot's present state."""
        if self.state is None:
            return
        env = self.envs[robot]
        self._batch.get_model(robot, env.model)
        self._batch.get_data(robot, env.data)
        mujoco.mj_forward(env.model, env.data)
        env.state = env.state._replace(
            tick=int(self.state.tick[robot]),
            target=self.state.target[robot].copy(),
            command=self._command_of(robot),
            cop_held=self.state.cop_held[robot].copy(),
        )
        env.truth = self._truth_of(robot)

    def _command_of(self, robot: int) -> Command:
        commanded: Any = self.command
        return Command._make(part[robot].copy() for part in commanded)

    def _truth_of(self, robot: int) -> Any:
        return self.envs[robot].read(self._rows[robot].copy())


def _bytes_of(model: mujoco.MjModel) -> dict[str, bytes]:
    """Return the fields of a model, derived ones included, as bytes."""
    own = copy.copy(model)
    mujoco.mj_setConst(own, mujoco.MjData(own))
    names = (name for name in dir(own) if not name.startswith("_"))
    return {name: field.tobytes() for name in names if isinstance(field := getattr(own, name), np.ndarray)}


def _gather_infos(truth: Any, terms: Any, seen: NDArray[np.bool_], paid: NDArray[np.bool_]) -> dict[str, Any]:
    """Gather infos as Gymnasium does: truth for the mask ``seen``, terms of the reward for ``paid``, (N,)."""
    told = _add_masks({"surefoot": _add_masks({"truth": _add_masks(_of(truth, seen), seen)}, seen)}, seen)
    return told | (_add_masks(_of(terms, paid), paid) if paid.any() else {})


def _of(arrays: dict[str, NDArray[Any]], mask: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Return arrays with 0 for robots outside a mask."""
    kept = {}
    for name, array in arrays.items():
        robots = mask.reshape(-1, *[1] * (np.ndim(array) - 1))
        kept[name] = np.where(robots, array, np.zeros((), np.asarray(array).dtype))
    return kept


def _add_masks(parts: dict[str, Any], mask: NDArray[np.bool_]) -> dict[str, Any]:
    """Add a mask of the robots that have each part, as in Gymnasium's infos."""
    return parts | {f"_{name}": mask for name in parts}


exercise = partial(BatchVectorEnv, ExerciseEnv)
stand = partial(BatchVectorEnv, NaoStandEnv)
walk = partial(BatchVectorEnv, NaoWalkEnv)
