"""How the calibrated channels of a foot add up to the wrench on its sole.

Every foot sensor is an affine map from raw channels to forces. Four load cells and a six-axis sensor at the
ankle differ only in how these forces add up to a wrench. A 6 x k matrix describes this. A calibrator needs no
other information about the hardware of a foot.

A wrench is (fx, fy, fz, tx, ty, tz), exerted by the ground on the robot, at and in the sole frame:
x forward, y left, z up, the origin below the ankle on the face that touches the ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.arrays import Floats
from surefoot.calibration.arrays import skew
from surefoot.calibration.checks import check_shape

LOAD_CELL_NAMES = ("front-left", "front-right", "rear-left", "rear-right")
FORCE_TORQUE_NAMES = ("fx", "fy", "fz", "tx", "ty", "tz")


@dataclass(frozen=True, eq=False)
class FootSensor:
    """One instrument of a foot: its channels, and the mass below it.

    The mass below a sensor (the sole plate below load cells, the whole foot below an ankle sensor) moves with
    the foot, so that the sensor measures its inertial force. Its weight at rest on level ground is part of
    the offset.
    """

    channels: slice  # its channels within the foot
    wrench_map: Floats  # sole wrench per unit of each of its channels, shape (6, channels)
    six_axis: bool  # whether its channels are the axes of one six-axis sensor, which may have cross-talk
    share: Floats  # weight of its wrench in the foot's wrench, per axis, shape (6,)
    mass_below: float = 0.0  # mass below it in kg
    com_below_sole: Floats = field(default_factory=lambda: np.zeros(3))
    """Centre of that mass in the sole frame in m, shape (3,)."""


@dataclass(frozen=True, eq=False)
class FootLayout:
    """One foot: its channels and the wrench that they make up.

    Attributes:
        name: The foot's name in messages and logs, such as ``"left"``.
        wrench_map: Sole wrench per unit of each calibrated channel, shape (6, k).
        channel_names: k names, such as ``"front-left"``.
        position_cell_sole: Positions of load cells in the sole frame in m, shape (k, 3), or ``None`` if the
            channels are not forces at points.
        sensors: The instruments to which the channels belong, by default one.
        flat: Whether the sole is flat, as opposed to round.
    """

    name: str
    wrench_map: Floats
    channel_names: tuple[str, ...]
    position_cell_sole: Floats | None = None
    sensors: tuple[FootSensor, ...] = ()
    flat: bool = True

    def __post_init__(self) -> None:
        """Raise ValueError if the wrench map is invalid."""
        if self.wrench_map.ndim != 2 or self.wrench_map.shape[0] != 6:
            raise ValueError(
                f"The wrench map of foot '{self.name}' must have shape (6, channels), "
                f"got {self.wrench_map.shape}."
            )
        if not np.isfinite(self.wrench_map).all():
            raise ValueError(f"The wrench map of foot '{self.name}' holds values that are not finite.")
        if len(self.channel_names) != self.wrench_map.shape[1]:
            raise ValueError(
                f"Foot '{self.name}' has {self.wrench_map.shape[1]} channels but "
                f"{len(self.channel_names)} channel names: {self.channel_names}."
            )
        if not self.sensors:
            whole = FootSensor(slice(0, self.channels), self.wrench_map, False, np.ones(6))
            object.__setattr__(self, "sensors", (whole,))

    @property
    def channels(self) -> int:
        """The number of channels, k."""
        return int(self.wrench_map.shape[1])

    @classmethod
    def load_cells(
        cls,
        name: str,
        position_cell_sole: ArrayLike,
        channel_names: Sequence[str] | None = None,
        *,
        mass_below: float = 0.0,
        com_below_sole: ArrayLike = (0.0, 0.0, 0.0),
    ) -> "FootLayout":
        """Describe a foot on single-axis load cells.

        Each cell measures a vertical force at its position, so that the cells of a foot add up to
        (fz, tx, ty) = (sum F_i, sum y_i F_i, -sum x_i F_i). The other three rows are 0. A foot with a single
        cell does not measure its centre of pressure, like a foot of :meth:`point`.

        Args:
            name: The foot's name in messages and logs.
            position_cell_sole: Positions of the cells in the sole frame in m, shape (k, 2) or (k, 3), for one
                cell or at least three. Four cells are ordered (front-left, front-right, rear-left,
                rear-right).
            channel_names: Names of the cells. Four cells have default names.
            mass_below: Mass of the sole plate under the cells in kg.
            com_below_sole: Its centre of mass in the sole frame in m, shape (3,).

        Raises:
            ValueError: If there are no or two cells, they are collinear, a position is not finite, or the
                mass is negative.

        >>> foot = FootLayout.load_cells("left", [(0.1, 0.05), (0.1, -0.05), (-0.06, 0.05), (-0.06, -0.05)])
        >>> foot.wrench_map[2]
        array([1., 1., 1., 1.])
        """
        position = _check_cells(name, position_cell_sole)
        single = len(position) == 1
        if channel_names is None:
            usual = {1: ("fz",), 4: LOAD_CELL_NAMES}
            channel_names = usual.get(len(position)) or [f"cell-{i}" for i in range(len(position))]
        x, y = position[:, 0], position[:, 1]
        zero = np.zeros_like(x)
        wrench_map = np.stack([zero, zero, np.ones_like(x), y, -x, zero])
        below = _check_below(name, mass_below, com_below_sole)
        sensor = FootSensor(slice(0, len(position)), wrench_map, False, np.ones(6), *below)
        return cls(
            name, wrench_map, tuple(channel_names), None if single else position, (sensor,), not single
        )

    @classmethod
    def force_torque(
        cls,
        name: str,
        *,
        position_sensor_sole: ArrayLike,
        R_sole_sensor: ArrayLike | None = None,
        mass_below: float = 0.0,
        com_below_sole: ArrayLike = (0.0, 0.0, 0.0),
    ) -> "FootLayout":
        """Describe a foot below a six-axis force-torque sensor.

        The channels are (fx, fy, fz, tx, ty, tz) of the ground on the robot, at and in the sensor's frame.

        Args:
            name: The foot's name in messages and logs.
            position_sensor_sole: Origin of the sensor's frame in the sole frame in m, shape (3,).
            R_sole_sensor: Rotation from the sensor's frame to the sole frame, shape (3, 3), by default the
                identity.
            mass_below: Mass of the foot below the sensor in kg.
            com_below_sole: Its centre of mass in the sole frame in m, shape (3,).

        Raises:
            ValueError: If a shape is wrong, a value is not finite, ``R_sole_sensor`` is not a rotation, or
                the mass is negative.

        >>> foot = FootLayout.force_torque("left", position_sensor_sole=(0.0, 0.0, 0.05))
        >>> foot.wrench_map @ (10.0, 0.0, 50.0, 0.0, 0.0, 0.0)
        array([10. ,  0. , 50. ,  0. ,  0.5,  0. ])
        """
        position = _check_vector(name, "position_sensor_sole", position_sensor_sole)
        R = _check_rotation(name, R_sole_sensor)
        wrench_map = np.block([[R, np.zeros((3, 3))], [skew(position) @ R, R]])
        below = _check_below(name, mass_below, com_below_sole)
        sensor = FootSensor(slice(0, 6), wrench_map, True, np.ones(6), *below)
        return cls(name, wrench_map, FORCE_TORQUE_NAMES, None, (sensor,))

    @classmethod
    def point(cls, name: str, axes: str = "z", *, R_sole_sensor: ArrayLike | None = None) -> "FootLayout":
        """Describe a foot that touches the ground at one point, the origin of its frame, as on a quadruped.

        Its channels are forces at this point, which is also its centre of pressure.

        Args:
            name: The foot's name in messages and logs.
            axes: The measured force components: ``"z"``, or several of ``"xyz"`` in this order.
            R_sole_sensor: Rotation from the sensor's axes to those of the foot, shape (3, 3), by default the
                identity.

        Raises:
            ValueError: If ``axes`` is invalid, or ``R_sole_sensor`` is not a rotation.

        >>> FootLayout.point("front left", "xyz").channel_names
        ('fx', 'fy', 'fz')
        """
        if not axes or list(axes) != [axis for axis in "xyz" if axis in axes]:
            raise ValueError(f"'axes' of foot '{name}' must be some of 'xyz' in this order, got {axes!r}.")
        R = _check_rotation(name, R_sole_sensor)
        wrench_map = np.zeros((6, len(axes)))
        wrench_map[:3] = R[:, ["xyz".index(axis) for axis in axes]]
        return cls(name, wrench_map, tuple(f"f{axis}" for axis in axes), flat=False)

    @classmethod
    def combined(cls, name: str, *feet: "FootLayout") -> "FootLayout":
        """Describe a foot with several instruments, such as load cells below an ankle sensor.

        Each instrument measures the same wrench. The foot's wrench is the mean over the instruments that
        measure an axis. Calibrators can also compare the instruments with each other.

        Args:
            name: The foot's name in messages and logs.
            feet: Layouts of the same foot with one instrument each. Their channels are concatenated.

        Raises:
            ValueError: If there are fewer than two layouts, or two channels have the same name.
        """
        if len(feet) < 2:
            raise ValueError(f"Foot '{name}' combines instruments and needs at least two, got {len(feet)}.")
        names = tuple(channel for foot in feet for channel in foot.channel_names)
        if len(set(names)) != len(names):
            raise ValueError(f"Foot '{name}' combines channels of the same name: {names}; rename some.")
        measures = np.array([(foot.wrench_map != 0.0).any(axis=1) for foot in feet], dtype=np.float64)
        shares = measures / np.maximum(measures.sum(axis=0), 1.0)
        ends = np.cumsum([0, *(foot.channels for foot in feet)]).tolist()
        sensors = tuple(
            replace(sensor, channels=slice(start + sensor.channels.start, start + sensor.channels.stop),
                    share=sensor.share * share)
            for start, foot, share in zip(ends, feet, shares, strict=False)
            for sensor in foot.sensors
        )  # fmt: skip
        wrench_map = np.hstack(
            [share[:, None] * foot.wrench_map for foot, share in zip(feet, shares, strict=True)]
        )
        return cls(name, wrench_map, names, None, sensors, all(foot.flat for foot in feet))


@dataclass(frozen=True, eq=False)
class FeetLayout:
    """Both feet, ordered (left, right), with their channels concatenated in one flat array.

    There may be any number of feet: one for a force plate or a balance board, four for a quadruped. Axes that
    are documented with length 2 then have this length. With four feet, for example, the positions of the
    soles have shape (4, 3).

    Attributes:
        feet: The layouts of the feet.
    """

    feet: tuple[FootLayout, ...]

    def __post_init__(self) -> None:
        """Raise ValueError if there is no foot, or two have the same name."""
        if not self.feet:
            raise ValueError("A layout needs at least one foot, such as a force plate; got none.")
        for i, foot in enumerate(self.feet):
            if not isinstance(foot, FootLayout):
                raise TypeError(
                    f"'feet[{i}]' must be a FootLayout, got {type(foot).__name__}; leave a missing foot out."
                )
        names = [foot.name for foot in self.feet]
        if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
            raise ValueError(f"Several feet are named {twice}; give each its own name.")

    @property
    def channels(self) -> int:
        """The number of channels of all feet, K."""
        return sum(foot.channels for foot in self.feet)

    @property
    def slices(self) -> tuple[slice, ...]:
        """The slice of each foot's channels in the flat array."""
        ends = np.cumsum([0, *(foot.channels for foot in self.feet)]).tolist()
        return tuple(slice(start, end) for start, end in pairwise(ends))

    @property
    def channel_names(self) -> tuple[str, ...]:
        """K names such as ``"left/front-left"``."""
        return tuple(f"{foot.name}/{channel}" for foot in self.feet for channel in foot.channel_names)

    @property
    def wrench_map(self) -> Floats:
        """Sole wrenches per unit of each channel, shape (2, 6, K): zero for the other foot's channels."""
        combined = np.zeros((len(self.feet), 6, self.channels))
        for i, (foot, channels) in enumerate(zip(self.feet, self.slices, strict=True)):
            combined[i, :, channels] = foot.wrench_map
        return combined

    @property
    def foot_of_channel(self) -> NDArray[np.intp]:
        """The number of the foot to which each channel belongs, shape (K,)."""
        return np.repeat(np.arange(len(self.feet)), [foot.channels for foot in self.feet])

    def check_reading(self, raw: Any, what: str = "raw") -> None:
        """Raise ValueError unless readings are one sample of one robot, shape (K,)."""
        self.check_raw(raw, what)
        check_shape(np.asarray(raw), (self.channels,), what)

    def check_raw(self, raw: Any, what: str = "raw") -> None:
        """Raise ValueError unless the last axis of readings has the length K."""
        shape = np.shape(raw) if not hasattr(raw, "shape") else raw.shape
        if not shape or shape[-1] != self.channels:
            raise ValueError(
                f"'{what}' must hold one reading for each of the {self.channels} channels "
                f"{self.channel_names} on its last axis, got shape {shape}."
            )


