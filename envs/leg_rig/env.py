"""The rig of in-situ calibration as an environment: the agent turns the hip to gather information."""

from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.leg_rig.spec import (
    ADDED_MASSES,
    HIP_JOINTS,
    SENSORS,
    LimbBody,
    limb_beyond,
    load_leg_rig_spec,
    place_added_mass,
    read_wrenches,
    sensor_frames,
)
from surefoot.envs.options import check_action, check_render_mode, positive
from surefoot.envs.rendering import DrawnEnv, SceneRenderer


class HipDrive:
    """Targets of position servos that follow speeds with limited acceleration in rad/s^2.

    A speed changes evenly over a step of ``step`` s, by at most ``acceleration`` times that, and only so that
    the target can still come to rest within its range, ``low`` to ``high`` in rad, (J,); a step has
    ``substeps`` targets. ``target`` and its ``speed`` are those of now in rad and rad/s, (J,).
    """

    def __init__(self, low: Floats, high: Floats, *, acceleration: float, step: float, substeps: int) -> None:
        self.target, self.speed = 0.5 * (low + high), np.zeros(len(low))
        self._low, self._high = low, high
        self._change, self._step = acceleration * step, step
        self._fraction = np.arange(1, substeps + 1)[:, None] / substeps

    def rest(self, target: Floats) -> None:
        """Stand still at ``target``."""
        self.target, self.speed = target.copy(), np.zeros(len(target))

    def follow(self, wanted: Floats) -> Floats:
        """Approach wanted speeds in rad/s, (J,), for a step by targets in rad, (substeps, J)."""
        last = self.speed
        self.speed = self._next_speed(wanted)
        f = self._fraction
        moved = self._step * (f * last + 0.5 * f**2 * (self.speed - last))
        targets = np.clip(self.target + moved, self._low, self._high)
        self.target = targets[-1]
        return targets

    def ahead(self, time: float) -> Floats:
        """Where the target will be in ``time`` s, if its speed stays."""
        return np.asarray(np.clip(self.target + self.speed * time, self._low, self._high))

    def _next_speed(self, wanted: Floats) -> Floats:
        speed = np.clip(wanted, self.speed - self._change, self.speed + self._change)
        reached = self.target + 0.5 * self._step * self.speed
        return np.asarray(
            np.clip(speed, -self._stopping(reached - self._low), self._stopping(self._high - reached))
        )

    def _stopping(self, room: Floats) -> Floats:
        """Solve v dt / 2 + v^2 dt / (2 change) = room in rad for the speed v that can still be stopped."""
        change = self._change
        room = np.maximum(room, 0.0)
        return np.asarray(np.sqrt(0.25 * change**2 + 2.0 * room * change / self._step) - 0.5 * change)


CONTROL_STEP = 0.1  # duration of one environment step in s
SUBSTEPS = 50  # simulation steps of 2 ms within one environment step

ACCELERATION = float(np.radians(10.0))  # how fast the commanded speed of the hip changes at most, in rad/s^2
PRIOR_INFORMATION = 1e-3  # information on each direction of (g / 9.81, 1) before the first sample, in samples


