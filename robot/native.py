"""All of one sample of one robot by the library, in one call: beliefs, filter and observation."""

from collections.abc import Sequence
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import FootCalibrator
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.native import NativeFilter
from surefoot.envs.observation import COP_BOUND
from surefoot.native import Library, PointerRecord, StateRecord, call_for_many
from surefoot.robot.beliefs.believed import reference_info
from surefoot.robot.beliefs.native import NativeBeliefs
from surefoot.robot.chances import Chances
from surefoot.robot.foot_view import DETERMINED, FootView
from surefoot.robot.python import AnyBeliefs, Outputs, PythonSample
from surefoot.robot.sensing.native import ManySensing
from surefoot.robot.sensing.sensors import RobotSensors

_OF_ESTIMATE = ("flags", "vgrf", "scale", "offset")  # what ``info`` holds of an estimate
NOTHING = None, 0  # no packets: neither a place of rows nor a number of them


class NativeSample:
    """The library for one robot; its beliefs, its filter and the held values stay those of the objects.

    Attributes:
        sampled: Whether it has taken in any sample.
        many: The library's function of several robots.
        address: Where the library finds its records.
        memory: What the library tells of a sample, in bytes.
    """

    def __init__(
        self,
        beliefs: NativeBeliefs,
        native: NativeFilter,
        state: StateRecord,
        view: FootView,
        calibrator: FootCalibrator,
        chances: Chances,
    ) -> None:
        dt = calibrator.setup.dt
        self._calibrator, self._dt = calibrator, dt
        library = beliefs.library
        self._beliefs, self._state = beliefs, state
        self._filter, self._raw, self.sampled = native, native.raw, False
        told = _output_dtype(library, beliefs, native, view)
        self._dtype, self.memory = told, np.zeros(library.places["told"][""][2], np.uint8)
        self._parts, self._believed = view.parts, ("known", *beliefs.believed.kind._fields)
        self._fields = itemgetter(*(told.names or ()))
        shown = {"view": view_record(library, view), "held": view.held, "told": self.memory}
        own = {**shown, "state": state, "counts": chances.counts, "dt": dt}
        self._records = PointerRecord(library, "sample_records", beliefs.parts() | native.parts | own)
        self._sample, self.address = library.functions.surefoot_sample, self._records.address
        self.many = library.functions.surefoot_sample_many

    def sample(self, sensors: RobotSensors, then: float, command: Any, hold: bool) -> Outputs:
        """Take in one sample."""
        beliefs, arrived = self._beliefs, sensors.packet_rows()
        beliefs.keep_up()
        if arrived is None:
            beliefs.update(sensors.packets)
        self._raw[...] = sensors.raw
        self.expect(sensors.ages)
        how = beliefs.plan(command) + 2 * hold
        self.sampled = True
        self._sample(self.address, *(arrived or NOTHING), then, sensors.time, how)
        return self.outputs()

    def expect(self, ages: Floats | None) -> None:
        """Take the coming readings to be of these ages in s, shape (K,), if they are known."""
        if ages is not None:
            # What is handed out is of the middle of the last step; see CalibrationSetup.calibrator.
            self._filter.expect(self._state, self._calibrator.lateness(ages - 0.5 * self._dt))

    def keep_in(self, memory: NDArray[np.uint8]) -> None:
        """Keep :attr:`memory` elsewhere from here on."""
        memory[...] = self.memory
        self.memory = self._records["told"] = memory

    def outputs(self, memory: NDArray[np.uint8] | None = None) -> Outputs:
        """Return the observation of the last sample, and the ``info`` of the estimate, in fresh arrays.

        They are of N robots of this one's kind, which are in front, if their memory is given, (N, bytes).
        """
        alone, memory = memory is None, self.memory if memory is None else memory
        # What comes after the last number is room that this robot has no use for.
        memory = memory[..., : self._dtype.itemsize].copy()
        one = np.ndarray(memory.shape[:-1], self._dtype, memory)
        shown, told = self._read(one, True if alone else np.ones(len(memory), bool))
        reference = told["reference"]
        if not (self._beliefs.known if alone else np.isfinite(reference["com"]).all()):
            del reference["known"]
            told["reference"] = reference_info(self._beliefs.believed.kind(**reference))
        return shown, told

    def _read(self, one: NDArray[Any], known: Any) -> Outputs:
        flags, vgrf, scale, offset, *others = self._fields(one)
        shares = {}
        if self._filter.constants.contact:
            shares, others = dict(zip(DETERMINED, others)), others[len(DETERMINED) :]  # noqa: B905
        # Others follow behind both.
        shown = dict(zip(self._parts, others))  # noqa: B905
        reference = dict(zip(self._believed, (known, *others[len(shown) :])))  # noqa: B905
        return shown, {
            "parameters": {"scale": scale, "offset": offset},
            "covariance": others[-1] if self._filter.constants.covariance else None,
            "flags": flags,
            "vgrf": vgrf,
            "reference": reference,
            **shares,
        }

    def estimate(self) -> Estimate:
        """Return the last estimate."""
        return self._filter.read(self._state)