def _check_vector(foot: str, what: str, value: ArrayLike) -> Floats:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"'{what}' of foot '{foot}' must hold three finite numbers in m, got {value!r}.")
    return vector


def _check_rotation(foot: str, value: ArrayLike | None) -> Floats:
    R = np.eye(3) if value is None else np.asarray(value, dtype=np.float64)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0.0:
        raise ValueError(f"'R_sole_sensor' of foot '{foot}' must be a rotation of shape (3, 3), got {R}.")
    return R


def _check_cells(name: str, position_cell_sole: ArrayLike) -> Floats:
    """Return the positions of a foot's cells, shape (k, 3), or raise ValueError if they are invalid."""
    position = np.asarray(position_cell_sole, dtype=np.float64)
    if position.ndim != 2 or position.shape[0] in (0, 2) or position.shape[1] not in (2, 3):
        raise ValueError(
            f"Foot '{name}' needs one cell position or at least three, of shape (k, 2) or (k, 3), "
            f"got shape {position.shape}: two cells do not determine a centre of pressure."
        )
    if not np.isfinite(position).all():
        raise ValueError(f"The cell positions of foot '{name}' hold values that are not finite.")
    if position.shape[1] == 2:
        position = np.column_stack([position, np.zeros(len(position))])
    spread = np.linalg.svd(position[:, :2] - position[:, :2].mean(axis=0), compute_uv=False)
    if len(position) > 1 and spread[1] < 1e-6:
        raise ValueError(
            f"The cells of foot '{name}' are on one line, so that the centre of pressure across it is not "
            "determined; check the positions (metres, sole frame)."
        )
    return position


def _check_below(foot: str, mass: float, com: ArrayLike) -> tuple[float, Floats]:
    if not (np.isfinite(mass) and mass >= 0.0):
        raise ValueError(f"'mass_below' of foot '{foot}' must be finite and not negative, got {mass} kg.")
    return float(mass), _check_vector(foot, "com_below_sole", com)


def nao_shoe_layout() -> FeetLayout:
    """Return the layout of a NAO's four-cell shoes, with the cells of Han's force-sensing shoes.

    The cells are at (+-85, +-49) mm about a point (23.97, +-6.76) mm from the ankle's projection on the sole.

    >>> nao_shoe_layout().channels
    8
    """
    corner = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)]) * (0.085, 0.049)
    left = FootLayout.load_cells("left", corner + np.array([0.02397, 0.00676]))
    right = FootLayout.load_cells("right", corner + np.array([0.02397, -0.00676]))
    return FeetLayout((left, right))
