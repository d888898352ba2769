"""A NAO-class biped on eight load cells: the base of its tasks."""

from collections.abc import Sequence
from os import PathLike
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.biped import BipedEnv, Fall
from surefoot.envs.command import Command
from surefoot.envs.instrumentation.drawing import RobotDrawing, draw_nao
from surefoot.envs.instrumentation.truth import FeetTruth
from surefoot.envs.nao.disturbances import CHEST, Payload, PayloadRange, Pushes
from surefoot.envs.nao.truth import truth_layout
from surefoot.envs.observation import FORCE_BOUND, Observation, Seen, closeness
from surefoot.envs.options import (
    check_range,
    check_render_mode,
    check_stiffness,
    check_time_constant,
    positive,
)
from surefoot.envs.prelude import Prelude
from surefoot.envs.rendering import SceneRenderer
from surefoot.envs.robots.nao import (
    LEG_MOTORS,
    cell_positions,
    hinge_joint_names,
    motor_names,
    motor_of_joint,
    nao_model,
    place_on_ground,
)

CONTROL_STEP = 1.0 / 80.0  # duration of one environment step in s
SUBSTEPS = 10  # simulation steps of 1.25 ms within one environment step

FALLEN_HEIGHT = 0.22  # height of the torso's origin in m below which the robot has fallen (0.32 in a stand)
FALLEN_TILT = 0.8  # angle between the torso and the vertical in rad above which the robot has fallen
SINK = 0.00016  # depth in m by which the standing robot sinks in, at the time constant of nao.xml; measured
SINK_EXPONENT = 1.3
"""Exponent of that depth over the time constant: 2 for a linear spring, less as MuJoCo's contact stiffens."""

GROUND_TIME_CONSTANT = 0.02  # time constant in s of the contacts in nao.xml: firm ground

DEFAULT_STIFFNESS = (1.08, 0.87, 0.94, 1.15, 0.91, 1.12, 1.18, 0.83)
"""Relative stiffnesses of the eight cells, uneven by up to 18 %, since the corners of a real shoe differ."""


