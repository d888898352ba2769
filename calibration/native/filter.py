"""The calibrator of one robot by the library: the same states, the same estimates, to rounding."""

from typing import Any

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.native.config import Constants, constants_of
from surefoot.calibration.native.reference import ReferenceRecord
from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.calibration.setup import OnlineSetup
from surefoot.native import Library, Record, StateRecord, leaves_of, rebuilt, state_dtype


class NativeFilter:
    """The library for one robot: its constants and those of the method, readings, references and estimates.

    ``raw`` are its readings, (K,); ``references`` the records that references are put in, one for each kind
    that is taken; ``estimate`` is the record of the last estimate, and ``parts`` are its constants and these
    two, by the names in ``sf_sample_records``.
    """

    def __init__(self, library: Library, constants: Constants) -> None:
        self.library, self._functions = library, library.functions
        K, F = constants.front.setup.layout.channels, len(constants.front.setup.layout.feet)
        self._real = library.real
        # Shapes and kinds are all that is wanted of its states.
        self._template = rebuilt(constants.like, _without_memory)
        self.constants = constants._replace(like=self._template)
        self.raw, self._shape, self._feet = np.zeros(K, library.real), (K,), F
        shapes = {
            "force": (K,), "wrench": (F, 6), "vgrf": (F,), "cop": (2,), "cop_measured": (2,),
            "cop_foot": (F, 2), "scale": (K,), "offset": (K,), "force_std": (K,), "cop_covariance": (2, 2),
            "nis": (), "nis_rows": (), "undetermined": (K,), "contact_probability": (F,), "flags": (K,),
            "cop_valid": (), "cop_foot_valid": (F,),
            "force_aligned": (K,), "cop_aligned": (2,), "cop_foot_aligned": (F, 2),
        }  # fmt: skip
        state = state_dtype(library, constants.state, self._template)
        estimate = library.record("estimate", shapes)
        if state is None or estimate is None:
            raise ValueError("The robot's state is larger than those that the library was compiled for.")
        self._dtype = state
        taken = constants.front.motions.taken
        self.references: dict[Any, ReferenceRecord] = {
            kind: ReferenceRecord(library, kind, F) for kind in taken
        }
        self.estimate = Record(estimate)
        self._told = [name for name in shapes if name not in constants.untold]
        filter_ = constants.filter(library)
        self.parts = {"filter": filter_, "raw": self.raw, "estimate": self.estimate}
        self._addresses = filter_.address, self.raw.ctypes.data, self.estimate.address

    def put(self, state: StateRecord, python: Any) -> None:
        """Go on in place from a Python state, or from before any sample if it is ``None``.

        ValueError if it is of another robot or method.
        """
        if python is None:
            state.bytes[:] = 0
            self._functions.surefoot_init(self._addresses[0], state.address)
            return
        given, wanted = (
            dict(leaves_of(part)) if type(part) is type(self._template) else {}
            for part in (python, self._template)
        )
        if [*map(np.shape, given.values())] != [*map(np.shape, wanted.values())]:
            kind, other = type(self._template).__name__, type(python).__name__
            raise ValueError(
                f"A {kind} of a robot of {len(self.raw)} channels cannot go on from this {other}: its parts "
                "have other shapes. Give a state of the same method and robot."
            )
        state.put(python)

    def pack(self, state: Any = None) -> StateRecord:
        """Return a Python state as the library's, by default that before any sample; as :meth:`put`."""
        found = StateRecord(self._dtype, self._template)
        self.put(found, state)
        return found

    def takes(self, raw: Array, reference: Reference | MomentumReference | ReferenceRecord, dt: Any) -> bool:
        """Return whether arguments are as the library wants them; of others Python names the flaw."""
        if not (
            type(raw) is np.ndarray
            and raw.dtype == self._real
            and raw.shape == self._shape
            and isinstance(dt, float)
        ):
            return False
        if isinstance(reference, ReferenceRecord):
            return (
                reference.feet == self._feet
                and reference.real == self._real
                and reference.kind in self.references
            )
        record = self.references.get(type(reference))
        return record is not None and record.takes(reference)

    def expect(self, state: StateRecord, late: Array) -> None:
        """Take the coming readings to be older than on average by times in s, shape (K,)."""
        names = state.now.dtype.names or ()
        state.now["front_late" if "front_late" in names else "late"] = late

    def update(
        self,
        state: StateRecord,
        raw: Array,
        reference: Reference | MomentumReference | ReferenceRecord,
        dt: float,
    ) -> Estimate:
        """Take in one sample that :meth:`takes` has looked at; the state goes on in place."""
        self.raw[...] = raw
        filter_at, reading, out = self._addresses
        if isinstance(reference, ReferenceRecord):
            record = reference
        else:
            record = self.references[type(reference)]
            record.fill(reference)
        self._functions.surefoot_step(filter_at, state.address, reading, record.address, dt, out)
        return self.read(state)

    def read(self, state: StateRecord) -> Estimate:
        """Return the last estimate, of a robot in this state."""
        one = self.estimate.copy()
        told: dict[str, Any] = {name: one[name] for name in self._told}
        covariance = self.constants.covariance
        if covariance is None:
            return Estimate(covariance=None, **told)
        of_step = {name: told[name][()] for name in ("nis", "nis_rows")}
        return Estimate(covariance=state.now[covariance].copy(), **told | of_step)

    def retract(self, state: StateRecord) -> None:
        """Take back the learning of the last seconds."""
        self._functions.surefoot_retract(self._addresses[0], state.address)


def native_filter(
    library: Library | None, method: str, setup: OnlineSetup, options: dict[str, Any]
) -> NativeFilter | None:
    """Return a method for one robot by a library; ``None`` if it cannot be."""
    constants = None if library is None else constants_of(library, method, setup, options)
    return None if library is None or constants is None else NativeFilter(library, constants)


def _without_memory(path: tuple[str, ...], part: Any) -> Any:
    """Return an array of zeros in the place of another, with one zero in memory."""
    if not isinstance(part, np.ndarray):
        return part
    return np.broadcast_to(np.zeros((), part.dtype), part.shape)
