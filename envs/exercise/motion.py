r"""The motions of an exercise: centre of mass, feet and targets of the motors.

*Paths* are straight lines of the centre of mass along which one foot may rise, with tabulated targets of the
motors. A *move* runs along a path from one point to another with minimum jerk: after the share :math:`t` of
its time it has covered the share :math:`s(t) = 10 t^3 - 15 t^4 + 6 t^5` of its length. The tables therefore
serve moves of any extent.

An episode lifts one foot and then the other, first for a short and then for a longer time, with sways and a
squat in between. Motions can also be played by name (:mod:`surefoot.envs.exercise.moves`). Distances are
shares of the soles' size and times are multiples of :math:`\sqrt{h / g}`, the time scale of a falling
pendulum (:math:`h` is the height of the centre of mass): a sway of amplitude :math:`A` in 4.5 of these units
needs a centre of pressure that leads by at most 0.29 :math:`A`.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise, product
from math import ceil, sqrt
from pathlib import Path
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from surefoot.arrays import Floats
from surefoot.envs.command import Command
from surefoot.envs.exercise.moves import SWAYS, Move, Schedule, motions_of, one_leg
from surefoot.envs.exercise.postures import Postures, UnreachableError
from surefoot.envs.exercise.robot import ExerciseRobot, prepare_robot
from surefoot.envs.instrumentation.made import keep
from surefoot.envs.prelude import Prelude
from surefoot.envs.robots.library import ROBOTS

MOVE_TIME: Final = 4.5  # duration of a sway to one side in units of sqrt(h / g)
KNOT_SPACING: Final = 0.2  # distance between tabulated postures as a share of a path

BENDS: Final = (0.6, 0.8, 1.0, 0.3)
"""Flexions that are added to the knees in rad. The first one for which the legs reach all paths is used."""

INWARD: Final = (0.0, 0.25, 0.5)
"""Distances from the middle of the sole, towards the other foot, at which the robot stands on one leg, as
shares of the sole's half width. The first one for which the legs reach all paths is used."""

FORWARD: Final = 0.45  # amplitude of a sway forward as a share of half a sole's length
ASIDE: Final = 0.6  # amplitude of a sway to a side as a share of half the distance between the feet
SQUAT: Final = 0.1  # depth of a squat as a share of the height of the centre of mass
LIFT: Final = 0.06  # lift of a foot as a share of the height of the centre of mass

ONE_LEG_FORWARD: Final = 0.35
"""Amplitude of a sway forward over one foot as a share of half its sole's length."""

ONE_LEG_ASIDE: Final = 0.3  # amplitude of a sway aside over one foot as a share of half its sole's width
SURELY_BEARS: Final = 0.1  # share of the weight above which a foot on the ground is in stance
SURELY_UP: Final = 0.5  # share of the lift above which a foot is in swing

REACH: Final = 1.6
"""Largest extent of a path if the legs reach it, for motions that are played by name."""

_PLANNED: "dict[tuple[Any, ...], Motion]" = {}


class Paths(NamedTuple):
    """P lines along which the robot moves, with a parameter s."""

    com: Floats  # centre of mass at s = 0 in m, shape (P, 3)
    along: Floats  # its displacement per unit of s in m, shape (P, 3)
    lift: Floats  # heights of both feet at s = 0 in m, shape (P, 2)
    rise: Floats  # their change per unit of s in m, shape (P, 2)
    first: Floats  # smallest s that the legs reach, shape (P,)
    last: Floats  # largest s that the legs reach, shape (P,)
    pieces: NDArray[np.intp]  # index of the last cubic of each path, shape (P,)
    piece: Floats
    """Cubics of the motors' targets in rad between knots: coefficients, that of the third power first, shape
    (P, pieces, 4, 3, M); paths with fewer knots are filled up."""

    @classmethod
    def of(cls, lines: Sequence[tuple[Any, ...]]) -> "Paths":
        """Collect lines, whose last entry is the spline of the targets, in arrays."""
        *parts, targets = zip(*lines, strict=True)
        cubics = [np.moveaxis(target.c, 0, 1) for target in targets]
        pieces = np.array([len(cubic) - 1 for cubic in cubics])
        piece = np.zeros((len(cubics), pieces.max() + 1, *cubics[0].shape[1:]))
        for row, cubic in zip(piece, cubics, strict=True):
            row[: len(cubic)] = cubic
        return cls._make((*map(np.array, parts), pieces, piece))


