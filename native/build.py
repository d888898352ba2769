"""Compile the libraries, during installation or with ``python -m surefoot.native``.

This module needs only the standard library, because ``setup.py`` runs it before the package is installed.
"""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).resolve().parent
"""Folder of the C code: headers, and one source file per library that includes them."""

FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fvisibility=hidden")
"""Contraction is off because it would make rounding depend on the machine."""

SMALLER = {
    "calibration": ("-DSF_CHANNELS=8", "-DSF_FEET=2", "-DSF_COMPONENTS=3", "-DSF_TALKS=0", "-DSF_BLOCK=16")
}
"""Sizes of a package's second library, with smaller records for two feet with up to four cells each."""

PLATFORMS = {
    "manylinux_2_17_x86_64.manylinux2014_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux_2_17_aarch64.manylinux2014_aarch64": "aarch64-linux-gnu.2.17",
    "macosx_11_0_x86_64": "x86_64-macos.11.0",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "win_amd64": "x86_64-windows-gnu",
}
"""Platforms for which any machine can build wheels, and their names for ziglang's compiler."""

_ZIG = (sys.executable, "-m", "ziglang", "cc")

COMPILER = 'ziglang>=0.14; platform_machine in "x86_64 AMD64 aarch64 arm64"'
"""Requirement for a compiler package if the system has no compiler, on the platforms that it supports."""


def compiler(platform: str | None = None) -> tuple[str, ...] | None:
    """Return the command of a C compiler, or ``None`` if there is none.

    The compiler is that of ``CC``, the system's ``cc``, ``gcc`` or ``clang``, or the package ziglang.

    Args:
        platform: One of :data:`PLATFORMS` (compiled by ziglang), by default this machine.
    """
    zig = _ZIG if find_spec("ziglang") else None
    if platform is not None:
        return zig and (*zig, "-target", PLATFORMS[platform])
    for words in (shlex.split(os.environ.get("CC", "")), ["cc"], ["gcc"], ["clang"]):
        if words and (program := shutil.which(words[0])):
            return (program, *words[1:])
    return zig


def requirements() -> list[str]:
    """Return the packages needed to compile: none with a compiler, or if ``SUREFOOT_NATIVE`` is 0."""
    return [] if compiler() or os.environ.get("SUREFOOT_NATIVE") == "0" else [COMPILER]


def ending(platform: str | None = None) -> str:
    """Return the suffix of library files. The argument is that of :func:`compiler`."""
    windows = platform.startswith("win") if platform else sys.platform == "win32"
    return ".dll" if windows else ".so"


class Sources(NamedTuple):
    """The source file of one library, which includes the headers of the same folder."""

    path: Path  # the source file, named after the package
    sizes: tuple[str, ...] = ()  # compiler options that set the sizes of records

    @property
    def name(self) -> str:
        """Name of the library without a suffix."""
        return f"surefoot_{self.path.stem}" + ("_cells" if self.sizes else "")

    @property
    def smaller(self) -> "Sources | None":
        """The sources of the library with smaller records, or ``None``."""
        sizes = SMALLER.get(self.path.stem)
        return None if sizes is None or self.sizes else Sources(self.path, sizes)

    @property
    def library(self) -> Path:
        """Path of the compiled library, in the folder of its sources."""
        return self.path.with_name(self.name + ending())

    def fingerprint(self, flags: Sequence[str] = FLAGS) -> str:
        """Return the hash of the present sources and compiler flags, which a library must contain."""
        files = (self.path, *sorted(self.path.parent.glob("*.h")))
        parts = (" ".join((*flags, *self.sizes)).encode(), *(path.read_bytes() for path in files))
        return sha256(b"".join(parts)).hexdigest()[:16]

    def compile(
        self, target: Path | None = None, flags: Sequence[str] = FLAGS, platform: str | None = None
    ) -> str | None:
        """Compile the library. Return ``None``, or one line with the reason of a failure.

        Args:
            target: Path of the library, by default in the folder of the sources.
            flags: Options of the compiler.
            platform: The target platform, see :func:`compiler`.
        """
        program = compiler(platform)
        if program is None:
            if platform:
                return "the package ziglang, which compiles for other platforms, is not installed"
            return "there is no C compiler (cc, gcc, clang or what CC says)"
        target = target or self.library
        # The file is replaced atomically, so that running programs keep the library that they have loaded.
        fresh = target.with_name(f"{target.name}.{os.getpid()}")
        source = [
            "-shared",
            # Code on Windows is always position independent. Wheels do not contain debugging symbols.
            *(() if ending(platform) == ".dll" else ("-fPIC",)),
            *(("-s",) if platform else ()),
            f'-DSF_SOURCE="{self.fingerprint(flags)}"',
            *self.sizes,
            "-o",
            str(fresh),
            str(self.path),
            "-lm",
        ]
        try:
            done = subprocess.run([*program, *flags, *source], capture_output=True, text=True, check=False)
            if done.returncode:
                complaint = (done.stderr.strip() or f"status {done.returncode}").splitlines()[0]
                return f"{shlex.join(program)} refused: {complaint}"
            fresh.replace(target)
        except OSError as error:
            return f"{shlex.join(program)} could not be run: {error}"
        finally:
            fresh.unlink(missing_ok=True)
            # The import library for linkers on Windows, which is not used.
            target.with_name(f"{self.path.stem}.lib").unlink(missing_ok=True)
        return None


def sources_below(root: Path = FOLDER.parent) -> Iterator[Sources]:
    """Yield the sources of each library in the subfolder ``native`` of a folder, sorted by name."""
    for path in sorted(root.glob("native/*.c")):
        sources = Sources(path)
        yield sources
        if sources.smaller is not None:
            yield sources.smaller
