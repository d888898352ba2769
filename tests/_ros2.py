"""Programs of the package in ros2/, compiled against stand-ins for ROS."""

import re
import shutil
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import yaml

from surefoot.native import CALIBRATION, FOLDER

PACKAGE = Path(__file__).parents[1] / "ros2"
FLAGS = ("-O0", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-Wno-maybe-uninitialized")

needs_cpp = pytest.mark.skipif(
    not PACKAGE.is_dir() or shutil.which("c++") is None or CALIBRATION.installed() is None,
    reason="needs the package in ros2/, a C++ compiler and surefoot's library in C",
)


def build(source: Path, folder: Path, main: Path | None = None) -> Path:
    """Return a program of a source, or of another one that includes it, linked to the library."""
    for header in re.findall(r"#include <(\w+/[\w/]+\.hp*)>", source.read_text()):
        (folder / header).parent.mkdir(parents=True, exist_ok=True)
        (folder / header).write_text(f'#pragma once\n#include "{Path(__file__).parent}/_ros2.hpp"\n')
    # As CMake has the headers of an imported target.
    include = [f"-isystem{path}" for path in (folder, FOLDER)]
    program, library = folder / "program", CALIBRATION.sources.library
    command = ["c++", "-std=c++17", *FLAGS, *include, "-o", program, main or source, library]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


def write_parameters(path: Path, *files: Path, node: str = "surefoot", **more: Any) -> Path:
    """Write parameters of YAML files as the stand-ins read them; later files replace earlier ones."""
    lines: dict[str, str] = {}

    def add(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, part in value.items():
                add(f"{name}.{key}" if name else key, part)
            return
        values = value if isinstance(value, list) else [value]
        kinds = {type(one) for one in values}
        # ROS allows one kind in a list.
        assert len(kinds) <= 1, (name, kinds)
        names = {float: "double", int: "integer", str: "string", bool: "bool"}
        kind = names[next(iter(kinds), float)] + "_array" * isinstance(value, list)
        lines[name] = " ".join([name, kind, *map(str, values)])

    for file in files:
        add("", yaml.safe_load(file.read_text())[node]["ros__parameters"])
    add("", more)
    path.write_text("\n".join(lines.values()))
    return path


def run(program: Path, parameters: Path, lines: Iterable[str] = ()) -> list[list[str]]:
    """Return the words of each line that a program prints for these lines."""
    done = subprocess.run(
        [program, parameters], input="\n".join(lines), capture_output=True, text=True, check=True
    )
    return [line.split() for line in done.stdout.splitlines()]


def spoken(time_ns: int, topic: str, values: Any = ()) -> str:
    return " ".join([str(time_ns), topic, *map(repr, map(float, values))])
