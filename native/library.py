"""Find and load compiled libraries, and describe the layout of their records."""

import ctypes
import logging
import os
from collections.abc import Mapping, Sequence
from functools import cache
from math import prod
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.native.build import Sources

SWITCH = "SUREFOOT_NATIVE"
"""Environment variable that disables the libraries if it is 0."""

ADDRESS = ctypes.c_void_p
"""Type of arguments that point to a record or an array."""

_BY_HAND = "python -m surefoot.native"

_MISSING: Any = object()


_KINDS: dict[str, np.dtype[Any]] = {
    "int": np.dtype(np.int32),
    "whole": np.dtype(np.int64),
    "word": np.dtype(np.uint64),
    "byte": np.dtype(np.bool_),
    "double": np.dtype(np.float64),
    "single": np.dtype(np.float32),
}


class _Place(ctypes.Structure):
    _fields_ = (
        ("record", ctypes.c_char_p),
        ("field", ctypes.c_char_p),
        ("kind", ctypes.c_char_p),
        ("offset", ctypes.c_size_t),
        ("size", ctypes.c_size_t),
    )


class Library(NamedTuple):
    """A loaded library."""

    functions: Any  # its functions
    real: np.dtype[Any]  # the dtype of its floating-point numbers
    places: dict[str, dict[str, tuple[str, int, int]]]
    """Kind, offset and size in bytes of each field, by record and field. The field "" is the whole record."""
    found: dict[Any, np.dtype[Any] | None]
    """Cached results of :meth:`record` by its arguments."""

    @property
    def source(self) -> str:
        """Hash of the sources and sizes from which it was compiled. Records of other sources may differ."""
        mark: bytes = self.functions.surefoot_source()
        return mark.decode()

    def record(self, name: str, shapes: Mapping[str, tuple[int, ...]]) -> np.dtype[Any] | None:
        """Return the dtype of a record with these shapes, or ``None`` if a field is too small.

        Args:
            name: Name of the record, such as ``config`` or ``state``.
            shapes: The shape of each field.
        """
        key = name, *shapes.items()
        if key not in self.found:
            self.found[key] = self._layout(name, shapes)
        return self.found[key]

    def _layout(self, name: str, shapes: Mapping[str, tuple[int, ...]]) -> np.dtype[Any] | None:
        places, formats = self.places[name], []
        for field, shape in shapes.items():
            kind, _, size = places[field]
            dtype = _KINDS.get(kind, self.real)
            if prod(shape) * dtype.itemsize > size:
                return None
            formats.append((dtype, shape))
        offsets = [places[field][1] for field in shapes]
        return np.dtype(
            {"names": list(shapes), "formats": formats, "offsets": offsets, "itemsize": places[""][2]}
        )

    def constants(self, name: str, *sources: Any) -> NDArray[Any] | None:
        """Return a record whose fields are looked up by name, or ``None`` if a field is too small.

        Args:
            name: Name of the record.
            sources: Where values are looked up, in this order: mappings by key, objects by attribute, and
                modules by constant (in capitals). A prefix may be an attribute: ``wire_delay`` is also found
                as ``wire.delay``.

        Raises:
            KeyError: If no source has a value for a field.
        """
        fields = (field for field in self.places[name] if field)
        return self.record_of(name, {field: _value_of(field, name, sources) for field in fields})

    def record_of(self, name: str, values: Mapping[str, Any]) -> NDArray[Any] | None:
        """Return a record with these values, shape (), or ``None`` if a field is too small."""
        dtype = self.record(name, {field: np.shape(value) for field, value in values.items()})
        if dtype is None:
            return None
        record = np.zeros((), dtype)
        for field, value in values.items():
            record[field] = value
        return record


def _value_of(field: str, record: str, sources: Sequence[Any]) -> Any:
    """Look up the value of a field; see :meth:`Library.constants`."""
    for search in (_attribute, _part):
        for source in sources:
            value = search(source, field)
            if value is not _MISSING:
                return value
    kinds = [getattr(source, "__name__", type(source).__name__) for source in sources]
    raise KeyError(f"No value for field '{field}' of record '{record}'; looked in {', '.join(kinds)}.")


