"""The beliefs of one robot by the library: the same numbers as those of Python, to rounding."""

from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import MomentumReference, Reference
from surefoot.calibration.native import Library, ReferenceRecord, installed
from surefoot.native import c_header, require
from surefoot.robot.beliefs.believed import nothing
from surefoot.robot.beliefs.contacts import plan_window
from surefoot.robot.beliefs.lag import HISTORY
from surefoot.robot.beliefs.momentum import MomentumBeliefs, unknown
from surefoot.robot.beliefs.odometry import Odometry
from surefoot.robot.beliefs.references import Beliefs
from surefoot.robot.beliefs.strapdown import Strapdown, StrapdownConstants
from surefoot.sensors.telemetry.computer import TelemetryLayout
from surefoot.sensors.transport.link import Packet, Packets

AT_ONCE = 8
"""Packets that are handed over together."""

_OWN = "clock", "seen", "run", "parts", "sum"
_ODOMETRY = "forward", "up", "spin", "spin_bias", "force_bias", "count"
_STRAPDOWN = "R", "velocity", "place", "spin_bias", "vertical_bias", "count"
_UPRIGHT = "lean", "highest", "upright"
"""Attributes of parts of beliefs, by whose names the library has them."""


class NativeBeliefs:
    """The library for one robot; it goes on where a Python object is, which stays as it is.

    Args:
        library: The library.
        believed: The Python object.

    Attributes:
        believed: The result of the last :meth:`sample`; the next one overwrites it.

    Raises:
        ValueError: If the library is not made for such a robot; docs/native.md has its limits.
    """

    def __init__(self, library: Library, believed: Beliefs | MomentumBeliefs) -> None:
        self.library, self._functions, self._spec = library, library.functions, _without_rows(believed)
        self.model = believed.model
        momentum = believed if isinstance(believed, MomentumBeliefs) else None
        beliefs, F = believed.beliefs if isinstance(believed, MomentumBeliefs) else believed, self.model.feet
        self._layout, self.feet, self._momentum = beliefs.layout, F, momentum is not None
        needed, window = plan_window(beliefs.lag)
        timing = {
            "averaged": beliefs.averaged, "needed": needed, "window": window, "dt": beliefs.dt,
            "period": beliefs.period, "delay": beliefs.delay, "joined": beliefs.joined,
            "gravity": self.model.gravity, "feet": F, "rolls": beliefs.rolls,
            **StrapdownConstants.of(beliefs.touching)._asdict(),
        }  # fmt: skip
        joints = beliefs.layout.joint_position.stop
        vectors = "accelerometer", "gyroscope", "forward", "up", "spin", "spin_bias", "force_bias", "lean"
        numbers = "highest", "clock", "number", "seen", "run", "count", "parts", "upright"
        shapes = dict.fromkeys(vectors, (3,)) | dict.fromkeys(numbers, ()) | {
            "ring": (HISTORY, beliefs.rows.width, 3), "angle": (joints,), "sum": (6,),
            "planned": (window, 2 * F), "found": (2 * F,), **_strapdown_shapes("rolling"),
        }  # fmt: skip
        record = "beliefs"
        if momentum is not None:
            record = "momentum_beliefs"
            shapes |= {"moved": (HISTORY, momentum.rows.width, 3), **_strapdown_shapes("strapdown")}
        found, state = library.record_of("timing", timing), library.record(record, shapes)
        kinds = (MomentumReference if self._momentum else Reference), Reference, MomentumReference
        self.believed, self._other, self._moved = (ReferenceRecord(library, kind, F) for kind in kinds)
        if found is None or state is None:
            raise ValueError("The robot has more joints, or a longer lag, than the library has room for.")
        self._timing, self._state = found, np.zeros((), state)
        self._rows = np.zeros((AT_ONCE, 2 + beliefs.layout.size))
        self._slots = [(row[:2], row[2:]) for row in self._rows]
        self._planned, self._soles = np.zeros(2 * F, np.bool_), np.zeros((F, 4), library.real)
        self._stance, self._swing = self._planned[:F], self._planned[F:]
        self._force_bias = self._state["force_bias"]
        self._model: NDArray[Any] | None = None
        self._adopt()
        self._pack(beliefs)
        if momentum is not None:
            self._state["moved"] = momentum.ring
            self._put(momentum.strapdown, _STRAPDOWN, "strapdown_")
        self.believed.fill(believed.believed)
        records = self._timing, self._state, self._rows, self._planned, self._soles
        self._addresses = tuple(record.ctypes.data for record in records)

    def begin_episode(self) -> "NativeBeliefs":
        """Go on at an episode's start; as :meth:`Beliefs.begin_episode`, but in place."""
        self._functions.surefoot_beliefs_init(self._momentum, self._addresses[1])
        self.believed.fill(unknown(self.feet) if self._momentum else nothing(self.feet))
        return self

    def keep_up(self) -> None:
        """Take over the model's masses if they have changed."""
        if self.model.revision != self._revision:
            self._adopt()

    def _adopt(self) -> None:
        """Take over the model."""
        tree, library = self.model.tree(), self.library
        sizes = {} if tree is None else {"bodies": len(tree["mass"]), "hinges": len(tree["axis"])}
        model = None if tree is None else library.record_of("model", {**sizes, **tree})
        if (
            model is None
            or model["hinges"] != self._state["angle"].size
            or not library.functions.surefoot_beliefs_fit(model.ctypes.data, self._timing.ctypes.data)
        ):
            raise ValueError(
                "The robot is no tree of bodies that the library has room for, or packets have other joints."
            )
        self._revision = self.model.revision
        if self._model is None:
            self._model, self._tree = model, model.ctypes.data
        self._model[...] = model  # in place: others know its address

    @property
    def constants(self) -> dict[str, NDArray[Any]]:
        """The records of the robot by the names that they have in headers: model and timing."""
        assert self._model is not None
        return {"model": self._model, "timing": self._timing}

    @property
    def force_bias(self) -> NDArray[np.float64]:
        """As of :class:`Beliefs`."""
        bias: NDArray[np.float64] = self._force_bias.copy()
        return bias

    def update(self, packets: Packets) -> None:
        """Take in packets of telemetry, in order."""
        self.keep_up()
        timing, state, rows, _, _ = self._addresses
        for start in range(0, len(packets), AT_ONCE):
            some = packets[start : start + AT_ONCE]
            for (head, content), (number, arrival, values) in zip(self._slots, some, strict=False):
                head[0], head[1] = number, arrival
                content[...] = values
            self._functions.surefoot_beliefs_packets(
                self._tree, timing, self._momentum, state, rows, len(some)
            )

    def sample(self, time: float, command: Any, hold: bool = False) -> bool:
        """As :meth:`Beliefs.sample`; :attr:`believed` is filled in place."""
        timing, state, _, planned, _ = self._addresses
        plan = planned if self.plan(command) else None
        found = self._functions.surefoot_beliefs_sample(
            timing, self._momentum, state, time, plan, hold, self.believed.address
        )
        return bool(found & 1)

    def addresses(self) -> dict[str, int]:
        """Return where the library finds its records now, by their names in ``sf_sample_records``."""
        self.keep_up()
        timing, state, _, planned, _ = self._addresses
        return {
            "model": self._tree,
            "timing": timing,
            "momentum": int(self._momentum),
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

    @property
    def known(self) -> bool:
        """Whether anything is believed."""
        return self.believed.known

    @property
    def standing(self) -> bool:
        """Whether a foot surely stood."""
        return self.believed.standing

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
        started: Beliefs | MomentumBeliefs = self._spec.begin_episode()
        state, believed = self._state, self.believed.reference()
        if not isinstance(started, MomentumBeliefs):
            self._unpack(started)
            started.believed = believed
            return started
        self._unpack(started.beliefs)
        # What it believes of accelerations is made anew at each sample.
        started.believed, started.ring[...] = believed, state["moved"]
        started.run, started.number = int(state["run"]), int(state["number"])
        self._get(started.strapdown, _STRAPDOWN, "strapdown_")
        return started

    def _unpack(self, found: Beliefs) -> None:
        state, odometry = self._state, found.odometry
        self._get(found, _OWN)
        self._get(found.upright, _UPRIGHT)
        if isinstance(odometry, Odometry):
            self._get(odometry, _ODOMETRY)
        else:
            self._get(odometry.strapdown, _STRAPDOWN, "rolling_")
            odometry.count = int(state["count"])
        found.ring[...] = state["ring"]
        found.plan.runs.extend(state["planned"].tolist())
        found.kinematics.runs = state["found"].tolist()
        if found.seen:
            values = np.zeros(self._layout.size)
            for name, part in _packet_places(self._layout):
                values[part] = state[name]
            found.last = Packet(int(state["number"]), 0.0, values)

    def _pack(self, beliefs: Beliefs) -> None:
        state, last, odometry = self._state, beliefs.last, beliefs.odometry
        self._put(beliefs, _OWN)
        self._put(beliefs.upright, _UPRIGHT)
        if isinstance(odometry, Odometry):
            self._put(odometry, _ODOMETRY)
            self._put(Strapdown(beliefs.period, self.model.gravity), _STRAPDOWN, "rolling_")
        else:
            self._put(Odometry(beliefs.period), _ODOMETRY)
            self._put(odometry.strapdown, _STRAPDOWN, "rolling_")
            state["count"] = odometry.count
        state["ring"] = beliefs.ring
        runs = list(beliefs.plan.runs)
        # The oldest one counts until there are as many as are kept.
        state["planned"] = runs[:1] * (len(state["planned"]) - len(runs)) + runs
        state["found"] = beliefs.kinematics.runs
        if last is not None:
            state["number"] = last.number
            for name, part in _packet_places(beliefs.layout):
                state[name] = last.values[part]

    def _put(self, part: Any, names: tuple[str, ...], prefix: str = "") -> None:
        """Take over a part of beliefs into the library's record."""
        for name in names:
            self._state[prefix + name] = getattr(part, name)

    def _get(self, part: Any, names: tuple[str, ...], prefix: str = "") -> None:
        """Take over a part of beliefs from the library's record."""
        for name in names:
            value, like = self._state[prefix + name], getattr(part, name)
            setattr(
                part, name, value.copy() if isinstance(like, np.ndarray) else _of_kind(like, value.tolist())
            )

    def __reduce__(self) -> Any:
        return native_beliefs, (self.unpack(),)


def _without_rows(beliefs: Any) -> Any:
    """Return beliefs to begin episodes of, without the memory of an episode."""
    bare = copy(beliefs)
    bare.ring = None
    if isinstance(bare, MomentumBeliefs):
        bare.beliefs = _without_rows(bare.beliefs)
    return bare


def native_beliefs(
    beliefs: Beliefs | MomentumBeliefs, library: Library | None = None
) -> Beliefs | MomentumBeliefs | NativeBeliefs:
    """Return beliefs that go on by a library, or as they are where there is none for such a robot.

    Args:
        beliefs: The Python's, which are used up.
        library: That of the robot's calibrator; by default the one with room for all robots.
    """
    library = library or installed()
    if library is None or library.real != np.float64:
        return beliefs
    try:
        return NativeBeliefs(library, beliefs)
    except ValueError:
        return beliefs


def c_source(beliefs: Beliefs | MomentumBeliefs) -> str:
    """Return a header with one robot's ``sf_model model`` and ``sf_timing timing``, for its controller.

    Raises:
        RuntimeError: If there is no library here.
        ValueError: If the library is not made for such a robot.
    """
    native = NativeBeliefs(require(installed()), beliefs)
    model, timing = native.constants.values()
    sizes = {
        "FEET": int(timing["feet"]),
        "CORNERS": int(timing["points"]),
        "BODIES": int(model["bodies"]),
        "HINGES": max(1, int(model["hinges"])),
        "PLANNED": int(timing["window"]),
    }
    header = "surefoot_strapdown.h" if native._momentum else "surefoot_beliefs.h"
    return c_header(header, sizes, {"sf_model model": model, "sf_timing timing": timing})


def _strapdown_shapes(name: str) -> dict[str, tuple[int, ...]]:
    shapes = (3, 3), (3,), (3,), (3,), (), ()
    return {f"{name}_{part}": shape for part, shape in zip(_STRAPDOWN, shapes, strict=True)}


def _of_kind(like: Any, value: Any) -> Any:
    return tuple(value) if isinstance(like, tuple) else type(like)(value)


def _packet_places(layout: TelemetryLayout) -> tuple[tuple[str, slice], ...]:
    """Return where a packet holds the numbers that are kept of it."""
    return (
        ("angle", layout.joint_position),
        ("accelerometer", layout.accelerometer),
        ("gyroscope", layout.gyroscope),
    )
