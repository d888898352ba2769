"""The observation of a robot on two feet that follows a pattern: its state and the forces under its feet.

Everything is made from the last row of the control step's sensor data. :func:`observe` is the specification,
of one robot; :class:`FeetObserver` calls the library for one or many, with the same bits.
"""

from collections.abc import Sequence
from math import asin, atan2, exp
from typing import Any, Final, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.command import Command, command_state, rotate_level
from surefoot.envs.instrumentation.means import places_record
from surefoot.envs.instrumentation.robot import RowLayout
from surefoot.envs.instrumentation.truth import centres, ground_at_feet
from surefoot.native import ENVS, Call, Library, PointerRecord

Observation = dict[str, NDArray[Any]]

FORCE_BOUND: Final = 1000.0  # largest force that is shown in N, but of heavy robots
COP_BOUND: Final = 1.0  # largest coordinate of a centre of pressure that is shown in m
STATE: Final = 15  # numbers of the state after angles and speeds of the joints


class Places(NamedTuple):
    """Where things are that are shown."""

    feet: RowLayout  # in a row of sensor data
    joint_dofs: NDArray[np.intp]  # where the joints' speeds are in ``qvel``


class Seen(NamedTuple):
    """The end of one robot's control step, as its reward and the end of its episode depend on it.

    Errors are those of the centre of pressure (m) and of the centre of mass's velocity (m/s) less their
    references: in the world, or the true one in the level frame of the true soles and its reference in that
    of the commanded ones. A centre of pressure that does not exist is at the origin.
    """

    cop_valid: float  # whether there is a centre of pressure, 0 or 1
    cop_error_x: float
    cop_error_y: float
    cop_error_forward: float
    cop_error_left: float
    velocity_error_forward: float
    velocity_error_left: float
    up_x: float  # the vertical in the torso's axes
    up_y: float
    up_z: float
    height: float  # of the torso's origin in m
    effort: float  # reward of the action: -0.1 times its mean square


def closeness(x: float, y: float, scale: float) -> float:
    """Return 1 without an error (x, y), and 1/e for one as long as ``scale``."""
    return exp(-(x * x + y * y) / scale**2)


class Look(NamedTuple):
    """What is made of the last row of a control step, of one robot or with many in front."""

    observation: Observation  # the observation
    seen: Floats  # the numbers of :class:`Seen`, but for the last, shape (..., 11)
    cop_held: Floats
    """The last valid centres of pressure in m: of both feet in the level frame, and of each in its sole's
    frame, shape (..., 3, 2)."""


class FeetObserver:
    """Turns truth and command into an observation.

    ``force_bound`` is the largest force of a cell that is shown in N; ``state_layout`` says where each part
    lies in the state vector.
    """

    def __init__(self, places: Places, force_bound: float) -> None:
        self._places = places
        joints = places.joint_dofs.size
        bounds = {
            "joint_position": (joints, np.pi),
            "joint_velocity": (joints, 50.0),
            "tilt": (2, np.pi),
            "gyroscope": (3, 50.0),
            "com_reference": (2, 1.0),
            "com_reference_velocity": (2, 2.0),
            "cop_reference": (2, 1.0),
            "stance": (2, 1.0),
            "phase": (2, 1.0),
        }
        self.state_layout: dict[str, slice] = {}
        end = 0
        for name, (size, _) in bounds.items():
            self.state_layout[name] = slice(end, end + size)
            end += size
        self._high = np.concatenate([np.full(n, high, dtype=np.float32) for n, high in bounds.values()])
        self._low = -self._high
        self._low[self.state_layout["stance"]] = 0.0
        self._force_bound = force_bound
        self.space: Any = spaces.Dict(
            {
                "state": spaces.Box(self._low.copy(), self._high.copy(), dtype=np.float32),
                "foot_force": spaces.Box(-force_bound, force_bound, (8,), dtype=np.float32),
                "cop_foot": spaces.Box(-COP_BOUND, COP_BOUND, (2, 2), dtype=np.float32),
                "cop": spaces.Box(-COP_BOUND, COP_BOUND, (2,), dtype=np.float32),
                "cop_valid": spaces.Box(0.0, 1.0, (3,), np.float32),
            }
        )
        self._calls: dict[tuple[int, ...], _Observe | None] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        # Addresses are of no use elsewhere.
        return FeetObserver, (self._places, self._force_bound)

    def look(self, rows: Floats, qvel: Floats, command: Command, cop_held: Floats, threads: int = 1) -> Look:
        """Show the last row of a control step, of one robot, or of many on so many threads.

        Sensor data, shape (..., S, columns), and MuJoCo's velocities at the instant of the last row, (...,
        nv); ``cop_held`` is that of :class:`Look` before this step.
        """
        key = *rows.shape, qvel.shape[-1]
        if key not in self._calls:
            library = ENVS.installed()
            self._calls[key] = None if library is None else _Observe(library, self._places, key)
        native = self._calls[key]
        if native is not None:
            shown, wrench, seen, held = native(rows, qvel, command, cop_held, threads)
        elif rows.ndim == 2:
            shown, wrench, seen, held = observe(rows[-1], qvel, command, cop_held, self._places)
        else:
            parts: Any = command
            commands = [Command._make(part[robot] for part in parts) for robot in range(len(rows))]
            robots = zip(rows[:, -1], qvel, commands, cop_held, strict=True)
            looks = [observe(*robot, self._places) for robot in robots]
            shown = {name: np.array([look[0][name] for look in looks]) for name in looks[0][0]}
            wrench, seen, held = (np.array([look[i] for look in looks]) for i in (1, 2, 3))
        state = shown["state"]
        np.maximum(state, self._low, out=state)
        np.minimum(state, self._high, out=state)
        force = self._places.feet.force_cell(rows[..., -1, :], wrench).astype(np.float32)
        np.maximum(force, -self._force_bound, out=force)
        np.minimum(force, self._force_bound, out=force)
        parts = {"state": state, "foot_force": force, "cop_foot": shown["cop_foot"], "cop": shown["cop"]}
        return Look(parts | {"cop_valid": shown["cop_valid"]}, seen, held)


