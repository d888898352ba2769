"""The robot stands still, sways, or balances an unknown load."""

from collections.abc import Sequence
from math import cos, pi
from typing import Any

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.command import Command
from surefoot.envs.nao.env import CONTROL_STEP, NaoEnv
from surefoot.envs.nao.sway import RandomSway, Sine
from surefoot.envs.observation import Seen
from surefoot.envs.options import check_range, numbers_of, positive
from surefoot.envs.robots.nao import FEET, place_on_ground

LEG_LENGTH = 0.2029  # thigh and tibia in m
LARGEST_SWAY = 0.065  # largest sway in m that keeps the robot over its feet


class NaoStandEnv(NaoEnv):
    r"""Stand on both feet without falling; actions, observations and reward are :class:`NaoEnv`'s.

    ``surefoot/NaoStand-v0`` stands still or sways by a sine.

    ## Balance

    ``surefoot/NaoBalance-v0`` is this task with a random sway and a random load. After a quiet stand the
    commanded centre of pressure (``cop_reference`` in ``"state"``) moves smoothly at random (three sines per
    axis, periods of 3 to 8 s). The open-loop pattern sways the pelvis by the holding torques *without a
    payload*. At a random moment a mass is fixed somewhere to the torso, within a box of 0.18 x 0.24 x 0.10 m
    about the chest. It moves the centre of pressure by up to two centimetres and hardly moves the joints, so
    that neither encoders nor tilt reveal it: only the feet do. ``reward_cop`` is at most 2 with a scale of
    0.015 m, so that an error of 10 mm costs 0.72 of 3 per step.

    ``surefoot/NaoBalanceHard-v0`` has 1 to 1.4 kg within 0.2 m before or behind and 0.15 m beside the torso,
    sways of up to 65 mm, which bring it to within two centimetres of the heels, weak pushes, and lasts 30 s.
    The load moves the centre of pressure by up to 40 mm; with a zero action one robot in three falls.

    Args:
        sway: Amplitudes (forward, left) of the sway of the pelvis over the feet in m; zero to stand still.
            The feet stay flat and the torso upright. A random sway has them as bounds of the centre of mass.
        sway_period: Period in s of a sway that is not random. It fades in over the first period.
        sway_share: Lowest and highest share of a bound that the amplitudes of an axis of a random sway add up
            to; ``None`` for a sway that is not random.
        stand_time: Time in s before the sway begins.
        **options: Of :class:`NaoEnv`.

    Raises:
        ValueError: If an option is out of its range, naming it.
    """

    def __init__(
        self,
        *,
        sway: Sequence[float] = (0.0, 0.0),
        sway_period: float = 4.0,
        sway_share: Sequence[float] | None = None,
        stand_time: float = 0.0,
        **options: Any,
    ) -> None:
        amplitude = numbers_of(sway)
        if len(amplitude) != 2 or not all(abs(part) <= LARGEST_SWAY for part in amplitude):
            raise ValueError(
                f"'sway' must be amplitudes (forward, left) of at most {LARGEST_SWAY} m, which keep the "
                f"robot over its feet; got {sway!r}."
            )
        self._share = None if sway_share is None else check_range("sway_share", sway_share)
        if self._share is not None and min(amplitude) < 0.0:
            raise ValueError(f"'sway' must not be negative if it is random, got {sway!r}.")
        begin = positive("stand_time", stand_time, or_zero=True)
        super().__init__(stand_time=begin, **options)
        motor = {name: i for i, name in enumerate(self.motor_names)}
        # A positive ankle pitch turns the toes down, or, with the sole on the ground, the leg backwards.
        self._swaying = np.zeros((2, len(motor)))
        for joint, axis, sign in (
            ("AnklePitch", 0, -1.0),
            ("HipPitch", 0, 1.0),
            ("AnkleRoll", 1, 1.0),
            ("HipRoll", 1, -1.0),
        ):
            self._swaying[axis, [motor[side + joint] for side in "LR"]] = sign
        self._posture = self.model.key("stand").ctrl.copy()
        self._height = LEG_LENGTH * cos(self._posture[motor["LAnklePitch"]])
        self._com, self._position_sole = self._stand(self._posture)
        pelvis = 0.01
        # How far the centre of mass follows the pelvis, forward and left.
        forward, left = (
            float((self._stand(self._lean(*shift))[0] - self._com)[axis]) / pelvis
            for axis, shift in enumerate([(pelvis, 0.0), (0.0, pelvis)])
        )
        self._gravity = -float(self.model.opt.gravity[2])
        rate = 2.0 * pi / positive("sway_period", sway_period)
        self._sine = Sine((amplitude[0], amplitude[1]), rate, (forward, left), begin)
        self._still = self._command(0.0, 0.0, np.zeros((3, 3)))

    def _stand(self, posture: Floats) -> tuple[Floats, Floats]:
        """Find the centre of mass and the soles of a posture in which both soles are flat."""
        data = mujoco.MjData(self.model)
        data.qpos[7:] = posture[self._motor_of_joint]
        place_on_ground(self.model, data, np.zeros((2, 3)), np.zeros(2))
        mujoco.mj_comPos(self.model, data)
        soles = np.array([data.site(f"{foot}_sole").xpos for foot in FEET])
        return data.subtree_com[self._torso] - (soles.mean(axis=0) * (1.0, 1.0, 0.0)), soles

    def _lean(self, forward: Any, left: Any) -> Floats:
        pitch, roll = np.multiply.outer(forward / self._height, self._swaying[0]), self._swaying[1]
        posture: Floats = self._posture + pitch + np.multiply.outer(left / self._height, roll)
        return posture

    def draw(self, options: dict[str, Any]) -> Sine | RandomSway:
        """Draw the sway and the payload."""
        sway: Sine | RandomSway = self._sine
        if self._share is not None:
            bounds, _, follow, begin = self._sine
            sway = RandomSway.draw(bounds, self._share, follow, begin, self.np_random)
        self.draw_payload()
        return sway

    @staticmethod
    def join(plans: Sequence[Sine | RandomSway]) -> list[Sine | RandomSway]:
        """Put sways of many robots into one plan."""
        return list(plans)

    def command_at(self, plan: Any, tick: Any) -> Command:
        """Return the command at a control step of an episode; tasks' rules are in :class:`BipedEnv`."""
        if not any(self._sine.amplitude):
            return self._still
        if np.ndim(tick):
            times = (tick * CONTROL_STEP).tolist()
            pelvis, motion = map(np.array, zip(*map(_at, plan, times), strict=True))
        else:
            pelvis, motion = map(np.array, plan.at(tick * CONTROL_STEP))
        level = np.zeros((*motion.shape[:-1], 3))
        level[..., :2] = motion
        return self._command(pelvis[..., 0], pelvis[..., 1], level)

    def cop_reward(self, seen: Seen) -> float:
        """Return the reward of the centre of pressure, compared in the world unless the sway is random."""
        if self._share is None:
            seen = seen._replace(cop_error_forward=seen.cop_error_x, cop_error_left=seen.cop_error_y)
        return super().cop_reward(seen)

    def _command(self, forward: Any, left: Any, motion: Floats) -> Command:
        """Return the command for a displacement of the pelvis in m.

        The motion of the centre of mass has shape (..., 3, 3): displacement, velocity and acceleration.
        """
        com = self._com + motion[..., 0, :]
        velocity, acceleration = motion[..., 1, :], motion[..., 2, :]
        return Command(
            joint_target=self._lean(forward, left),
            com=com,
            com_velocity=velocity,
            com_acceleration=acceleration,
            cop=com[..., :2] - self._com[2] / self._gravity * acceleration[..., :2],
            position_sole=self._position_sole,
            yaw_sole=np.zeros(2),
            stance=np.ones(2, dtype=bool),
            swing=np.zeros(2, dtype=bool),
            phase=0.0,
        )


def _at(sway: Sine | RandomSway, time: float) -> Any:
    return sway.at(time)
