"""The filter in C against the Python that specifies it: the same estimates and states, sample by sample."""

import runpy
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from _ankles import ANKLES
from _native import SANITIZED, compile_program, run_program
from _native_filters import Log, same, same_estimate
from _synthetic import DT, LAYOUT, MASS

from surefoot.calibration import FeetLayout, FootLayout, OnlineSetup, Parameters
from surefoot.calibration.native import c_source, native_filter
from surefoot.calibration.online import online_method
from surefoot.native import CALIBRATION, FOLDER, compiler, leaves_of

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


def heavy(foot, kind):
    """The same foot with something that hangs below its sensor."""
    below = {"mass_below": 0.2, "com_below_sole": (0.01, 0.002, 0.02)}
    if kind == "cells":
        return FootLayout.load_cells(foot.name, foot.position_cell_sole, **below)
    return FootLayout.force_torque(foot.name, position_sensor_sole=(0.01, -0.005, 0.06), **below)


HEAVY = [heavy(foot, "cells") for foot in LAYOUT.feet], [heavy(foot, "ankle") for foot in ANKLES.feet]
LAYOUTS = {
    "cells": LAYOUT,
    "ankles": ANKLES,
    "both": FeetLayout(
        tuple(FootLayout.combined(f.name, f, a) for f, a in zip(LAYOUT.feet, ANKLES.feet, strict=True))
    ),
    "heavy cells": FeetLayout(tuple(HEAVY[0])),
    "heavy ankles": FeetLayout(tuple(HEAVY[1])),
    "heavy both": FeetLayout(tuple(FootLayout.combined(f.name, f, a) for f, a in zip(*HEAVY, strict=True))),
}


def dead(log):
    log.force[log.at :, 2] = 0.3


def dead_with_noise(log):
    log.force[log.at :, 5] = 0.05 * log.rng.normal(size=len(log.force) - log.at)


def stuck(log):
    log.force[log.at :, 1] = log.force[log.at, 1]


def dropped(log):
    log.force[log.at :, 3] = np.nan


def dropped_for_a_while(log):
    log.force[log.at : log.at + 200, 3] = np.nan


def at_its_rail(log):
    log.force[log.at :, 0] = 150.0


def spikes(log):
    log.force += np.where(
        log.rng.random(log.force.shape) < 0.02, log.rng.choice([-60.0, 60.0], log.force.shape), 0.0
    )


def flipped(log):
    log.force[log.at :, 4] *= -1.0


def swapped(log):
    log.force[log.at :, [1, 2]] = log.force[log.at :, [2, 1]]


def crossed(log):
    log.force[log.at :, [0, 6]] = -log.force[log.at :, [6, 0]]


def loaded(log):
    log.force[log.at :] *= 1.15


def comes_back(log):
    log.force[log.at : log.at + 300, 2] = 0.3


def gaps(log):
    for k, dt in (
        (300, 10.0),
        (301, 0.0),
        (700, -1.0),
        (900, np.nan),
        (1100, np.inf),
        (1300, 1e9),
        (1500, 0.05),
    ):
        log.times[k] = dt


def missing_and_impossible(log):
    hit = log.rng.random(log.force.shape) < 0.01
    log.force[hit] = log.rng.choice([np.nan, np.inf, -np.inf, 1e300, 1e5], int(hit.sum()))


def bad_references(log):
    for field, at, value in (
        ("com", 200, np.nan),
        ("R_level_sole", 500, np.inf),
        ("com_acceleration", 800, 1e30),
    ):
        getattr(log.reference, field)[at : at + 3] = value
    log.reference.com_acceleration[1200:1240, 2] = -9.0
    log.reference.com[1500:1520, 0] += 30.0
    log.reference.gyroscope[100] = np.nan


def lies(log):
    for field in ("stance", "swing"):
        part = getattr(log.reference, field)
        part[...] ^= log.rng.random(part.shape) < 0.1


def retracted(log):
    log.reference.com[log.at : log.at + 80, 0] += 0.03
    log.retracted = {3, 500, log.at + 80, log.at + 82}


def stands_for_long(log):
    for part in (log.force, *log.reference):
        part[200:1600] = part[200]


