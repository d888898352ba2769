"""The moment filter of one robot by the library: the same states, the same estimates, to rounding."""

from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.stream import MomentStream
from surefoot.calibration.native.config import config_record
from surefoot.calibration.native.reference import ReferenceRecord
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineSetup
from surefoot.native import Library, Record, leaves_of, rebuilt

_SHAPE, _DTYPE = attrgetter("shape"), attrgetter("dtype")
_ARRAYS = (np.ndarray,) * len(Reference._fields)

_OF_REFERENCE = (
    "com",
    "com_acceleration",
    "angular_momentum_rate",
    "position_sole",
    "R_level_sole",
    "stance",
    "swing",
)


class NativeState:
    """A state of the moment filter as the library holds it.

    Args:
        record: All numbers.
    """

    def __init__(self, record: NDArray[Any]) -> None:
        self.record, self.address = record, record.ctypes.data
        self._covariance: NDArray[np.float64] | None = None

    @property
    def covariance(self) -> NDArray[np.float64]:
        """That of an estimate, the same array until the next block is learnt from."""
        if self._covariance is None:
            self._covariance = self.record["learnt"].copy()
        return self._covariance

    def changed(self) -> None:
        """Forget what was handed out."""
        self._covariance = None


class NativeFilter:
    """The library for one robot.

    Args:
        library: The library.
        stream: What it stands in for.
        config: The robot's constants; see :func:`~surefoot.calibration.native.config.config_record`.

    Attributes:
        config: The same.
        raw: What it reads, shape (K,).
        estimate: The record of the last estimate.
        addresses: Where the library finds these three.
    """

    def __init__(self, library: Library, stream: MomentStream, config: NDArray[Any]) -> None:
        self._functions, self.config = library.functions, config
        K, F = stream.setup.layout.channels, len(stream.setup.layout.feet)
        self._real = library.real
        self._template = stream.init(np.zeros(K, library.real))
        tails = stream._front_end.motions.tails
        self._shapes = tuple(tails[field] for field in Reference._fields)
        contacts = np.dtype(np.bool_)
        self._dtypes = tuple(
            contacts if field in ("stance", "swing") else self._real for field in Reference._fields
        )
        self.raw, self._shape, self._feet = np.zeros(K, library.real), (K,), F
        shapes = {
            "force": (K,), "wrench": (F, 6), "vgrf": (F,), "cop": (2,), "cop_foot": (F, 2), "scale": (K,),
            "offset": (K,), "force_std": (K,), "cop_covariance": (2, 2), "nis": (), "nis_rows": (),
            "flags": (K,), "cop_valid": (), "cop_foot_valid": (F,),
        }  # fmt: skip
        leaves = {path[-1]: np.shape(leaf) for path, leaf in leaves_of(self._template)}
        state = library.record("state", leaves)
        reference = library.record("reference", {field: tails[field] for field in _OF_REFERENCE})
        estimate = library.record("estimate", shapes)
        if state is None or reference is None or estimate is None:
            raise ValueError("The robot's state is larger than those that the library was compiled for.")
        self._dtype = state
        self._reference, self.estimate = np.zeros((), reference), Record(estimate)
        self._inputs = tuple(self._reference[field] for field in _OF_REFERENCE)
        self.addresses = {
            "config": config.ctypes.data,
            "raw": self.raw.ctypes.data,
            "estimate": self.estimate.address,
        }
        config_at, raw_at, out_at = self.addresses.values()
        self._addresses = config_at, raw_at, self._reference.ctypes.data, out_at

    def init(self) -> NativeState:
        """Return the state before any sample."""
        record = np.zeros((), self._dtype)
        self._functions.surefoot_init(self._addresses[0], record.ctypes.data)
        return NativeState(record)

    def state(self, state: Any) -> NativeState | None:
        """Return any state as the library's, begun if it is ``None``; ``None`` if it is of another kind."""
        if isinstance(state, NativeState):
            return state
        return self.init() if state is None else self.pack(state)

    def pack(self, state: Any) -> NativeState | None:
        """Return a Python state as the library's; ``None`` if it is of another robot or kind."""
        record = np.zeros((), self._dtype)
        try:
            given, wanted = list(leaves_of(state)), list(leaves_of(self._template))
        except (TypeError, ValueError):
            return None
        if type(state) is not type(self._template) or len(given) != len(wanted):
            return None
        for (path, leaf), (_, like) in zip(given, wanted, strict=True):
            if isinstance(like, int):
                if not isinstance(leaf, int):
                    return None
            elif not isinstance(leaf, np.ndarray | np.generic) or (leaf.shape, leaf.dtype) != (
                like.shape,
                like.dtype,
            ):
                return None
            record[path[-1]] = leaf
        return NativeState(record)

    def unpack(self, state: NativeState) -> Any:
        """Return the library's state as a Python state, which shares nothing with it."""

        def own(path: tuple[str, ...], like: Any) -> Any:
            part = state.record[path[-1]]
            return int(part) if isinstance(like, int) else part.astype(like.dtype)

        return rebuilt(self._template, own)

    def takes(self, raw: Array, reference: Reference | ReferenceRecord, dt: Any) -> bool:
        """Return whether arguments are as the library wants them; of others Python says what is wrong."""
        if not (
            type(raw) is np.ndarray
            and raw.dtype == self._real
            and raw.shape == self._shape
            and isinstance(dt, float)
        ):
            return False
        if type(reference) is ReferenceRecord:
            return self._feet == 2 and reference.real == self._real
        return (
            type(reference) is Reference
            and tuple(map(type, reference)) == _ARRAYS
            and tuple(map(_DTYPE, reference)) == self._dtypes
            and tuple(map(_SHAPE, reference)) == self._shapes
        )

    def update(
        self, state: NativeState, raw: Array, reference: Reference | ReferenceRecord, dt: float
    ) -> Estimate:
        """Take in one sample that :meth:`takes` has looked at; the state goes on in place."""
        self.raw[...] = raw
        config, reading, beliefs, out = self._addresses
        if isinstance(reference, ReferenceRecord):
            beliefs = reference.address
        else:
            com, acceleration, rate, position, R, stance, swing = self._inputs
            com[...], acceleration[...], rate[...] = reference[:3]
            position[...], R[...], stance[...], swing[...] = reference[3:7]
        self._functions.surefoot_step(config, state.address, reading, beliefs, dt, out)
        if self.estimate.now["nis"] == self.estimate.now["nis"]:
            state.changed()
        return self.read(state)

    def read(self, state: NativeState) -> Estimate:
        """Return the last estimate, of a robot in this state; its covariance may be the last one's array."""
        one = self.estimate.copy()
        return Estimate(
            one["force"], one["wrench"], one["vgrf"], one["cop"], one["cop_foot"], one["cop_valid"],
            one["cop_foot_valid"], one["scale"], one["offset"], state.covariance, one["flags"],
            one["force_std"], one["cop_covariance"], one["nis"][()], one["nis_rows"][()],
        )  # fmt: skip

    def retract(self, state: NativeState) -> None:
        """Take back what was learnt in the last seconds."""
        self._functions.surefoot_retract(self._addresses[0], state.address)
        state.changed()


def native_filter(
    library: Library | None, setup: OnlineSetup, options: dict[str, Any]
) -> NativeFilter | None:
    """Return the moment filter of one robot by a library; ``None`` if it cannot be."""
    if library is None:
        return None
    stream = MomentStream(setup, MomentFilterConfig(**options))
    config = config_record(library, stream)
    return None if config is None else NativeFilter(library, stream, config)
