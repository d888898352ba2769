"""Compile libraries: when surefoot is installed, or by hand with ``python -m surefoot.native``.

Nothing here needs more than Python itself, as ``setup.py`` runs it before there is a package.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

SHARED = Path(__file__).resolve().parent
"""Where ``library.h`` lies, which every ``library.c`` includes."""

FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fvisibility=hidden")
"""Contraction would round differently from machine to machine."""


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


class Sources(NamedTuple):
    """The sources of one library: the folder ``native`` of a package, with ``library.c`` and its headers.

    Attributes:
        folder: The folder.
    """

    folder: Path

    @property
    def name(self) -> str:
        """Name of the library, without an ending."""
        return f"surefoot_{self.folder.parent.name}"

    @property
    def library(self) -> Path:
        """Where the library lies: beside its sources."""
        return self.folder / (self.name + (".dll" if sys.platform == "win32" else ".so"))

    def fingerprint(self) -> str:
        """Return what tells whether a library was compiled from the sources at hand."""
        found = (path for folder in (self.folder, SHARED) for path in sorted(folder.glob("*.[ch]")))
        return sha256(b"".join(path.read_bytes() for path in found)).hexdigest()[:16]

    def compile(self, target: Path | None = None, flags: Sequence[str] = FLAGS) -> str | None:
        """Compile the library; return ``None``, or in one line why it could not be.

        Args:
            target: Where to; by default beside the sources.
            flags: Options of the compiler.
        """
        program = compiler()
        if program is None:
            return "there is no C compiler (cc, gcc, clang or what CC says)"
        target = target or self.library
        # Moved in one step: a program that runs keeps the library that it has.
        fresh = target.with_name(f"{target.name}.{os.getpid()}")
        source = [
            "-shared",
            "-fPIC",
            f'-DSF_SOURCE="{self.fingerprint()}"',
            f"-I{SHARED}",
            "-o",
            str(fresh),
            str(self.folder / "library.c"),
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


def sources_below(root: Path) -> Iterator[Sources]:
    """Yield the sources of each library in a folder of packages, in the order of their names."""
    for path in sorted(root.glob("*/native/library.c")):
        yield Sources(path.parent)
