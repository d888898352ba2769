"""The beliefs of one robot by the library: the same numbers as those of Python, to rounding."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import MomentumReference, Reference
from surefoot.calibration.native import Library, ReferenceRecord, installed
from surefoot.native import c_header, required
from surefoot.robot.beliefs.contacts import planned_window
from surefoot.robot.beliefs.lag import HISTORY
from surefoot.robot.beliefs.momentum import MomentumBeliefs, unknown
from surefoot.robot.beliefs.references import Beliefs, nothing
from surefoot.sensors.telemetry.computer import TelemetryLayout
from surefoot.sensors.transport.link import Packet, Packets

FEET = 2
"""Feet of the robots that the library believes something of; others' beliefs are in Python."""

AT_ONCE = 8
"""Packets that are handed over together."""

_OWN = {"clock": "_clock", "seen": "_seen", "run": "_run", "parts": "_parts", "sum": "_sum"}
_ODOMETRY = {
    "forward": "_forward", "up": "up", "spin": "_spin", "spin_bias": "_spin_bias",
    "force_bias": "force_bias", "count": "_count",
}  # fmt: skip
_UPRIGHT = {"lean": "_mean", "highest": "_highest", "upright": "_upright"}
"""Attributes of the Python by the names of ``sf_beliefs``."""

_STRAPDOWN = {
    "R": "R", "velocity": "velocity", "place": "place", "velocity_spin_bias": "spin_bias",
    "vertical_bias": "vertical_bias", "velocities": "count",
}  # fmt: skip
"""The same of a :class:`Strapdown`, by the names of ``sf_momentum_beliefs``."""