def _attribute(source: Any, field: str) -> Any:
    if isinstance(source, Mapping):
        return source.get(field, _MISSING)
    return getattr(source, field.upper() if isinstance(source, ModuleType) else field, _MISSING)


def _part(source: Any, field: str) -> Any:
    name, _, rest = field.partition("_")
    return _attribute(_attribute(source, name), rest)


def places_at(address: int, count: int) -> dict[str, dict[str, tuple[str, int, int]]]:
    """Return kind, offset and size of each field by record and field, from a library's table.

    Args:
        address: Address of the table.
        count: Number of its rows.
    """
    places: dict[str, dict[str, tuple[str, int, int]]] = {}
    for place in (_Place * count).from_address(address):
        fields = places.setdefault(place.record.decode(), {})
        fields[place.field.decode()] = place.kind.decode(), place.offset, place.size
    return places


class Native:
    """The library of one package.

    Args:
        sources: Its sources.
        signatures: Result (or ``None``) and arguments of each of its functions, as ctypes types.
        many: Functions for many robots, which release the interpreter's lock.
    """

    def __init__(
        self,
        sources: Sources,
        signatures: Mapping[str, tuple[Any, tuple[Any, ...]]],
        many: tuple[str, ...] = (),
    ) -> None:
        self.sources, self._signatures, self._many = sources, signatures, many
        self._found: tuple[Library | None] | None = None
        self._smaller: tuple[Library, ...] | None = None

    def load(self, path: Path, source: str | None = None) -> Library:
        """Load a library.

        Args:
            path: The file.
            source: The fingerprint that it must have, by default any.

        Raises:
            OSError: If there is no such file, or it is not a library of this package.
        """
        # Calls take microseconds, so that releasing the interpreter's lock would cost more than it gains.
        functions = ctypes.PyDLL(str(path))
        try:
            functions.surefoot_source.restype = ctypes.c_char_p
            functions.surefoot_places.restype = ctypes.c_size_t
            functions.surefoot_places_count.restype = ctypes.c_size_t
            functions.surefoot_real_size.restype = ctypes.c_size_t
            if source is not None and functions.surefoot_source().decode() != source:
                raise OSError("it was compiled from other sources than those at hand, or otherwise")
            unlocked = ctypes.CDLL(str(path))
            for name in self._many:
                setattr(functions, name, getattr(unlocked, name))
            for name, (result, arguments) in self._signatures.items():
                function = getattr(functions, name)
                function.restype, function.argtypes = result, arguments
        except AttributeError as error:
            raise OSError(f"it is another library: {error}") from None
        places = places_at(functions.surefoot_places(), functions.surefoot_places_count())
        return Library(functions, np.dtype(f"f{functions.surefoot_real_size()}"), places, {})

    def installed(self) -> Library | None:
        """Return the library of this package, or log one line and return ``None`` if it cannot be used."""
        if self._found is None:
            self._found = (self.look(self.sources.library),)
        return self._found[0]

    def rooms(self) -> tuple[Library, ...]:
        """Return the libraries of this package, those with the smallest records first."""
        largest, sources = self.installed(), self.sources.smaller
        if largest is None:
            return ()
        if self._smaller is None:
            library = None if sources is None else self.look(sources.library, sources)
            self._smaller = () if library is None else (library,)
        return *self._smaller, largest

    def look(self, path: Path, sources: Sources | None = None) -> Library | None:
        """Load a library file of this package; see :meth:`installed`."""
        if os.environ.get(SWITCH) == "0":
            return None
        effect = "runs in Python, slower" if sources is None else "needs more memory for many robots"
        problem = f"there is no {path.name}"
        if path.exists():
            try:
                return self.load(path, (sources or self.sources).fingerprint())
            except OSError as error:
                problem = f"{path.name} cannot be used, {error}"
        say_once(problem, effect)
        return None


def require(library: Library | None) -> Library:
    """Return the library, or raise RuntimeError if it is ``None``."""
    if library is None:
        raise RuntimeError(f"The library is missing: run '{_BY_HAND}' first.")
    return library


@cache
def say_once(problem: str, effect: str) -> None:
    """Log once that a library is missing, the effect, and how to compile it."""
    logging.getLogger("surefoot").warning("surefoot %s: %s; compile it with: %s", effect, problem, _BY_HAND)
