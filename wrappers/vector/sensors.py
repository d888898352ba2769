"""The sensors of N robots, independent of the kind of vector environment."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.calibration import Parameters
from surefoot.checks import check_flag
from surefoot.envs import FeetTruth, RobotDrawing
from surefoot.envs.instrumentation.means import MeanTruth
from surefoot.native import cores
from surefoot.pickles import OfOneVersion
from surefoot.robot.sensing.condition import Faults, severity_of_each
from surefoot.robot.sensing.equipment import Equipment
from surefoot.robot.sensing.foot_equipment import FootEquipment
from surefoot.robot.sensing.native import ManySensing, NativeSensing
from surefoot.robot.sensing.raw_view import TRUTH_KEY, RawView
from surefoot.robot.sensing.sensors import RobotSensors, SensorsFace
from surefoot.wrappers.vector.truth_row import NO_PLAN, Lent, RowMeaning

Floats = NDArray[np.float64]
Rows = Floats | Lent
Mask = NDArray[np.bool_]

Seeds = int | Sequence[int | None] | None
"""One number for all robots, or a number or ``None`` per robot."""

Attribute = Callable[[str], Sequence[Any]]
"""Returns an attribute of each copy."""

_PLANNED = (NO_PLAN, 0.0, 1.0)
_CHANGED = (
    "{owner} reads the rows of truth as TruthRow writes them, but a wrapper between them has changed them; "
    "put whatever stacks, scales or changes observations around {owner}."
)


class Planned(NamedTuple):
    """Planned stance and swing of a robot's feet, (F,) each, as in :class:`~surefoot.envs.Command`."""

    stance: Mask
    swing: Mask


class Listener(Protocol):
    """An object that processes the readings when they are taken."""

    def step(self, starting: Mask | None, fell: Mask | None) -> None:
        """Process a step, with masks of robots that were reset instead and that have fallen, (N,) each."""

    def begin(self, mask: Mask, seeds: Sequence[int | None], choice: str | None) -> None:
        """Process the robots of a mask that were reset, shape (N,), with their seeds and the choice."""


