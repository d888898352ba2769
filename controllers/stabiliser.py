r"""A balance controller that trusts its centre of pressure.

After the linear inverted pendulum tracking of Kajita, Morisawa, Miura, Nakaoka, Harada, Kaneko, Kanehiro
and Yokoi, "Biped walking stabilization based on linear inverted pendulum tracking", IROS 2010, whose ankle
part Caron, Kheddar and Tempier, "Stair climbing stabilization of the HRP-4 humanoid robot using whole-body
admittance control", ICRA 2019, write as an admittance from the centre of pressure.

A body that leans off its pattern by :math:`\Delta` (of its centre of mass, in m) is an inverted pendulum:
it is brought back by a centre of pressure further out than itself. So the desired one is

.. math:: p^d = p^{ref} + k_1 \Delta + k_2 \dot\Delta, \qquad k_1 > 1,

and, as the motors take positions and not torques, the ankles turn at a rate proportional to the error of the
measured one,

.. math:: \ell \dot\delta = A \, (p - p^d):

a centre of pressure too far in front means that the front of the sole is pressed too hard, and the ankle
gives way. Both ankles turn alike, which keeps the soles parallel, and to first order moves the centre of
mass by :math:`\ell \delta` over the foot that carries it. The lean itself is read off the torso's tilt,
:math:`\Delta = \ell\, \theta`, for the other joints are stiff.

**The effect of an error of the sensors.** At rest :math:`\Delta = p - p^{ref}`, so that a bias :math:`b` of
the measured centre of pressure makes the body lean by :math:`b / (k_1 - 1)`. A small :math:`k_1` is gentle on
impacts and noise, and hard on a miscalibrated foot: with :math:`k_1 = 1.3`, a bias of 15 mm comes to 50 mm,
as much as a sole has to its side.
"""

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

ACTION_SIZE = 11  # number of leg motors of a NAO-class biped

HIP_ROLL, HIP_PITCH, ANKLE_PITCH, ANKLE_ROLL = [1, 6], [2, 7], [4, 9], [5, 10]
"""Where these joints (left, right) are in an action."""


