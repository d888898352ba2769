"""State estimate of one robot by the C library, equal to the Python estimate up to rounding."""

from copy import copy
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import MomentumReference, Reference
from surefoot.calibration.native import ReferenceRecord
from surefoot.native import CALIBRATION, Library, c_header, require
from surefoot.pickles import Made, refuse
from surefoot.robot.beliefs.believed import nothing, reference_info, unknown
from surefoot.robot.beliefs.contacts import plan_window
from surefoot.robot.beliefs.momentum import MomentumBeliefs
from surefoot.robot.beliefs.references import Beliefs
from surefoot.robot.beliefs.strapdown import StrapdownConstants
from surefoot.sensors.transport.link import Packets

AT_ONCE = 8  # packets that are passed to the library in one call

PythonBeliefs = TypeVar("PythonBeliefs", bound=Beliefs | MomentumBeliefs)


class NativeBeliefs:
    """State estimate of one robot by the C library, at the start of an episode.

    Args:
        library: The library that computes the estimate.
        believed: The Python estimator of the robot.

    Attributes:
        believed: The result of the last :meth:`sample`. The next call overwrites it.

    Raises:
        ValueError: If the library does not support the robot. docs/native.md lists its limits.
    """

    def __init__(self, library: Library, believed: Beliefs | MomentumBeliefs) -> None:
        self.library, self._functions, self._spec = library, library.functions, _without_rows(believed)
        self.model = believed.model
        self._momentum = isinstance(believed, MomentumBeliefs)
        beliefs, F = believed.beliefs if isinstance(believed, MomentumBeliefs) else believed, self.model.feet
        self.feet = F
        own = dict(zip(("needed", "window"), plan_window(beliefs.lag), strict=True))
        constants = StrapdownConstants.of(beliefs.touching)
        found = library.constants("timing", own, constants, beliefs, self.model)
        kinds = (MomentumReference if self._momentum else Reference), Reference, MomentumReference
        self.believed, self._other, self._moved = (ReferenceRecord(library, kind, F) for kind in kinds)
        if found is None:
            raise ValueError("The robot has a longer lag than the library has room for.")
        size = library.places["momentum_beliefs" if self._momentum else "beliefs"][""][2]
        self._timing, self._state = found, np.zeros(size, np.uint8)
        self._rows = np.zeros((AT_ONCE, 2 + beliefs.layout.size))
        self._slots = [(row[:2], row[2:]) for row in self._rows]
        self._planned, self._soles = np.zeros(2 * F, np.bool_), np.zeros((F, 4), library.real)
        self._stance, self._swing = self._planned[:F], self._planned[F:]
        self._joints = beliefs.layout.joint_position.stop
        self._model: NDArray[Any] | None = None
        self._adopt()
        records = self._timing, self._state, self._rows, self._planned, self._soles
        self._addresses = tuple(record.ctypes.data for record in records)
        self.begin_episode()

    def begin_episode(self) -> "NativeBeliefs":
        """Reset the estimator in place for a new episode, and return it."""
        self._functions.surefoot_beliefs_init(self._momentum, self._addresses[1])
        self.believed.fill(unknown(self.feet) if self._momentum else nothing(self.feet))
        return self

    def keep_up(self) -> None:
        """Copy the nominal model to the library if its masses have changed."""
        if self.model.revision != self._revision:
            self._adopt()

    def _adopt(self) -> None:
        """Copy the nominal model to the library."""
        tree, library = self.model.tree(), self.library
        sizes = {} if tree is None else {"bodies": len(tree["mass"]), "hinges": len(tree["axis"])}
        model = None if tree is None else library.record_of("model", {**sizes, **tree})
        if (
            model is None
            or model["hinges"] != self._joints
            or not library.functions.surefoot_beliefs_fit(model.ctypes.data, self._timing.ctypes.data)
        ):
            raise ValueError(
                "The robot is no tree of bodies that the library has room for, or packets have other joints."
            )
        self._revision = self.model.revision
        if self._model is None:
            self._model, self._tree = model, model.ctypes.data
        self._model[...] = model  # in place, because its address is already in use

    @property
    def constants(self) -> dict[str, NDArray[Any]]:
        """The constant records of the robot, under their names in C headers: model and timing."""
        assert self._model is not None
        return {"model": self._model, "timing": self._timing}

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
        """Update :attr:`believed` in place, with arguments and result of :meth:`Beliefs.sample`."""
        timing, state, _, planned, _ = self._addresses
        plan = planned if self.plan(command) else None
        found = self._functions.surefoot_beliefs_sample(
            timing, self._momentum, state, time, plan, hold, self.believed.address
        )
        return bool(found & 1)

    def parts(self) -> dict[str, Any]:
        """Return the records under their names in ``sf_sample_records``."""
        self.keep_up()
        records = {**self.constants, "beliefs": self._state, "planned": self._planned}
        return {**records, "momentum": self._momentum, "belief": self.believed}

    def plan(self, command: Any) -> bool:
        """Copy a plan to the memory that the library reads, and return whether the command contains one."""
        if command is None:
            return False
        self._stance[...], self._swing[...] = command.stance, command.swing
        return True

    @property
    def known(self) -> bool:
        """Whether the last estimate is valid."""
        return self.believed.known

    @property
    def standing(self) -> bool:
        """Whether at least one foot was certainly in stance."""
        return self.believed.standing

    def info(self) -> dict[str, Any]:
        """Return the last estimate for ``info``, as :meth:`Beliefs.info`."""
        return reference_info(self.believed.reference())

    def reference(self, time: float, stance: NDArray[np.bool_], swing: NDArray[np.bool_]) -> Reference:
        """Return the estimated motion at a time, as :meth:`Beliefs.reference`."""
        timing, state, _, _, _ = self._addresses
        self._functions.surefoot_beliefs_reference(timing, state, time, self._other.address)
        found: Reference = self._other.reference()._replace(stance=stance, swing=swing)
        return found

    def momentum(self, time: float, stance: NDArray[np.bool_], swing: NDArray[np.bool_]) -> MomentumReference:
        """Return the estimated momentum at a time, as :meth:`MomentumBeliefs.momentum`."""
        timing, state, _, _, _ = self._addresses
        self._functions.surefoot_beliefs_momentum(timing, state, time, self._moved.address)
        found: MomentumReference = self._moved.reference()._replace(stance=stance, swing=swing)
        return found

    def soles(self, time: float) -> Floats:
        """Return the predicted poses of the soles, as :meth:`Beliefs.soles`."""
        timing, state, _, _, soles = self._addresses
        self._functions.surefoot_beliefs_soles(timing, state, time, soles)
        return self._soles.astype(np.float64)

    def __reduce__(self) -> Any:
        made, told = Made("NativeBeliefs", self.library.source), (self.believed.now, self._planned)
        return _going_on, (made, self._spec, self._momentum, self._state.tobytes(), *map(np.copy, told))

    def take(self, state: bytes, believed: NDArray[Any], planned: NDArray[np.bool_]) -> None:
        """Restore the state of another instance."""
        self._state[:] = np.frombuffer(state, np.uint8)
        self.believed.now[...], self._planned[:] = believed, planned