def on_one_leg(log):
    held, half = slice(200, 1600), log.force.shape[1] // 2
    log.reference.stance[held], log.reference.swing[held] = (True, False), (False, True)
    left, right = log.force[held, :half], log.force[held, half:]
    left += right.mean(axis=1, keepdims=True)
    right[:] = 0.3 * log.rng.normal(size=half) + 0.02 * log.rng.normal(size=right.shape)


def lifted(log):
    log.force[log.at : log.at + 160] = 0.0


def down_early(log):
    for _ in range(8):
        log.reference.swing[1:] |= log.reference.swing[:-1]
    log.reference.stance[log.reference.swing] = False


def clean(log):
    pass


FAULTS = [
    dead, dead_with_noise, stuck, dropped, dropped_for_a_while, at_its_rail, spikes, flipped, swapped,
    crossed, loaded, comes_back,
]  # fmt: skip
EVENTS = [
    clean, gaps, missing_and_impossible, bad_references, lies, retracted, stands_for_long, on_one_leg, lifted,
    down_early,
]  # fmt: skip


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory):
    """A function that compiles the program of garbage, with sanitizers, once for all robots and methods."""
    folder = tmp_path_factory.mktemp("fuzz")

    @cache
    def compiled(*flags):
        path = folder / ("fuzz" + "".join(flags))
        compile_program(Path(__file__).parent / "fuzz_native.c", path, *SANITIZED, *flags)
        return path

    return compiled


def setup_of(layout, lag=2, age=0.0):
    feet = LAYOUTS[layout]
    initial = Parameters(np.ones(feet.channels), np.zeros(feet.channels))
    return OnlineSetup(layout=feet, mass=MASS, initial=initial, lag=lag, foot_length=0.17, age=age)


def robot(library, layout="cells", lag=2, method="moment", age=0.0, **options):
    """The filter of one robot, by Python and by the library."""
    setup = setup_of(layout, lag, age)
    filter_ = native_filter(library, method, setup, options)
    assert filter_ is not None
    return online_method(method, setup, **options), filter_


def same_state(stream, native, expected, state, **tolerance):
    found = state.python()
    assert type(found) is type(expected)
    for (path, a), (_, b) in zip(leaves_of(expected), leaves_of(found), strict=True):
        same(path[-1], a, b, **tolerance)


def play(stream, native, log, exchange=(), **tolerance):
    """Play a log to both; at some samples each goes on with the other's state."""
    exchange = {exchange} if isinstance(exchange, int) else set(exchange)
    expected, found = stream.init(log.force[0]), native.pack()
    same_state(stream, native, expected, found, **tolerance)
    for k in range(len(log.force)):
        row, dt = log.row(k), float(log.times[k])
        assert native.takes(log.force[k], row, dt)
        expected, one = stream.update(expected, log.force[k], row, dt)
        two = native.update(found, log.force[k], row, dt)
        if k in log.retracted:
            expected = stream.retract(expected)
            native.retract(found)
        same_estimate(one, two, **tolerance)
        if k % 48 == 47 or k in exchange | log.retracted:
            same_state(stream, native, expected, found, **tolerance)
        if k in exchange:
            other = found.python()
            found, expected = native.pack(expected), other
    return expected, one


OTHERS = [
    *[
        ("tare", "cells", lag, event, {})
        for lag, event in ((2, clean), (0, gaps), (2, missing_and_impossible))
    ],
    *[("tare", "cells", 2, event, {}) for event in (bad_references, lies)],
    *[("tare", layout, 2, clean, {}) for layout in ("ankles", "both", "heavy both")],
    ("tare", "ankles", 1, dropped_for_a_while, {"settle": 0.0, "spread": 0.2, "offset_range": 1.0}),
    *[("none", layout, 2, missing_and_impossible, {}) for layout in ("cells", "both")],
    *[("none", "ankles", 0, event, {}) for event in (gaps, bad_references)],
    *[(method, "cells", 2, lies, {"age": 0.006}) for method in ("tare", "none")],
    ("tare", "both", 0, gaps, {"age": np.repeat([0.005, 0.0, 0.02, 0.0], [4, 6, 4, 6])}),
]


def named(value):
    return value.__name__ if callable(value) else None


