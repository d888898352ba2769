"""Keeping the state of an online method: to a file and back without losing a bit.

A state is a tree of tuples, mostly named, with arrays and numbers at its leaves. The file is a plain
``.npz`` with one entry a leaf, named by its path such as ``"front.raw"``, and no pickles.
"""

import os
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.setup import OLD_NAMES

_FORMAT = "surefoot-state-1"


def save_state(path: str | PathLike[str], state: Any, **notes: str) -> None:
    """Write a state to a file.

    Args:
        path: Where to; the name is used as it is given.
        state: The state of an online method.
        notes: Texts to keep with it, checked again by :func:`load_state`.
    """
    leaves = {f"state.{name}": np.asarray(leaf) for name, leaf in _leaves(state).items()}
    texts = {f"note.{name}": np.asarray(text) for name, text in notes.items()}
    # Replaced in one step: whoever is interrupted while writing keeps the file that was there.
    temporary = f"{os.fspath(path)}.{os.getpid()}.tmp"
    try:
        with open(temporary, "wb") as file:
            np.savez(file, format=np.asarray(_FORMAT), **texts, **leaves)  # type: ignore[arg-type]
        os.replace(temporary, path)
    except BaseException:
        if os.path.exists(temporary):
            os.remove(temporary)
        raise


def load_state(path: str | PathLike[str], like: Any, **notes: str) -> Any:
    """Read a state from a file.

    Args:
        path: A file that :func:`save_state` wrote.
        like: A state of the same method and setup, such as a fresh one, which says what must fit. It is
            not changed.
        notes: Texts that must be as they were saved; under ``method`` an old name of the method is accepted.

    Returns:
        The saved state.

    Raises:
        ValueError: If the file is no state, or not one of this method, shape and dtype.
    """
    entries = _read(path)
    if str(entries.get("format")) != _FORMAT:
        raise ValueError(f"'{path}' is not a saved state: it lacks the mark '{_FORMAT}'.")
    for name, text in notes.items():
        saved = str(entries.get(f"note.{name}", "nothing"))
        if name == "method":
            method, space, options = saved.partition(" ")
            saved = OLD_NAMES.get(method, method) + space + options
        if saved != text:
            raise ValueError(f"'{path}' was saved for {name} '{saved}', but this is '{text}'.")
    saved_leaves = {name[6:]: entry for name, entry in entries.items() if name.startswith("state.")}
    wanted = _leaves(like)
    if set(wanted) != set(saved_leaves):
        odd = sorted(set(wanted) ^ set(saved_leaves))
        raise ValueError(
            f"'{path}' holds the state of another method or of another version of surefoot: {odd} are not "
            "in both. Calibrate afresh."
        )
    for name, leaf in wanted.items():
        expected, found = np.asarray(leaf), saved_leaves[name]
        if expected.shape != found.shape or expected.dtype != found.dtype:
            raise ValueError(
                f"'{name}' in '{path}' has shape {found.shape} and dtype {found.dtype}, but this state needs "
                f"{expected.shape} and {expected.dtype}: layout, lag and window must be as they were saved."
            )
    return _rebuild(like, saved_leaves, "")


def _read(path: str | PathLike[str]) -> dict[str, NDArray[Any]]:
    """Read all entries of a file."""
    # Opened here, as NumPy leaves a damaged archive open.
    with open(path, "rb") as opened:
        try:
            file = np.load(opened, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise ValueError("it holds a single array")
            with file:
                return {name: file[name] for name in file.files}
        except Exception as error:  # Whatever a damaged archive raises; nothing of it is executed.
            raise ValueError(
                f"'{path}' is not a saved state: it is another file or damaged; give one that save_state "
                "wrote."
            ) from error


def _branches(state: Any) -> dict[str, Any] | None:
    """Name what a tuple or a ``NamedTuple`` holds; ``None`` for a leaf."""
    if not isinstance(state, tuple):
        return None
    names = getattr(state, "_fields", range(len(state)))
    return {str(name): part for name, part in zip(names, state, strict=True)}


def _leaves(state: Any, path: str = "") -> dict[str, Any]:
    """List the leaves of a state by their paths; what is ``None`` is none."""
    branches = _branches(state)
    if branches is None:
        return {} if state is None else {path: state}
    result: dict[str, Any] = {}
    for name, part in branches.items():
        result |= _leaves(part, f"{path}.{name}" if path else name)
    return result


def _rebuild(like: Any, leaves: dict[str, NDArray[Any]], path: str) -> Any:
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