class NativeBeliefs:
    """The library for one robot; it goes on where a Python object is, which stays as it is.

    Args:
        library: The library.
        believed: The Python object.

    Attributes:
        believed: What the last :meth:`sample` found; the next one overwrites it.
        known: Whether it is anything.
        standing: Whether a foot surely stood.

    Raises:
        ValueError: If the library is not made for such a robot; docs/native.md has its limits.
    """

    def __init__(self, library: Library, believed: Beliefs | MomentumBeliefs) -> None:
        self.library, self._functions, self._spec = library, library.functions, believed
        self.model = believed.model
        momentum = believed if isinstance(believed, MomentumBeliefs) else None
        beliefs = believed.beliefs if isinstance(believed, MomentumBeliefs) else believed
        self._layout = beliefs.layout
        needed, window = planned_window(beliefs._lag)
        timing = {
            "averaged": beliefs._averaged, "needed": needed, "window": window, "dt": beliefs.dt,
            "period": beliefs.period, "delay": beliefs._delay, "joined": beliefs._join,
            "gravity": self.model.gravity,
        }  # fmt: skip
        joints = beliefs.layout.joint_position.stop
        shapes = {
            "ring": (HISTORY, beliefs.rows.width, 3),
            "angle": (joints,), "accelerometer": (3,), "gyroscope": (3,),
            "forward": (3,), "up": (3,), "spin": (3,), "spin_bias": (3,), "force_bias": (3,), "lean": (3,),
            "highest": (), "clock": (), "number": (), "seen": (), "run": (), "count": (),
            "parts": (), "sum": (6,),
            "planned": (window, 4), "found": (4,), "upright": (),
        }  # fmt: skip
        legs, record = None, "beliefs"
        if momentum is not None:
            legs, record = (
                library.filled("strapdown_config", momentum.constants._asdict()),
                "momentum_beliefs",
            )
            shapes |= {
                "moved": (HISTORY, momentum.rows.width, 3), "R": (3, 3), "velocity": (3,), "place": (3,),
                "velocity_spin_bias": (3,), "vertical_bias": (), "velocities": (),
            }  # fmt: skip
        found, state = library.filled("timing", timing), library.record(record, shapes)
        if found is None or state is None or (legs is None and momentum is not None):
            raise ValueError("The robot has more joints, or a longer lag, than the library has room for.")
        self._timing, self._state, self._legs = found, np.zeros((), state), legs
        self._rows = np.zeros((AT_ONCE, 2 + beliefs.layout.size))
        self._slots = [(row[:2], row[2:]) for row in self._rows]
        self._planned, self._soles = np.zeros(4, np.bool_), np.zeros((2, 4), library.real)
        self._stance, self._swing = self._planned[:2], self._planned[2:]
        self.believed = ReferenceRecord(library, Reference if momentum is None else MomentumReference)
        self._other, self._moved = ReferenceRecord(library), ReferenceRecord(library, MomentumReference)
        self._force_bias = self._state["force_bias"]
        self._adopt()
        self._pack(beliefs)
        if momentum is not None:
            self._state["moved"] = momentum.ring
            for name, attribute in _STRAPDOWN.items():
                self._state[name] = getattr(momentum.strapdown, attribute)
        self.believed.fill(believed.believed)
        self.known, self.standing = believed.known, believed.standing
        records = self._timing, self._state, self._rows, self._planned, self._soles
        self._addresses = tuple(record.ctypes.data for record in records)
        self._legs_at = None if legs is None else legs.ctypes.data

    def begun(self) -> "NativeBeliefs":
        """Go on at an episode's start; as :meth:`Beliefs.begun`, but in place."""
        self._functions.surefoot_beliefs_init(self._legs_at, self._addresses[1])
        self.believed.fill(nothing(FEET) if self._legs is None else unknown(FEET))
        self.known = self.standing = False
        return self

    def _keep_up(self) -> None:
        """Take over the model's masses if they have changed."""
        if self.model.revision != self._revision:
            self._adopt()

    def _adopt(self) -> None:
        """Take over the model."""
        tree, library = self.model.tree(), self.library
        sizes = {} if tree is None else {"bodies": len(tree["mass"]), "hinges": len(tree["axis"])}
        model = None if tree is None else library.filled("model", {**sizes, **tree})
        if (
            model is None
            or model["hinges"] != self._state["angle"].size
            or not library.functions.surefoot_beliefs_fit(model.ctypes.data, self._timing.ctypes.data)
            or not (self._legs is None or library.functions.surefoot_legs_fit(self._legs.ctypes.data))
        ):
            raise ValueError(
                "The robot is no tree of bodies that the library has room for, or packets have other joints."
            )
        self._revision, self._model, self._tree = self.model.revision, model, model.ctypes.data

    @property
    def force_bias(self) -> NDArray[np.float64]:
        """As of :class:`Beliefs`."""
        bias: NDArray[np.float64] = self._force_bias.copy()
        return bias

    def update(self, packets: Packets) -> None:
        """Take in packets of telemetry, in order."""
        self._keep_up()
        timing, state, rows, _, _ = self._addresses
        for start in range(0, len(packets), AT_ONCE):
            some = packets[start : start + AT_ONCE]
            for (head, content), (number, arrival, values) in zip(self._slots, some, strict=False):
                head[0], head[1] = number, arrival
                content[...] = values
            self._functions.surefoot_beliefs_packets(
                self._tree, timing, self._legs_at, state, rows, len(some)
            )

    def update_rows(self, address: int, count: int) -> None:
        """Take in packets of telemetry where the library has written them, so many."""
        self._keep_up()
        timing, state, _, _, _ = self._addresses
        self._functions.surefoot_beliefs_packets(self._tree, timing, self._legs_at, state, address, count)

    def sample(self, time: float, command: Any, hold: bool = False) -> bool:
        """As :meth:`Beliefs.sample`; :attr:`believed` is filled in place."""
        timing, state, _, planned, _ = self._addresses
        plan = planned if self.plan(command) else None
        found = self._functions.surefoot_beliefs_sample(
            timing, self._legs_at, state, time, plan, hold, self.believed.address
        )
        self.tell(found)
        return bool(found & 1)

    def addresses(self) -> dict[str, int]:
        """Return where the library finds its records now, by their names in ``sf_sample_records``."""
        self._keep_up()
        timing, state, _, planned, _ = self._addresses
        return {
            "model": self._tree,
            "timing": timing,
            "legs": self._legs_at or 0,
            "beliefs": state,
            "belief": self.believed.address,
            "planned": planned,
        }

    def plan(self, command: Any) -> bool:
        """Put a plan where the library finds it; return whether there is one."""
        if command is None:
            return False
        self._stance[...], self._swing[...] = command.stance, command.swing
        return True

    def tell(self, found: int) -> None:
        """Learn what the library found of a sample."""
        self.known, self.standing = found & 2 > 0, found & 4 > 0

    def info(self) -> dict[str, Any]:
        """As :meth:`Beliefs.info`."""
        return {"known": self.known, **self.believed.mapping(self.known)}

    def reference(self, time: float, stance: NDArray[np.bool_], swing: NDArray[np.bool_]) -> Reference:
        """As :meth:`Beliefs.reference`."""
        timing, state, _, _, _ = self._addresses
        self._functions.surefoot_beliefs_reference(timing, state, time, self._other.address)
        found: Reference = self._other.reference()._replace(stance=stance, swing=swing)
        return found

    def momentum(self, time: float, stance: NDArray[np.bool_], swing: NDArray[np.bool_]) -> MomentumReference:
        """As :meth:`MomentumBeliefs.momentum`."""
        timing, state, _, _, _ = self._addresses
        self._functions.surefoot_beliefs_momentum(timing, state, time, self._moved.address)
        found: MomentumReference = self._moved.reference()._replace(stance=stance, swing=swing)
        return found

    def soles(self, time: float) -> NDArray[np.float64]:
        """As :meth:`Beliefs.soles`."""
        timing, state, _, _, soles = self._addresses
        self._functions.surefoot_beliefs_soles(timing, state, time, soles)
        return self._soles.astype(np.float64)

    def unpack(self) -> Beliefs | MomentumBeliefs:
        """Return the Python object that goes on from here; it shares nothing but the model."""
        begun, state, believed = self._spec.begun(), self._state, self.believed.reference()
        if not isinstance(begun, MomentumBeliefs):
            self._unpack(begun)
            begun.believed = believed
            return begun
        self._unpack(begun.beliefs)
        # What it believes of accelerations is made anew at each sample.
        begun.believed, begun.ring[...] = believed, state["moved"]
        begun.run, begun.number = int(state["run"]), int(state["number"])
        for name, attribute in _STRAPDOWN.items():
            part = state[name].copy()
            setattr(begun.strapdown, attribute, part if part.ndim else part.item())
        return begun

    def _unpack(self, found: Beliefs) -> None:
        state = self._state
        for owner, names in _owners(found):
            for name, attribute in names.items():
                part = state[name].tolist()
                setattr(owner, attribute, tuple(part) if isinstance(part, list) else part)
        found._odometry.force_bias = self.force_bias
        found._upright._upright = bool(state["upright"])
        found._ring[...] = state["ring"]
        found._plan._runs.extend(state["planned"].tolist())
        found._kinematics._runs = state["found"].tolist()
        if found._seen:
            values = np.zeros(self._layout.size)
            for name, part in _measured(self._layout):
                values[part] = state[name]
            found._last = Packet(int(state["number"]), 0.0, values)

    def _pack(self, beliefs: Beliefs) -> None:
        state, last = self._state, beliefs._last
        for owner, names in _owners(beliefs):
            for name, attribute in names.items():
                state[name] = getattr(owner, attribute)
        state["ring"] = beliefs._ring
        runs = list(beliefs._plan._runs)
        # The oldest one counts until there are as many as are kept.
        state["planned"] = runs[:1] * (len(state["planned"]) - len(runs)) + runs
        state["found"] = beliefs._kinematics._runs
        if last is not None:
            state["number"] = last.number
            for name, part in _measured(beliefs.layout):
                state[name] = last.values[part]

    def __reduce__(self) -> Any:
        return native_beliefs, (self.unpack(),)


