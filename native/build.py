"""Compile libraries: when surefoot is installed, or by hand with ``python -m surefoot.native``.

Nothing here needs more than Python itself, as ``setup.py`` runs it before there is a package.
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
"""Where all of the C lies: headers, and a source a library that includes them."""

FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fvisibility=hidden")
"""Contraction would round differently from machine to machine."""

SMALLER = {
    "calibration": ("-DSF_CHANNELS=8", "-DSF_FEET=2", "-DSF_COMPONENTS=3", "-DSF_TALKS=0", "-DSF_BLOCK=16")
}
"""Sizes of a package's second library, whose records are small: for two feet on up to four cells each."""


PLATFORMS = {
    "manylinux_2_17_x86_64.manylinux2014_x86_64": "x86_64-linux-gnu.2.17",
    "manylinux_2_17_aarch64.manylinux2014_aarch64": "aarch64-linux-gnu.2.17",
    "macosx_11_0_x86_64": "x86_64-macos.11.0",
    "macosx_11_0_arm64": "aarch64-macos.11.0",
    "win_amd64": "x86_64-windows-gnu",
}
"""Platforms of wheels that any machine can make, and what ziglang's compiler calls them."""

_ZIG = (sys.executable, "-m", "ziglang", "cc")

COMPILER = 'ziglang>=0.14; platform_machine in "x86_64 AMD64 aarch64 arm64"'
"""The package that compiles where the system has no compiler, on the platforms that it is published for."""


def compiler(platform: str | None = None) -> tuple[str, ...] | None:
    """Return the command of a C compiler; ``None`` without one.

    The compiler of ``CC``, or ``cc``, ``gcc`` or ``clang`` of the system, or that of the package ziglang.

    Args:
        platform: One of :data:`PLATFORMS`, for which ziglang compiles; this machine by default.
    """
    zig = _ZIG if find_spec("ziglang") else None
    if platform is not None:
        return zig and (*zig, "-target", PLATFORMS[platform])
    for words in (shlex.split(os.environ.get("CC", "")), ["cc"], ["gcc"], ["clang"]):
        if words and (program := shutil.which(words[0])):
            return (program, *words[1:])
    return zig


def requirements() -> list[str]:
    """Return the packages that compiling needs: none with a compiler, or where ``SUREFOOT_NATIVE`` is 0."""
    return [] if compiler() or os.environ.get("SUREFOOT_NATIVE") == "0" else [COMPILER]


def ending(platform: str | None = None) -> str:
    """Return the ending of library names; arguments as of :func:`compiler`."""
    windows = platform.startswith("win") if platform else sys.platform == "win32"
    return ".dll" if windows else ".so"


class Sources(NamedTuple):
    """The sources of one library: a package's, which includes the headers beside it."""

    path: Path  # the source, named as the package
    sizes: tuple[str, ...] = ()  # options of the compiler for records of another size

    @property
    def name(self) -> str:
        """Name of the library, without an ending."""
        return f"surefoot_{self.path.stem}" + ("_cells" if self.sizes else "")

    @property
    def smaller(self) -> "Sources | None":
        """The same with less room in its records, if the package has it so."""
        sizes = SMALLER.get(self.path.stem)
        return None if sizes is None or self.sizes else Sources(self.path, sizes)

    @property
    def library(self) -> Path:
        """Where the library lies: beside its sources."""
        return self.path.with_name(self.name + ending())

    def fingerprint(self, flags: Sequence[str] = FLAGS) -> str:
        """Return the mark of a library that is compiled from the sources at hand with these flags."""
        found = (self.path, *sorted(self.path.parent.glob("*.h")))
        parts = (" ".join((*flags, *self.sizes)).encode(), *(path.read_bytes() for path in found))
        return sha256(b"".join(parts)).hexdigest()[:16]

    def compile(
        self, target: Path | None = None, flags: Sequence[str] = FLAGS, platform: str | None = None
    ) -> str | None:
        """Compile the library; return ``None``, or in one line why it could not be.

        Args:
            target: Where to; by default beside the sources.
            flags: Options of the compiler.
            platform: The target, as of :func:`compiler`.
        """
        program = compiler(platform)
        if program is None:
            if platform:
                return "the package ziglang, which compiles for other platforms, is not installed"
            return "there is no C compiler (cc, gcc, clang or what CC says)"
        target = target or self.library
        # Moved in one step: a program that runs keeps the library that it has.
        fresh = target.with_name(f"{target.name}.{os.getpid()}")
        source = [
            "-shared",
            # Windows knows no other code, and symbols of a debugger have no place in a wheel.
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
            # What programs would be linked to on Windows.
            target.with_name(f"{self.path.stem}.lib").unlink(missing_ok=True)
        return None


def sources_below(root: Path = FOLDER.parent) -> Iterator[Sources]:
    """Yield the sources of each library in the folder ``native`` of a folder, in the order of their names."""
    for path in sorted(root.glob("native/*.c")):
        sources = Sources(path)
        yield sources
        if sources.smaller is not None:
            yield sources.smaller
