r"""The exercise: where the centre of mass and the feet go, and the motors' targets.

It is made of *paths*, straight lines of the centre of mass on which one foot may rise, with the motors'
targets tabulated along each; a *move* runs along a path from one place to another with least jerk,
:math:`s(t) = 10 t^3 - 15 t^4 + 6 t^5` of the way after the share :math:`t` of its time. Postures hence
fit any extent of a move, which an episode draws.

A cycle lifts one foot and then the other, shortly at first and then longer, with sways and a squat in
between. Distances are shares of the
soles' size, times are multiples of :math:`\sqrt{h / g}` (:math:`h` the height of the centre of mass), the
time scale of a falling pendulum: a sway of amplitude :math:`A` in 4.5 of them asks for a centre of pressure
that leads by at most 0.29 :math:`A`.
"""

from bisect import bisect_right
from itertools import pairwise, product
from math import sqrt
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from surefoot.envs.command import Command
from surefoot.envs.exercise.postures import Postures, UnreachableError
from surefoot.envs.exercise.robot import ExerciseRobot

MOVE_TIME: Final = 4.5
"""Duration of a sway to one side in units of sqrt(h / g)."""

KNOT_SPACING: Final = 0.2
"""Distance of tabulated postures as a share of a path."""

BENDS: Final = (0.6, 0.8, 1.0, 0.3)
"""Flexions that are added to the knees, in rad: the first with which everything is in reach is taken."""

INWARD: Final = (0.0, 0.25, 0.5)
"""How far inside the middle of its sole the robot stands on one leg, shares of its half width: likewise."""

FORWARD: Final = 0.45
"""Amplitude of a sway forward as a share of half a sole's length."""

ASIDE: Final = 0.6
"""Amplitude of a sway to a side as a share of half the distance between the feet."""

SQUAT: Final = 0.1
"""How far the centre of mass sinks in a squat, as a share of its height."""

LIFT: Final = 0.06
"""How far a foot rises, as a share of the height of the centre of mass."""

ONE_LEG_FORWARD: Final = 0.35
"""Amplitude of a sway forward over one foot as a share of half its sole's length."""

ONE_LEG_ASIDE: Final = 0.3
"""Amplitude of a sway aside over one foot as a share of half its sole's width."""

SURELY_BEARS: Final = 0.1
"""Share of the weight above which a foot on the ground is in stance."""

SURELY_UP: Final = 0.5
"""Share of the lift above which a foot is in swing."""

SWAYS: Final = (
    "forward",
    "left",
    "back",
    "right",
    "forward left",
    "back right",
    "forward right",
    "back left",
)


class Path(NamedTuple):
    """A line along which the robot moves by its parameter s.

    Attributes:
        com: Centre of mass at s = 0 in m, shape (3,).
        along: Its displacement per unit of s in m, shape (3,).
        lift: Heights of both feet at s = 0 in m, shape (2,).
        rise: Their change per unit of s in m, shape (2,).
        target: Motors' targets in rad over s.
    """

    com: NDArray[np.float64]
    along: NDArray[np.float64]
    lift: NDArray[np.float64]
    rise: NDArray[np.float64]
    target: CubicSpline


class Move(NamedTuple):
    """A run along a path.

    Attributes:
        path: Name of the path.
        start: Where it starts, s.
        end: Where it ends, s.
        time: Duration in multiples of that of a sway.
    """

    path: str
    start: float
    end: float
    time: float


