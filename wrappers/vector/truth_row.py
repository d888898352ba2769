"""Carries a robot's truth through a vector environment's own machinery, as one more row of the observation.

A vector environment already gathers observations from its copies, through shared memory where they live in
processes of their own, and hands over the last one of an episode where it resets by itself. A row beside the
observation travels that way for free. The wrapper around the vector environment takes it out before anyone
sees it.

The row holds the simulator's readings at each substep; its meaning is worked out where it is read.
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surefoot.envs.instrumentation.robot import TORSO_WIDTH, FootColumns
from surefoot.robot.sensing.raw_view import TRUE_KEYS, TRUTH_KEY, own_copy
from surefoot.sensors.telemetry.computer import MEASURED
from surefoot.wrappers.source import (
    check_clock,
    check_order,
    find_source,
    refuse_second,
    warning_of_true_forces,
    with_source,
)

if TYPE_CHECKING:
    AnyVectorWrapper = VectorWrapper[Any, Any, Any, Any, Any]
else:  # before Gymnasium 1.4 the class takes no types
    AnyVectorWrapper = VectorWrapper

NO_PLAN = -1.0
"""What the row holds for feet planned to stand and to swing, 0 or 1, where nobody plans."""


class RowMeaning(NamedTuple):
    """The meaning of the rows of a robot's copies."""

    rows: int  # number of substeps S of a control step
    columns: int
    """Number of the simulator's sensors, those of one substep after the other in front; feet planned to stand
    and to swing follow."""
    feet: int  # number of feet F
    joints: tuple[str, ...]  # names of the J hinge joints
    dt: float  # duration of a control step in s
    seldom: bool  # whether only one of several substeps of a control step is read
    state: tuple[tuple[str, int, int], ...]
    """Where (name, start, stop) of the parts that telemetry has (``MEASURED``) lie in
    ``observation["state"]``, or nothing."""

    @property
    def size(self) -> int:
        """Number of all columns."""
        return self.rows * self.columns + 2 * self.feet

    def read(self, rows: "NDArray[np.float64] | Lent") -> "Lent":
        """Take many robots' rows apart, shape (N, size)."""
        if isinstance(rows, Lent):
            return rows
        substeps, plans = rows[:, : -2 * self.feet], rows[:, -2 * self.feet :]
        return Lent(substeps.reshape(len(rows), self.rows, self.columns), plans)


class Lent(NamedTuple):
    """What a row holds, of one robot or of N, in arrays that the next step overwrites."""

    substeps: NDArray[np.float64]  # the simulator's readings in each substep, shape (..., S, columns)
    plans: NDArray[np.float64]
    """Feet planned to stand and to swing, 0 or 1, shape (..., 2 F); :data:`NO_PLAN` for none."""


