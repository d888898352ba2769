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
"""Least and greatest value of leaves by the last part, or the last two, of their names. ``None`` allows NaN
and infinity, which some leaves of emulated devices hold before the first sample."""

LARGEST = 2.0**53
"""Magnitude beyond which a float64 does not resolve single counts: no number of a robot is as large."""

_ANY = (-LARGEST, LARGEST)
_NO_LIMITS: Limits = MappingProxyType({})
_FLAGS: Limits = {"status": (0, ALL_FLAGS), "kind": (0, ALL_FLAGS)}
_LARGEST_FILE = 2**28  # bytes of a saved state of many robots
_ROOM, _HEADER = 2**20, 256  # bytes of a file besides the numbers: notes, and what an array says of itself


def save_state(path: AnyPath, state: Any, limits: Limits = _NO_LIMITS, /, **notes: str) -> None:
    """Write a state of an online method, and notes that :func:`load_state` compares, to a file.

    ValueError if a leaf is beyond its limits, such as those of an
    :class:`~surefoot.calibration.setup.OnlineMethod`, or the path is not that of a regular file. A file that
    exists is then left unchanged.
    """
    leaves = {name: np.asarray(leaf) for name, leaf in _leaves(state).items()}
    check_leaves(leaves, limits, f"Nothing was written to '{path}'")
    texts = {f"note.{name}": np.asarray(text) for name, text in notes.items()}
    entries: dict[str, Any] = texts | {f"state.{name}": leaf for name, leaf in leaves.items()}
    with atomic_path(path) as part, part.open("wb") as file:
        np.savez(file, format=np.asarray(_FORMAT), **entries)


LARGEST_MASS_CHANGE = 0.2
"""Share by which a robot's mass may differ from that of a saved state: a battery, a payload, other shoes."""


def mass_share(path: AnyPath, now: float) -> float:
    """Return the mass for which a state was saved, by its note ``mass``, as a share of the present one in kg.

    Warns if they differ; ValueError if they differ by so much that the state is another robot's.
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
            f"{100 * LARGEST_MASS_CHANGE:.0f} % apart, it is another robot's. Give 'mass' in kg, or "
            "calibrate afresh."
        )
    warnings.warn(
        f"'{path}' was saved when the robot had a mass of {saved:g} kg, and now it has {now:g} kg. The map "
        "of its channels is kept, and what was learnt of the mass and the centre of mass begins again.",
        stacklevel=3,
    )
    return saved / now


def load_state(path: AnyPath, like: Any, limits: Limits = _NO_LIMITS, /, **notes: str) -> Any:
    """Read a state that :func:`save_state` wrote.

    ``like`` is a state of the same method and setup, such as a fresh one; it is not changed. Shapes, dtypes
    and notes must be the same. FileNotFoundError if there is no such file; ValueError if it does not hold a
    state, or one of another method or setup, or numbers that are impossible in a state.
    """
    wanted = {name: np.asarray(leaf) for name, leaf in _leaves(like).items()}
    # A state that is up to twice as large is read, so that the message names what does not fit.
    largest = sum(2 * leaf.nbytes + _HEADER for leaf in wanted.values()) + _ROOM
    try:
        entries = read_arrays(path, largest)
    except ValueError as error:
        if error.__cause__ is None:
            raise  # No file at all.
        raise ValueError(
            f"'{path}' is not a saved state: it is another file or damaged ({error.__cause__}); "
            "give one that save() wrote."
        ) from error
    if str(entries.get("format")) != _FORMAT:
        raise ValueError(f"'{path}' is not a saved state: it lacks the mark '{_FORMAT}'.")
    _check_notes(path, entries, notes)
    leaves = {name[6:]: entry for name, entry in entries.items() if name.startswith("state.")}
    here, there = _robots(wanted), _robots(leaves)
    if here != there:
        raise ValueError(f"'{path}' is of {there} robot(s), and this is of {here}; load it into as many.")
    if set(wanted) != set(leaves):
        odd = sorted(set(wanted) ^ set(leaves))
        raise ValueError(
            f"'{path}' holds the state of another method or of another version of surefoot: {odd} are not "
            "in both. Calibrate afresh."
        )
    for name, expected in wanted.items():
        found = leaves[name]
        if expected.shape != found.shape or expected.dtype != found.dtype:
            raise ValueError(
                f"'{name}' in '{path}' has shape {found.shape} and dtype {found.dtype}, but this state needs "
                f"{expected.shape} and {expected.dtype}: layout, lag, window and surefoot must be "
                "as they were when it was saved."
            )
    check_leaves(leaves, limits, f"'{path}' is no state to go on with")
    return _rebuild(like, leaves, "")


def _check_notes(path: AnyPath, entries: Mapping[str, Any], notes: Mapping[str, str]) -> None:
    """Raise ValueError, which names all that differ, unless a file was saved with these texts."""
    different = []
    for name, text in notes.items():
        if f"note.{name}" not in entries:
            raise ValueError(
                f"'{path}' does not say for which {name} it was saved, and '{text}' is needed: it is of "
                "something else, or of another version of surefoot. Calibrate afresh."
            )
        saved = str(entries[f"note.{name}"])
        if saved != text:
            different.append(f"{name} '{saved}', but this is '{text}'")
    if different:
        raise ValueError(f"'{path}' was saved for {'; for '.join(different)}.")


def _robots(leaves: Mapping[str, Any]) -> int:
    """Return the number of robots. Names of leaves begin with a robot's number if there are several."""
    return max(1, len({name.partition(".")[0] for name in leaves if name[0].isdigit()}))


