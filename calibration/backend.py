"""The filter of one calibrator and its state: in Python, which is the specification, or in the library.

:class:`~surefoot.calibration.FootCalibrator` chooses one when it is made, and keeps it.
"""

from typing import Any

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import as_number
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.native import NativeFilter, ReferenceRecord
from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.calibration.setup import OnlineMethod
from surefoot.native import Library, StateRecord

AnyReference = Reference | MomentumReference | ReferenceRecord


class PythonFilter:
    """The specification of a method; its state is a value, ``None`` before the first sample."""

    library: Library | None = None  # the library that it runs in, if it does

    def __init__(self, method: OnlineMethod, state: Any = None) -> None:
        self._method, self.state = method, state

    def update(self, raw: Array, reference: AnyReference, dt: Any) -> Estimate:
        """Take in one sample."""
        if isinstance(reference, ReferenceRecord):
            reference = reference.reference()
        state = self._method.init(raw) if self.state is None else self.state
        self.state, estimate = self._method.update(state, raw, reference, as_number("dt", dt))
        return estimate

    def retract(self) -> None:
        """Take back the learning of the last seconds."""
        if self.state is not None:
            self.state = self._method.retract(self.state)

    def native(self) -> None:
        """Return the library's filter and its state, for somebody who goes on with both: there are none."""


class LibraryFilter:
    """The library's filter of a method, in which the state stays in one place."""

    def __init__(self, native: NativeFilter, method: OnlineMethod) -> None:
        self._native, self._method, self._state = native, method, native.pack()
        self._started = self._shared = False
        self.library: Library | None = native.library

    @property
    def state(self) -> Any:
        """The state as the Python has it."""
        return self._state.python() if self._in_use else None

    @state.setter
    def state(self, state: Any) -> None:
        self._native.put(self._state, state)
        self._started = state is not None

    def update(self, raw: Array, reference: AnyReference, dt: Any) -> Estimate:
        """Take in one sample; Python names the flaw of one that the library refuses, or takes it in."""
        if isinstance(reference, ReferenceRecord) and reference.library is not self.library:
            reference = reference.reference()
        if not self._native.takes(raw, reference, dt):
            python = PythonFilter(self._method, self.state)
            estimate = python.update(raw, reference, dt)
            self.state = python.state
            return estimate
        self._started = True
        return self._native.update(self._state, raw, reference, dt)

    def retract(self) -> None:
        """Take back the learning of the last seconds."""
        if self._in_use:
            self._native.retract(self._state)

    def native(self) -> tuple[NativeFilter, StateRecord]:
        """Return the filter and its state."""
        self._shared = True
        return self._native, self._state

    @property
    def _in_use(self) -> bool:
        """Whether a sample has come, or may have come by somebody else."""
        return self._started or self._shared


FilterBackend = PythonFilter | LibraryFilter  # who filters, and holds the state
