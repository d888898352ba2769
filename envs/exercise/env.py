"""A humanoid with flat feet sways, squats and lifts its feet: what a robot does to calibrate them."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Final

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
from numpy.typing import NDArray

from surefoot.envs.command import Command
from surefoot.envs.exercise.balance import AnkleBalance
from surefoot.envs.exercise.motion import plan_motion
from surefoot.envs.exercise.observation import ExerciseObserver
from surefoot.envs.instrumentation.truth import FeetTruth
from surefoot.envs.observation import FORCE_BOUND, Observation
from surefoot.envs.options import check_render_mode, checked_action, checked_range, positive
from surefoot.envs.prelude import Player, Prelude
from surefoot.envs.rendering import check_size

CONTROL_STEP: Final = 0.02
"""Duration of a step in s, up to the simulation's own step: a whole number of the 2 ms and 1.25 ms with which
the robots are simulated, which 1/80 s is not, and as often as humanoids of this size are commanded."""

FEWEST_SUBSTEPS: Final = 5
"""Simulation steps that a step must have at least."""

FALLEN_TILT: Final = 0.8
"""Angle between the torso and its first posture's vertical in rad above which the robot has fallen."""

FALLEN_HEIGHT: Final = 0.6
"""Height of the torso's origin below which it has fallen, as a share of that in the first posture."""

COP_WIDTH: Final = 0.08
"""Error of the centre of pressure that costs 63 % of its reward, as a share of the robot's height (CoM)."""