class BatchSensors(OfOneVersion):
    """Read N robots through load cells or ankle sensors, joint encoders and IMUs.

    ``owner`` is the name of the wrapper, for messages, ``space`` the observation space of one copy, and
    ``given`` the sensors that the user chose. Each robot has the readings that it would have alone.

    Attributes:
        drawing: The robot.
        equipment: The sensors of this type of robot.
        robots: The sensors of each robot.
        view: The common view.
        plans: Planned stance, then swing, of the feet, shape (N, 2 F); ``None`` without a plan.
        listeners: Objects that process the readings.
        threads: Number of threads for sensors and calibrators, by default all cores.
        time: The hosts' times since their resets in s, shape (N,).
        together: The library's reader of all robots; ``None`` if any robot is read in Python.

    Raises:
        TypeError: If copies have no row of truth, or already have sensors.
        ValueError: If copies differ, a preset is unknown, a value is out of range, or the sensors do not fit.
    """

    def __init__(
        self,
        owner: str,
        count: int,
        space: Any,
        attribute: Attribute,
        given: FootEquipment,
        measure_state: bool = True,
    ) -> None:
        check_flag("measure_state", measure_state)
        self.drawing, self._meaning = _check_copies(owner, space, attribute)
        for warning in sorted(set(attribute("warning")) - {""}):
            warnings.warn(warning, stacklevel=3)
        self._attribute, joints = attribute, self._meaning.joints
        meaning = self._meaning
        self._owner = owner
        self.equipment = Equipment(owner, self.drawing, joints, meaning.dt, given, meaning.seldom)
        if "foot_raw" in space.spaces:
            raise TypeError(
                f"{owner} adds 'foot_raw' to an observation that has a part of that name already."
            )
        state = {name: slice(start, stop) for name, start, stop in self._meaning.state}
        readings, packet = self.equipment.instruments.space, self.equipment.packet
        self.view = RawView(space, readings, state if state and measure_state else None, packet)
        self.robots = [RobotSensors(self.equipment, self.view.measures) for _ in range(count)]
        self.plans: NDArray[np.bool_] | None = None
        self.listeners: list[Listener] = []
        self._substeps: Floats = np.zeros((count, 0, 0))
        self._key: Any = None
        self._drawn: dict[str, NDArray[Any]] = {}
        self.together: ManySensing | None = None
        self.threads = cores()
        self._put_side_by_side()

    def listen(self, listener: Listener) -> None:
        """Send telemetry from the next reset on, and notify a listener of every step and reset."""
        self.listeners.append(listener)
        for robot in self.robots:
            robot.listening = True

    def reset(self, rows: Rows, mask: Mask | None, seed: Seeds, asked: Mapping[str, str]) -> None:
        """Read robots that were reset, those of a mask (N,) or all, with rows of truth, shape (N, R).

        ``asked`` holds ``"fresh"`` or ``"keep"`` by kind, if the caller chose it.
        """
        count = len(self.robots)
        mask = np.ones(count, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        each = list(seed) if isinstance(seed, Sequence) else [seed] * count
        if not isinstance(seed, Sequence) and seed is not None:
            each = [seed + robot for robot in range(count)]  # as in Gymnasium
        self._key = self._attribute("row_key")[0]
        self._mean_truth = MeanTruth(self._key)
        self.begin(rows, mask, each, asked)

    def step(self, rows: Rows, starting: Mask | None = None, fell: Mask | None = None) -> None:
        """Read all robots after a control step, with one row of truth each, shape (N, R).

        ``starting`` and ``fell`` are masks of robots that were reset instead and that terminated, (N,) each.
        """
        substeps, dt = self._look(rows), self._meaning.dt
        begins = np.zeros(len(substeps), dtype=bool) if starting is None else np.asarray(starting)
        left = np.flatnonzero(self._read_together(substeps, ~begins)).tolist()
        for i in left:
            truth = FeetTruth(substeps[i], self._key)
            if begins[i]:
                self.robots[i].reset(truth, dt)
            else:
                self.robots[i].step(truth)
        if left:
            self._gather(left)
        if starting is not None:
            self._note_conditions()
        for listener in self.listeners:
            listener.step(starting, fell)

    def begin(
        self,
        rows: Rows,
        mask: Mask,
        seeds: Sequence[int | None] | None = None,
        asked: Mapping[str, str] | None = None,
    ) -> None:
        """Read robots of a mask that start an episode; within a step it follows :meth:`step`.

        Arguments are those of :meth:`reset`. Rows of these robots belong to the new episode.
        """
        substeps, asked = self._look(rows), asked or {}
        if not isinstance(rows, Lent) and not np.isin(rows[:, -2 * self._meaning.feet :], _PLANNED).all():
            raise TypeError(_CHANGED.format(owner=self._owner))
        seeds = [None] * len(substeps) if seeds is None else seeds
        which = np.flatnonzero(mask).tolist()
        for i in which:
            truth = FeetTruth(substeps[i], self._key)
            self.robots[i].reset(truth, self._meaning.dt, seeds[i], asked.get("sensors"))
        self._gather(which)
        self._note_conditions()
        for listener in self.listeners:
            listener.begin(mask, seeds, asked.get("calibration"))

    def show(self, observations: Mapping[str, Any]) -> dict[str, Any]:
        """Return the observations with the hosts' present data, without changing the environment's arrays."""
        return self.view.show(observations, self._held, self._newest)

    def show_one(self, observation: Mapping[str, Any], robot: int) -> dict[str, Any]:
        """Return the observation of one robot with its host's present data."""
        own = self.robots[robot]
        return self.view.show(observation, own.held, own.newest)

    @property
    def truth(self) -> dict[str, NDArray[Any]]:
        """The truth: :func:`~surefoot.envs.instrumentation.means.mean_truth`, and :meth:`conditions`."""
        return self._mean_truth(self._substeps, self.threads) | self.true_conditions()

    def true_conditions(self) -> dict[str, NDArray[Any]]:
        """Return the robots' drawn conditions, (N, ...); empty if they do not differ."""
        return {name: part.copy() for name, part in self._drawn.items()}

    def _robots_of(self, robots: Sequence[int] | None) -> list[RobotSensors]:
        """Return robots by index."""
        count = len(self.robots)
        given = np.arange(count) if robots is None else np.asarray(robots).ravel()
        if given.size and not np.issubdtype(given.dtype, np.integer):
            raise TypeError(
                f"'robots' must be their numbers, got {robots!r}; np.flatnonzero makes them of a mask."
            )
        numbers = given.tolist()
        odd = [number for number in numbers if not 0 <= number < count]
        if odd:
            raise IndexError(f"There are robots 0 to {count - 1}, got {odd}.")
        return [self.robots[number] for number in numbers]

    def _note_conditions(self) -> None:
        """Store the robots' drawn conditions, shape (N, ...); nothing if they do not differ."""
        differ = any(robot.differs for robot in self.robots)
        drawn = [robot.true_condition() for robot in self.robots] if differ else [{}]
        self._drawn = {name: np.array([one[name] for one in drawn]) for name in drawn[0]}

    def _read_together(self, truth: Floats, steps: Mask) -> Mask:
        """Read a control step of all robots of a mask in one call of the library, if possible.

        ``truth`` holds sensor data of each substep, shape (N, S, columns). Returns a mask of the robots that
        remain to be read.
        """
        together, left = self.together, np.ones(len(steps), dtype=bool)
        if together is not None and len(steps) > 1:
            which, dt = np.flatnonzero(steps), self._meaning.dt
            if together.step(which, truth, self.time[which] + dt, self.threads):
                self.time[which] += dt
                left[which] = False
        return left

    def _gather(self, alone: Sequence[int] = ()) -> None:
        """Collect the library's readers of all robots, after some were read alone or have new ones."""
        readers = [robot.backend for robot in self.robots]
        if self.together is None or self.together.robots != readers:
            native = [one for one in readers if isinstance(one, NativeSensing)]
            self.together = ManySensing(native) if len(native) == len(readers) else None
        else:
            self.together.count_packets(alone)

    def _put_side_by_side(self) -> None:
        """Store the hosts' readings in arrays with the robots as first axis."""
        count, first = len(self.robots), self.robots[0]
        self._held = np.zeros((count, *first.held.shape), first.held.dtype)
        self._newest, self.time = np.zeros((count, *first.newest.shape)), np.zeros(count)
        for i, robot in enumerate(self.robots):
            robot.keep_in(self._held[i], self._newest[i], self.time[i : i + 1])

    def __setstate__(self, kept: dict[str, Any]) -> None:
        # After copying, rows no longer share memory with these arrays.
        super().__setstate__(kept)
        self._put_side_by_side()

    def _look(self, rows: Rows) -> Floats:
        """Store each robot's plan, and return the sensor data of each substep, (N, S, columns)."""
        self._substeps, plans = self._meaning.read(rows)
        self.plans = None if (plans[:, 0] == NO_PLAN).all() else plans > 0.0
        return self._substeps

    def plan_of(self, robot: int) -> Planned | None:
        """Return the plan of a robot, or ``None`` without a plan."""
        if self.plans is None:
            return None
        return Planned(*np.split(self.plans[robot], 2))


class BatchSensorsFace(SensorsFace):
    """The common part of wrappers of :class:`BatchSensors`."""

    sensors: BatchSensors  # the sensors of all robots

    def set_severity(self, severity: Any, robots: Sequence[int] | None = None) -> None:
        """Set the severity of the next fresh sensors of some robots.

        Args:
            severity: A number or a tuple (lowest, highest) for all of them, or a list or an array with one
                per robot.
            robots: Their indices; ``None`` for all.

        Raises:
            IndexError: If a robot does not exist.
            ValueError: If there are more or fewer values than robots, or a device does not allow one.
        """
        named, set_one = self.sensors._robots_of(robots), self.sensors.equipment.with_severity
        values = severity_of_each(severity, len(named))
        found = [set_one(robot.conditions, value) for robot, value in zip(named, values, strict=True)]
        for robot, conditions in zip(named, found, strict=True):
            robot.conditions = conditions

    def set_faults(self, faults: Faults, robots: Sequence[int] | None = None) -> None:
        """Set the faults of some robots, or their probabilities, from their next resets on.

        Args:
            faults: As for :class:`~surefoot.wrappers.FootSensors`, for each of them.
            robots: Their indices; ``None`` for all.

        Raises:
            IndexError: If a robot does not exist.
            ValueError: If a fault or a probability is refused.
        """
        sensors = self.sensors
        named = sensors._robots_of(robots)
        found = [sensors.equipment.with_faults(robot.conditions, faults) for robot in named]
        for robot, conditions in zip(named, found, strict=True):
            robot.conditions = conditions

    def true_parameters(self) -> Parameters:
        """Return the maps that correct the feet's present errors, shape (N, K): truth, for scoring."""
        maps = [robot.true_parameters() for robot in self.sensors.robots]
        return Parameters(*map(np.array, zip(*maps, strict=True)))

    @property
    def _robots(self) -> Sequence[RobotSensors]:
        return self.sensors.robots

    def _gather(self) -> None:
        self.sensors._gather()


def merge_rows(rows: Any, finals: Mapping[int, Mapping[str, Any]]) -> Any:
    """Return a copy in which the rows of some robots, by index, are the last ones of their episodes."""
    if not finals:
        return rows
    if isinstance(rows, Lent):
        merged = Lent(*(part.copy() for part in rows))
        for robot, final in finals.items():
            merged.substeps[robot], merged.plans[robot] = final[TRUTH_KEY]
        return merged
    merged = rows.copy()
    for robot, final in finals.items():
        merged[robot] = final[TRUTH_KEY]
    return merged


def _check_copies(owner: str, space: Any, attribute: Attribute) -> tuple[RobotDrawing, RowMeaning]:
    """Return the robot of all copies, which must be the same and show its truth, and the meaning of its rows.

    Raises:
        TypeError: If copies have no row of truth.
        ValueError: If copies differ.
    """
    if not isinstance(space, spaces.Dict) or TRUTH_KEY not in space.spaces:
        shown = list(space.spaces) if isinstance(space, spaces.Dict) else space
        raise TypeError(
            f"{owner} reads a row of truth beside each copy's observation, found none in {shown}; wrap "
            "each copy: gym.make_vec(..., vectorization_mode='sync', wrappers=[TruthRow]), or for SB3 "
            f"DummyVecEnv([lambda: TruthRow(gym.make(...))]), and {owner} right around them."
        )
    shown = attribute("observation_space")
    odd = [i for i, own in enumerate(shown) if own != shown[0]]
    if odd:
        raise ValueError(
            f"{owner} needs copies with one observation space, but those of copies {odd} are not that of "
            f"copy 0: {shown[odd[0]]} is not {shown[0]}."
        )
    drawings, meanings = attribute("drawing"), attribute("row_meaning")
    if space[TRUTH_KEY].shape != (meanings[0].size,):
        raise TypeError(_CHANGED.format(owner=owner))
    first, meaning = drawings[0], meanings[0]
    odd = [
        i
        for i, own in enumerate(drawings)
        if own.xml != first.xml
        or not np.array_equal(own.position_cell_sole, first.position_cell_sole)
        or meanings[i] != meaning
    ]
    if odd:
        raise ValueError(
            f"{owner} needs copies of one robot, but copies {odd} are of another than copy 0 (other bodies, "
            "masses, joints, cells or control steps); put them into vector environments of their own."
        )
    return first, meaning