def check_leaves(leaves: Mapping[str, NDArray[Any]], limits: Limits, refusal: str) -> None:
    """Raise ValueError at a leaf that is impossible in a state; the message begins with ``refusal``.

    Leaves are arrays by their names, with the robots along the first axis if there are many. Limits are those
    of :func:`save_state`.
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
            at = tuple(int(place) for place in np.argwhere(wrong)[0])
            least, most = (float(np.broadcast_to(end, leaf.shape)[at]) for end in (low, high))
            problem = f"holds {leaf[at]:.4g}{f' at {at}' * bool(at)}, and {least:.4g} to {most:.4g} can be"
        elif last.endswith("covariance") and leaf.ndim > 1 and leaf.shape[-1] == leaf.shape[-2]:
            problem = _covariance_problem(leaf)
        if problem:
            raise ValueError(f"{refusal}: '{name}' {problem}. Calibrate afresh, or load an older file.")


def _covariance_problem(matrix: NDArray[Any]) -> str:
    """Return why a matrix is not a covariance; empty if it is one within rounding errors."""
    rounding = np.sqrt(np.finfo(matrix.dtype).eps) * np.abs(matrix).max()
    if np.abs(matrix - np.swapaxes(matrix, -1, -2)).max() > rounding:
        return "is not symmetric, as a covariance is"
    least = np.linalg.eigvalsh(matrix).min()
    return f"has the variance {least:.4g}, which is less than none" if least < -rounding else ""


def _branches(state: Any) -> dict[str, Any] | None:
    """Name the parts of a tuple or a ``NamedTuple``; ``None`` for a leaf."""
    if not isinstance(state, tuple):
        return None
    names = getattr(state, "_fields", range(len(state)))
    return {str(name): part for name, part in zip(names, state, strict=True)}


def _leaves(state: Any, path: str = "") -> dict[str, Any]:
    """List the leaves of a state by their paths; ``None`` is no leaf."""
    branches = _branches(state)
    if branches is None:
        return {} if state is None else {path: state}
    result: dict[str, Any] = {}
    for name, part in branches.items():
        result |= _leaves(part, f"{path}.{name}" if path else name)
    return result


def _rebuild(like: Any, leaves: dict[str, Floats], path: str) -> Any:
    """Put leaves back into a tree of the same form."""
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
