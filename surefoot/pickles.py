"""Pickles are of one version: another one refuses them in plain words, before anything in them can fail."""

from functools import cache
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from typing import Any

_MARK = "_made"


@cache
def version() -> str:
    """Return the version of this package; "unknown" where it is copied beside a program."""
    try:
        return version_of("surefoot")
    except PackageNotFoundError:
        return "unknown"


class Made:
    """A mark that refuses to be unpickled by another version; it goes in front of all else in a pickle.

    Args:
        name: What is pickled.
        mark: What must be the same besides the version, such as that of a library.
    """

    def __init__(self, name: str, mark: str = "") -> None:
        self.name, self.mark = name, mark

    def __reduce__(self) -> tuple[Any, ...]:
        return _check, (self.name, version(), self.mark)


def _check(name: str, made: str, mark: str) -> Made:
    if made != version():
        refuse(name, f"surefoot {made}, and this is {version()}")
    return Made(name, mark)


def refuse(name: str, made: str) -> None:
    """Raise ValueError for a pickle that was made by something else.

    Args:
        name: What was pickled.
        made: What made it.
    """
    raise ValueError(
        f"This {name} was pickled by {made}. Pickles are of one version: unpickle it with that one and keep "
        "what it has learnt with its save(), or make a new one and calibrate afresh."
    )


class OfOneVersion:
    """The common part of classes whose pickles are of one version."""

    def __getstate__(self) -> dict[str, Any]:
        return {_MARK: Made(type(self).__name__), **vars(self)}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        if _MARK not in kept:
            refuse(type(self).__name__, f"an older surefoot, and this is {version()}")
        self.__dict__.update({name: part for name, part in kept.items() if name != _MARK})
