"""The compiled library: where it is found, and how its records are laid out."""

import ctypes
import logging
import os
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from surefoot.calibration.native.build import LIBRARY, fingerprint

SWITCH = "SUREFOOT_NATIVE"
"""Environment variable that turns the library off if it is 0."""

_BY_HAND = "python -m surefoot.calibration.native"


class _Place(ctypes.Structure):
    _fields_ = (
        ("record", ctypes.c_char_p),
        ("field", ctypes.c_char_p),
        ("kind", ctypes.c_char_p),
        ("offset", ctypes.c_size_t),
        ("size", ctypes.c_size_t),
    )


class Library(NamedTuple):
    """A library that was loaded.

    Attributes:
        functions: Its functions.
        real: The dtype of its numbers.
        places: Kind, offset and size in bytes of each field, by record and field; of a whole record under "".
    """

    functions: Any
    real: np.dtype[Any]
    places: dict[str, dict[str, tuple[str, int, int]]]

    def record(self, name: str, shapes: dict[str, tuple[int, ...]]) -> np.dtype[Any] | None:
        """Return the dtype of a record whose fields are as large as here; ``None`` if one has no room.

        Args:
            name: ``config``, ``state``, ``reference`` or ``estimate``.
            shapes: The shape of each field.
        """
        kinds: dict[str, np.dtype[Any]] = {
            "int": np.dtype(np.int32),
            "whole": np.dtype(np.int64),
            "byte": np.dtype(np.bool_),
        }
        places, formats = self.places[name], []
        for field, shape in shapes.items():
            kind, _, size = places[field]
            dtype = kinds.get(kind, self.real)
            if int(np.prod(shape)) * dtype.itemsize > size:
                return None
            formats.append((dtype, shape))
        offsets = [places[field][1] for field in shapes]
        return np.dtype(
            {"names": list(shapes), "formats": formats, "offsets": offsets, "itemsize": places[""][2]}
        )


def load(path: Path, source: str | None = None) -> Library:
    """Load a library.

    Args:
        path: The file.
        source: The fingerprint that it must have; any by default.

    Raises:
        OSError: If there is no such file, or it is none of this package.
    """
    functions = ctypes.CDLL(str(path))
    pointer = ctypes.c_void_p
    try:
        functions.surefoot_source.restype = ctypes.c_char_p
        functions.surefoot_places.restype = ctypes.POINTER(_Place)
        functions.surefoot_places_count.restype = functions.surefoot_real_size.restype = ctypes.c_size_t
        functions.surefoot_fits.argtypes = (pointer,)
        functions.surefoot_init.argtypes = functions.surefoot_retract.argtypes = (pointer, pointer)
        functions.surefoot_init.restype = functions.surefoot_retract.restype = None
        functions.surefoot_step.argtypes = (pointer, pointer, pointer, pointer, ctypes.c_double, pointer)
        functions.surefoot_step.restype = None
    except AttributeError as error:
        raise OSError(f"it is another library: {error}") from None
    if source is not None and functions.surefoot_source().decode() != source:
        raise OSError("it was compiled from other sources than those at hand")
    places: dict[str, dict[str, tuple[str, int, int]]] = {}
    for place in functions.surefoot_places()[: functions.surefoot_places_count()]:
        fields = places.setdefault(place.record.decode(), {})
        fields[place.field.decode()] = place.kind.decode(), place.offset, place.size
    return Library(functions, np.dtype(f"f{functions.surefoot_real_size()}"), places)


@cache
def installed() -> Library | None:
    """Return the library of this package; ``None``, with one line in the log, if it cannot be used."""
    if os.environ.get(SWITCH) == "0":
        return None
    problem = f"there is no {LIBRARY.name}"
    if LIBRARY.exists():
        try:
            return load(LIBRARY, fingerprint())
        except OSError as error:
            problem = f"{LIBRARY.name} cannot be used, {error}"
    logging.getLogger("surefoot").warning(
        "surefoot calibrates in Python, slower: %s; compile it with: %s", problem, _BY_HAND
    )
    return None
