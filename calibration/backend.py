"""Run the filter of one calibrator in Python, which is the specification, or in the C library.

:class:`~surefoot.calibration.FootCalibrator` chooses one of the two when it is created.
"""

from typing import Any

from surefoot.calibration.arrays import Array
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.native import NativeFilter, ReferenceRecord
from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.calibration.setup import OnlineMethod
from surefoot.checks import as_number
from surefoot.native import Library, StateRecord

AnyReference = Reference | MomentumReference | ReferenceRecord


class PythonFilter:
    """The Python implementation of a method. Its state is ``None`` before the first sample."""

    library: Library | None = None  # always None: this backend does not use the library

    def __init__(self, method: OnlineMethod, state: Any = None) -> None:
        self._method, self.state = method, state

    def update(self, raw: Array, reference: AnyReference, dt: Any, late: Array | None = None) -> Estimate:
        """Process one sample of readings that are older than usual by ``late`` in s, shape (K,)."""
        if isinstance(reference, ReferenceRecord):
            reference = reference.reference()
        state = self._method.init(raw) if self.state is None else self.state
        if late is not None:
            front = getattr(state, "front", None)
            own = {"late": late} if front is None else {"front": front._replace(late=late)}
            state = state._replace(**own)
        self.state, estimate = self._method.update(state, raw, reference, as_number("dt", dt))
        return estimate

    def retract(self) -> None:
        """Discard what was learnt in the last seconds."""
        if self.state is not None:
            self.state = self._method.retract(self.state)

    def native(self) -> None:
        """Return None: this backend has no native filter."""


class LibraryFilter:
    """The C implementation of a method. Its state is a record that the library updates in place."""

    def __init__(self, native: NativeFilter, method: OnlineMethod) -> None:
        self._native, self._method, self._state = native, method, native.pack()
        self._started = self._shared = False
        self.library: Library | None = native.library

    @property
    def state(self) -> Any:
        """The state as a tuple of NumPy arrays, or ``None`` before the first sample."""
        return self._state.python() if self._in_use else None

    @state.setter
    def state(self, state: Any) -> None:
        self._native.put(self._state, state)
        self._started = state is not None

    def update(self, raw: Array, reference: AnyReference, dt: Any, late: Array | None = None) -> Estimate:
        """Process one sample. Samples that the library cannot take are passed to the Python backend."""
        if isinstance(reference, ReferenceRecord) and reference.library is not self.library:
            reference = reference.reference()
        if not self._native.takes(raw, reference, dt):
            python = PythonFilter(self._method, self.state)
            estimate = python.update(raw, reference, dt, late)
            self.state = python.state
            return estimate
        self._started = True
        if late is not None:
            self._native.expect(self._state, late)
        return self._native.update(self._state, raw, reference, dt)

    def retract(self) -> None:
        """Discard what was learnt in the last seconds."""
        if self._in_use:
            self._native.retract(self._state)

    def native(self) -> tuple[NativeFilter, StateRecord]:
        """Return the filter and its state."""
        self._shared = True
        return self._native, self._state

    @property
    def _in_use(self) -> bool:
        """Whether there was a sample, or there may have been one from another caller of the record."""
        return self._started or self._shared


FilterBackend = PythonFilter | LibraryFilter