@dataclass(eq=False)
class Stabiliser:
    """Turns observations of a NaoEnv, or of wrappers around one, into residuals on the ankles' targets.

    Reads of an observation ``"cop"``, ``"cop_valid"``, and of ``"state"`` the parts ``cop_reference``,
    ``tilt`` and ``gyroscope``. While the centre of pressure is flagged invalid, or is not finite, it
    balances on the tilt alone.

    Args:
        state_layout: Where the parts of ``observation["state"]`` are: ``env.unwrapped.state_layout``.
        admittance: Rate at which the lean follows an error of the centre of pressure, A, in 1/s.
        position_gain: k1, metres of centre of pressure per metre of lean; above 1.
        velocity_gain: k2, metres of centre of pressure per m/s of lean, in s.
        lever: Height of the centre of mass above the ankles that a lean turns about, in m.
        largest_error: Errors of the centre of pressure beyond this are cut off, in m.
        largest_angle: Largest residual of an ankle in rad; beyond, the integration stops.
        engage_after: For how long after a reset to do nothing, in s: until a calibrator has settled, say.
        action_scale: The environment's, in rad.
        dt: Time from one observation to the next in s.

    Attributes:
        angle: The ankles' correction of the pattern in rad, shape (2,), positive to lean forward and to the
        left.

    Raises:
        ValueError: If a gain would not balance, an argument is not positive, or the layout lacks a part.

    >>> layout = {"tilt": slice(0, 2), "gyroscope": slice(2, 5), "cop_reference": slice(5, 7)}
    >>> stabiliser = Stabiliser(layout)
    >>> standing = {"state": np.zeros(7), "cop": np.array([0.01, 0.0]), "cop_valid": np.ones(3)}
    >>> bool(stabiliser(standing)[4] < 0)  # pressed in front: the toes give way upwards
    True
    """

    state_layout: Mapping[str, slice]
    _: KW_ONLY
    admittance: float = 1.5
    position_gain: float = 1.3
    velocity_gain: float = 0.065
    lever: float = 0.24
    largest_error: float = 0.1
    largest_angle: float = 0.2
    engage_after: float = 0.0
    action_scale: float = 0.2
    dt: float = 1.0 / 80.0

    def __post_init__(self) -> None:
        """Raise ValueError if a value is impossible."""
        for name in ("admittance", "lever", "largest_error", "largest_angle", "action_scale", "dt"):
            if not (isfinite(value := getattr(self, name)) and value > 0):
                raise ValueError(f"'{name}' must be finite and positive, got {value}.")
        for name in ("velocity_gain", "engage_after"):
            if not (isfinite(value := getattr(self, name)) and value >= 0):
                raise ValueError(f"'{name}' must be finite and not negative, got {value}.")
        if not (isfinite(self.position_gain) and self.position_gain > 1):
            raise ValueError(
                f"'position_gain' must be above 1, got {self.position_gain}: the centre of pressure has to "
                "lie further out than the body leans, or it cannot push the body back."
            )
        parts = ("cop_reference", "tilt", "gyroscope")
        if missing := [name for name in parts if name not in self.state_layout]:
            raise ValueError(
                f"'state_layout' lacks {missing}; it has {sorted(self.state_layout)}. Hand over the layout "
                "of a NaoEnv: env.unwrapped.state_layout."
            )
        self._reference, self._tilt, self._gyroscope = (self.state_layout[name] for name in parts)
        self._wait = round(self.engage_after / self.dt)
        self.reset()

    def reset(self) -> None:
        """Start an episode: the ankles go back to the pattern."""
        self.angle: NDArray[np.float64] = np.zeros(2)
        self._seen = 0

    def __call__(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the action for one observation, within [-1, 1], shape (11,); ValueError without a CoP."""
        check_parts(observation, ("cop", "cop_valid"))
        self._seen += 1
        if self._seen <= self._wait:
            return np.zeros(ACTION_SIZE, dtype=np.float32)
        state = np.asarray(observation["state"], dtype=np.float64)
        roll, pitch = state[self._tilt]
        turn_left_side_up, turn_forward = state[self._gyroscope][:2]
        # Pitching forward moves the body along x, rolling to the right side down along -y.
        lean = self.lever * np.array([pitch, -roll])
        lean_rate = self.lever * np.array([turn_forward, -turn_left_side_up])
        desired = self.position_gain * lean + self.velocity_gain * lean_rate
        rate = self.admittance * (self._cop_error(observation, state) - desired) / self.lever
        self.angle = np.clip(self.angle + self.dt * rate, -self.largest_angle, self.largest_angle)

        action = np.zeros(ACTION_SIZE)
        # On the ground, a foot that turns toes up, or left side up, leans the body forward, or to the left.
        action[ANKLE_PITCH] = -self.angle[0] / self.action_scale
        action[ANKLE_ROLL] = self.angle[1] / self.action_scale
        return np.clip(action, -1.0, 1.0).astype(np.float32)

    def _cop_error(self, observation: Mapping[str, Any], state: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return measured less planned centre of pressure in m, shape (2,); zero while it is not known."""
        error = np.asarray(observation["cop"], dtype=np.float64) - state[self._reference]
        if not observation["cop_valid"][0] or not np.isfinite(error).all():
            return np.zeros(2)
        return np.clip(error, -self.largest_error, self.largest_error)


def check_parts(observation: Mapping[str, Any], parts: Iterable[str]) -> None:
    """Raise ValueError if an observation lacks parts that a controller looks at."""
    if missing := [part for part in parts if part not in observation]:
        raise ValueError(
            f"The observation lacks {missing}; it has {sorted(observation)}. FootSensors takes the centre of "
            "pressure away and SelfCalibration brings it back: SelfCalibration(FootSensors(env))."
        )


def zero_action(observation: Mapping[str, Any]) -> NDArray[np.float32]:
    """Return the action that leaves the pattern as it is, zeros: the open-loop walker."""
    return np.zeros(ACTION_SIZE, dtype=np.float32)