def native_beliefs(beliefs: Beliefs | MomentumBeliefs) -> Beliefs | MomentumBeliefs | NativeBeliefs:
    """Return beliefs that go on by the library, or as they are where there is none for such a robot."""
    library = installed()
    if library is None or library.real != np.float64 or beliefs.model.feet != FEET:
        return beliefs
    try:
        return NativeBeliefs(library, beliefs)
    except ValueError:
        return beliefs


def c_source(beliefs: Beliefs | MomentumBeliefs) -> str:
    """Return a header with one robot's ``sf_model model`` and ``sf_timing timing``, for its controller.

    Of beliefs that hold momentum it declares ``sf_strapdown_config legs`` as well.

    Raises:
        RuntimeError: If there is no library here.
        ValueError: If the library is not made for such a robot.
    """
    native = NativeBeliefs(required(installed()), beliefs)
    model, timing = native._model, native._timing
    sizes = {
        "BODIES": int(model["bodies"]),
        "HINGES": max(1, int(model["hinges"])),
        "PLANNED": int(timing["window"]),
    }
    records = {"sf_model model": model, "sf_timing timing": timing}
    if native._legs is None:
        return c_header("surefoot_beliefs.h", sizes, records)
    sizes["CORNERS"] = int(native._legs["points"])
    return c_header("surefoot_strapdown.h", sizes, records | {"sf_strapdown_config legs": native._legs})


def _owners(beliefs: Beliefs) -> tuple[tuple[Any, dict[str, str]], ...]:
    """Return what holds the parts of a state, and the attributes that do."""
    return (beliefs, _OWN), (beliefs._odometry, _ODOMETRY), (beliefs._upright, _UPRIGHT)


def _measured(layout: TelemetryLayout) -> tuple[tuple[str, slice], ...]:
    """Return where a packet holds what is kept of it."""
    return (
        ("angle", layout.joint_position),
        ("accelerometer", layout.accelerometer),
        ("gyroscope", layout.gyroscope),
    )
