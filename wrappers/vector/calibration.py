"""Calibration of N robots, independent of the kind of vector environment."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.online import MethodOptions
from surefoot.robot.calibration import CalibrationFace, CalibrationSetup, RobotCalibration
from surefoot.robot.foot_view import drop_counts
from surefoot.robot.native import ManySamples, NativeSample
from surefoot.wrappers.vector.sensors import BatchSensors

Mask = NDArray[np.bool_]


class BatchCalibration:
    """Calibrate the readings of :class:`BatchSensors`, and compute the observations of the feet.

    Each robot has its own calibrator, with the result that it would have alone. Options are those of
    :class:`~surefoot.wrappers.SelfCalibration`; ``owner`` is the name of the wrapper, for messages.

    Attributes:
        robots: The beliefs and the calibrator of each robot.
        setup: The common setup.
        shown: The present observation, with the robots as first axis. Later steps do not change its arrays.
        ended: The observation before the last episodes started.
        told: The present ``info``.

    Raises:
        ValueError: If the method or an option does not exist, a value is out of range, or no nominal model
            can be built for the robot, which needs one free body, hinge joints and feet.
    """

    def __init__(
        self, owner: str, sensors: BatchSensors, method: str | MethodOptions = "moment", /, **options: Any
    ) -> None:
        self._sensors = sensors
        self.setup = setup = CalibrationSetup(owner, sensors.equipment, method, **options)
        self.robots = [RobotCalibration(setup, robot) for robot in sensors.robots]
        self._judged = False
        self._together: ManySamples | None = None
        self.shown: dict[str, NDArray[Any]] = {}
        self.ended = self.shown
        self.told: dict[str, Any] = {}
        sensors.listen(self)

    def step(self, starting: Mask | None, fell: Mask | None) -> None:
        """Calibrate by one sample after a step of the sensors, see :class:`Listener`."""
        if starting is not None:
            self._begin(np.flatnonzero(starting).tolist(), [None] * len(starting), None)
        self._sample(np.arange(len(self.robots)))
        for i in [] if fell is None else np.flatnonzero(fell).tolist():
            self.robots[i].retract()

    def begin(self, mask: Mask, seeds: Sequence[int | None], choice: str | None) -> None:
        """Process robots that were reset, after their sensors, see :class:`Listener`."""
        which = np.flatnonzero(mask)
        self.ended = self.shown
        self._begin(which.tolist(), seeds, choice)
        self._sample(which)

    def around(self, observed: Mapping[str, Any], parts: Mapping[str, Any]) -> dict[str, Any]:
        """Add parts to the observation of the sensors."""
        return {**drop_counts(observed, self.setup.show), **parts}

    def last_of(self, robot: int) -> dict[str, NDArray[Any]]:
        """Return a copy of one robot's observation before its last episode started."""
        return {name: part[robot].copy() for name, part in self.ended.items()}

    def _begin(self, which: list[int], seeds: Sequence[int | None], choice: str | None) -> None:
        """Start episodes of robots. Warn once, about the first robot that could not calibrate for long."""
        for i in which:
            robot = self.robots[i]
            self._judged = self._judged or robot.judge()
            robot.reset(seeds[i], choice)
        self._gather()

    def _sample(self, which: NDArray[np.intp]) -> None:
        """Process one sample of some robots."""
        sensors, count = self._sensors, len(self.robots)
        readers, natives = sensors.together, self._together or self._gather()
        # A robot with new records has its last observation in `shown` only.
        if readers and natives and (len(which) == count or natives.sampled.all()):
            now, plans = sensors.time[which], None if sensors.plans is None else sensors.plans[which]
            then = self.robots[0].reference_time_at(now)
            natives.feed(which, readers, plans, then, now, self.robots[0].frozen, sensors.threads)
            self.shown, self.told = natives.outputs()
        else:
            each = which.tolist()
            shown, told = zip(*(self.robots[i].sample(sensors.plan_of(i)) for i in each), strict=True)
            self.shown, self.told = _put(shown, each, self.shown), _put(told, each, self.told)
        self.told["lag"] = np.full(count, self.robots[0].late)

    def _gather(self) -> ManySamples | None:
        """Return the library's object for samples of all robots; ``None`` if any robot runs in Python."""
        backends = [robot.backend for robot in self.robots if robot.made]
        if self._together is None or self._together.robots != backends:
            natives = [one for one in backends if isinstance(one, NativeSample)]
            self._together = ManySamples(natives) if len(natives) == len(self.robots) else None
        return self._together


class BatchCalibrationFace(CalibrationFace):
    """The common part of wrappers of :class:`BatchCalibration`."""

    calibration: BatchCalibration  # the calibration of all robots

    @property
    def _robots(self) -> Sequence[RobotCalibration]:
        return self.calibration.robots

    def _gather(self) -> None:
        self.calibration._gather()


def _put(rows: Sequence[Any], which: list[int], old: Any) -> Any:
    """Replace the samples of some robots in a tree of arrays of all robots."""
    if isinstance(rows[0], dict):
        return {name: _put([row[name] for row in rows], which, (old or {}).get(name)) for name in rows[0]}
    if rows[0] is None:
        return None
    new = np.array(rows)
    if old is None or len(old) == len(rows):
        return new
    kept = old.copy()
    kept[which] = new
    return kept