class ExerciseEnv(gym.Env[Observation, NDArray[np.float32]]):
    """Calibration exercises of a biped under position control; docs/exercise.md has the tables.

    A step lasts 0.02 s. The action is a residual on the targets of the leg motors, zero for the exercise
    alone; observations have :class:`~surefoot.envs.NaoEnv`'s keys, and so have reward and ``info``. The
    robot's own sensors, colliders and torque limits stay; motors of the legs that are too weak to stand on
    one foot get higher gains, and the ankles answer errors of the centre of mass.

    *Terminated* once the torso leans by more than 0.8 rad or has sunk below 0.6 of its height; *truncated*
    after ``duration``.

    Args:
        robot: "g1", "t1", "op3", "nao", the path of an MJCF file with robot and floor, or such a
            ``mujoco.MjSpec``. A robot of one's own stands upright in the keyframe "home", "stand" or
            "standing" or in its zero pose, heading along x, with a position motor for each joint of its legs.
            Give a name or a path where ``env.spec`` is needed, to make the environment again or to save it:
            an ``MjSpec`` cannot be copied into it, and ``env.spec`` is ``None`` then.
        feet: Names of the feet's bodies, the left one first; None to guess.
        duration: Length of an episode in s, or ``None`` for no end.
        amplitude: Least and largest share of each sway and squat that an episode draws, at most 1.
        tempo: Least and largest factor on all speeds that it draws, at most 1.5.
        prelude: What the robot does before each episode, or the path of its file, which ``surefoot calibrate
            motion`` writes; ``None`` for nothing. ``duration`` begins after it.
        action_scale: What a full action adds to a target, in rad.
        joint_noise: Largest initial error of a joint in rad.
        velocity_noise: Largest initial velocity of the torso along each axis, in m/s and rad/s.
        render_mode: ``"rgb_array"`` or ``None``.
        width: Width of a frame in pixels.
        height: Height of a frame in pixels.

    Attributes:
        model: The MuJoCo model.
        data: Its state.
        truth: What really happened during the last step, at every substep.
        drawing: What the robot's maker hands out.
        command: What the robot commands itself now; its targets are of all M motors in model order.
        motion: What it can do.
        prelude: Plays what comes before the episode (:class:`~surefoot.envs.prelude.Player`).
        joint_names: The J hinge joints.
        leg_motor_names: The L motors of an action.
        state_layout: Where each part lies in ``observation["state"]``.

    Raises:
        ModuleNotFoundError: If a named robot's package is missing.
        TypeError: If ``robot`` or ``feet`` is of another type.
        ValueError: If an option is out of its range, or the robot cannot do the exercise.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012

    def __init__(
        self,
        robot: str | Path | mujoco.MjSpec = "g1",
        *,
        feet: Sequence[str] | None = None,
        duration: float | None = 40.0,
        amplitude: Sequence[float] = (0.7, 1.0),
        tempo: Sequence[float] = (0.9, 1.1),
        prelude: Prelude | str | PathLike[str] | None = None,
        action_scale: float = 0.02,
        joint_noise: float = 0.005,
        velocity_noise: float = 0.01,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        self._amplitude = _up_to("amplitude", amplitude, 1.0)
        self._tempo = _up_to("tempo", tempo, 1.5)
        self._action_scale = positive("action_scale", action_scale)
        self._joint_noise = positive("joint_noise", joint_noise, or_zero=True)
        self._velocity_noise = positive("velocity_noise", velocity_noise, or_zero=True)
        length = None if duration is None else positive("duration", duration)
        check_render_mode(render_mode, self.metadata["render_modes"])

        self.motion = plan_motion(robot, feet, boxes=render_mode is None)
        prepared = self.motion.robot
        self.model, self.drawing = prepared.model, prepared.instrumentation.drawing
        self.data = mujoco.MjData(self.model)
        self._instrumentation = prepared.instrumentation
        self._substeps = round(CONTROL_STEP / self.model.opt.timestep)
        if self._substeps < FEWEST_SUBSTEPS:
            raise ValueError(
                f"The model's timestep must be at most {CONTROL_STEP / FEWEST_SUBSTEPS} s, got "
                f"{self.model.opt.timestep} s; set spec.option.timestep."
            )
        self.dt = self._substeps * float(self.model.opt.timestep)
        self._steps = None if length is None else max(round(length / self.dt), 1)
        self._balance = AnkleBalance(prepared, self.motion)
        self._torso, self._leg_motors = prepared.torso, prepared.leg_motors
        self.joint_names = self.drawing.joint_names
        self.leg_motor_names = tuple(self.model.actuator(i).name for i in self._leg_motors)
        joints = [self.model.joint(name).id for name in self.joint_names]
        self._joint_dofs = self.model.jnt_dofadr[joints]
        motors = [self.model.actuator(i).name for i in range(self.model.nu)]
        self.prelude = Player(prelude, motors, self.dt)
        limited = self.model.actuator_ctrllimited.astype(bool)
        self._low, self._high = np.where(limited, self.model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
        self._fraction = np.arange(1, self._substeps + 1)[:, None] / self._substeps
        self._cop_width = COP_WIDTH * self.motion.height
        self._first_height = float(self.motion.qpos[2])

        bound = max(FORCE_BOUND, 10.0 * prepared.weight)
        self._observer = ExerciseObserver(len(self.joint_names), bound)
        self.observation_space = self._observer.space
        self.state_layout = self._observer.state_layout
        self.action_space = spaces.Box(-1.0, 1.0, (len(self._leg_motors),), dtype=np.float32)
        self.render_mode = render_mode
        check_size(self.model, width, height)
        self._size = width, height
        self._renderer: MujocoRenderer | None = None
        self.truth: FeetTruth
        self.command: Command
        self._target: NDArray[np.float64]
        self._tick: int | None = None

    def __getstate__(self) -> dict[str, Any]:
        given = {} if self.spec is None else self.spec.kwargs
        # An MjSpec cannot be copied: without it there is no env.spec, as where it was made.
        spec = None if isinstance(given.get("robot"), mujoco.MjSpec) else self.spec
        return vars(self) | {"_renderer": None, "spec": spec}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Stand the robot up and draw an exercise.

        Args:
            seed: Seeds all that the environment draws.
            options: Not used.
        """
        super().reset(seed=seed)
        model, data, rng = self.model, self.data, self.np_random
        self.motion.begin(rng, self._amplitude, self._tempo)
        mujoco.mj_resetData(model, data)
        self._tick = 0
        self.command = self.motion.command(0.0)
        self.prelude.begin(self.command)
        self._target = self._limited(self.command.joint_target)
        data.ctrl[:] = self._target
        data.qpos[:] = self.motion.qpos
        noise = np.zeros(model.nv)
        noise[self._joint_dofs] = rng.uniform(-self._joint_noise, self._joint_noise, self._joint_dofs.size)
        mujoco.mj_integratePos(model, data.qpos, noise, 1.0)
        data.qvel[:6] = rng.uniform(-self._velocity_noise, self._velocity_noise, 6)
        mujoco.mj_forward(model, data)
        rows = np.tile(data.sensordata, (self._substeps, 1))
        self.truth = self._instrumentation.read_rows(model, rows)
        self._observer.reset()
        observation, truth = self._observer.observe(self.truth, data.qvel[self._joint_dofs], self.command)
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
        residual = checked_action(
            action,
            self.leg_motor_names,
            "a residual for each leg motor",
            "zeros leave the exercise alone",
        )
        correction = self._balance.correction(self.truth, self.command)
        if self.prelude.playing:
            self.command = self.prelude.next()
        else:
            self._tick += 1
            self.command = self.motion.command(self._tick * self.dt)
        target = self.command.joint_target.copy()
        target[self._leg_motors] += self._action_scale * residual + correction
        target = self._limited(target)

        model, data, mj_step = self.model, self.data, mujoco.mj_step
        sensordata, ctrl = data.sensordata, data.ctrl
        rows = np.empty((self._substeps, model.nsensordata))
        for row, substep_target in zip(
            rows, self._target + self._fraction * (target - self._target), strict=True
        ):
            joint_velocity = data.qvel[self._joint_dofs]
            ctrl[:] = substep_target
            mj_step(model, data)
            row[:] = sensordata
        self._target = target

        self.truth = self._instrumentation.read_rows(model, rows)
        observation, truth = self._observer.observe(self.truth, joint_velocity, self.command)
        terms = self._reward(truth, residual)
        truncated = self._steps is not None and self._tick >= self._steps
        return (
            observation,
            sum(terms.values()),
            self._fallen(),
            truncated,
            {"surefoot": {"truth": truth}, **terms},
        )

    def _reward(self, truth: dict[str, NDArray[np.float64]], action: NDArray[np.float64]) -> dict[str, float]:
        """Return the terms of a step's reward, which is their sum, by name."""
        error = truth["cop_world"] - self.command.cop
        square = float(error @ error)
        return {
            "reward_alive": 1.0,
            "reward_cop": float(np.exp(-square / self._cop_width**2)) if truth["cop_valid"][0] else 0.0,
            "reward_action": -0.1 * float(action @ action) / action.size,
        }

    def _fallen(self) -> bool:
        """Return whether the robot has fallen."""
        up = float(self.truth.R_world_torso[-1, 2] @ self.motion.up_torso)
        height = float(self.truth.position_torso[-1, 2])
        return not (up > np.cos(FALLEN_TILT) and height > FALLEN_HEIGHT * self._first_height)

    def _limited(self, target: NDArray[np.float64]) -> NDArray[np.float64]:
        limited: NDArray[np.float64] = np.minimum(np.maximum(target, self._low), self._high)
        return limited

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the robot: a frame (height, width, 3); nothing without a render mode."""
        if self.render_mode is None:
            gym.logger.warn("render() draws nothing without render_mode='rgb_array'.")
            return None
        if self._renderer is None:
            reach = self.motion.height
            view = {
                "lookat": np.array([0.0, 0.0, reach]),
                "distance": 4.0 * reach,
                "azimuth": 140.0,
                "elevation": -15.0,
            }
            self._renderer = MujocoRenderer(self.model, self.data, view, *self._size)
        frame: NDArray[np.uint8] | None = self._renderer.render(self.render_mode)
        return frame

    def close(self) -> None:
        """Close what was drawn on; the next frame opens another."""
        if self._renderer is not None:
            self._renderer.close()  # type: ignore[no-untyped-call]
            self._renderer = None


def _up_to(name: str, value: Sequence[float], highest: float) -> tuple[float, float]:
    """Return a range of positive numbers, or raise ValueError if it is none or exceeds ``highest``."""
    low, high = checked_range(name, value)
    if not 0.0 < low <= high <= highest:
        raise ValueError(f"'{name}' must be (lowest, highest) in (0, {highest}], got {value!r}.")
    return low, high