class LegRigEnv(DrawnEnv):
    r"""A leg on a stand, with F/T sensors at hip and foot, that is turned to calibrate them.

    The leg hangs by its hip; its knee is held. Masses can be added to a beam under its foot, as in the eight
    data sets of the in-situ paper. Within a step the hip follows the commanded speeds by way of position
    servos; speeds change by at most 10 deg/s^2 and die away before the ends of the ranges.

    ## Action

    ``Box(-1, 1, (2,), float32)``: speeds of the hip; values beyond the bounds are clipped.

    | Num | Action | Min | Max | Joint | Unit |
    |-----|--------|-----|-----|-------|------|
    | 0 | front-back, positive forward | -speed_deg | speed_deg | hip_front_back | deg/s |
    | 1 | lateral, positive outward | -speed_deg | speed_deg | hip_lateral | deg/s |

    ## Observation

    ``Box(float32, (10,))``; values beyond the bounds are clipped. The IMU on the beam is perfect; its axes
    are those of the sensors: x forward, y right, z down.

    | Num | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | 0 | angle of the hip, front-back (from -35 to 35 deg) | -1 | 1 | rad |
    | 1 | angle of the hip, lateral (from -45 to 45 deg) | -1 | 1 | rad |
    | 2 | rate of the hip, front-back | -5 | 5 | rad/s |
    | 3 | rate of the hip, lateral | -5 | 5 | rad/s |
    | 4-6 | specific force x, y, z; (0, 0, -9.81) in the zero posture | -50 | 50 | m/s^2 |
    | 7-9 | angular velocity x, y, z | -10 | 10 | rad/s |

    ## Reward

    The gain by the step of the log-determinant of the information on the directions of h = (g / 9.81, 1), on
    which a gravitational reading depends linearly: with :math:`\Lambda_0 = 0.001\, I`,

    .. math:: \Lambda_{k+1} = \Lambda_k + h h^T, \qquad
        \log\det\Lambda_{k+1} - \log\det\Lambda_k = \log(1 + h^T \Lambda_k^{-1} h)

    with g in the foot sensor's frame. Shaking does not pay, as g comes from the posture; a posture pays less
    each time it is seen, and planar motion leaves a direction unknown. The sum over an episode is the
    information that was gained beyond the starting posture.

    ## Starting state

    At rest, each angle drawn evenly from the middle third of its range.

    ## End of an episode

    Never *terminated*; *truncated* by ``max_episode_steps``: 3000 steps, five minutes, as registered.

    ## Options of a reset

    ``configuration``: which masses to add from this episode on, 1 to 8.

    ## Info

    ``info["surefoot"]["configuration"]`` and ``info["surefoot"]["truth"]`` at the end of the step. Names
    end in ``_foot`` or ``_leg``, the sensor at and in whose frame a quantity is:

    | Key | Truth | Unit |
    |-----|-------|------|
    | ``wrench_foot``, ``wrench_leg`` (6) | load of limb and added mass on the robot | N, N m |
    | ``gravity_foot``, ``gravity_leg`` (3) | g, pointing down | m/s^2 |
    | ``mass_foot``, ``mass_leg`` | mass of the limb beyond the sensor, nothing added | kg |
    | ``mass_com_foot``, ``mass_com_leg`` (3) | its first moment | kg m |
    | ``inertia_foot``, ``inertia_leg`` (3, 3) | its inertia about the sensor's origin | kg m^2 |
    | ``added_mass`` | added mass | kg |
    | ``added_com_foot``, ``added_com_leg`` (3) | its centre of mass (leg: with a straight knee) | m |

    Args:
        configuration: Which masses to add until a reset says otherwise, 1 to 8.
        speed_deg: Highest commanded speed of the hip in deg/s.
        knee_slack: By how many rad the knee bends per N m: 0 holds it.
        floor: Whether the tip of the beam meets a block of foam at the rear end of the front-back range.
        render_mode: ``"rgb_array"``, ``"human"`` or ``None``.
        width: Width of a frame in pixels.
        height: Height of a frame in pixels.
        camera: A camera of rig.xml: ``"side"`` or ``"front"``.

    Attributes:
        model: The MuJoCo model.
        data: Its state.
        configuration: Which masses hang on the foot.
        markers: Spheres to draw into the next frames: (position in the world in m, RGBA, radius in m).

    Raises:
        ValueError: If an option is out of its range, naming it.
    """

    metadata = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        *,
        configuration: int = 1,
        speed_deg: float = 5.0,
        knee_slack: float = 0.0,
        floor: bool = False,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera: str = "side",
    ) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        self._top_speed = float(np.radians(positive("speed_deg", speed_deg)))
        self.model = load_leg_rig_spec(configuration, knee_slack=knee_slack, floor=floor).compile()
        self.data = mujoco.MjData(self.model)
        self.configuration = configuration
        self._draw_by(SceneRenderer(self.model, self.data, camera, width, height), render_mode)
        self._range = self.model.actuator_ctrlrange.T.copy()
        self._drive = HipDrive(*self._range, acceleration=ACCELERATION, step=CONTROL_STEP, substeps=SUBSTEPS)
        self._stiffness = np.concatenate([self.model.actuator_gainprm[:, 0], self.model.jnt_stiffness[2:]])
        self._bends = self.model.nv > len(HIP_JOINTS)
        bound = np.array([1.0] * 2 + [5.0] * 2 + [50.0] * 3 + [10.0] * 3, dtype=np.float32)
        self.observation_space = spaces.Box(-bound, bound, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (len(HIP_JOINTS),), dtype=np.float32)
        self._covariance: Floats = np.eye(4)
        self._limbs: list[LimbBody] = []

    @property
    def dt(self) -> float:
        """Duration of a step in s."""
        return CONTROL_STEP

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Hang the leg at rest; ``{"configuration": j}`` changes the added masses, j from 1 to 8.

        Raises:
            ValueError: If an option is unknown or there is no such configuration.
        """
        super().reset(seed=seed)
        chosen = dict(options or {})
        configuration = chosen.pop("configuration", self.configuration)
        if chosen:
            raise ValueError(f"A reset knows the option 'configuration' alone, got {sorted(chosen)} as well.")
        model, data = self.model, self.data
        if configuration != self.configuration:
            place_added_mass(model, data, configuration)
            self.configuration = configuration
        mujoco.mj_resetData(model, data)
        self._drive.rest(self.np_random.uniform(*self._range) / 3.0)
        self._covariance = np.eye(4) / PRIOR_INFORMATION
        data.ctrl[:] = self._drive.target
        # Servos and knee give way under the weight: start where they carry it.
        rest = np.concatenate([self._drive.target, np.zeros(model.nv - 2)])
        data.qpos[:] = rest
        for _ in range(10):
            mujoco.mj_forward(model, data)
            data.qpos[:] = rest - data.qfrc_bias / self._stiffness
        mujoco.mj_forward(model, data)
        self._limbs = [limb_beyond(model, data, sensor) for sensor in SENSORS]
        truth = self._truth()
        self._gain(truth)
        self._show()
        return self._observation(), self._info(truth)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Turn the hip for 0.1 s, with speeds as shares of ``speed_deg``, shape (2,).

        Raises:
            ValueError: If the action has another shape or is not finite.
            gymnasium.error.ResetNeeded: If the environment has not been reset.
        """
        if not self._limbs:
            raise gym.error.ResetNeeded("Call reset() before the first step().")
        model, data = self.model, self.data
        wanted = check_action(action, HIP_JOINTS, "a speed for each of", "zeros hold the leg still")
        for target in self._drive.follow(wanted * self._top_speed):
            data.ctrl[:] = target
            mujoco.mj_step(model, data)
        # Sensors lag the state by one substep unless they are evaluated again, under the command of the next.
        data.ctrl[:] = self._drive.ahead(model.opt.timestep)
        mujoco.mj_forward(model, data)
        truth = self._truth()
        reward = self._gain(truth)
        self._show()
        return self._observation(), reward, False, False, self._info(truth)

    def _gain(self, truth: dict[str, Any]) -> float:
        """Take the posture's row into the information; return the gain in its log-determinant."""
        h = np.append(truth["gravity_foot"] / np.linalg.norm(self.model.opt.gravity), 1.0)
        spread = self._covariance @ h
        factor = 1.0 + float(h @ spread)
        self._covariance -= np.outer(spread, spread) / factor
        return float(np.log(factor))

    def _observation(self) -> NDArray[np.float32]:
        data, space = self.data, self.observation_space
        assert isinstance(space, spaces.Box)
        imu = [data.sensor("specific_force").data, data.sensor("angular_velocity").data]
        values = np.concatenate([data.qpos[:2], data.qvel[:2], *imu])
        return np.clip(values.astype(np.float32), space.low, space.high)

    def _truth(self) -> dict[str, Any]:
        model, data = self.model, self.data
        limbs = [limb_beyond(model, data, s) for s in SENSORS] if self._bends else self._limbs
        wrenches = read_wrenches(data.sensordata)
        _, rotations = sensor_frames(data)
        truth: dict[str, Any] = {}
        for sensor, limb, wrench, R in zip(SENSORS, limbs, wrenches, rotations, strict=True):
            truth[f"wrench_{sensor}"] = wrench
            truth[f"gravity_{sensor}"] = R.T @ model.opt.gravity
            truth[f"mass_{sensor}"] = limb.mass
            truth[f"mass_com_{sensor}"] = limb.mass_com.copy()
            truth[f"inertia_{sensor}"] = limb.inertia.copy()
        load = ADDED_MASSES[self.configuration]
        return truth | {
            "added_mass": load.mass,
            "added_com_foot": np.array(load.com_foot),
            "added_com_leg": np.array(load.com_leg),
        }

    def _info(self, truth: dict[str, Any]) -> dict[str, Any]:
        return {"surefoot": {"configuration": self.configuration, "truth": truth}}
