"""Save the state of an online method to a file, and read it back without loss.

A state is a tree of tuples, mostly named, with arrays and numbers at its leaves. The file is a plain
``.npz`` without pickles. It has one entry for each leaf, named by the leaf's path such as ``"front.raw"``.

Saving and loading check a state by the same rules: shapes and dtypes, finite numbers, valid covariances, and
the limits that a method sets on its numbers. A diverged state therefore does not replace a good file, and an
edited file does not reach a robot.
"""

import warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.arrays import Floats
from surefoot.calibration.estimate import ALL_FLAGS
from surefoot.files import AnyPath, atomic_path, read_arrays

_FORMAT = "surefoot-state-1"

Limits = Mapping[str, tuple[ArrayLike, ArrayLike] | None]
"""Smallest and largest values of leaves by the last part, or the last two parts, of their names. ``None``
allows NaN and infinity, which some leaves of emulated devices hold before the first sample."""

LARGEST = 2.0**53
"""Magnitude above which a float64 does not resolve single counts. No number of a robot is as large."""

_ANY = (-LARGEST, LARGEST)
_NO_LIMITS: Limits = MappingProxyType({})
_FLAGS: Limits = {"status": (0, ALL_FLAGS), "kind": (0, ALL_FLAGS)}
_LARGEST_FILE = 2**28  # bytes of a saved state of many robots
_ROOM, _HEADER = 2**20, 256  # bytes of a file in addition to the numbers: notes, and the header of an array


def save_state(path: AnyPath, state: Any, limits: Limits = _NO_LIMITS, /, **notes: str) -> None:
    """Write a state of an online method, and notes that :func:`load_state` compares, to a file.

    ValueError if a leaf is outside its limits, such as those of an
    :class:`~surefoot.calibration.setup.OnlineMethod`, or the path is not that of a regular file. An existing
    file is then left unchanged.
    """
    leaves = {name: np.asarray(leaf) for name, leaf in _leaves(state).items()}
    check_leaves(leaves, limits, f"Nothing was written to '{path}'")
    texts = {f"note.{name}": np.asarray(text) for name, text in notes.items()}
    entries: dict[str, Any] = texts | {f"state.{name}": leaf for name, leaf in leaves.items()}
    with atomic_path(path) as part, part.open("wb") as file:
        np.savez(file, format=np.asarray(_FORMAT), **entries)


LARGEST_MASS_CHANGE = 0.2
"""Largest relative difference between a robot's mass and that of a saved state (battery, payload, shoes)."""


def mass_share(path: AnyPath, now: float) -> float:
    """Return the mass noted in a saved state as a share of the present mass in kg.

    Warns if they differ. ValueError if they differ by so much that the state belongs to another robot.
    """
    text = read_arrays(path, _LARGEST_FILE).get("note.mass")
    try:
        saved = now if text is None else float(str(text))
    except ValueError:
        raise ValueError(f"'{path}' has the mass '{text}', which is not a number: it was changed.") from None
    if saved == now:
        return 1.0
    if not abs(saved / now - 1.0) <= LARGEST_MASS_CHANGE:
        raise ValueError(
            f"'{path}' was saved for mass '{saved:g}' kg, but this is '{now:g}' kg: more than "
            f"{100 * LARGEST_MASS_CHANGE:.0f} % apart, it belongs to another robot. Give 'mass' in kg, or "
            "calibrate again."
        )
    warnings.warn(
        f"'{path}' was saved when the robot had a mass of {saved:g} kg, and now it has {now:g} kg. The map "
        "of its channels is kept. The estimates of the mass and the centre of mass start again.",
        stacklevel=3,
    )
    return saved / now


def load_state(path: AnyPath, like: Any, limits: Limits = _NO_LIMITS, /, **notes: str) -> Any:
    """Read a state that :func:`save_state` wrote.

    ``like`` is a state of the same method and setup, such as an initial one. It is not changed. Shapes,
    dtypes and notes must be the same. FileNotFoundError if there is no such file. ValueError if it does not
    hold a state, holds one of another method or setup, or holds implausible numbers.
    """
    templates = {name: np.asarray(leaf) for name, leaf in _leaves(like).items()}
    # States of up to twice the size are read, so that the message can name the part that does not fit.
    largest = sum(2 * leaf.nbytes + _HEADER for leaf in templates.values()) + _ROOM
    try:
        entries = read_arrays(path, largest)
    except ValueError as error:
        if error.__cause__ is None:
            raise  # There is no such file.
        raise ValueError(
            f"'{path}' is not a saved state: it is another file or damaged ({error.__cause__}); "
            "give one that save() wrote."
        ) from error
    if str(entries.get("format")) != _FORMAT:
        raise ValueError(f"'{path}' is not a saved state: it lacks the mark '{_FORMAT}'.")
    _check_notes(path, entries, notes)
    leaves = {name[6:]: entry for name, entry in entries.items() if name.startswith("state.")}
    robots, saved_robots = _robots(templates), _robots(leaves)
    if robots != saved_robots:
        raise ValueError(
            f"'{path}' holds the state of {saved_robots} robot(s), but there are {robots}; load it into the "
            "same number of robots."
        )
    if set(templates) != set(leaves):
        different = sorted(set(templates) ^ set(leaves))
        raise ValueError(
            f"'{path}' holds the state of another method or of another version of surefoot: {different} are "
            "not in both. Calibrate again."
        )
    for name, template in templates.items():
        leaf = leaves[name]
        if template.shape != leaf.shape or template.dtype != leaf.dtype:
            raise ValueError(
                f"'{name}' in '{path}' has shape {leaf.shape} and dtype {leaf.dtype}, but this state needs "
                f"{template.shape} and {template.dtype}: layout, lag, window and the version of surefoot "
                "must be the same as when it was saved."
            )
    check_leaves(leaves, limits, f"'{path}' cannot be loaded")
    return _rebuild(like, leaves, "")