class NaoEnv(BipedEnv):
    r"""A position-controlled NAO-class biped; subclasses supply its commands.

    ## Action

    ``Box(-1, 1, (11,), float32)``: a residual on the pattern's targets of the leg motors; zero leaves the
    open-loop pattern alone. Values beyond the bounds are clipped. Within a step the targets move linearly, as
    the NAO's motor boards interpolate. They respect the limits of joint angles and speeds.

    | Num | Action | Min | Max | Motor | Unit |
    |-----|--------|-----|-----|-------|------|
    | 0 | both hips, yaw-pitch | -action_scale | action_scale | LHipYawPitch | rad |
    | 1 | left hip, roll | -action_scale | action_scale | LHipRoll | rad |
    | 2 | left hip, pitch | -action_scale | action_scale | LHipPitch | rad |
    | 3 | left knee, pitch | -action_scale | action_scale | LKneePitch | rad |
    | 4 | left ankle, pitch | -action_scale | action_scale | LAnklePitch | rad |
    | 5 | left ankle, roll | -action_scale | action_scale | LAnkleRoll | rad |
    | 6 | right hip, roll | -action_scale | action_scale | RHipRoll | rad |
    | 7 | right hip, pitch | -action_scale | action_scale | RHipPitch | rad |
    | 8 | right knee, pitch | -action_scale | action_scale | RKneePitch | rad |
    | 9 | right ankle, pitch | -action_scale | action_scale | RAnklePitch | rad |
    | 10 | right ankle, roll | -action_scale | action_scale | RAnkleRoll | rad |

    ## Observation

    A ``Dict`` of float32 arrays; values beyond the bounds are clipped. The level frame has z up, its origin
    on the ground midway between the two sole origins, and x along the mean heading of the soles. References
    are given in the level frame of the *commanded* soles.

    ``"state"``, of which ``state_layout`` names the parts:

    | Num | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | 0-23 | ``joint_position``: hinge joints in the order of ``joint_names`` | -pi | pi | rad |
    | 24-47 | ``joint_velocity`` | -50 | 50 | rad/s |
    | 48-49 | ``tilt``: roll and pitch of the torso | -pi | pi | rad |
    | 50-52 | ``gyroscope``: angular velocity in the torso's axes | -50 | 50 | rad/s |
    | 53-54 | ``com_reference``: planned centre of mass, level frame | -1 | 1 | m |
    | 55-56 | ``com_reference_velocity``: planned velocity, level frame | -2 | 2 | m/s |
    | 57-58 | ``cop_reference``: planned centre of pressure, level frame | -1 | 1 | m |
    | 59-60 | ``stance``: feet (left, right) planned to bear weight | 0 | 1 | 1 |
    | 61-62 | ``phase``: sine and cosine of the gait cycle's phase | -1 | 1 | 1 |

    The feet (true values; wrappers replace them by sensors):

    | Key | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | ``"foot_force"`` (8) | forces of the cells, left then right: FL, FR, RL, RR | -1000 | 1000 | N |
    | ``"cop_foot"`` (2, 2) | centre of pressure of each foot (left, right), sole frame | -1 | 1 | m |
    | ``"cop"`` (2) | centre of pressure of both feet, level frame | -1 | 1 | m |
    | ``"cop_valid"`` (3) | whether the total, left and right one are defined | 0 | 1 | 1 |

    A centre of pressure is defined above 5 N. Below that, the last one is held and flagged.

    ## Reward

    Each step pays ``reward_alive`` = 1, ``reward_cop`` = w exp(-(e / s)^2) with the weight w = 1, the scale s
    = 0.02 m and e the distance between the true centre of pressure and its reference (0 where there is none),
    and ``reward_action`` = -0.1 times the mean square of the action. ``info`` holds the three terms.

    ## Starting state and disturbances

    The pattern's first posture, upright on its footprints, with uniform noise on the joints and on the
    velocity of the torso. The friction of the ground is drawn once per episode. Pushes come at exponentially
    distributed intervals and last 0.1 s, horizontal and in any direction at the torso's centre of mass. A
    payload is fixed to the torso at a fixed or random time. With ``quiet_start`` nothing happens during the
    initial stand, in which residuals are not applied either, so that calibrators get a standing start.

    ## End of an episode

    *Terminated* once the torso's origin is lower than 0.22 m or leans by more than 0.8 rad; *truncated* after
    ``duration``.

    ## Info

    ``info["surefoot"]["truth"]`` holds means over the step, see
    :func:`~surefoot.envs.instrumentation.means.mean_truth`; observation and reward are of its end.
    ``unwrapped.truth`` has all of the step's substeps and more.

    Args:
        duration: Length of an episode in s, or ``None`` for no end.
        action_scale: The change of a target by a full action, in rad.
        cell_stiffness: Relative stiffnesses of the eight cells, which decide how a sole shares its load;
            ``None`` for a fixed unequal set.
        friction: Lowest and highest coefficient of friction under the soles; (0.15, 0.2) is slippery, and
            from 0.05 downwards feet slide at every step.
        ground_time_constant: Time constant in s in which the ground gives way to a sole, from 0.005 to 0.1.
            Under a foot that carries the robot, 0.02 gives way by 0.5 mm, 0.04 (a carpet) by 1.4 mm and 0.06
            (a soft mat) by 2.8 mm.
        prelude: The robot's motion before each episode, or the path of its file, which
            ``surefoot calibrate motion nao`` writes. Its steps are ordinary ones, in which nobody pushes;
            ``duration`` and a task's own times begin after it. ``None`` for nothing.
        payload: (mass in kg, time in s): a mass that is fixed before the chest from that time on, which
            neither the pattern nor a nominal model contains, (0.3, 15) for instance; ``None`` for none.
        payload_mass: Lowest and highest mass in kg of a payload that each episode draws instead; (0, 0) for
            none, ``None`` to draw nothing.
        payload_time: When it comes: least and most time in s after the initial stand. The default leaves a
            calibrator enough time to distinguish a load from a broken sensor.
        payload_boxes: Boxes in the torso's frame in m, shape (boxes, 2, 3). An episode draws one, and the
            place of the payload's centre of mass in it.
        stand_time: Time in s for which the robot stands at the beginning.
        quiet_start: Whether pushes and residuals are held back during that time.
        cop_scale: Error of the centre of pressure in m at which its reward has fallen to 1/e.
        cop_weight: Largest ``reward_cop``.
        joint_noise: Largest initial error of a joint in rad.
        velocity_noise: Largest initial velocity of the torso along each axis, in m/s and rad/s.
        push_impulse: Smallest and largest impulse of a push in N s; (0, 0) for none.
        push_interval: Mean time between pushes in s.
        render_mode: ``"rgb_array"``, ``"human"`` or ``None``.
        width: Width of a frame in pixels.
        height: Height of a frame in pixels.
        camera: A camera of nao.xml.

    Attributes:
        model: The MuJoCo model.
        data: Its state.
        truth: The truth of the last step.
        command: The robot's present command to itself.
        prelude: Plays the motion before the episode (:class:`~surefoot.envs.prelude.Player`).
        joint_names: The J hinge joints.
        motor_names: The M motors, the leg motors of an action first.
        state_layout: Where each part lies in ``observation["state"]``.
        position_cell_sole: Places of the cells in the sole frames in m, shape (2, 4, 3).
        stand_time: Duration of the quiet start in s; 0 without one.
        markers: Spheres to draw into the next frames: (position in the world in m, RGBA, radius in m).

    Raises:
        ValueError: If an option is out of its range, naming it.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 80}  # noqa: RUF012

    truth: FeetTruth
    shared = (*BipedEnv.shared, "channels", "position_cell_sole")
    varied = ("pair_friction", "body_mass", "body_ipos", "body_inertia", "body_iquat")
    _neutral = "a policy that returns NaN has diverged, zeros leave the pattern alone"

    def __init__(
        self,
        *,
        duration: float | None = 30.0,
        action_scale: float = 0.2,
        cell_stiffness: Sequence[float] | None = None,
        friction: Sequence[float] = (0.6, 0.9),
        ground_time_constant: float = GROUND_TIME_CONSTANT,
        payload: Sequence[float] | None = None,
        payload_mass: Sequence[float] | None = None,
        payload_time: Sequence[float] = (10.5, 12.5),
        payload_boxes: Sequence[Sequence[Sequence[float]]] = CHEST,
        stand_time: float = 0.0,
        quiet_start: bool = False,
        cop_scale: float = 0.02,
        cop_weight: float = 1.0,
        prelude: Prelude | str | PathLike[str] | None = None,
        joint_noise: float = 0.005,
        velocity_noise: float = 0.01,
        push_impulse: Sequence[float] = (0.0, 0.0),
        push_interval: float = 5.0,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera: str = "track",
    ) -> None:
        stiffness = DEFAULT_STIFFNESS if cell_stiffness is None else check_stiffness(cell_stiffness)
        self._friction = check_range("friction", friction)
        self._joint_noise = positive("joint_noise", joint_noise, or_zero=True)
        self._velocity_noise = positive("velocity_noise", velocity_noise, or_zero=True)
        self._cop_reward = positive("cop_weight", cop_weight, or_zero=True), positive("cop_scale", cop_scale)
        check_render_mode(render_mode, self.metadata["render_modes"])

        model = nao_model()
        self.channels = truth_layout(model, stiffness)
        super().__init__(
            model,
            self.channels,
            hinge_joint_names(model),
            substeps=SUBSTEPS,
            legs=slice(0, len(LEG_MOTORS)),
            leg_motors=LEG_MOTORS,
            force_bound=FORCE_BOUND,
            fall=Fall((0.0, 0.0, 1.0), float(np.cos(FALLEN_TILT)), FALLEN_HEIGHT),
            duration=duration,
            action_scale=action_scale,
            prelude=prelude,
        )
        self._draw_by(SceneRenderer(model, self.data, camera, width, height), render_mode)
        self.motor_names = motor_names(model)
        self.position_cell_sole = cell_positions(model)
        self._soften_ground(check_time_constant("ground_time_constant", ground_time_constant))
        self._payload = Payload(model, payload, CONTROL_STEP)
        self._payload_range = PayloadRange.of(payload_mass, payload_time, payload_boxes, stand_time, payload)
        self.stand_time = stand_time if quiet_start else 0.0
        self.quiet_ticks = round(self.stand_time / CONTROL_STEP)
        self._pushes = Pushes(model, push_impulse, push_interval, CONTROL_STEP, quiet_time=self.stand_time)
        self._motor_of_joint = motor_of_joint(model)
        self.fastest = model.actuator_user[:, 0] * CONTROL_STEP
        self._torso = model.body("torso").id

    @property
    def drawing(self) -> RobotDrawing:
        """The nominal description of the robot: nao.xml without the changes of an episode."""
        return draw_nao()

    def _soften_ground(self, time_constant: float) -> None:
        """Set the contacts' time constant in s, and how far the standing robot sinks in with it."""
        self.model.pair_solref[:, 0] = time_constant
        self._sink = SINK * (time_constant / GROUND_TIME_CONSTANT) ** SINK_EXPONENT

    def disturb(self, data: Any, tick: int, prepares: bool) -> bool:
        """Push the robot, and add its payload when it is due."""
        if not prepares:
            self._pushes.apply(data, self.np_random)
        return self._payload.apply(tick)

    def draw_payload(self) -> None:
        """Draw the payload of an episode, if it is random."""
        if self._payload_range is not None:
            self._payload.plan(*self._payload_range.draw(self.np_random))

    def read(self, rows: Floats) -> FeetTruth:
        """Return the truth of a control step, of sensor data of shape (..., S, columns)."""
        return FeetTruth(rows, self.channels)

    def cop_reward(self, seen: Seen) -> float:
        """Return the reward of the centre of pressure, compared in the level frames of the soles."""
        if not seen.cop_valid:
            return 0.0
        weight, scale = self._cop_reward
        return weight * closeness(seen.cop_error_forward, seen.cop_error_left, scale)

    def reward(self, seen: Seen) -> dict[str, float]:
        """Return the terms of the reward, by name."""
        return {"reward_alive": 1.0, "reward_cop": self.cop_reward(seen), "reward_action": seen.effort}

    def place(self, command: Command, target: Floats) -> None:
        """Put the robot onto its footprints."""
        model, data, rng = self.model, self.data, self.np_random
        model.pair_friction[:, :2] = rng.uniform(*self._friction)
        noise = rng.uniform(-self._joint_noise, self._joint_noise, target.size)
        data.qpos[7:] = (target + noise)[self._motor_of_joint]
        place_on_ground(model, data, command.position_sole, command.yaw_sole)
        data.qpos[2] -= self._sink
        data.qvel[:6] = rng.uniform(-self._velocity_noise, self._velocity_noise, 6)
        self._pushes.reset(rng)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Put the robot onto its footprints. The options are those of the task."""
        self._payload.reset()
        return super().reset(seed=seed, options=options)
