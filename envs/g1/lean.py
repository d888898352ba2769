"""A Unitree G1 leans to places near the edge of its support, under a load that only its feet can feel."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.checks import check_count
from surefoot.envs.g1.robot import LIFTS, Measured, Stance, StandingG1
from surefoot.envs.gait.swing import minimum_jerk
from surefoot.envs.instrumentation.means import MeanTruth
from surefoot.envs.options import check_action, check_range, check_render_mode, positive
from surefoot.envs.rendering import DrawnEnv, SceneRenderer

CONTROL_STEP: Final = 0.02  # duration of a step in s
MOST_OFFSET: Final = 0.10  # largest offset of the centre of mass along each axis in m
FASTEST: Final = 0.10  # speed of the offset along each axis at a full action, in m/s
SMOOTHING: Final = 0.1  # time constant in s with which that speed follows the action
WIDTH: Final = 0.015  # error of the centre of pressure in m at which the reward for it has fallen to 1 / e
FALLEN: Final = (0.8, 0.5)
"""Cosine of the pelvis's tilt and its height in m below which the robot has fallen."""

TILT, GYROSCOPE, NOISE, ENCODER, COM, STIFFNESS = 5e-3, 1e-3, 2.5e-3, 1e-3, 3e-3, 0.05
"""Standard deviations of what a robot does not know of itself. The first five are those of the sensors and
beliefs elsewhere in this package: tilt in rad, of an accelerometer's bias of 0.05 m/s^2; bias and noise of
the gyroscope in rad/s; offsets of the encoders in rad; centre of mass in m. The last one is the relative
error of a servo's stiffness, chosen: the robot sags by up to 0.1 rad, of which it expects the wrong part."""

