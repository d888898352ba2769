"""A humanoid with flat feet sways, squats and lifts its feet, which calibrates their sensors."""

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.biped import BipedEnv, Fall
from surefoot.envs.command import Command
from surefoot.envs.exercise.balance import AnkleBalance
from surefoot.envs.exercise.motion import plan_motion
from surefoot.envs.exercise.moves import Schedule
from surefoot.envs.instrumentation.truth import FeetTruth
from surefoot.envs.observation import FORCE_BOUND, Seen, closeness
from surefoot.envs.options import check_range, check_render_mode, positive
from surefoot.envs.prelude import Prelude
from surefoot.envs.rendering import SceneRenderer

CONTROL_STEP: Final = 0.02
"""Duration of a step in s: a usual control period of humanoids, and a multiple of the simulated steps (2 ms
and 1.25 ms)."""

FEWEST_SUBSTEPS: Final = 5  # minimum number of simulation steps per step

FALLEN_TILT: Final = 0.8
"""Angle of the torso from its initial orientation to the vertical in rad above which the robot has fallen."""

FALLEN_HEIGHT: Final = 0.6
"""Height of the torso's origin below which the robot has fallen, as a share of the initial height."""

COP_WIDTH: Final = 0.08
"""Error of the centre of pressure at which its reward has fallen to 1/e, as a share of the CoM height."""


