"""A robot's motion before an episode: commands over time, planned once, that a file can hold."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.envs.command import Command
from surefoot.files import AnyPath, read_columns, write_text

BLEND_TIME = 1.5  # time in s in which the robot goes from an episode's first posture to a prelude's, and back
SAME_POSTURE = 0.005
"""Difference in rad between two targets of a motor that is not worth a way from one to the other."""

SAME_PLACE = 0.005
"""Distance in m by which soles of a prelude may be off those of the episode that follows it."""

_CURE = "write it with surefoot calibrate motion"

_COLUMNS = (
    ("com", "m", ("x", "y", "z")),
    ("com_velocity", "m_s", ("x", "y", "z")),
    ("com_acceleration", "m_s2", ("x", "y", "z")),
    ("cop", "m", ("x", "y")),
    ("position_sole", "m", ("left_x", "left_y", "left_z", "right_x", "right_y", "right_z")),
    ("yaw_sole", "rad", ("left", "right")),
    ("stance", "1", ("left", "right")),
    ("swing", "1", ("left", "right")),
)


class Prelude(NamedTuple):
    """N rows of commands for M motors.

    Attributes:
        dt: Time between two rows in s; the first row is ``dt`` after the beginning.
        motors: Names of the motors.
        commands: The rows, N in front of each field; their phase is 0.
        rest: Rows at which the robot is in its first posture again and may stop, shape (N,), bool.
    """

    dt: float
    motors: tuple[str, ...]
    commands: Command
    rest: NDArray[np.bool_]

    @property
    def duration(self) -> float:
        """Its length in s."""
        return self.dt * len(self.rest)

    @classmethod
    def of_commands(
        cls, dt: float, motors: tuple[str, ...], commands: Sequence[Command], rest: NDArray[np.bool_]
    ) -> "Prelude":
        """Put commands into rows."""
        parts: Any = map(np.array, zip(*commands, strict=True))
        return cls(dt, motors, Command._make(parts)._replace(phase=0.0), rest)

    def command(self, row: int) -> Command:
        """Return the command of a row."""
        *parts, phase = self.commands
        return Command._make([*(part[row] for part in parts), phase])

    def write(self, path: AnyPath) -> None:
        """Write a CSV: ``time_s``, ``target_<motor>_rad``, the other fields with units, and ``rest_1``."""
        names = ["time_s", *(f"target_{motor}_rad" for motor in self.motors), *_names(), "rest_1"]
        time = self.dt * np.arange(1, len(self.rest) + 1)
        parts = [np.reshape(getattr(self.commands, field), (len(time), -1)) for field, _, _ in _COLUMNS]
        rows = np.column_stack([time, self.commands.joint_target, *parts, self.rest])
        lines = [",".join(names), *(",".join(f"{value:.7g}" for value in row) for row in rows)]
        write_text(path, "\n".join(lines) + "\n")

    @classmethod
    def read(cls, path: AnyPath) -> "Prelude":
        """Read a file of :meth:`write`.

        Raises:
            ValueError: If it is no such table, a column is missing, a number is not finite, or the times are
                not evenly spaced.
        """
        table = read_columns(path, ("time_s", *_names(), "rest_1"), _CURE)
        targets = [name for name in table if name.startswith("target_") and name.endswith("_rad")]
        motors = tuple(name.removeprefix("target_").removesuffix("_rad") for name in targets)
        time = table["time_s"]
        if len(time) < 2 or np.ptp(np.diff(time)) > 1e-5 or not time[-1] > time[0] >= 0.0:
            raise ValueError(f"{path} must have two rows or more, evenly spaced in time.")
        parts: dict[str, Any] = {}
        for field, unit, axes in _COLUMNS:
            values = np.stack([table[f"{field}_{axis}_{unit}"] for axis in axes], axis=1)
            parts[field] = values.astype(bool) if field in ("stance", "swing") else values
        parts["position_sole"] = parts["position_sole"].reshape(-1, 2, 3)
        target = np.stack([time, *(table[name] for name in targets)], axis=1)[:, 1:]
        commands = Command(target, **parts, phase=0.0)
        return cls(float(time[-1]) / len(time), motors, commands, table["rest_1"].astype(bool))


class Player:
    """Plays a prelude, or its file, or none, before an environment's own commands, in steps of ``dt`` s.

    ``motors`` are the environment's; ValueError if the prelude is for others.
    """

    def __init__(self, prelude: Prelude | AnyPath | None, motors: Sequence[str], dt: float) -> None:
        if prelude is not None and not isinstance(prelude, Prelude):
            try:
                prelude = Prelude.read(prelude)
            except TypeError as error:
                raise TypeError(f"'prelude' must be a Prelude or the path of one: {error}") from None
        if prelude is not None and prelude.motors != tuple(motors):
            raise ValueError(
                f"'prelude' moves {list(prelude.motors)}, but the robot's motors are {list(motors)}; plan "
                "one for this robot: surefoot calibrate motion."
            )
        self._prelude, self._dt = prelude, dt
        self._played: list[Command] = []
        self._ends: list[int] = []
        if prelude is not None:
            last, ratio = len(prelude.rest) - 1, dt / prelude.dt
            row = ratio * np.arange(1, int((last + 1) / ratio + 1e-9) + 1) - 1.0
            self._played = [self._between(float(one)) for one in row]
            nearest = np.minimum(np.round(row), last)
            self._ends = [int(np.searchsorted(nearest, end)) + 1 for end in np.flatnonzero(prelude.rest)]
        self._commands: list[Command] = []
        self._stops: list[int] = []
        self._next = self._end = 0

    @property
    def duration(self) -> float:
        """Length of the prelude in s; 0 without one."""
        return 0.0 if self._prelude is None else self._prelude.duration

    @property
    def playing(self) -> bool:
        """Whether there is anything left to play."""
        return self._next < self._end

    @property
    def resting(self) -> bool:
        """Whether the robot has just come back to where it may stop."""
        return self._next in self._stops

    def begin(self, first: Command) -> None:
        """Start an episode whose commands begin with ``first``; ValueError if its soles are elsewhere."""
        if not self._played:
            return
        off = float(np.abs(self._played[0].position_sole - first.position_sole).max())
        if off > SAME_PLACE:
            raise ValueError(
                f"'prelude' has its soles {1e3 * off:.0f} mm from where the episode begins; plan one for a "
                "stand like the episode's."
            )
        there = self._blend(first, self._played[0])
        self._commands = [*there, *self._played, *self._blend(self._played[-1], first)]
        self._stops = [len(there) + end for end in self._ends]
        self._next, self._end = 0, len(self._commands)

    def stop(self) -> None:
        """Go back to the episode's first posture now; only where the robot is :attr:`resting`."""
        if self.resting:
            self._next = max(self._next, self._stops[-1])

    def next(self) -> Command:
        """Return the next command."""
        self._next += 1
        return self._commands[self._next - 1]

    def _between(self, row: float) -> Command:
        """Interpolate between rows."""
        assert self._prelude is not None
        low = min(max(int(row), 0), len(self._prelude.rest) - 1)
        high = min(low + 1, len(self._prelude.rest) - 1)
        return _mix(self._prelude.command(low), self._prelude.command(high), min(max(row - low, 0.0), 1.0))

    def _blend(self, start: Command, end: Command) -> list[Command]:
        """Go from one posture to another with least jerk."""
        if np.abs(start.joint_target - end.joint_target).max() < SAME_POSTURE:
            return []
        t = np.arange(1, round(BLEND_TIME / self._dt) + 1) * self._dt / BLEND_TIME
        shares = t**3 * (10.0 + t * (6.0 * t - 15.0))
        still: dict[str, Any] = {"com_velocity": np.zeros(3), "com_acceleration": np.zeros(3)}
        return [_mix(start, end, float(share))._replace(**still) for share in shares]


def _names() -> list[str]:
    return [f"{field}_{axis}_{unit}" for field, unit, axes in _COLUMNS for axis in axes]


def _mix(start: Command, end: Command, share: float) -> Command:
    parts: dict[str, Any] = {
        name: (1.0 - share) * getattr(start, name) + share * getattr(end, name)
        for name in Command._fields
        if name not in ("stance", "swing")
    }
    return Command(stance=start.stance & end.stance, swing=start.swing & end.swing, **parts)