class ManySamples:
    """Samples of many robots, one at least and all of one kind, in one call of the library.

    Attributes:
        robots: The library's objects of each of them.
        sampled: Whether each of them has taken in any sample, shape (N,).
    """

    def __init__(self, robots: Sequence[NativeSample]) -> None:
        self.robots, self._many = robots, robots[0].many
        self.sampled = np.array([robot.sampled for robot in robots])
        self._at = np.array([robot.address for robot in robots], dtype=np.uintp)
        self._memory = np.zeros((len(robots), len(robots[0].memory)), np.uint8)
        for robot, memory in zip(robots, self._memory, strict=True):
            robot.keep_in(memory)

    def __reduce__(self) -> Any:
        # Addresses are of no use elsewhere: a copy of the wrapper makes its own.
        return type(None), ()

    def feed(
        self,
        which: NDArray[np.intp],
        sensed: ManySensing,
        planned: NDArray[np.bool_] | None,
        then: Floats,
        now: Floats,
        hold: bool,
        threads: int,
    ) -> None:
        """Take in a sample of the n robots of these numbers.

        ``planned`` are feet planned to stand, then to swing, shape (n, 2 F), or ``None``; ``then`` are the
        moments of the samples and ``now`` the hosts' clocks in s, shape (n,).
        """
        plans = np.zeros(len(which), dtype=np.uintp)
        how = np.full(len(which), 2 * hold, dtype=np.int32)
        if planned is not None:
            planned = np.ascontiguousarray(planned)
            how, plans = how + np.int32(1), plans + planned.ctypes.data
            plans += planned.strides[0] * np.arange(len(plans), dtype=np.uintp)
        for i in which.tolist():
            self.robots[i].expect(sensed.robots[i].ages())
        found = sensed.rows[which], sensed.packets[which], sensed.raw[which]
        call_for_many(self._many, (self._at[which], *found, plans, then, now, how), threads)
        if not self.sampled.all():
            self.sampled[which] = True
            for i in which.tolist():
                self.robots[i].sampled = True

    def outputs(self) -> Outputs:
        """Return observations and ``info`` of all, as :meth:`NativeSample.outputs` does."""
        return self.robots[0].outputs(self._memory)


SampleBackend = PythonSample | NativeSample  # who takes in all samples of one robot


def native_sample(
    beliefs: AnyBeliefs, calibrator: FootCalibrator, view: FootView, chances: Chances
) -> SampleBackend:
    """Return the library for one robot, or Python where that does its beliefs or its filter."""
    native = calibrator.native()
    if native is None or not isinstance(beliefs, NativeBeliefs):
        return PythonSample(beliefs, calibrator, view, chances)
    return NativeSample(beliefs, *native, view, calibrator, chances)


def view_record(library: Library, view: FootView) -> NDArray[Any]:
    """Return the bounds of the observation, as the library wants them."""
    config = library.constants("view", view, {"cop_bound": COP_BOUND})
    assert config is not None
    return config


def view_dtype(library: Library, view: FootView) -> np.dtype[Any]:
    """Return the dtype of the library's observation."""
    dtype = library.record("shown", {name: space.shape or () for name, space in view.every.items()})
    assert dtype is not None
    return dtype


def _output_dtype(
    library: Library, beliefs: NativeBeliefs, native: NativeFilter, view: FootView
) -> np.dtype[Any]:
    """Return the dtype of a sample's outputs, up to the last number.

    Its names come in the order in which :meth:`NativeSample._read` takes them.
    """
    places, unknowns = library.places["told"], 2 * len(native.raw)
    taken = {
        "estimate": (
            native.estimate.now.dtype,
            _OF_ESTIMATE + DETERMINED * native.constants.contact,
        ),
        "shown": (view_dtype(library, view), view.parts),
        "belief": (beliefs.believed.dtype, beliefs.believed.kind._fields),
    }
    # Names alone would not do: an estimate's are shown as well.
    fields = [
        (f"{record}.{name}", dtype[name], places[record][1] + dtype.fields[name][1])
        for record, (dtype, own) in taken.items()
        for name in own
        if dtype.fields is not None
    ]
    if native.constants.covariance:
        covariance = np.dtype((library.real, (unknowns, unknowns)))
        fields.append(("covariance", covariance, places["covariance"][1]))
    keys, formats, offsets = (list(column) for column in zip(*fields, strict=True))
    end = max(offset + dtype.itemsize for _, dtype, offset in fields)
    return np.dtype({"names": keys, "formats": formats, "offsets": offsets, "itemsize": end})