@pytest.mark.parametrize(
    ("method", "layout", "lag", "event", "options"),
    [
        row if row[1] == "cells" and row[3] is clean else pytest.param(*row, marks=pytest.mark.slow)
        for row in OTHERS
    ],
    ids=named,
)
def test_the_library_is_the_python_of_other_methods(library, method, layout, lag, event, options):
    log = Log(layout)
    event(log)
    if event is clean:
        log.force = log.force[:900]
    play(*robot(library, layout, lag, method, **options), log, exchange=789)


def play_garbage(library, program, tmp_path, layout):
    _, native = robot(library, layout, method="tare")
    constants = native.constants
    (tmp_path / "config").write_bytes(constants.config.tobytes() + constants.own.tobytes())
    run_program(program, tmp_path / "config", "100000")


@pytest.mark.slow
def test_garbage_leaves_the_state_finite_and_memory_alone(library, fuzzer, tmp_path):
    play_garbage(library, fuzzer(), tmp_path, "both")


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["cells", "heavy both"])
def test_garbage_does_no_harm_in_single_precision(single, fuzzer, tmp_path, layout):
    play_garbage(single, fuzzer("-DSF_SINGLE"), tmp_path, layout)


@pytest.mark.parametrize("layout", ["cells", pytest.param("both", marks=pytest.mark.slow)])
def test_a_state_is_half_as_large_in_single_precision(library, tmp_path, monkeypatch, layout):
    monkeypatch.setattr(CALIBRATION, "installed", lambda: library)
    (tmp_path / "robot.h").write_text(c_source(setup_of(layout), "tare"))
    (tmp_path / "size.c").write_text(
        '#include <stdio.h>\n#include "robot.h"\n'
        "int main(void) { static sf_tare_state state; sf_tare_init(&robot, &state);\n"
        'printf("%lu", (unsigned long)sizeof state);\n'
        "return !(tare.minimum_samples && sf_robot_fits(&robot)); }\n"
    )
    sizes = []
    for flags in ([], ["-DSF_SINGLE"]):
        compile_program(tmp_path / "size.c", tmp_path / "size", "-O0", *flags)
        done = subprocess.run([tmp_path / "size"], capture_output=True, check=True)
        sizes.append(int(done.stdout))
    assert sizes[1] < 0.6 * sizes[0]
    if plus := shutil.which("c++"):
        strict = ("-std=c++20", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-I", FOLDER)
        subprocess.run([plus, "-x", "c++", *strict, tmp_path / "size.c"], check=True)


@pytest.mark.slow
def test_a_robots_own_programs_print_what_python_replays(library, tmp_path, monkeypatch):
    path = ROOT / "examples" / "robot" / "build.py"
    if not path.is_file():
        pytest.skip("the examples are not part of the wheel")
    monkeypatch.setattr(CALIBRATION, "installed", lambda: library)
    programs = runpy.run_path(str(path))["build_robot"](setup_of("cells"), tmp_path)
    stream, log, lines, expected = online_method("moment", setup_of("cells")), Log("cells"), [], []
    missing_and_impossible(log)
    state = stream.init(log.force[0])
    for k in range(1000):
        row = log.row(k)
        numbers = [log.force[k], *row[:3], row.position_sole, row.R_level_sole, row.stance, row.swing, DT]
        lines.append(" ".join(repr(float(value)) for part in numbers for value in np.ravel(part)))
        state, estimate = stream.update(state, log.force[k], row, DT)
        cop_std = np.sqrt(np.diagonal(estimate.cop_covariance))
        answer = np.concatenate([estimate.force, estimate.cop, estimate.force_std, cop_std])
        expected.append("".join(f"{value:.6f} " for value in answer).replace("-nan", "nan"))
    for program in programs:
        done = subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, check=True)
        assert done.stdout.replace("-nan", "nan").splitlines() == expected
        done = subprocess.run([program], input="1 2 3\n", capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (1, "A line needs 46 numbers, got: 1 2 3\n")


def test_every_field_of_a_record_is_in_the_table(library):
    for fields in library.places.values():
        if not any(fields):  # of beliefs the size alone is asked for
            continue
        end = 0
        for _, offset, size in sorted(
            (place for name, place in fields.items() if name), key=lambda place: place[1]
        ):
            assert end <= offset < end + 8
            end = offset + size
        assert end <= fields[""][2] < end + 8
