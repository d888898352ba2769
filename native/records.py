"""Records (C structs) that a library reads and writes, and their conversion from and to Python."""

from collections.abc import Callable, Iterator, Mapping
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.native.library import Library

Path = tuple[str, ...]


class Record:
    """A record that a library writes to repeatedly.

    Args:
        dtype: Its layout.

    Attributes:
        now: Its present values, shape ().
        address: Its address in memory.
        bytes: The same memory as an array of bytes.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.now = np.zeros((), dtype)
        self.address = self.now.ctypes.data
        self.bytes = self.now.reshape(1).view(np.uint8)

    def copy(self) -> NDArray[Any]:
        """Return a copy, made byte by byte because NumPy's copy field by field takes 5 us."""
        return np.ndarray((), self.now.dtype, self.bytes.copy())

    def __reduce__(self) -> Any:
        if type(self) is not Record:
            raise TypeError(f"A {type(self).__name__} is of one process: it has no copies and no pickles.")
        return _record, (self.now.dtype, self.bytes.tobytes())


class PointerRecord(Record):
    """A record of numbers and of addresses of other records or arrays, which it keeps alive.

    Args:
        library: The library.
        name: Name of the record, whose fields are all numbers or addresses.
        parts: Values of its fields, see :meth:`__setitem__`. Other fields are 0.

    Attributes:
        parts: The values of its fields.
    """

    def __init__(self, library: Library, name: str, parts: Mapping[str, Any]) -> None:
        dtype = library.record(name, {field: () for field in library.places[name] if field})
        assert dtype is not None
        super().__init__(dtype)
        self.parts: dict[str, Any] = {}
        for field, part in parts.items():
            self[field] = part

    def __setitem__(self, field: str, part: Any) -> None:
        """Set a field to a number, or to the address of an array or record."""
        self.parts[field] = part
        value = part.ctypes.data if isinstance(part, np.ndarray) else getattr(part, "address", part)
        self.now[field] = value


class StateRecord(Record):
    """A state of nested tuples as a record, which the library updates in place.

    The name of a field is the path of a leaf in the state.

    Args:
        dtype: Its layout, from :func:`state_dtype`.
        like: A state with the same shapes and types.
    """

    def __init__(self, dtype: np.dtype[Any], like: Any) -> None:
        super().__init__(dtype)
        self._like = like

    def put(self, state: Any) -> None:
        """Copy a state of nested tuples into the record."""
        for path, leaf in leaves_of(state):
            self.now["_".join(path)] = leaf

    def python(self) -> Any:
        """Return the state as nested tuples, in memory of its own."""

        def copy_leaf(path: Path, like: Any) -> Any:
            part = self.now["_".join(path)]
            return part.astype(like.dtype) if isinstance(like, np.ndarray) else type(like)(part)

        return rebuilt(self._like, copy_leaf)


def _record(dtype: np.dtype[Any], values: bytes) -> Record:
    record = Record(dtype)
    record.bytes[:] = np.frombuffer(values, np.uint8)
    return record


def state_dtype(library: Library, name: str, like: Any) -> np.dtype[Any] | None:
    """Return the layout of a state in a library's record, or ``None`` if the record is too small for it."""
    return library.record(name, {"_".join(path): np.shape(leaf) for path, leaf in leaves_of(like)})


def leaves_of(state: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the path and the value of each leaf of nested named tuples.

    Raises:
        TypeError: If the state is not a tuple.
        ValueError: If one of its tuples has no field names.
    """
    for name, part in zip(getattr(state, "_fields", ()), state, strict=True):
        if isinstance(part, tuple):
            yield from leaves_of(part, (*path, name))
        else:
            yield (*path, name), part


def rebuilt(like: Any, leaf: Callable[[Path, Any], Any], path: Path = ()) -> Any:
    """Return nested tuples of the same structure with other leaves.

    Args:
        like: The structure.
        leaf: Returns the new leaf for the path and the value of each leaf of ``like``.
        path: The path of ``like`` itself.
    """
    if not isinstance(like, tuple):
        return leaf(path, like)
    names = getattr(like, "_fields", ())
    return type(like)(*(rebuilt(part, leaf, (*path, name)) for name, part in zip(names, like, strict=True)))


def c_header(header: str, sizes: Mapping[str, int], records: Mapping[str, NDArray[Any]]) -> str:
    """Return a C header that defines sizes, includes another header, and defines constant records.

    Args:
        header: Name of the included header.
        sizes: Its sizes by their names without ``SF_``.
        records: Records of the library by their types and names.
    """
    lines = [f"#define SF_{name} {size}" for name, size in sizes.items()]
    lines.append(f'#include "{header}"')
    for declared, record in records.items():
        assert record.dtype.fields is not None
        places = record.dtype.fields
        lines += ["", f"static const {declared} = {{"]
        # C++ requires all fields in their order, and C does not allow empty braces.
        for name in sorted(places, key=lambda field: places[field][1]):
            values = record[name].ravel().tolist()
            numbers = ", ".join("HUGE_VAL" if value == inf else repr(value) for value in values) or "0"
            lines.append(
                f"    .{name} = {{{numbers}}}," if record[name].ndim else f"    .{name} = {numbers},"
            )
        lines.append("};")
    return "\n".join([*lines, ""])