class Motion:
    """Everything that a robot does in an exercise, planned once.

    Args:
        robot: The robot.

    Attributes:
        qpos: The posture between the moves, shape (nq,).
        height: Height of the centre of mass in it in m.
        up_torso: The vertical in the torso's axes in it, shape (3,).
        position_sole: Places of the soles in m, shape (2, 3).
        yaw_sole: Their headings in rad, shape (2,).

    Raises:
        ValueError: If the legs cannot do it.
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

    def shares(self, command: Command) -> NDArray[np.float64]:
        """Return how much of the weight each foot is to bear, shape (2,)."""
        return self._postures.shares(command.cop, command.position_sole[:, 2])

    def _plan(self, postures: Postures) -> None:
        robot = postures.robot
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
        self._paths: dict[str, Path] = {}
        for name in SWAYS:
            words = name.split()
            along = sum({"forward": x, "back": -x, "left": y, "right": -y}[word] for word in words) / sqrt(
                len(words)
            )
            self._add(name, middle, along, still, still, 0.0)
        self._add("squat", middle, down, still, still, 0.0)
        self._lift = LIFT * self.height
        for foot in (0, 1):
            above = np.array([*postures.stand[foot], self.height])
            rise = self._lift * (np.arange(2) != foot)
            start = self._add(f"shift {foot}", middle, above - middle, still, still, 0.0)
            start = self._add(f"lift {foot}", above, np.zeros(3), still, rise, 0.0, start)
            x = ONE_LEG_FORWARD * robot.half[0] * postures.forward
            y = ONE_LEG_ASIDE * robot.half[1] * postures.left
            for name, along in (("pitch", x), ("roll", y)):
                self._add(f"{name} {foot}", above, along, rise, still, -1.0, start)

    def _add(
        self,
        name: str,
        com: NDArray[np.float64],
        along: NDArray[np.float64],
        lift: NDArray[np.float64],
        rise: NDArray[np.float64],
        first: float,
        start: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Tabulate a path from s = 0 outwards; returns the posture at s = 1."""
        steps = round(1.0 / KNOT_SPACING)
        postures: dict[float, NDArray[np.float64]] = {}
        up = np.maximum(lift, lift + rise)
        for sign in (-1.0, 1.0) if first < 0.0 else (1.0,):
            qpos = self.qpos if start is None else start
            for s in sign * np.linspace(0.0, 1.0, steps + 1):
                qpos = self._postures.solve(com + s * along, lift + s * rise, qpos)
                postures[round(float(s), 9)] = qpos
        knots = sorted(postures)
        slopes = _slopes(self._postures.robot.model, [postures[s] for s in knots], KNOT_SPACING)
        leads = [
            self._postures.leads(postures[s], slope, self._postures.shares((com + s * along)[:2], up))
            for s, slope in zip(knots, slopes, strict=True)
        ]
        self._paths[name] = Path(com, along, lift, rise, CubicSpline(knots, np.array(leads)))
        return qpos

    def begin(
        self, rng: np.random.Generator, amplitude: tuple[float, float], tempo: tuple[float, float]
    ) -> None:
        """Draw an episode: its tempo, which foot is lifted first, the sways' order and every extent.

        Args:
            rng: What to draw from.
            amplitude: Least and largest share of a path that is used.
            tempo: Least and largest factor on all speeds.
        """
        self._scale = self._unit / rng.uniform(*tempo)
        first = int(rng.integers(2))
        sways = rng.permutation(len(SWAYS))
        moves: list[Move] = []

        def out_and_back(name: str) -> None:
            s = rng.uniform(*amplitude)
            moves.extend([Move(name, 0.0, s, 1.0), Move(name, s, 0.0, 1.0)])

        def one_leg(foot: int, *turns: str) -> None:
            moves.extend([Move(f"shift {foot}", 0.0, 1.0, 1.6), Move(f"shift {foot}", 1.0, 1.0, 0.2)])
            moves.extend([Move(f"lift {foot}", 0.0, 1.0, 1.0), Move(f"lift {foot}", 1.0, 1.0, 0.3)])
            for name in (f"{turn} {foot}" for turn in turns):
                s = rng.uniform(*amplitude)
                moves.extend([Move(name, 0.0, s, 0.8), Move(name, s, -s, 1.2), Move(name, -s, 0.0, 0.8)])
            moves.append(Move(f"lift {foot}", 1.0, 0.0, 1.0))
            moves.extend([Move(f"shift {foot}", 1.0, 1.0, 0.2), Move(f"shift {foot}", 1.0, 0.0, 1.6)])

        # Both feet are lifted first, so that a calibrator sees the offsets before anything else.
        one_leg(first)
        one_leg(1 - first)
        out_and_back(SWAYS[sways[0]])
        one_leg(first, "pitch", "roll")
        out_and_back(SWAYS[sways[1]])
        out_and_back("squat")
        one_leg(1 - first, "pitch", "roll")
        for k in sways[2:]:
            out_and_back(SWAYS[k])
        self._moves = moves
        self._ends = (self._scale * np.cumsum([move.time for move in moves])).tolist()

    def command(self, time: float) -> Command:
        """Return what is planned at a time in s after the episode start."""
        cycle = time % self._ends[-1]
        k = min(bisect_right(self._ends, cycle), len(self._moves) - 1)
        move, length = self._moves[k], self._scale * self._moves[k].time
        t = 1.0 - (self._ends[k] - cycle) / length
        way = move.end - move.start
        s = move.start + way * t**3 * (10.0 + t * (6.0 * t - 15.0))
        speed = way * 30.0 * t**2 * (1.0 - t) ** 2 / length
        surge = way * 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / length**2
        path = self._paths[move.path]
        target, damped, pushed = path.target(s)
        com, acceleration = path.com + s * path.along, surge * path.along
        lift = path.lift + s * path.rise
        cop = com[:2] - com[2] / (self._gravity + acceleration[2]) * acceleration[:2]
        share = self._postures.shares(cop, lift)
        position_sole = self.position_sole.copy()
        position_sole[:, 2] += lift
        return Command(
            joint_target=target + speed * damped + surge * pushed,
            com=com,
            com_velocity=speed * path.along,
            com_acceleration=acceleration,
            cop=cop,
            position_sole=position_sole,
            yaw_sole=self.yaw_sole,
            stance=(lift < 1e-9) & (share > SURELY_BEARS),
            swing=lift > SURELY_UP * self._lift,
            phase=cycle / self._ends[-1],
        )


def _slopes(
    model: mujoco.MjModel, postures: list[NDArray[np.float64]], spacing: float
) -> list[NDArray[np.float64]]:
    """Differentiate postures at equal distances along a path, shape (nv,) each."""
    steps = []
    for before, after in pairwise(postures):
        step = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, step, spacing, before, after)
        steps.append(step)
    middle = [(before + after) / 2.0 for before, after in pairwise(steps)]
    ends = [1.5 * steps[0] - 0.5 * steps[1], 1.5 * steps[-1] - 0.5 * steps[-2]]
    return [ends[0], *middle, ends[1]]