def _check_notes(path: AnyPath, entries: Mapping[str, Any], notes: Mapping[str, str]) -> None:
    """Raise ValueError, which names all differences, unless a file was saved with these notes."""
    different = []
    for name, text in notes.items():
        if f"note.{name}" not in entries:
            raise ValueError(
                f"'{path}' has no note of its {name}, and '{text}' is needed: it belongs to another setup "
                "or to another version of surefoot. Calibrate again."
            )
        saved = str(entries[f"note.{name}"])
        if saved != text:
            different.append(f"{name} '{saved}', but this is '{text}'")
    if different:
        raise ValueError(f"'{path}' was saved for {'; for '.join(different)}.")


def _robots(leaves: Mapping[str, Any]) -> int:
    """Return the number of robots: names of leaves begin with a robot's number if there are several."""
    return max(1, len({name.partition(".")[0] for name in leaves if name[0].isdigit()}))


def check_leaves(leaves: Mapping[str, NDArray[Any]], limits: Limits, refusal: str) -> None:
    """Raise ValueError, whose message begins with ``refusal``, if a leaf is implausible in a state.

    Leaves are arrays by their names, with robots on the first axis if there are many. Limits are those of
    :func:`save_state`.
    """
    for name, leaf in leaves.items():
        if leaf.dtype.kind not in "iuf" or not leaf.size:
            continue
        last, two = name.rpartition(".")[2], ".".join(name.split(".")[-2:])
        stated = limits[two] if two in limits else limits.get(last, _FLAGS.get(last, _ANY))
        low, high = stated or _ANY
        wrong = ~((leaf >= low) & (leaf <= high)) & (np.isfinite(leaf) | (stated is not None))
        problem = ""
        if wrong.any():
            index = tuple(int(axis) for axis in np.argwhere(wrong)[0])
            lowest, highest = (float(np.broadcast_to(end, leaf.shape)[index]) for end in (low, high))
            place = f" at {index}" if index else ""
            problem = f"is {leaf[index]:.4g}{place}, outside {lowest:.4g} to {highest:.4g}"
        elif last.endswith("covariance") and leaf.ndim > 1 and leaf.shape[-1] == leaf.shape[-2]:
            problem = _covariance_problem(leaf)
        if problem:
            raise ValueError(f"{refusal}: '{name}' {problem}. Calibrate again, or load an older file.")


def _covariance_problem(matrix: NDArray[Any]) -> str:
    """Return why a matrix is not a covariance, or "" if it is one within rounding errors."""
    rounding = np.sqrt(np.finfo(matrix.dtype).eps) * np.abs(matrix).max()
    if np.abs(matrix - np.swapaxes(matrix, -1, -2)).max() > rounding:
        return "is not symmetric, as a covariance is"
    smallest = np.linalg.eigvalsh(matrix).min()
    return f"has the negative eigenvalue {smallest:.4g}" if smallest < -rounding else ""


def _branches(state: Any) -> dict[str, Any] | None:
    """Return the parts of a tuple or ``NamedTuple`` by their names, or ``None`` for a leaf."""
    if not isinstance(state, tuple):
        return None
    names = getattr(state, "_fields", range(len(state)))
    return {str(name): part for name, part in zip(names, state, strict=True)}


def _leaves(state: Any, path: str = "") -> dict[str, Any]:
    """Return the leaves of a state by their paths, without parts that are ``None``."""
    branches = _branches(state)
    if branches is None:
        return {} if state is None else {path: state}
    result: dict[str, Any] = {}
    for name, part in branches.items():
        result |= _leaves(part, f"{path}.{name}" if path else name)
    return result


def _rebuild(like: Any, leaves: dict[str, Floats], path: str) -> Any:
    """Return a tree of the same form with these leaves."""
    branches = _branches(like)
    if branches is not None:
        parts = (
            _rebuild(part, leaves, f"{path}.{name}" if path else name) for name, part in branches.items()
        )
        return type(like)(*parts) if hasattr(like, "_fields") else tuple(parts)
    if like is None:
        return None
    value = leaves[path]
    return value if isinstance(like, np.ndarray | np.generic) else type(like)(value)
