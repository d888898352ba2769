"""What the tests of all headers need: a library, and programs compiled beside a header."""

import re
import subprocess
from pathlib import Path

from surefoot.native import FOLDER, Library, Native, Sources, compiler

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


def library_with(native: Native, folder: Path, **constants: float) -> Library:
    """Return a library compiled into a folder with other constants in the place of those in its headers."""
    for source in (native.sources.path, *FOLDER.glob("*.h")):
        text = source.read_text()
        for name, value in constants.items():
            text = re.sub(rf"(#define {name} )\(\(sf_real\)[^)]+\)", rf"\g<1>((sf_real){value})", text)
        (folder / source.name).write_text(text)
    headers = "".join(header.read_text() for header in folder.glob("*.h"))
    for name, value in constants.items():
        assert f"#define {name} ((sf_real){value})" in headers, name
    path = folder / "other.so"
    assert Sources(folder / native.sources.path.name).compile(path) is None
    return native.load(path)


def compile_program(source: Path, target: Path, *flags: str) -> None:
    """Compile one program beside the headers, with all warnings as errors."""
    command = [
        *compiler(), *STRICT, *flags, f"-I{FOLDER}", "-o", str(target), str(source), "-lm"
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