class TruthRow(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Put one row of truth beside a robot's observation, for a vector wrapper to take out again.

    It goes around each copy, for instance by ``gym.make_vec(..., wrappers=[TruthRow])``. A robot that does
    not record its truth is instrumented first (:class:`~surefoot.envs.InstrumentedEnv`). An observation that
    is no ``Dict`` becomes its ``"state"``; parts that only truth has are left out. Never give a policy
    this wrapper's return value.

    Args:
        env: An environment built on MuJoCo.
        keep_info: Whether ``info["surefoot"]``, in which the copy has its truth, is handed on; it costs
            more than everything else here.

    Attributes:
        row_meaning: The meaning of the row.
        warning: Of other truth in the observation, for the wrapper around all copies to give once.
        lends: Whether the row is lent (:class:`Lent`) to who reads it at once, and not copied.

    Raises:
        TypeError: If the environment is not built on MuJoCo, there is another row below, or a wrapper below
            has made something else of an observation with truth in it.
        RuntimeError: At a step, if a wrapper below repeats steps or resets by itself.
    """

    def __init__(self, env: gym.Env[Any, Any], *, keep_info: bool = False) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, keep_info=keep_info)
        if TRUTH_KEY in getattr(getattr(env, "observation_space", None), "spaces", ()):
            raise TypeError(f"TruthRow found another TruthRow below it; one is enough. Got {env}.")
        refuse_second("TruthRow", env)
        gym.Wrapper.__init__(self, with_source(env))
        source = find_source(self.env)
        assert source is not None
        self._source: Any = source
        check_order("TruthRow", self.env, source)
        space = self.env.observation_space
        self._flat = not isinstance(space, spaces.Dict)
        parts = dict(space.spaces) if isinstance(space, spaces.Dict) else {"state": space}
        self.row_meaning = _meaning(source)
        self.warning = warning_of_true_forces(self.env)
        self._keep_info = keep_info
        if not keep_info and hasattr(source, "tells"):
            source.tells = False
        self._plans = self.lends = False
        self._kept = [key for key in parts if key not in TRUE_KEYS]
        row = spaces.Box(-np.inf, np.inf, (self.row_meaning.size,), np.float64)
        self.observation_space = spaces.Dict({key: parts[key] for key in self._kept} | {TRUTH_KEY: row})

    @property
    def drawing(self) -> Any:
        """The drawing by the robot's maker."""
        return self._source.drawing

    @property
    def row_key(self) -> Any:
        """The :class:`~surefoot.envs.instrumentation.robot.RowLayout` of the simulator's columns."""
        return self._source.truth.layout

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.begin(self._source)
        self._clock: float | None = None
        return self.show(observation, self._source), self._info(info)

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        before, self._clock = self._clock, float(self._source.truth.time[-1])
        if before is not None:
            check_clock("TruthRow", self.env, self._clock - before, self.row_meaning.dt, self._source)
        return self.show(observation, self._source), reward, terminated, truncated, self._info(info)

    def begin(self, source: Any) -> None:
        """Read the attributes that a source has once it has been reset."""
        self._plans = hasattr(source, "command")

    def show(self, observation: Any, source: Any) -> dict[str, Any]:
        """Return an observation and the row of its source's truth, of one robot or with many in front."""
        parts = {"state": observation} if self._flat else observation
        seen = {key: own_copy(parts[key]) for key in self._kept}
        rows = source.truth.rows
        plans = np.full((*rows.shape[:-2], 2 * self.row_meaning.feet), NO_PLAN)
        if self._plans:
            command = source.command
            plans[...] = np.concatenate([command.stance, command.swing], axis=-1)
        if self.lends:
            return {**seen, TRUTH_KEY: Lent(rows, plans)}
        return {**seen, TRUTH_KEY: np.concatenate([rows.reshape(*rows.shape[:-2], -1), plans], axis=-1)}

    def _info(self, info: dict[str, Any]) -> dict[str, Any]:
        return info if self._keep_info else _without_truth(info)


class VectorTruthRow(AnyVectorWrapper):
    """Put the rows of truth of a :class:`~surefoot.envs.batch.BatchVectorEnv` beside its observations.

    They are those of :class:`TruthRow` around each robot, lent or copied. ``VectorFootSensors`` puts this
    wrapper around such an environment itself.

    Raises:
        TypeError: If a wrapper below changes observations.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], lends: bool = False) -> None:
        super().__init__(env)
        batch: Any = env.unwrapped
        if env.single_observation_space != batch.single_observation_space:
            raise TypeError(
                "VectorFootSensors reads what a vector environment observes, and a wrapper below it has made "
                f"something else of that; wrap in this order: VectorFootSensors(envs), and once. Got {env}."
            )
        self._batch = batch
        self._row = TruthRow(batch.envs[0])
        self._row.lends = lends
        self.single_observation_space = self._row.observation_space

    @property
    def observation_space(self) -> spaces.Space[Any]:
        """That of all rows, made when asked for: bounds of thousands are as large as records."""
        return batch_space(self.single_observation_space, self.num_envs)

    @observation_space.setter
    def observation_space(self, space: spaces.Space[Any]) -> None:
        raise AttributeError("The space of VectorTruthRow follows from that of one robot, and is not set.")

    @property
    def mean_truth(self) -> dict[str, NDArray[Any]]:
        """Means of the rows, as :class:`~surefoot.envs.instrumentation.means.MeanTruth` makes them."""
        truth: dict[str, NDArray[Any]] = self._batch.mean_truth
        return truth

    def get_attr(self, name: str) -> list[Any]:
        """Return an attribute of the :class:`TruthRow` that might be around each robot."""
        return [getattr(self._row, name)] * self.num_envs

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset all robots, or those of ``options["reset_mask"]``."""
        observations, infos = self.env.reset(seed=seed, options=options)
        self._row.begin(self._batch)
        return self._row.show(observations, self._batch), _without_truth(infos)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all robots."""
        observations, *paid, infos = self.env.step(actions)
        infos = _without_truth(infos)
        if self._batch.ended:
            finals = infos["final_obs"].copy()
            for robot, ended in self._batch.ended.items():
                finals[robot] = self._row.show(finals[robot], ended)
            infos |= {"final_obs": finals, "final_info": _without_truth(infos["final_info"])}
        return self._row.show(observations, self._batch), *paid, infos


def _without_truth(infos: dict[str, Any]) -> dict[str, Any]:
    return {key: part for key, part in infos.items() if key not in ("surefoot", "_surefoot")}


def _meaning(source: Any) -> RowMeaning:
    feet, joints = len(source.drawing.feet), tuple(source.joint_names)
    if hasattr(source, "channels"):
        columns = source.channels.size
    else:
        columns = FootColumns.width * feet + TORSO_WIDTH + len(joints) + 1
    seldom = getattr(source, "seldom", False)
    rows = 1 if seldom else round(source.dt / source.model.opt.timestep)
    named = getattr(source, "state_layout", None)
    state = () if named is None else tuple((name, named[name].start, named[name].stop) for name in MEASURED)
    return RowMeaning(rows, int(columns), feet, joints, float(source.dt), seldom, state)