def _without_rows(beliefs: Any) -> Any:
    """Return a copy from which episodes can start, without the stored rows of the current episode."""
    bare = copy(beliefs)
    bare.ring = None
    if isinstance(bare, MomentumBeliefs):
        bare.beliefs = _without_rows(bare.beliefs)
    return bare


def _going_on(made: Made, spec: Any, momentum: bool, state: bytes, *told: NDArray[Any]) -> NativeBeliefs:
    """Restore a pickled estimate in a library built from the same sources."""
    rooms = CALIBRATION.rooms() or (require(None),)
    library = next((one for one in rooms if one.source == made.mark), None)
    if library is None:
        refuse(made.name, "a library of other sources, whose numbers lie elsewhere")
    native = NativeBeliefs(require(library), spec)
    native.take(state, *told)
    return native


def native_beliefs(beliefs: PythonBeliefs, library: Library | None = None) -> PythonBeliefs | NativeBeliefs:
    """Return a native estimator at an episode's start, or the Python one if the robot is not supported.

    Pass the library of the robot's calibrator. The default is the installed library for robots of any
    supported size. Do not use the Python estimator after it has been replaced.
    """
    library = library or CALIBRATION.installed()
    if library is None or library.real != np.float64:
        return beliefs
    try:
        return NativeBeliefs(library, beliefs)
    except ValueError:
        return beliefs


def c_source(beliefs: Beliefs | MomentumBeliefs) -> str:
    """Return a C header for the robot's controller with ``sf_model model`` and ``sf_timing timing``.

    Raises:
        RuntimeError: If the library is not installed.
        ValueError: If the library does not support the robot.
    """
    native = NativeBeliefs(require(CALIBRATION.installed()), beliefs)
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
