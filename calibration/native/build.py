"""Compile the library: when surefoot is installed, or by hand with ``python -m surefoot.calibration.native``.

Nothing here needs more than Python itself, as ``setup.py`` runs it before there is a package.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
HEADER = FOLDER / "surefoot_calibration.h"
LIBRARY = FOLDER / ("surefoot_calibration" + (".dll" if sys.platform == "win32" else ".so"))

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fvisibility=hidden")
"""Contraction would round differently from machine to machine."""


def fingerprint() -> str:
    """Return what tells whether a library was compiled from the sources at hand."""
    sources = HEADER.read_bytes() + (FOLDER / "library.c").read_bytes()
    return sha256(sources).hexdigest()[:16]


def compiler() -> str | None:
    """Return the system's C compiler: what ``CC`` says, or ``cc``, ``gcc`` or ``clang``; ``None`` without."""
    return next(
        (
            found
            for name in (os.environ.get("CC"), "cc", "gcc", "clang")
            if name and (found := shutil.which(name))
        ),
        None,
    )


def compile_library(target: Path = LIBRARY, flags: Sequence[str] = FLAGS) -> str | None:
    """Compile the library; return ``None``, or in one line why it could not be.

    Args:
        target: Where to.
        flags: Options of the compiler.
    """
    program = compiler()
    if program is None:
        return "there is no C compiler (cc, gcc, clang or what CC says)"
    # Moved in one step: a program that runs keeps the library that it has.
    fresh = target.with_name(f"{target.name}.{os.getpid()}")
    source = [
        "-shared",
        "-fPIC",
        f'-DSF_SOURCE="{fingerprint()}"',
        "-o",
        str(fresh),
        str(FOLDER / "library.c"),
        "-lm",
    ]
    try:
        done = subprocess.run([program, *flags, *source], capture_output=True, text=True, check=False)
        if done.returncode:
            complaint = (done.stderr.strip() or f"status {done.returncode}").splitlines()[0]
            return f"{program} refused: {complaint}"
        fresh.replace(target)
    except OSError as error:
        return f"{program} could not be run: {error}"
    finally:
        fresh.unlink(missing_ok=True)
    return None
