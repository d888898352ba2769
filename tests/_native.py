"""What the tests of all headers need: a library, and programs compiled beside a header."""

import subprocess
from pathlib import Path

from surefoot.native import FOLDER, Library, Native, compiler

STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off")
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def library_of(native: Native, folder: Path) -> Library:
    """Return the library of a package: the installed one, or one compiled into a folder."""
    here = native.installed()
    if here is not None:
        return here
    path = folder / "double.so"
    assert native.sources.compile(path) is None
    return native.load(path, native.sources.fingerprint())


def compile_program(source: Path, target: Path, *flags: str) -> None:
    """Compile one program beside the headers, with all warnings as errors."""
    command = [
        *compiler(), *STRICT, *flags, f"-I{FOLDER}", "-o", str(target), str(source), "-lm"
    ]  # fmt: skip
    run_program(*command)


def run_program(*command: str | Path) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
