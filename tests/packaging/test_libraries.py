"""Libraries in C: what is said of one that is missing or wrong."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from surefoot.calibration import OnlineSetup, Parameters, nao_shoe_layout
from surefoot.calibration.native import c_source
from surefoot.native import CALIBRATION, ENVS, FOLDER, SENSORS, Sources, build, compiler
from surefoot.native.__main__ import main
from surefoot.native.library import say_once

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
def test_a_library_that_cannot_be_used_is_one_line_in_the_log(caplog, monkeypatch, tmp_path):
    monkeypatch.delenv("SUREFOOT_NATIVE", raising=False)
    other = tmp_path / "other.c"
    other.write_text("int surefoot_other(void) { return 0; }\n")
    wrong, text, old = tmp_path / "wrong.so", tmp_path / "text.so", tmp_path / "old.so"
    subprocess.run([*compiler(), "-shared", "-fPIC", "-o", wrong, other], check=True)
    text.write_text("no library")
    assert CALIBRATION.sources.compile(old, ["-std=c99", "-O0"]) is None
    for path, problem in (
        (tmp_path / "missing.so", "there is no missing.so"),
        (wrong, "wrong.so cannot be used, it is another library"),
        (text, "text.so cannot be used"),
        (old, "old.so cannot be used, it was compiled from other sources"),
    ):
        caplog.clear()
        say_once.cache_clear()
        assert CALIBRATION.look(path) is None
        assert CALIBRATION.look(path) is None
        (line,) = caplog.messages
        assert line.startswith(f"surefoot runs in Python, slower: {problem}")
        assert line.endswith("compile it with: python -m surefoot.native")
        assert "\n" not in line
    caplog.clear()
    monkeypatch.setenv("SUREFOOT_NATIVE", "0")
    assert CALIBRATION.look(tmp_path / "another.so") is None
    assert not caplog.messages


def test_where_one_library_of_calibrators_is_the_smaller_one_is_too():
    assert len(CALIBRATION.rooms()) in (0, 2)


def test_a_fingerprint_is_of_the_sources_and_the_flags(tmp_path):
    sources, found = Sources(tmp_path / "one.c"), set()
    for text in ("one", "another"):
        sources.path.write_text(text)
        found |= {sources.fingerprint(), sources.fingerprint(["-O0"])}
    assert len(found) == 4


def test_without_a_compiler_it_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    sources = CALIBRATION.sources
    missing = "there is no C compiler (cc, gcc, clang or what CC says)"
    assert sources.compile(tmp_path / "x.so") == missing
    assert main() == f"Not compiled, surefoot_calibration: {missing}."
    monkeypatch.setattr(build, "find_spec", lambda name: None)
    assert "the package ziglang" in str(sources.compile(tmp_path / "x.dll", platform="win_amd64"))
    monkeypatch.undo()
    if compiler() is not None:
        assert "refused: " in str(sources.compile(tmp_path / "x.so", ["-no-such-option"]))
    assert list(tmp_path.iterdir()) == []


def test_installing_brings_a_compiler_where_there_is_none(monkeypatch, tmp_path):
    monkeypatch.delenv("SUREFOOT_NATIVE", raising=False)
    monkeypatch.setattr(build, "find_spec", lambda name: None)
    monkeypatch.setenv("CC", "cc")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert build.requirements() == [build.COMPILER]
    monkeypatch.setenv("SUREFOOT_NATIVE", "0")
    assert build.requirements() == []
    monkeypatch.delenv("SUREFOOT_NATIVE")
    (tmp_path / "cc").touch(mode=0o755)
    assert build.requirements() == []


def test_it_compiles_all_libraries(monkeypatch, capsys):
    monkeypatch.setattr(Sources, "compile", lambda self: None)
    assert main() is None
    paths = [Path(line.split()[-1]) for line in capsys.readouterr().out.replace(".\n", "\n").splitlines()]
    assert paths == [CALIBRATION.sources.library, CALIBRATION.sources.smaller.library] + [
        native.sources.library for native in (ENVS, SENSORS)
    ]


def test_it_says_where_the_headers_are(capsys):
    assert main(["--include"]) is None
    folders = [Path(option.removeprefix("-I")) for option in capsys.readouterr().out.split()]
    headers = {path.name for folder in folders for path in folder.glob("*.h")}
    assert {"surefoot_moment.h", "surefoot_beliefs.h", "surefoot_sensors.h", "library.h"} <= headers


@pytest.mark.skipif(shutil.which("cmake") is None or compiler() is None, reason="needs cmake and a compiler")
def test_cmake_finds_the_headers(tmp_path, capsys):
    """A program with robot.h, as a wheel's user would build it."""
    initial = Parameters(np.full(8, 2e-5), np.zeros(8))
    setup = OnlineSetup(layout=nao_shoe_layout(), mass=5.3, initial=initial)
    (tmp_path / "robot.h").write_text(c_source(setup))
    program = (
        '#include <stdio.h>\n#include "robot.h"\nint main(void) { printf("%d", robot.channels); return 0; }'
    )
    (tmp_path / "main.c").write_text(program)
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.10)\nproject(mine C)\nfind_package(surefoot REQUIRED CONFIG)\n"
        "add_executable(mine main.c)\ntarget_link_libraries(mine PRIVATE surefoot::surefoot m)\n"
    )
    main(["--cmakedir"])
    folder = capsys.readouterr().out.strip()
    build_folder = str(tmp_path / "build")
    commands = (
        ["cmake", "-S", str(tmp_path), "-B", build_folder, f"-Dsurefoot_DIR={folder}"],
        ["cmake", "--build", build_folder],
    )
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    assert subprocess.run([f"{build_folder}/mine"], capture_output=True, text=True).stdout == "8"


def test_controllers_use_what_the_headers_have():
    """The package of ROS 2 and the library of Arduino, which few machines compile."""
    has = "".join(path.read_text() for path in FOLDER.glob("*.[ch]"))
    known = set(re.findall(r"\w+", has))
    for path in (
        *ROOT.glob("ros2/src/*"),
        *ROOT.glob("arduino/src/Sure*"),
        *ROOT.glob("examples/robot/*.c*"),
    ):
        assert set(re.findall(r"\bsf_\w+", path.read_text())) <= known, path
