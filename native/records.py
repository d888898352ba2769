"""Records that a library fills or reads, and their contents: states of Python, and constants written as C."""

from collections.abc import Callable, Iterator, Mapping
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.native.library import Library

Path = tuple[str, ...]


class Record:
    """A record that a library fills over and over.

    Args:
        dtype: Its layout.

    Attributes:
        now: Its values, shape ().
        address: Where the library finds it.
        bytes: The same memory, byte by byte.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.now = np.zeros((), dtype)
        self.address = self.now.ctypes.data
        self.bytes = self.now.reshape(1).view(np.uint8)

    def copy(self) -> NDArray[Any]:
        """Return a copy, of which all fields are views; NumPy's own copies field by field, in 5 us."""
        return np.ndarray((), self.now.dtype, self.bytes.copy())

    def __reduce__(self) -> Any:
        if type(self) is not Record:
            raise TypeError(f"A {type(self).__name__} is of one process: it has no copies and no pickles.")
        return _record, (self.now.dtype, self.bytes.tobytes())


class PointerRecord(Record):
    """A record that tells a library where others are, which it keeps alive, and some numbers.

    Args:
        library: The library.
        name: The record, of single numbers and addresses alone.
        parts: Its fields, as of :meth:`__setitem__`; others are 0.

    Attributes:
        parts: The same.
    """

    def __init__(self, library: Library, name: str, parts: Mapping[str, Any]) -> None:
        dtype = library.record(name, {field: () for field in library.places[name] if field})
        assert dtype is not None
        super().__init__(dtype)
        self.parts: dict[str, Any] = {}
        for field, part in parts.items():
            self[field] = part

    def __setitem__(self, field: str, part: Any) -> None:
        """Set a field: to a number, or to the address of an array or of what has one."""
        self.parts[field] = part
        at = part.ctypes.data if isinstance(part, np.ndarray) else getattr(part, "address", part)
        self.now[field] = at


class StateRecord(Record):
    """A state of Python's as a library holds it, each part under the way to it; it goes on in place.

    Args:
        dtype: Its layout, as :func:`state_dtype` returns it.
        like: A state of its kind, of which shapes and types are taken.
    """

    def __init__(self, dtype: np.dtype[Any], like: Any) -> None:
        super().__init__(dtype)
        self._like = like

    def put(self, state: Any) -> None:
        """Go on from a state as the Python has it."""
        for path, leaf in leaves_of(state):
            self.now["_".join(path)] = leaf

    def python(self) -> Any:
        """Return the state as the Python has it, which shares nothing with it."""

        def own(path: Path, like: Any) -> Any:
            part = self.now["_".join(path)]
            return part.astype(like.dtype) if isinstance(like, np.ndarray) else type(like)(part)

        return rebuilt(self._like, own)


def _record(dtype: np.dtype[Any], values: bytes) -> Record:
    found = Record(dtype)
    found.bytes[:] = np.frombuffer(values, np.uint8)
    return found


def state_dtype(library: Library, name: str, like: Any) -> np.dtype[Any] | None:
    """Return the layout of a state like this one in a library's record; ``None`` without room for it."""
    return library.record(name, {"_".join(path): np.shape(leaf) for path, leaf in leaves_of(like)})


def leaves_of(state: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the ways through the named tuples of a state, and the parts that are no tuples.

    Raises:
        TypeError: If it is no tuple.
        ValueError: If one of its tuples has no names.
    """
    for name, part in zip(getattr(state, "_fields", ()), state, strict=True):
        if isinstance(part, tuple):
            yield from leaves_of(part, (*path, name))
        else:
            yield (*path, name), part


def rebuilt(like: Any, leaf: Callable[[Path, Any], Any], path: Path = ()) -> Any:
    """Return a state like another one with parts of its own.

    Args:
        like: The other one.
        leaf: Makes each part, of the way to it and the other one's value there.
        path: The way to this state.
    """
    if not isinstance(like, tuple):
        return leaf(path, like)
    names = getattr(like, "_fields", ())
    return type(like)(*(rebuilt(part, leaf, (*path, name)) for name, part in zip(names, like, strict=True)))


def c_header(header: str, sizes: Mapping[str, int], records: Mapping[str, NDArray[Any]]) -> str:
    """Return a header in C that includes another one with some sizes, and declares constant records.

    Args:
        header: The other one.
        sizes: Its sizes, by their names without ``SF_``.
        records: Records of the library, by their types and names.
    """
    lines = [f"#define SF_{name} {size}" for name, size in sizes.items()]
    lines.append(f'#include "{header}"')
    for declared, record in records.items():
        assert record.dtype.fields is not None
        places = record.dtype.fields
        lines += ["", f"static const {declared} = {{"]
        # C++ complains of fields in another order or left out, C of braces with nothing in them.
        for name in sorted(places, key=lambda field: places[field][1]):
            values = record[name].ravel().tolist()
            numbers = ", ".join("HUGE_VAL" if value == inf else repr(value) for value in values) or "0"
            lines.append(
                f"    .{name} = {{{numbers}}}," if record[name].ndim else f"    .{name} = {numbers},"
            )
        lines.append("};")
    return "\n".join([*lines, ""])