def observe(
    last: Floats, qvel: Floats, command: Command, cop_held: Floats, places: Places
) -> tuple[Observation, Floats, Floats, Floats]:
    """Show one robot, but for the forces of its cells; the state is not brought into its bounds.

    Of the last row, (columns,), MuJoCo's velocities then, (nv,), and ``cop_held`` before this step: the
    observation; wrenches at and in the soles' frames in N and N m, shape (12,); ``seen`` and ``cop_held`` of
    :class:`Look`.
    """
    row = last.tolist()
    columns = places.feet.columns
    wrench, common = ground_at_feet(places.feet.feet(row), columns.up)
    ((x, y), *cop_foot), valid = centres(wrench, common, places.feet.flat)
    middle_x, middle_y, heading = places.feet.level(row)
    level = rotate_level(x - middle_x, y - middle_y, heading)
    kept = cop_held.tolist()
    held = [
        place if there else old for there, place, old in zip(valid, (level, *cop_foot), kept, strict=True)
    ]
    shown = [[_clip(part, COP_BOUND) for part in place] for place in held]

    at, joints = columns.com_velocity.start, places.joint_dofs.size
    velocity = rotate_level(row[at], row[at + 1], heading)
    seen = [float(valid[0]), *_errors(command, (x, y), level, velocity)]
    torso = columns.axes_torso.start
    up = row[torso + 2], row[torso + 5], row[torso + 8]
    state = np.empty(2 * joints + STATE, dtype=np.float32)
    state[:joints] = last[columns.joint_position]
    state[joints : 2 * joints] = qvel[places.joint_dofs]
    tilt = atan2(up[1], up[2]), -asin(_clip(up[0], 1.0))
    state[2 * joints :] = [*tilt, *row[columns.gyroscope], *command_state(command)]
    return (
        {
            "state": state,
            "cop_foot": np.array(shown[1:], dtype=np.float32),
            "cop": np.array(shown[0], dtype=np.float32),
            "cop_valid": np.array(valid, dtype=np.float32),
        },
        np.array(wrench).ravel(),
        np.array([*seen, *up, row[columns.position_torso.start + 2]]),
        np.array(held),
    )


def _errors(
    command: Command, cop: tuple[float, float], cop_level: Sequence[float], velocity_level: Sequence[float]
) -> list[float]:
    """Return how far a robot is off its command: the errors of :class:`Seen` in their order."""
    (left_x, left_y, _), (right_x, right_y, _) = command.position_sole.tolist()
    left, right = command.yaw_sole.tolist()
    (vx, vy, _), (x, y) = command.com_velocity.tolist(), command.cop.tolist()
    heading = 0.5 * (left + right)
    velocity_plan = rotate_level(vx, vy, heading)
    cop_plan = rotate_level(x - 0.5 * (left_x + right_x), y - 0.5 * (left_y + right_y), heading)
    return [
        cop[0] - x,
        cop[1] - y,
        *(true - planned for true, planned in zip(cop_level, cop_plan, strict=True)),
        *(true - planned for true, planned in zip(velocity_level, velocity_plan, strict=True)),
    ]


def _clip(number: float, bound: float) -> float:
    return min(max(number, -bound), bound)


class _Observe:
    """The library's :func:`observe` for rows of a shape, whose last number is the length of ``qvel``."""

    def __init__(self, library: Library, places: Places, shape: tuple[int, ...]) -> None:
        *robots, substeps, columns, speeds = shape
        at = PointerRecord(
            library,
            "places",
            {
                "feet": places_record(library, places.feet, substeps, columns),
                "joint_dofs": places.joint_dofs.astype(np.int32),
                "cop_bound": COP_BOUND,
                "joints": places.joint_dofs.size,
                "speeds": speeds,
                **{name: getattr(places.feet.columns, name).start for name in _COLUMNS},
            },
        )
        single, real = np.float32, np.float64
        fields = {
            "wrench": (real, (12,)), "held": (real, (3, 2)), "seen": (real, (len(Seen._fields) - 1,)),
            "state": (single, (2 * places.joint_dofs.size + STATE,)), "cop_foot": (single, (2, 2)),
            "cop": (single, (2,)), "cop_valid": (single, (3,)),
        }  # fmt: skip
        front = robots[0] if robots else None
        self._call = Call(library, "surefoot_observe", "observation_room", at, fields, front)
        planned = library.record(
            "planned",
            dict.fromkeys(("com", "com_velocity", "cop", "yaw_sole", "stance"), (2,))
            | {"position_sole": (2, 2), "phase": ()},
        )
        assert planned is not None
        self._planned, self._front = planned, tuple(robots)

    def __call__(
        self, rows: Floats, qvel: Floats, command: Command, cop_held: Floats, threads: int
    ) -> tuple[Any, Floats, Floats, Floats]:
        planned = np.empty(self._front, self._planned)
        for name in ("com", "com_velocity", "cop"):
            planned[name] = getattr(command, name)[..., :2]
        planned["position_sole"] = command.position_sole[..., :2]
        for name in ("yaw_sole", "stance", "phase"):
            planned[name] = getattr(command, name)
        arrays = np.ascontiguousarray(rows), np.ascontiguousarray(qvel), planned, cop_held
        results = self._call(*arrays, threads=threads)
        return results, results["wrench"], results["seen"], results["held"]


_COLUMNS = ("axes_torso", "position_torso", "gyroscope", "com_velocity", "joint_position")