def plan_motion(robot: Any, feet: Sequence[str] | None, *, boxes: bool) -> "Motion":
    """Plan the exercise of a robot once per process. Each call returns another copy of the model.

    Arguments and errors are those of :func:`~surefoot.envs.exercise.robot.prepare_robot`; the plan
    of a ``mujoco.MjSpec`` is not stored. ValueError is also raised if the robot cannot do the exercise.
    """
    named = isinstance(robot, str) and robot in ROBOTS
    if not named and not (isinstance(robot, str | Path) and Path(robot).is_file()):
        return Motion(prepare_robot(robot, feet, boxes=boxes))
    version = None if named else (Path(robot).resolve(), Path(robot).stat().st_mtime_ns)
    key = (str(robot), version, repr(feet), boxes)
    own = copy(keep(_PLANNED, key, lambda: Motion(prepare_robot(robot, feet, boxes=boxes))))
    own.robot = replace(own.robot, model=copy(own.robot.model))
    return own


class Motion:
    """All motions of a robot in an exercise; ValueError if the legs cannot do them.

    Attributes of the posture between the moves: ``qpos``, (nq,); ``height`` of the centre of mass in m;
    ``up_torso``, the vertical in the torso's axes, (3,); ``position_sole`` in m, (2, 3), and the headings
    ``yaw_sole`` in rad, (2,).
    """

    def __init__(self, robot: ExerciseRobot) -> None:
        for inward, bend in product(INWARD, BENDS):
            try:
                self._plan(Postures(robot, bend, inward))
                return
            except UnreachableError as error:
                refusal = error
        raise ValueError(
            f"{refusal} A keyframe 'home' with the feet closer together or the knees less straight may help."
        )

    def shares(self, command: Command) -> Floats:
        """Return the planned share of the weight on each foot, shape (..., 2)."""
        return self._postures.shares(command.cop, command.position_sole[..., 2])

    def _plan(self, postures: Postures) -> None:
        self.robot = robot = postures.robot
        self._postures = postures
        self._gravity = robot.gravity
        self.qpos = postures.qpos
        self.height = float(postures.com[2])
        self.up_torso = postures.up_torso
        self.position_sole, self.yaw_sole = postures.position_sole, postures.yaw_sole
        self._unit = MOVE_TIME * sqrt(self.height / self._gravity)
        middle, still = postures.com, np.zeros(2)
        half = float(np.linalg.norm(postures.stand[0] - postures.stand[1])) / 2.0
        x = FORWARD * robot.half[0] * postures.forward
        y = ASIDE * half * postures.left
        down = np.array([0.0, 0.0, -SQUAT * self.height])
        self._lines: dict[str, tuple[Any, ...]] = {}
        for name in SWAYS:
            words = name.split()
            along = sum({"forward": x, "left": y, "right": -y}[word] for word in words) / sqrt(len(words))
            self._add(name, middle, along, still, still, -1.0)
        self._add("squat", middle, down, still, still, 0.0)
        self._lift = LIFT * self.height
        over = [np.array([*stand, self.height]) for stand in postures.stand]
        for foot in (0, 1):
            above = over[foot]
            rise = self._lift * (np.arange(2) != foot)
            start = self._add(f"shift {foot}", middle, above - middle, still, still, 0.0)
            if foot == 0:
                self._add("across", above, over[1] - above, still, still, 0.0, start)
            start = self._add(f"lift {foot}", above, np.zeros(3), still, rise, 0.0, start)
            x = ONE_LEG_FORWARD * robot.half[0] * postures.forward
            y = ONE_LEG_ASIDE * robot.half[1] * postures.left
            for name, along in (("pitch", x), ("roll", y)):
                self._add(f"{name} {foot}", above, along, rise, still, -1.0, start)
        self._number = {name: i for i, name in enumerate(self._lines)}
        self._table = Paths.of(list(self._lines.values()))

    def _add(
        self,
        name: str,
        com: Floats,
        along: Floats,
        lift: Floats,
        rise: Floats,
        first: float,
        start: Floats | None = None,
    ) -> Floats:
        """Tabulate a path outwards from s = 0, and return the posture at s = 1."""
        # Paths that lift a foot or move the robot over one foot end at 1.
        steps = round((REACH if first < 0.0 else 1.0) / KNOT_SPACING)
        postures: dict[float, Floats] = {}
        up = np.maximum(lift, lift + rise)
        for sign in (-1.0, 1.0) if first < 0.0 else (1.0,):
            qpos = self.qpos if start is None else start
            for s in sign * KNOT_SPACING * np.arange(steps + 1):
                try:
                    qpos = self._postures.solve(com + s * along, lift + s * rise, qpos)
                except UnreachableError:
                    if abs(s) < 1.0 + 1e-9:
                        raise
                    break
                postures[round(float(s), 9)] = qpos
        knots = sorted(postures)
        slopes = _slopes(self._postures.robot.model, [postures[s] for s in knots], KNOT_SPACING)
        leads = [
            self._postures.leads(postures[s], slope, self._postures.shares((com + s * along)[:2], up))
            for s, slope in zip(knots, slopes, strict=True)
        ]
        target = CubicSpline(knots, np.array(leads))
        self._lines[name] = com, along, lift, rise, knots[0], knots[-1], target
        return postures.get(1.0, qpos)

    def draw(
        self, rng: np.random.Generator, amplitude: tuple[float, float], tempo: tuple[float, float]
    ) -> Schedule:
        """Draw an episode: its tempo, the foot that is lifted first, the order of the sways, and all extents.

        ``amplitude`` is the range of the extents, ``tempo`` that of a factor on all speeds.
        """
        unit = self._unit / rng.uniform(*tempo)
        first = int(rng.integers(2))
        sways = [(SWAYS[k // 2], 1.0 - 2.0 * (k % 2)) for k in rng.permutation(2 * len(SWAYS))]
        moves: list[Move] = []

        def out_and_back(name: str, side: float = 1.0) -> None:
            s = side * rng.uniform(*amplitude)
            moves.extend([Move(name, 0.0, s, 1.0), Move(name, s, 0.0, 1.0)])

        def on_one_leg(foot: int, *turns: str) -> None:
            moves.extend(one_leg(foot, {turn: rng.uniform(*amplitude) for turn in turns}))

        # Both feet are lifted first, so that a calibrator measures the offsets first.
        on_one_leg(first)
        on_one_leg(1 - first)
        out_and_back(*sways[0])
        on_one_leg(first, "pitch", "roll")
        out_and_back(*sways[1])
        out_and_back("squat")
        on_one_leg(1 - first, "pitch", "roll")
        for sway in sways[2:]:
            out_and_back(*sway)
        return self._plan_moves(moves, unit)

    def prelude(self, names: Sequence[str], dt: float) -> Prelude:
        """Plan motions by name (:func:`~surefoot.envs.exercise.moves.motions_of`), one row every ``dt`` s.

        ValueError if a motion does not exist, or goes farther than the legs reach.
        """
        moves = [move for name in names for move in motions_of(name)]
        for move in moves:
            path, (least, most) = self._number[move.path], sorted((move.start, move.end))
            first, last = self._table.first[path], self._table.last[path]
            if least < first - 1e-9 or most > last + 1e-9:
                raise ValueError(
                    f"The legs reach from {first:g} to {last:g} along '{move.path}', and a motion "
                    f"goes from {least:g} to {most:g}; give it a smaller extent."
                )
        schedule = self._plan_moves(moves, self._unit)
        total = schedule.total
        rows = ceil(total / dt - 1e-9)
        times = np.minimum(dt * np.arange(1, rows + 1), total - 1e-9)
        rest = np.zeros(rows, dtype=bool)
        ends = [end for end, move in zip(schedule.end, moves, strict=True) if move.ends]
        rest[np.minimum(np.searchsorted(times, ends), rows - 1)] = True
        model = self.robot.model
        motors = tuple(model.actuator(i).name for i in range(model.nu))
        return Prelude.of_commands(dt, motors, [self.command(float(time), schedule) for time in times], rest)

    def _plan_moves(self, moves: list[Move], unit: float) -> Schedule:
        """Schedule moves one after another; ``unit`` is the duration of a sway in s."""
        length = unit * np.array([move.time for move in moves])
        end = np.cumsum(length)
        return Schedule(
            end=end,
            total=end[-1],
            path=np.array([self._number[move.path] for move in moves]),
            start=np.array([move.start for move in moves]),
            way=np.array([move.end - move.start for move in moves]),
            length=length,
        )

    def command(self, time: Any, plan: Schedule) -> Command:
        """Return the command of a plan at a time in s since the start, or at times (N,) of many robots."""
        table = self._table
        cycle = np.remainder(time, plan.total)
        k = (plan.end <= cycle[..., None]).sum(axis=-1)
        at = (k,) if plan.end.ndim == 1 else (np.arange(k.size), k)
        path, way, length = plan.path[at], plan.way[at], plan.length[at]
        t = 1.0 - (plan.end[at] - cycle) / length
        s = (plan.start[at] + way * (t * t * t) * (10.0 + t * (6.0 * t - 15.0)))[..., None]
        speed = (way * 30.0 * (t * t) * ((1.0 - t) * (1.0 - t)) / length)[..., None]
        surge = (way * 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / (length * length))[..., None]
        since = (s[..., 0] - table.first[path]) / KNOT_SPACING
        piece = np.minimum(np.maximum(since, 0.0), table.pieces[path]).astype(np.intp)
        x = ((since - piece) * KNOT_SPACING)[..., None, None]
        cubic = table.piece[path, piece]
        targets = cubic[..., 0, :, :]
        for power in (1, 2, 3):
            targets = targets * x + cubic[..., power, :, :]
        along = table.along[path]
        com, acceleration = table.com[path] + s * along, surge * along
        lift = table.lift[path] + s * table.rise[path]
        cop = com[..., :2] - com[..., 2:] / (self._gravity + acceleration[..., 2:]) * acceleration[..., :2]
        position_sole = np.empty((*lift.shape, 3))
        position_sole[:] = self.position_sole
        position_sole[..., 2] += lift
        return Command(
            joint_target=targets[..., 0, :] + speed * targets[..., 1, :] + surge * targets[..., 2, :],
            com=com,
            com_velocity=speed * along,
            com_acceleration=acceleration,
            cop=cop,
            position_sole=position_sole,
            yaw_sole=self.yaw_sole,
            stance=(lift < 1e-9) & (self._postures.shares(cop, lift) > SURELY_BEARS),
            swing=lift > SURELY_UP * self._lift,
            phase=cycle / plan.total,
        )


def _slopes(model: mujoco.MjModel, postures: list[Floats], spacing: float) -> list[Floats]:
    """Differentiate postures at equal distances along a path, shape (nv,) each."""
    steps = []
    for before, after in pairwise(postures):
        step = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, step, spacing, before, after)
        steps.append(step)
    middle = [(before + after) / 2.0 for before, after in pairwise(steps)]
    ends = [1.5 * steps[0] - 0.5 * steps[1], 1.5 * steps[-1] - 0.5 * steps[-2]]
    return [ends[0], *middle, ends[1]]