EXPERT_RATE: Final = 1.2  # part of an error that the expert removes per s; insensitive between 1 and 2.5
LARGEST: Final = 10.0  # bound of all observations: only a gyroscope during a fall comes near it
SETTLE, SHIFT, LIFT, HOLD = (
    0.5,
    2.4,
    0.6,
    0.4,
)  # durations in s of the start, a shift, a lift, and on one foot
MOVE, STAY = 3.0, 1.0  # durations in s of a move to a place, and of the stay there
HANDOVER: Final = 1.5  # time in s in which the robot takes over the load
PARTS: Final = ("goal", "way", "offset", "offset_speed", "com_error", "tilt", "gyroscope")
DIRECTIONS: Final = np.array([(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4.0])


class Leg(NamedTuple):
    """A straight move with least jerk."""

    end: float  # when it ends in s
    duration: float  # in s
    com: Floats  # centre of mass at its beginning and its end in m, shape (2, 2)
    lift: Floats  # heights of both feet at its beginning and its end in m, shape (2, 2)
    share: float  # share of the support that is used; 0 outside of the task


class LeanEnv(DrawnEnv):
    r"""A Unitree G1 leans to places near the edge of its support, under a load that it does not know.

    The robot stands, marches on the spot, and is handed a load of 1 to 2.5 kg in front of its chest. Then its
    centre of pressure (CoP) is to follow a goal that moves to one place after another near the edge of the
    support, and stays at each. A controller beneath the policy holds postures that would do so **without the
    load**, by the robot's own measurements. The load moves the CoP by up to 2 cm, and joints and tilt by a
    few milliradians, which is within the error of the tilt: it shows in the feet alone.

    ## Action space

    ``Box(-1, 1, (2,), float32)``: the speed, forward and to the left, of an offset that is added to the
    commanded centre of mass, 1 for 0.1 m/s. The offset stays within 0.1 m. Zero leaves it where it is; until
    the load comes actions have no effect.

    ## Observation space

    ``Box(-10, 10, (14,), float64)``. Positions are in the level frame midway between the soles' origins, x
    forward and y to the left. Nothing in it comes from the feet's sensors:
    :class:`~surefoot.wrappers.FootSensors` and :class:`~surefoot.wrappers.SelfCalibration` add these, with
    the CoP in the same frame.

    | Number | Observation | Unit |
    |--------|-------------|------|
    | 0, 1 | goal of the CoP, x and y | m |
    | 2, 3 | goal at the end of the present move | m |
    | 4, 5 | offset of the centre of mass | m |
    | 6, 7 | its speed | m/s |
    | 8, 9 | centre of mass by encoders and attitude, without the load, less the commanded one | m |
    | 10, 11 | measured roll and pitch of the pelvis | rad |
    | 12, 13 | gyroscope, x and y | rad/s |

    Each episode draws what the robot does not know of itself: errors of its tilt (5 mrad, from an
    accelerometer's bias of 0.05 m/s^2), encoders (1 mrad), centre of mass (3 mm) and the stiffness of its
    servos (5 %), and the gyroscope's bias and noise.

    ## Rewards

    Each step of the task earns :math:`(\exp(-(e / 1.5 cm)^2) + 1/2) / (1.5 N)`: e is the distance of the true
    CoP from the goal, and N the number of these steps. A return of 1 is the best possible. Before, the reward
    is 0.

    ## Starting state

    Upright, with a pelvis that drifts by up to 0.01 m/s.

    ## Episode end

    *Terminated* once the pelvis is below 0.5 m or leans by more than 37 degrees. *Truncated* at the end of
    the last move.

    ## Arguments

    Args:
        share: Share of the way from the middle to the edge of the support to which goals go, or (first, last)
            for goals that go farther and farther out.
        reaches: Number of places, in as many of eight directions.
        marches: How often each foot is lifted before the load comes; calibrators learn from it.
        wait: Time in s from the load to the task.
        load_mass: Lightest and heaviest load in kg.
        load_box: Lowest and highest corner of the box in which the load is, in the torso's axes in m.
        errors: Factor of all errors of what the robot measures and knows of itself.
        render_mode: ``"rgb_array"`` or ``None``.
        width: Width of a frame in pixels.
        height: Height of a frame in pixels.

    Attributes:
        model: The MuJoCo model.
        data: Its state.
        truth: The truth of the last step, at every substep.
        drawing: The drawing by the robot's maker.
        joint_names: The twelve joints of the legs.
        dt: Duration of a step in s.
        moves: The moves of the episode.
        stand_time: Time in s until the load comes, for which actions have no effect.
        observation_parts: Where each pair of numbers lies in the observation.

    Raises:
        ModuleNotFoundError: If the robot's description is missing: ``pip install surefoot[robots]``.
        ValueError: If an option is out of its range.
    """

    observation_parts: Final = {name: slice(2 * i, 2 * i + 2) for i, name in enumerate(PARTS)}
    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012

    def __init__(
        self,
        *,
        share: float | Sequence[float] = 0.8,
        reaches: int = 3,
        marches: int = 1,
        wait: float = 4.0,
        load_mass: Sequence[float] = (1.5, 2.5),
        load_box: Sequence[Sequence[float]] = ((0.05, -0.25, 0.0), (0.35, 0.25, 0.3)),
        errors: float = 1.0,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        self._share = check_range("share", share if isinstance(share, Sequence) else (share, share))
        self._reaches, self._marches = check_count("reaches", reaches, 1), check_count("marches", marches, 0)
        self._wait = positive("wait", wait)
        march = self._marches * 2.0 * (SHIFT + LIFT + HOLD + LIFT) + SHIFT
        self.stand_time = SETTLE + (march if self._marches else 0.0)
        self._load_mass = check_range("load_mass", load_mass)
        self._load_box = np.array(load_box, dtype=np.float64)
        if self._load_box.shape != (2, 3) or not (self._load_box[0] <= self._load_box[1]).all():
            raise ValueError(
                f"'load_box' must have a lowest and a highest corner (x, y, z), got {load_box!r}."
            )
        self._errors = positive("errors", errors, or_zero=True)
        check_render_mode(render_mode, self.metadata["render_modes"])

        self.g1 = StandingG1(drawn=render_mode is not None)
        robot = self.g1.robot
        self.model, self.data = robot.model, mujoco.MjData(robot.model)
        self._stiffness = self.model.actuator_gainprm[:, 0].copy()
        self.dt, self._substeps = CONTROL_STEP, round(CONTROL_STEP / self.model.opt.timestep)
        self._instrumentation = robot.instrumentation
        self.drawing = self._instrumentation.drawing
        self.joint_names = self.drawing.joint_names
        first = self._instrumentation.columns(self.model).start
        self._mean_truth = MeanTruth(self._instrumentation.layout.rows_after(first))
        self._torso = int(self.model.body("torso_link").id)
        self.observation_space = spaces.Box(-LARGEST, LARGEST, (14,), np.float64)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._tick: int | None = None
        view = {"lookat": np.array([0.0, 0.0, 0.7]), "distance": 2.6}
        self._draw_by(SceneRenderer(self.model, self.data, view, width, height), render_mode)

    @property
    def time(self) -> float:
        """Time since the reset in s."""
        return self.dt * (self._tick or 0)

    @property
    def expert_action(self) -> Floats:
        """The action of a controller that knows the load and the true state, not yet clipped, shape (2,).

        It moves the common centre of mass of robot and load to the goal. It is made of truth: to imitate in
        training, and nothing for a policy to see.
        """
        data, mass, load = self.data, self._load[0], self._load_position()
        robot = self.g1.robot.weight / self.g1.robot.gravity
        com = (robot * data.subtree_com[self.g1.robot.torso, :2] + mass * load[:2]) / (robot + mass)
        action: Floats = EXPERT_RATE / FASTEST * (self._goal[:2] - com)
        return action

    @property
    def task_steps(self) -> int:
        """Number of steps that can be rewarded."""
        return round((self.moves[-1].end - self.stand_time - self._wait) / self.dt)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Draw the places, the load and the errors of the measurements."""
        super().reset(seed=seed)
        rng, data = self.np_random, self.data
        self._draw_moves(rng)
        low, high = self._load_box
        self._load = rng.uniform(*self._load_mass), rng.uniform(low, high)
        self._draw_errors(rng)
        self._tick, self._offset, self._speed = 0, np.zeros(2), np.zeros(2)
        mujoco.mj_resetData(self.model, data)
        data.qpos[:] = self.g1.qpos
        data.qvel[:3] = rng.uniform(-0.01, 0.01, 3)
        self._stance, self._goal = self._command(0.0)
        self._targets = data.ctrl[:] = self.g1.targets(self._stance) - self._encoder_bias
        mujoco.mj_forward(self.model, data)
        return self._end_step(np.tile(data.sensordata, (self._substeps, 1)))

    def step(self, action: NDArray[np.float32]) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Go on for 0.02 s.

        ValueError if the action has another shape or is not finite, ResetNeeded before the first reset.
        """
        if self._tick is None:
            raise gym.error.ResetNeeded("Call reset() before the first step().")
        speed = check_action(action, ("forward", "left"), "a speed for each of", "zeros keep the offset")
        self._tick += 1
        if self.time > self.stand_time:
            self._speed += (speed - self._speed) * self.dt / SMOOTHING
            moved = self._offset + FASTEST * self.dt * self._speed
            self._offset = np.clip(moved, -MOST_OFFSET, MOST_OFFSET)
        before = self._stance.com
        self._stance, self._goal = self._command(self.time)
        stance = self._stance._replace(com_velocity=(self._stance.com - before) / self.dt)
        targets = self.g1.targets(stance) + self.g1.balance(self._believed, stance) - self._encoder_bias
        start = self._targets
        self._targets = targets

        model, data, rows = self.model, self.data, []
        self._carry()
        for k in range(1, self._substeps + 1):
            data.ctrl[:] = start + (targets - start) * (k / self._substeps)
            mujoco.mj_step(model, data)
            rows.append(data.sensordata.copy())
        observation, info = self._end_step(np.array(rows))
        up = 1.0 - 2.0 * float(data.qpos[4] ** 2 + data.qpos[5] ** 2)
        fallen = not (up > FALLEN[0] and data.qpos[2] > FALLEN[1])
        return (
            observation,
            self._reward(info),
            fallen,
            self._tick >= round(self.moves[-1].end / self.dt),
            info,
        )

    def _draw_errors(self, rng: np.random.Generator) -> None:
        """Draw what the robot does not know of itself."""
        self._tilt_bias = self._errors * rng.normal(0.0, TILT, 2)
        self._gyroscope_bias = self._errors * rng.normal(0.0, GYROSCOPE, 3)
        self._encoder_bias = self._errors * rng.normal(0.0, ENCODER, 12)
        self._com_bias = self._errors * rng.normal(0.0, COM, 2)
        stiffness = self._stiffness * np.exp(self._errors * rng.normal(0.0, STIFFNESS, 12))
        self.model.actuator_gainprm[:, 0], self.model.actuator_biasprm[:, 1] = stiffness, -stiffness

    def _draw_moves(self, rng: np.random.Generator) -> None:
        """Draw the places to which an episode goes."""
        self.moves = list[Leg]()
        middle, feet, standing = self.g1.middle, self.g1.stand, np.zeros(2)

        def go(duration: float, com: Floats, lift: Floats = standing, share: float = 0.0) -> None:
            last = (
                self.moves[-1] if self.moves else Leg(0.0, 0.0, np.array([middle] * 2), np.zeros((2, 2)), 0.0)
            )
            ways = np.array([last.com[1], com]), np.array([last.lift[1], lift])
            self.moves.append(Leg(last.end + duration, duration, *ways, share))

        go(SETTLE, middle)
        for foot in (0, 1) * self._marches:
            lift = LIFTS[-1] * (np.arange(2) != foot)
            for duration, up in ((SHIFT, standing), (LIFT, lift), (HOLD, lift), (LIFT, standing)):
                go(duration, feet[foot], up)
        if self._marches:
            go(SHIFT, middle)
        go(self._wait, middle)
        for k, way in enumerate(rng.permutation(DIRECTIONS)[np.arange(self._reaches) % 8]):
            share = self._share[0] + (self._share[1] - self._share[0]) * k / max(self._reaches - 1, 1)
            place = middle + share * self.g1.half * way
            go(MOVE, place, share=share)
            go(STAY, place, share=share)
        go(MOVE, middle)

    def _command(self, time: float) -> tuple[Stance, Floats]:
        """Return the commanded stance, and the goals of the CoP now and at the end of the move, (4,)."""
        move = next((move for move in self.moves if time < move.end), self.moves[-1])
        s = minimum_jerk(1.0 - (move.end - time) / move.duration)
        goal, lift = (way[0] + s * (way[1] - way[0]) for way in (move.com, move.lift))
        self._used = move.share
        return Stance(goal + self._offset, np.zeros(2), lift), np.concatenate([goal, move.com[1]])

    def _carry(self) -> None:
        """Let the load hang on the torso; the robot takes it over gradually."""
        mass, data, torso = self._load[0], self.data, self._torso
        force = (
            mass
            * float(self.model.opt.gravity[2])
            * min(max((self.time - self.stand_time) / HANDOVER, 0.0), 1.0)
        )
        arm = self._load_position() - data.xipos[torso]
        data.xfrc_applied[torso] = 0.0, 0.0, force, arm[1] * force, -arm[0] * force, 0.0

    def _load_position(self) -> Floats:
        """Return the position of the load in the world in m, shape (3,)."""
        position, R = self.data.xpos[self._torso], self.data.xmat[self._torso].reshape(3, 3)
        return np.asarray(position + R @ self._load[1])

    def _end_step(self, rows: Floats) -> tuple[Floats, dict[str, Any]]:
        """Measure, and return the observation and ``info``."""
        rng, data = self.np_random, self.data
        w, x, y, z = data.qpos[3:7]
        roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        pitch = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
        measured = Measured(
            data.qpos[7:] + self._encoder_bias,
            data.qvel[6:].copy(),
            np.array([roll, pitch]) + self._tilt_bias,
            data.qvel[3:6] + self._gyroscope_bias + self._errors * rng.normal(0.0, NOISE, 3),
        )
        com, com_velocity = self.g1.believe(measured, self._stance)
        self._believed = com + self._com_bias, com_velocity
        self.truth = self._instrumentation.read_rows(self.model, rows)
        com_error, speed = com + self._com_bias - self._stance.com, FASTEST * self._speed
        parts = self._goal, self._offset, speed, com_error, measured.tilt, measured.gyroscope[:2]
        truth = self._mean_truth(rows)
        error = float(np.linalg.norm(truth["cop"] - self._goal[:2])) if truth["cop_valid"][0] else np.inf
        observation = np.clip(np.concatenate(parts), -LARGEST, LARGEST)
        return observation, {
            "surefoot": {"truth": truth},
            "cop_distance": error,
            "share": self._used,
        }

    def _reward(self, info: dict[str, Any]) -> float:
        if self.time <= self.stand_time + self._wait + 1e-9:
            return 0.0
        return float((np.exp(-((info["cop_distance"] / WIDTH) ** 2)) + 0.5) / (1.5 * self.task_steps))
