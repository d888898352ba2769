"""Files are written completely or not at all, and read with limits on their size.

:func:`atomic_path` writes to a temporary file in the same folder and renames it, so that a full disk or a
killed process never damages the old file. Only regular files are replaced, because a rename would also
replace a device. The temporary file is locked while it is written. If it is not locked, a killed process
left it behind, and the next save to the target removes it.

The readers check sizes before contents: of a file, of an unpacked archive, and of an array by its header.
"""

import csv
import json
import os
import shutil
import stat
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import prod
from os import PathLike
from pathlib import Path
from secrets import token_hex
from typing import Any

import numpy as np
from numpy.typing import NDArray

AnyPath = str | PathLike[str]

LARGEST_TEXT = 2**26
"""Largest size of a text file in bytes. Descriptions, plans and a motion of an hour are smaller."""

DEEPEST = 64
"""Maximum nesting depth. The formats of this package use fewer than ten levels."""

_OWN = 50
"""Letters of the target's name in the name of the temporary file, which has at most 255 bytes."""


@contextmanager
def atomic_path(path: AnyPath) -> Iterator[Path]:
    """Yield a temporary path, and rename the finished file into place, or remove it after an error.

    Folders are created. If the path is a link, its target is replaced. Raises ValueError if the path is not a
    regular file, OSError if it cannot be written. The old file is unchanged then.
    """
    target = Path(os.path.realpath(_as_path(path)))
    there = stat_of_file(path)
    if there is not None and not os.access(target, os.W_OK):
        raise PermissionError(f"'{path}' is write-protected: nothing was written.")
    target.parent.mkdir(parents=True, exist_ok=True)
    start = f".{target.stem[:_OWN]}."
    for left in target.parent.iterdir():
        if left.name.startswith(start) and left.name.endswith(f".part{target.suffix}"):
            _remove_left(left)
    part = target.with_name(f"{start}{token_hex(4)}.part{target.suffix}")
    file = os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        _lock(file)
        yield part
        with part.open("rb+") as written:
            os.fsync(written.fileno())
        if there is not None:
            shutil.copymode(target, part)
        if sys.platform == "win32":
            os.close(file)
            file = -1
        part.replace(target)
    finally:
        if file >= 0:
            os.close(file)
        part.unlink(missing_ok=True)


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file atomically in UTF-8, with the errors of :func:`atomic_path`."""
    with atomic_path(path) as part:
        part.write_text(text, encoding="utf-8")


@contextmanager
def lock_folder(folder: Path, refusal: Exception) -> Iterator[None]:
    """Lock a folder while this process uses it. In other processes the error ``refusal`` is raised."""
    folder.mkdir(parents=True, exist_ok=True)
    file = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        if _lock(file) is False:
            raise refusal
        yield
    finally:
        os.close(file)


def stat_of_file(path: AnyPath, refusal: type[ValueError] = ValueError) -> os.stat_result | None:
    """Return the status of a regular file, or None if it does not exist.

    Raises the ``refusal`` for a folder or a device.
    """
    try:
        status = os.stat(_as_path(path))
    except (FileNotFoundError, NotADirectoryError):
        return None
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a device, pipe or socket"
        raise refusal(f"'{path}' is {kind}, not a regular file; give the path of a file.")
    return status


def read_text(path: AnyPath, refusal: type[ValueError] = ValueError) -> str:
    """Return a text file in UTF-8, with or without a byte order mark.

    Raises the ``refusal`` if the file does not exist, is not a regular file, is larger than
    :data:`LARGEST_TEXT`, or is not UTF-8.
    """
    target = Path(_as_path(path))
    name = target.name or str(path)
    there = stat_of_file(path, refusal)
    if there is None:
        raise refusal(f"{path}: no such file.")
    if there.st_size > LARGEST_TEXT:
        raise refusal(f"{name}: has {there.st_size} bytes; a text file has at most {LARGEST_TEXT}.")
    try:
        return target.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise refusal(f"{name}: not a text in UTF-8 ({error}); save it as UTF-8.") from None


def read_json(path: AnyPath, refusal: type[ValueError] = ValueError) -> Any:
    """Read a JSON file, with the errors of :func:`read_text` and :func:`parse_json`."""
    return parse_json(read_text(path, refusal), Path(path).name, refusal)


def parse_json(text: str | bytes, name: str, refusal: type[ValueError] = ValueError) -> Any:
    """Parse a JSON text that messages call ``name``.

    Raises the ``refusal`` if it is not JSON, or nested more than :data:`DEEPEST` levels deep.
    """
    try:
        return _shallow(json.loads(text))
    except (ValueError, RecursionError) as error:
        raise refusal(f"{name}: not JSON: {_said(error)}.") from None


def read_toml(path: AnyPath, refusal: type[ValueError] = ValueError) -> dict[str, Any]:
    """Read a TOML file. Raises the errors of :func:`read_text`, and the ``refusal`` if it is not TOML."""
    text = read_text(path, refusal)
    try:
        found: dict[str, Any] = _shallow(tomllib.loads(text))
    except (ValueError, RecursionError) as error:
        raise refusal(f"{Path(path).name}: not TOML: {_said(error)}.") from None
    return found


def read_columns(path: AnyPath, wanted: tuple[str, ...], cure: str) -> dict[str, NDArray[np.float64]]:
    """Return the columns of a CSV file of finite numbers by their names, shape (rows,) each.

    Raises the errors of :func:`read_text`. Raises ValueError with the advice ``cure`` if a ``wanted`` column
    is missing, a column occurs twice, a row has a different length than the names, or a cell is not a finite
    number.
    """

    def refusal(message: str) -> ValueError:
        return ValueError(f"{path}{message}; {cure}.")

    text = read_text(path)
    try:
        names, *rows = csv.reader(text.splitlines())
    except (ValueError, csv.Error):
        raise refusal(": not a table: it needs a line of column names") from None
    if missing := [column for column in wanted if column not in names]:
        raise refusal(f" lacks the columns {missing}")
    if len(set(names)) < len(names):
        raise refusal(" has a column twice")
    for line, row in enumerate(rows, 2):
        if len(row) != len(names):
            raise refusal(f": line {line} has {len(row)} cells for {len(names)} columns")
    try:
        table = np.array(rows, dtype=np.float64).reshape(-1, len(names))
    except ValueError as error:
        raise refusal(f": {error}") from None
    if not np.isfinite(table).all():
        line, column = np.argwhere(~np.isfinite(table))[0]
        raise refusal(f": column '{names[column]}' is not finite in line {line + 2}")
    return dict(zip(names, table.T, strict=True))


def read_arrays(path: AnyPath, largest: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` by their names. Nothing in the file is executed.

    Raises FileNotFoundError if the file does not exist. Raises ValueError if it is not a regular file or not
    such an archive, or if its arrays need more than ``largest`` bytes, which is checked before unpacking.
    """
    found: dict[str, NDArray[Any]] = {}
    with _archive(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
        if size > largest:
            raise ValueError(f"it unpacks to {size} bytes, and {largest} are the most")
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if name in found:
                raise ValueError(f"'{name}' is there twice")
            found[name] = _array_of(archive, member, name)
    return found


def names_in_archive(path: AnyPath) -> list[str]:
    """Return the names of the files in an archive, with the errors of :func:`read_arrays`."""
    with _archive(path) as archive:
        return archive.namelist()


@contextmanager
def _archive(path: AnyPath) -> Iterator[zipfile.ZipFile]:
    """Open an archive, and raise errors inside the block as a ValueError that names the archive."""
    target = Path(_as_path(path))
    if stat_of_file(path) is None:
        raise FileNotFoundError(f"{path}: no such file.")
    with target.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                yield archive
        except Exception as error:  # Whatever a damaged archive raises.
            raise ValueError(f"'{path}' is no archive of arrays, or damaged: {_said(error)}.") from error


def _array_of(archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str) -> NDArray[Any]:
    """Return one array after checking its size against its header."""
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with archive.open(member) as file:
        shape, _, dtype = read_header[np.lib.format.read_magic(file)](file)
        if dtype.hasobject or prod(shape) * dtype.itemsize != member.file_size - file.tell():
            raise ValueError(f"'{name}' is no array, or not of the size that it says")
    with archive.open(member) as file:
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _as_path(path: Any) -> str:
    """Return a path as a str, or raise TypeError, for example for an int (the number of an open file)."""
    if not isinstance(path, str | PathLike):
        raise TypeError(f"A path must be a str or a Path, got {path!r} of {type(path).__name__}.")
    if "\0" in (text := os.fspath(path)):
        raise ValueError(f"{text!r} cannot be the name of a file.")
    return text


def _lock(file: int) -> bool | None:
    """Lock an open file until it is closed.

    Returns True, False if another process has locked it, or None where files cannot be locked.
    """
    if sys.platform == "win32":
        return None
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None  # A file system without locks.
    return True


def _remove_left(part: Path) -> None:
    """Remove a temporary file of a killed process, but not one that is being written."""
    try:
        if sys.platform == "win32":
            part.unlink()  # Refused while it is open.
            return
        file = os.open(part, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return
    try:
        if _lock(file):
            part.unlink(missing_ok=True)
    finally:
        os.close(file)


def _shallow(data: Any) -> Any:
    """Return the data, or raise RecursionError if they are nested more than :data:`DEEPEST` levels deep."""
    level = [data]
    for _ in range(DEEPEST):
        inner = [list(one.values()) if isinstance(one, dict) else one for one in level]
        level = [part for one in inner if isinstance(one, list) for part in one]
        if not level:
            return data
    raise RecursionError


def _said(error: Exception) -> str:
    """Return the message of an error in one line."""
    if isinstance(error, RecursionError):
        return f"it is nested more than {DEEPEST} levels deep"
    return (str(error).splitlines() or [type(error).__name__])[0].rstrip(".")
