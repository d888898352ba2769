"""Sensors between the truth of an environment and the observer."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, SupportsFloat, Unpack

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.checks import check_flag
from surefoot.pickles import OfOneVersion
from surefoot.robot.sensing.condition import Faults, Severity
from surefoot.robot.sensing.device import FootDevice
from surefoot.robot.sensing.equipment import Equipment
from surefoot.robot.sensing.foot_equipment import FootEquipment, FootOptions, equip
from surefoot.robot.sensing.raw_view import RawView
from surefoot.robot.sensing.sensors import RobotSensors, SensorsFace
from surefoot.sensors.telemetry.computer import Telemetry
from surefoot.sensors.transport.link import Packets
from surefoot.wrappers.source import (
    Source,
    check_clock,
    check_order,
    find_source,
    refuse_second,
    split_options,
    warning_of_true_forces,
    with_source,
)


class FootSensors(
    OfOneVersion, SensorsFace, gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs
):
    """Read an environment through load cells or ankle sensors, joint encoders and an IMU.

    Any environment based on MuJoCo can be wrapped. If it does not record its truth, sensors are added to its
    model in memory first (:class:`~surefoot.envs.InstrumentedEnv`). The observation becomes a ``Dict``, in
    which an observation that was not a ``Dict`` is called ``"state"``, and gains

    | Key | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | ``"foot_raw"`` (K) | cells, left then right: FL, FR, RL, RR; ankles: fx to tz | 0 | 2^24 - 1 | count |

    (the range is that of the configuration). If no reading arrives, the last one is held, and before the
    first one that of an unloaded sensor. The true ``"foot_force"``, ``"cop"``, ``"cop_foot"`` and
    ``"cop_valid"`` are removed. If the environment has a ``state_layout``, ``joint_position``,
    ``joint_velocity``, ``tilt`` and ``gyroscope`` are replaced by those of the newest packet of telemetry
    that has arrived; the states of other environments are not changed. The truth stays in
    ``info["surefoot"]["truth"]``.

    A calibrating wrapper uses only :attr:`source`, :attr:`robot` and :meth:`listen`.

    Sensors have their own random streams, which are seeded by the seed of the reset. The environment's
    trajectory is therefore that without sensors, and the same seed under other wrappers gives the same
    episode. A reset with a seed draws fresh sensors: other scales, offsets, clocks and biases, equal to those
    of a copy in a vector that is reset with the same seed. A reset without a seed keeps the sensors, which
    continue to drift as hardware does. ``fresh=True`` or ``options={"surefoot": {"sensors": "fresh"}}`` draws
    fresh sensors in this case too, and ``"keep"`` keeps them despite a seed.

    If ``severity`` is a range, or ``faults`` are probabilities, ``info["surefoot"]["truth"]`` also contains
    the drawn values: ``severity``, and ``fault`` (K,), which is 0 for a channel without a fault and otherwise
    1 plus the index of its fault in :data:`surefoot.sensors.faults.channels.KINDS`. They are meant for a
    critic, not for a policy.

    Args:
        env: An environment based on MuJoCo, such as ``surefoot/NaoWalk-v0`` or ``Humanoid-v5``.
        config: The instruments under the feet: the name of a preset, a :class:`~surefoot.sensors.LoadCells`,
            a :class:`~surefoot.sensors.ForceTorque`, a mapping of the fields of either; or all sensors as one
            :class:`~surefoot.wrappers.FootEquipment`.
        measure_state: Whether encoders and IMU replace the parts that a ``state_layout`` names.
        feet: Names of the feet's bodies, for a robot whose feet are not found automatically.
        cells: Positions of the cells, see :class:`~surefoot.envs.InstrumentedEnv`.
        soles: Flat soles for feet without area, see there. They change how the robot moves.
        options: Fields of :class:`~surefoot.wrappers.FootEquipment`: ``ankles``, ``imu``, ``encoders``,
            ``link``, ``severity``, ``faults``, ``fresh`` and ``stream``.

    Attributes:
        source: The environment or wrapper that records the truth.
        robot: The sensors, which persist over episodes.
        instruments: The instruments under the feet.

    Raises:
        TypeError: If the environment is not based on MuJoCo, or already has sensors.
        ValueError: If a preset is unknown, a value is out of range, or the sensors do not fit the feet.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        config: str | Mapping[str, Any] | FootDevice | FootEquipment | None = None,
        *,
        measure_state: bool = True,
        feet: Sequence[str] | None = None,
        cells: Mapping[str, ArrayLike] | None = None,
        soles: bool | Mapping[str, Sequence[float]] | None = None,
        **options: Unpack[FootOptions],
    ) -> None:
        check_flag("measure_state", measure_state)
        given = equip(config, **options)
        refuse_second("FootSensors", env)
        # A spec rebuilds InstrumentedEnv first, which records the positions of the sensors.
        gym.utils.RecordConstructorArgs.__init__(self, measure_state=measure_state, **given.options)
        gym.Wrapper.__init__(self, with_source(env, feet=feet, cells=cells, soles=soles))
        source = find_source(self.env)
        assert source is not None
        self.source: Source = source
        dt, joints = float(source.dt), source.joint_names
        seldom = getattr(source, "seldom", False)
        equipment = Equipment("FootSensors", source.drawing, joints, dt, given, seldom)
        self.instruments = equipment.instruments
        check_order("FootSensors", self.env, source)
        if warning := warning_of_true_forces(self.env):
            warnings.warn(warning, stacklevel=2)
        shown: Any = self.env.observation_space
        if "foot_raw" in getattr(shown, "spaces", ()):
            raise TypeError(
                f"FootSensors adds 'foot_raw' to an observation that has a part of that name already: {env}."
            )
        layout = getattr(source, "state_layout", None) if measure_state else None
        self._view = RawView(shown, self.instruments.space, layout, equipment.packet)
        self.observation_space = self._view.space
        self.robot = RobotSensors(equipment, self._view.measures, self._view)
        self._clock: float | None = None
        self._drawn: dict[str, NDArray[Any]] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, with fresh or kept sensors.

        Args:
            seed: Seeds the environment and the sensors; without one the sensors are kept.
            options: ``options["surefoot"]["sensors"]`` may be ``"fresh"`` or ``"keep"``. Other options are
                passed to the environment.

        Raises:
            ValueError: If a choice does not exist.
        """
        rest, asked = split_options(options, "sensors", "calibration")
        observation, info = self.env.reset(seed=seed, options=rest)
        dt, choice = float(self.source.dt), asked.get("sensors")
        gravity = np.asarray(self.source.model.opt.gravity)
        seen = self.robot.reset(self.source.truth, dt, seed, choice, observation, gravity)
        self._clock = None
        self._drawn = self.robot.true_condition() if self.robot.differs else {}
        return seen, self._with_drawn(info)

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment and read the sensors. An unstable simulation gives no sample."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        truth, robot = self.source.truth, self.robot
        before, self._clock = self._clock, truth.time.item(-1)
        blown_up = before is not None and check_clock(
            "FootSensors", self.env, self._clock - before, robot.telemetry.dt, self.source
        )
        seen = robot.step(truth, observation)
        if blown_up:
            robot.raw[:] = np.nan
        return seen, reward, terminated, truncated, self._with_drawn(info)

    @property
    def time(self) -> float:
        """The host's time since the reset in s."""
        return self.robot.time

    @property
    def sensors_fresh(self) -> bool:
        """Whether the last reset drew fresh sensors."""
        return self.robot.sensors_fresh

    @property
    def packets(self) -> Packets:
        """Telemetry that arrived during the last step, in order; empty unless :meth:`listen` was called."""
        return self.robot.packets

    @property
    def raw(self) -> NDArray[np.float64]:
        """The feet's last reading in counts, in double precision, shape (K,); NaN: none arrived."""
        return self.robot.raw

    @property
    def telemetry(self) -> Telemetry:
        """The layout of the packets (``telemetry.layout``) and their rate."""
        return self.robot.telemetry

    def set_severity(self, severity: Severity) -> None:
        """Set the severity of the next fresh sensors, a number or (lowest, highest).

        Raises:
            ValueError: If a device does not allow it.
        """
        self.robot.conditions = self.robot.equipment.with_severity(self.robot.conditions, severity)

    def set_faults(self, faults: Faults) -> None:
        """Set the faults, or their probabilities, from the next reset on.

        Raises:
            ValueError: If a fault or a probability is refused.
        """
        self.robot.conditions = self.robot.equipment.with_faults(self.robot.conditions, faults)

    def listen(self) -> None:
        """Send telemetry from the next reset on, even if the observation does not contain it."""
        self.robot.listening = True

    def true_parameters(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the map that corrects the feet's present errors: truth, for scoring calibrators.

        Returns:
            Scale in N per count and offset in N, each (K,).
        """
        scale, offset = self.robot.true_parameters()
        return scale, offset

    @property
    def _robots(self) -> Sequence[RobotSensors]:
        return [self.robot]

    def _with_drawn(self, info: dict[str, Any]) -> dict[str, Any]:
        """Add the drawn condition to the truth."""
        if not self._drawn:
            return info
        told = info["surefoot"]
        return {**info, "surefoot": {**told, "truth": {**told["truth"], **self._drawn}}}