class ExerciseEnv(BipedEnv):
    """Calibration exercises of a biped under position control (see docs/exercise.md).

    A step lasts 0.02 s. The action is a residual on the targets of the leg motors; zero plays the exercise.
    Observations, reward and ``info`` have the keys of :class:`~surefoot.envs.NaoEnv`. Sensors, colliders and
    torque limits of the robot are kept. Gains of leg motors that are too low to stand on one foot are raised,
    and the ankles react to errors of the centre of mass.

    *Terminated* once the torso leans by more than 0.8 rad or has sunk below 0.6 of its height; *truncated*
    after ``duration``.

    Args:
        robot: "g1", "t1", "op3", "nao", the path of an MJCF file with robot and floor, or such a
            ``mujoco.MjSpec``. A robot of one's own stands upright in the keyframe "home", "stand" or
            "standing" or in its zero pose, heading along x, with a position motor for each joint of its legs.
            Give a name or a path where ``env.spec`` is needed, to make the environment again or to save it:
            an ``MjSpec`` cannot be copied into it, and ``env.spec`` is ``None`` then.
        feet: Names of the feet's bodies, the left one first; ``None`` to find them.
        duration: Length of an episode in s, or ``None`` for no end.
        amplitude: Range from which an episode draws the extents of sways and squats, at most 1.
        tempo: Range from which it draws a factor on all speeds, at most 1.5.
        prelude: The robot's motion before each episode, or the path of its file, which ``surefoot calibrate
            motion`` writes; ``None`` for no motion. ``duration`` begins after it.
        action_scale: The change of a target by a full action, in rad.
        joint_noise: Largest initial error of a joint in rad.
        velocity_noise: Largest initial velocity of the torso along each axis, in m/s and rad/s.
        render_mode: ``"rgb_array"`` or ``None``.
        width: Width of a frame in pixels.
        height: Height of a frame in pixels.

    Attributes:
        model: The MuJoCo model.
        data: Its state.
        truth: The truth of the last step, at every substep.
        drawing: The nominal description of the robot.
        command: The robot's present command, with targets of all M motors in model order.
        motion: Its possible motions.
        prelude: Plays the motion before the episode (:class:`~surefoot.envs.prelude.Player`).
        joint_names: The J hinge joints.
        leg_motor_names: The L motors of an action.
        state_layout: Where each part lies in ``observation["state"]``.

    Raises:
        ModuleNotFoundError: If a named robot's package is missing.
        TypeError: If ``robot`` or ``feet`` is of another type.
        ValueError: If an option is out of its range, or the robot cannot do the exercise.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012

    truth: FeetTruth
    shared = (*BipedEnv.shared, "motion", "drawing", "_instrumentation", "_balance")
    _neutral = "zeros leave the exercise alone"

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
        self._joint_noise = positive("joint_noise", joint_noise, or_zero=True)
        self._velocity_noise = positive("velocity_noise", velocity_noise, or_zero=True)
        check_render_mode(render_mode, self.metadata["render_modes"])

        self.motion = plan_motion(robot, feet, boxes=render_mode is None)
        prepared = self.motion.robot
        model, self._instrumentation = prepared.model, prepared.instrumentation
        self.drawing = self._instrumentation.drawing
        substeps = round(CONTROL_STEP / model.opt.timestep)
        if substeps < FEWEST_SUBSTEPS:
            raise ValueError(
                f"The model's timestep must be at most {CONTROL_STEP / FEWEST_SUBSTEPS} s, got "
                f"{model.opt.timestep} s; set spec.option.timestep."
            )
        self.leg_motor_names = tuple(model.actuator(i).name for i in prepared.leg_motors)
        layout = self._instrumentation.layout.rows_after(self._instrumentation.columns(model).start)
        super().__init__(
            model,
            layout,
            self.drawing.joint_names,
            substeps=substeps,
            legs=prepared.leg_motors,
            leg_motors=self.leg_motor_names,
            force_bound=max(FORCE_BOUND, 10.0 * prepared.weight),
            fall=Fall(
                tuple(self.motion.up_torso.tolist()),
                float(np.cos(FALLEN_TILT)),
                FALLEN_HEIGHT * float(self.motion.qpos[2]),
            ),
            duration=duration,
            action_scale=action_scale,
            prelude=prelude,
        )
        self._balance = AnkleBalance(prepared, self.motion)
        self._cop_width = COP_WIDTH * self.motion.height
        reach = self.motion.height
        view = {"lookat": np.array([0.0, 0.0, reach]), "distance": 4.0 * reach}
        self._draw_by(SceneRenderer(model, self.data, view, width, height), render_mode)

    def __getstate__(self) -> dict[str, Any]:
        given = {} if self.spec is None else self.spec.kwargs
        # An MjSpec cannot be copied, so that the copy has no env.spec either.
        spec = None if isinstance(given.get("robot"), mujoco.MjSpec) else self.spec
        return vars(self) | {"spec": spec}

    def draw(self, options: dict[str, Any]) -> Schedule:
        """Draw the moves of an episode."""
        return self.motion.draw(self.np_random, self._amplitude, self._tempo)

    @staticmethod
    def join(plans: Sequence[Schedule]) -> Schedule:
        """Join the moves of many robots."""
        return Schedule.join(plans)

    def command_at(self, plan: Schedule, tick: Any) -> Command:
        """Return the command at a control step of an episode; tasks' rules are in :class:`BipedEnv`."""
        return self.motion.command(tick * self.dt, plan)

    def place(self, command: Command, target: Floats) -> None:
        """Place the robot in its first posture."""
        model, data, rng = self.model, self.data, self.np_random
        joints = self._joint_dofs
        data.qpos[:] = self.motion.qpos
        noise = np.zeros(model.nv)
        noise[joints] = rng.uniform(-self._joint_noise, self._joint_noise, joints.size)
        mujoco.mj_integratePos(model, data.qpos, noise, 1.0)
        data.qvel[:6] = rng.uniform(-self._velocity_noise, self._velocity_noise, 6)

    def read(self, rows: Floats) -> FeetTruth:
        """Return the truth of a control step, of sensor data of shape (..., S, columns)."""
        return self._instrumentation.read_rows(self.model, rows)

    def correct(self, truth: FeetTruth, command: Command) -> Floats:
        """Return the correction by the ankles for the end of a step."""
        return self._balance.correction(truth, command)

    def reward(self, seen: Seen) -> dict[str, float]:
        """Return the terms of the reward, by name."""
        cop = closeness(seen.cop_error_x, seen.cop_error_y, self._cop_width) if seen.cop_valid else 0.0
        return {"reward_alive": 1.0, "reward_cop": cop, "reward_action": seen.effort}


def _up_to(name: str, value: Sequence[float], highest: float) -> tuple[float, float]:
    """Return a range of positive numbers, or raise ValueError if it is not one or exceeds ``highest``."""
    low, high = check_range(name, value)
    if not 0.0 < low <= high <= highest:
        raise ValueError(f"'{name}' must be (lowest, highest) in (0, {highest}], got {value!r}.")
    return low, high
