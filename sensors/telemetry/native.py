"""Telemetry of one robot by the library: the packets of the Python, several times faster."""

from math import ceil
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.native import SENSORS, Library, Record, require
from surefoot.sensors import Encoders, Imu, Link
from surefoot.sensors.devices.imu import ImuState
from surefoot.sensors.stages.affine import WalkState
from surefoot.sensors.telemetry.computer import Hardware, Telemetry
from surefoot.sensors.transport.link import Packet, Packets

LARGEST_NORMAL = 8.6
"""Standard deviations beyond which no normal number lies that is drawn of 53 bits."""


class NativeTelemetry(Telemetry):
    """Telemetry by the library, whose states go on in place.

    Args:
        library: The library.
        joints: As of :class:`~surefoot.sensors.telemetry.computer.Telemetry`, like all that follow.
        imu_config: The IMU.
        encoder_config: The encoders.
        link: The link to the host.
        dt: Duration of a control step in s.
        substeps: Rows of truth in a control step.

    Attributes:
        address: Where the library finds the parts that stay in place.
        arrived_address: Where rows lie of the packets that the last step has delivered.

    Raises:
        ValueError: If the robot does not fit into the library's arrays.
    """

    def __init__(
        self,
        library: Library,
        joints: int,
        imu_config: Imu,
        encoder_config: Encoders,
        link: Link,
        dt: float,
        substeps: int,
    ) -> None:
        super().__init__(joints, imu_config, encoder_config, link, dt, substeps)
        self._arguments = joints, imu_config, encoder_config, link, dt, substeps
        latest = link.delay + LARGEST_NORMAL * link.jitter
        under_way = max(self.before_start, int(min(ceil(latest / self.period), 2**30)))
        room = under_way + int(min(dt / self.period, 2**30)) + 1
        most = library.places["telemetry"]["arrival"][2] // 8
        if room > most:
            raise ValueError("More packets are under way than the library was compiled for.")
        own = self._of_imu(imu_config)
        self._skewed = bool(own["skewed"])
        before_start = min(self.before_start, 2**30)
        own |= {"joints": joints, "substeps": substeps, "before_start": before_start, "room": room}
        config = library.constants("telemetry_config", own | {"encoders": encoder_config}, self, link)
        assert config is not None
        self.config = config
        shapes = dict.fromkeys(("due", "number", "substeps", "first", "waiting"), ())
        state = library.record("telemetry", shapes | {
            "bias": (6,), "matrix": (2, 3, 3), "error": (joints,), "up": (3,), "gyroscope_bias": (3,),
            "position": (joints,), "velocity": (joints,), "inertial": (6,), "arrival": (room,),
            "ring": (room, 2 + self.layout.size),
        })  # fmt: skip
        functions, at = library.functions, self.config.ctypes.data
        if state is None or not functions.surefoot_telemetry_fits(at):
            raise ValueError("The robot is larger than those that the library was compiled for.")
        # Fields are views: what the robot's packets do not fill needs no memory.
        fields = dict(state.fields or {})
        ring, at = fields["ring"][:2]
        self.record = np.dtype({
            "names": list(fields), "formats": [field[0] for field in fields.values()],
            "offsets": [field[1] for field in fields.values()], "itemsize": at + ring.itemsize,
        })  # fmt: skip
        self._init, self._advance = functions.surefoot_telemetry_init, functions.surefoot_telemetry_advance
        self._position, self._inertial = np.zeros((substeps, joints)), np.zeros((substeps, 6))
        self._arrived = np.zeros((room, 2 + self.layout.size))
        self._heads = self._arrived.data  # which hands out plain floats
        arrays = self.config, self._position, self._inertial, self._arrived
        self._arrays = np.array([array.ctypes.data for array in arrays], dtype=np.uintp)
        self.address, self.arrived_address = self._arrays.ctypes.data, self._arrived.ctypes.data

    def __reduce__(self) -> tuple[Any, ...]:
        return _in_library, self._arguments

    def init(
        self, position: Floats, inertial: Floats, rng: Any, hardware: Hardware | None = None
    ) -> tuple[Packets, Any]:
        """Switch the robot on; as that of :class:`~surefoot.sensors.telemetry.computer.Telemetry`."""
        state = self.empty()
        if hardware is not None:
            self.put(state, hardware)
        self._position[0], self._inertial[0] = position, inertial
        return self.packets(self._init(self.address, state.address, rng.address, hardware is None)), state

    def advance(
        self, position: Floats, inertial: Floats, time: float, state: Any, rng: Any
    ) -> tuple[Packets, Any]:
        """Measure a control step; as that of :class:`~surefoot.sensors.telemetry.computer.Telemetry`."""
        self.expect(len(position))
        self._position[...], self._inertial[...] = position, inertial
        return self.packets(self._advance(self.address, state.address, rng.address, time)), state

    def expect(self, substeps: int) -> None:
        """Take control steps of so many rows of truth from here on."""
        if substeps != len(self._position):
            self.config["substeps"] = substeps
            self._position, self._inertial = (np.zeros((substeps, part.shape[1])) for part in self.inputs)
            self._arrays[1:3] = self._position.ctypes.data, self._inertial.ctypes.data

    def empty(self) -> Record:
        """Return room for a state, before an episode."""
        return Record(self.record)

    def packets(self, count: int) -> Packets:
        """Return the packets that the last step has delivered, so many."""
        heads, contents = self._heads, self._arrived[:count, 2:].copy()
        return tuple([Packet(int(heads[row, 0]), heads[row, 1], contents[row]) for row in range(count)])

    def put_packets(self, packets: Packets) -> int:
        """Put packets where those of the last step lie; return their number."""
        for row, packet in zip(self._arrived, packets, strict=False):
            row[:2], row[2:] = packet[:2], packet.values
        return len(packets)

    @property
    def inputs(self) -> tuple[Floats, Floats]:
        """Its next inputs: joints in rad, shape (S, J), and IMU in m/s^2 and rad/s, shape (S, 6)."""
        return self._position, self._inertial

    def hardware(self, state: Any) -> Hardware:
        """Return the present state of IMU and encoders."""
        record = state.now
        matrix = record["matrix"].copy() if self._skewed else ()
        return Hardware(ImuState(record["bias"].copy(), matrix), (WalkState(record["error"].copy()), (), ()))

    def with_hardware(self, state: Any, hardware: Hardware) -> Any:
        """Return a state that goes on with another IMU and other encoders."""
        after = self.empty()
        after.bytes[:] = state.bytes
        self.put(after, hardware)
        return after

    def put(self, state: Record, hardware: Hardware) -> None:
        """Go on with another IMU and other encoders, in place."""
        state.now["bias"], matrix = hardware.imu
        if self._skewed:
            state.now["matrix"] = matrix
        state.now["error"] = hardware.encoders[0].error

    def _of_imu(self, chip: Imu) -> dict[str, Any]:
        """Return the constants of an IMU by their names in ``sf_telemetry_config``."""
        axes, period = np.eye(3), self.period
        scales = np.array([chip.accelerometer_scale_std, chip.gyroscope_scale_std])[:, None, None]
        spread = scales * axes + chip.misalignment_std * (1.0 - axes)

        def both(name: str) -> Floats:
            return np.repeat(
                [getattr(chip, f"{sensor}_{name}") for sensor in ("accelerometer", "gyroscope")], 3
            )

        return {
            "skewed": spread.any(),
            "interval": period,
            "bias_std": both("bias_std"),
            "spread": spread.ravel(),
            "walk": both("walk") * period**0.5,
            "noise": both("noise") * period**-0.5,
            "step": both("resolution"),
            "most": both("range"),
        }


def _in_library(*arguments: Any) -> NativeTelemetry:
    """Return a copy, whose states are the library's."""
    return NativeTelemetry(require(SENSORS.installed()), *arguments)


def telemetry_of(
    joints: int, imu_config: Imu, encoder_config: Encoders, link: Link, dt: float, substeps: int
) -> Telemetry:
    """Build telemetry: by the library where there is one and the robot fits into its arrays."""
    library, arguments = SENSORS.installed(), (joints, imu_config, encoder_config, link, dt, substeps)
    if library is not None:
        try:
            return NativeTelemetry(library, *arguments)
        except ValueError:
            pass  # of what is refused Python says why
    return Telemetry(*arguments)
