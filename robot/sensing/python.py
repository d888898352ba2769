"""All sensors of one robot in Python, the specification of :mod:`surefoot.robot.sensing.native`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.robot.sensing.instruments import HardwareState, Instruments
from surefoot.robot.sensing.raw_view import RawView
from surefoot.sensors.randomness import Stream
from surefoot.sensors.telemetry.computer import Telemetry
from surefoot.sensors.transport.link import Packets

Seen = tuple[Floats, dict[str, Any]]
"""A reading in counts, shape (K,), and the observation, in fresh arrays; without a view the next one
overwrites the reading, and the observation is empty."""


class PythonSensing:
    """The specification. It takes a control step of any number of substeps, of ``dt`` s together.

    Attributes:
        instruments: The instruments under the feet.
        telemetry: The telemetry; ``None`` where nobody listens.
        kept: Where the newest packet's values and the counts that are held lie.
        view: The view, if an observation is put together.
        places: Where the library finds loads (:class:`~surefoot.robot.sensing.native.Places`);
            ``None`` if it does not.
        state: The hardware; telemetry's part as it was taken.
        telemetry_state: The telemetry's state; ``None`` before an episode.
        streams: Random streams by the names of devices.
        arrived: The packets of the last step.
    """

    state: HardwareState
    telemetry_state: Any
    streams: Mapping[str, Stream]

    def __init__(
        self,
        instruments: Instruments,
        telemetry: Telemetry | None,
        dt: float,
        kept: tuple[Floats, NDArray[np.float32]],
        view: RawView | None,
    ) -> None:
        self.instruments, self.telemetry, self.dt = instruments, telemetry, dt
        self.kept, self.view = kept, view
        self.telemetry_state, self.streams = None, {}
        self.arrived: Packets = ()
        self.places: Any = None

    def take(self, hardware: HardwareState) -> None:
        """Replace the hardware. IMU and encoders are kept if the new hardware has none."""
        self.state = hardware
        if self.telemetry and self.telemetry_state is not None and hardware.telemetry is not None:
            self.telemetry_state = self.telemetry.with_hardware(self.telemetry_state, hardware.telemetry)

    def hardware(self) -> HardwareState:
        """Return the present hardware, as a copy."""
        if self.telemetry is None or self.telemetry_state is None:
            return self.state
        return self.state._replace(telemetry=self.telemetry.hardware(self.telemetry_state))

    def draw_from(self, streams: Mapping[str, Stream]) -> None:
        """Use other random streams, by the names of devices."""
        self.streams = streams

    def keep_in(self, newest: Floats, held: NDArray[np.float32]) -> None:
        """Use other arrays for the newest packet's values and the held counts."""
        self.kept = newest, held

    def begin(self, truth: Any, at_rest: Floats, fresh: bool, observation: Any) -> Seen:
        """Start an episode: read every chip and the link under the first load.

        Before it the IMU's input was ``at_rest``, shape (6,); IMU and encoders are drawn if they are fresh.
        """
        self.state = self.instruments.with_load(truth, self.state)
        first, *more = self.instruments.first_steps(self.dt)
        raw = self._read(truth, first)
        for dt in more:
            raw = self._read(truth, dt)
        if self.telemetry is not None:
            self.arrived, self.telemetry_state = self.telemetry.init(
                truth.joint_position[-1].copy(),
                at_rest,
                self.streams["telemetry"],
                None if fresh else self.hardware().telemetry,
            )
        return self._show(raw, observation)

    def step(self, truth: Any, time: float, observation: Any) -> Seen:
        """Read a control step that ends at a time of the host in s."""
        raw = self._read(truth, self.dt)
        if self.telemetry is not None:
            self.arrived, self.telemetry_state = self.telemetry.advance(
                truth.joint_position, truth.inertial, time, self.telemetry_state, self.streams["telemetry"]
            )
        return self._show(raw, observation)

    def ages(self) -> Floats | None:
        """Return the age of each reading in s, shape (K,); ``None`` if it is not known."""
        cells = self.state.cells
        times = {"period": cells.period, "due": cells.due} if cells else {}
        return self.instruments.reading_ages(times)

    def packets(self) -> Packets:
        """Return telemetry that arrived during the last step, in order."""
        return self.arrived

    def packet_rows(self) -> None:
        """Return ``None``: the library alone has rows of packets."""

    def python(self) -> "PythonSensing":
        """Return this object, the reader in Python."""
        return self

    def _read(self, truth: Any, dt: float) -> Floats:
        """Read the instruments under the feet."""
        raw, self.state = self.instruments.read(truth, self.state, self.streams, dt)
        return raw

    def _show(self, raw: Floats, observation: Any) -> Seen:
        """Store the readings that have arrived, and return them with the observation."""
        newest, held = self.kept
        arrived = ~np.isnan(raw)
        held[arrived] = raw[arrived]
        if self.arrived:
            newest[:] = self.arrived[-1].values
        return raw, {} if self.view is None else self.view.show(observation, held, newest)
