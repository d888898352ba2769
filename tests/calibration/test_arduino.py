"""The Arduino library of one foot, compiled here: its numbers are those of the tare in Python."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surefoot.calibration import FeetLayout, FootCalibrator, FootLayout, Parameters, Reference
from surefoot.calibration.reference import GRAVITY

LIBRARY = Path(__file__).parents[2] / "arduino"
WEIGHT, RATE = 52.0, 80.0
PLACES = np.array([[0.11, 0.05], [0.11, -0.05], [-0.06, 0.05], [-0.06, -0.05]])
SCALE = np.float32([2.1e-5, 2.0e-5, 2.1e-5, 2.2e-5])
RAIL = 2**23 - 1
DEAD, SPIKE, MISSING, RAILED, REJECTED = 1024, 256, 1, 16384, 128

MAIN = """
#include <cstdio>
#include <cstdlib>
#define SUREFOOT_CELLS 4
#include "SurefootFoot.h"
const float X[] = {0.11, 0.11, -0.06, -0.06}, Y[] = {0.05, -0.05, 0.05, -0.05};
const float SCALE[] = {2.1e-5, 2.0e-5, 2.1e-5, 2.2e-5};
int main() {
    SurefootFoot foot(X, Y, 52.0, 80);
    for (int i = 0; i < 4; i++) foot.setScale(i, SCALE[i]);
    char line[200];
    while (fgets(line, sizeof line, stdin)) {
        char *rest = line + 1;
        if (*line == 't') foot.tare();
        if (*line == 'h') foot.hangs(rest[1] == '1');
        if (*line == 'f') foot.followBelow(strtof(rest, nullptr));
        if (*line != 'c') continue;
        long counts[4];
        for (long &one : counts) one = strtol(rest, &rest, 10);
        foot.update(counts);
        for (int i = 0; i < 4; i++) printf("%.9g %u ", foot.force(i), foot.faults(i));
        printf("%.9g %d %.9g %.9g\\n", foot.load(), foot.hasCop(), foot.x(), foot.y());
    }
}
"""

SKETCH = """
#include <cmath>
#include <cstdio>
#include <cstring>
typedef unsigned char byte;
struct Lines {
    void begin(long) {}
    int read() { return -1; }
    void print(const char *text) { std::printf("%s", text); }
    void print(float value, int digits) { std::printf("%.*f", digits, value); }
    void println() { std::printf("\\n"); }
} Serial;
"""

HX711 = """
struct HX711 {
    long at = 0;
    void begin(byte, byte) {}
    bool is_ready() { return true; }
    bool wait_ready_timeout(unsigned long) { return true; }
    long read() { return at += 37, at % 400 + (at > 37 * 100 ? 500000 : 100000); }
};
"""

pytestmark = pytest.mark.skipif(
    not LIBRARY.is_dir() or shutil.which("c++") is None, reason="needs the folder arduino/ and a C++ compiler"
)


def build(text: str, folder: Path) -> Path:
    source, program = folder / "main.cpp", folder / "main"
    source.write_text(text)
    flags = ["-std=c++11", "-O0", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
    command = ["c++", *flags, f"-isystem{LIBRARY / 'src'}", f"-I{folder}", "-o", program, source]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(MAIN, tmp_path_factory.mktemp("foot"))


class Seen:
    """What the library says: forces (N, 4), faults (N, 4), load, and centre of pressure (N, 2)."""

    def __init__(self, program: Path, lines: list[str]) -> None:
        text = subprocess.run([program], input="\n".join(lines), capture_output=True, text=True, check=True)
        found = np.array([line.split() for line in text.stdout.splitlines()], dtype=float)
        self.force, self.faults = found[:, 0:8:2], found[:, 1:8:2].astype(int)
        self.load, self.valid, self.cop = found[:, 8], found[:, 9] > 0.5, found[:, 10:]


def counts_of(force: Any, zero: Any, rng: np.random.Generator) -> Any:
    """Return the readings for forces (N, 4) by zeros in N, with an HX711's noise."""
    return np.rint((force - zero) / SCALE + 40.0 * rng.standard_normal(force.shape)).astype(int)


def steps(rng: np.random.Generator) -> tuple[Any, Any]:
    """Return forces (N, 4) of a foot that steps for ten seconds, and when it hangs."""
    time = np.arange(800) / RATE
    hangs = (time % 2.0) > 1.0
    share = np.array([0.3, 0.2, 0.3, 0.2]) + 0.05 * np.sin(time)[:, None] * np.array([1.0, 1.0, -1.0, -1.0])
    return np.where(hangs[:, None], 0.0, WEIGHT * share), hangs


def row(counts: Any) -> str:
    return "c " + " ".join(map(str, counts))


def test_forces_are_those_of_the_swing_tare_in_python(program: Path) -> None:
    rng = np.random.default_rng(1)
    force, hangs = steps(rng)
    zero = np.array([3.0, -2.0, 1.0, -1.0]) + np.linspace(0.0, 2.0, 800)[:, None]
    counts = counts_of(force, zero, rng)
    lines = [line for k in range(800) for line in (f"h {int(hangs[k])}", row(counts[k]))]
    seen = Seen(program, lines)
    foot = FootLayout.load_cells("one", PLACES, ("a", "b", "c", "d"))
    initial = Parameters(SCALE.astype(float), np.zeros(4))
    known: dict[str, Any] = {"mass": WEIGHT / GRAVITY, "initial": initial, "dt": 1.0 / RATE, "lag": 0}
    python = FootCalibrator(FeetLayout((foot,)), "tare", **known)
    zeros, nobody = np.zeros(3), np.zeros(1, dtype=bool)
    for k in range(800):
        still = Reference(
            zeros, zeros, zeros, np.zeros((1, 3)), np.eye(3)[None], nobody, hangs[k : k + 1], zeros, zeros
        )
        one = python.update(counts[k].astype(float), still)
        np.testing.assert_allclose(seen.force[k], one.force, atol=2e-4)
        assert seen.valid[k] == one.cop_foot_valid[0]
        np.testing.assert_allclose(seen.cop[k], one.cop_foot[0], atol=1e-5)
    # What drifted within the last step is left.
    assert np.abs(seen.force[-80:] - force[-80:]).max() < 0.5
    assert not seen.faults.any()


def test_a_tare_takes_any_zeros_and_waits_for_a_foot_that_is_still(program: Path) -> None:
    rng = np.random.default_rng(2)
    zero = np.array([-90.0, 60.0, -30.0, 10.0])
    moving = 5.0 * np.sin(np.arange(100))[:, None] * np.ones(4)
    counts = counts_of(np.concatenate([moving, np.zeros((200, 4)), np.full((50, 4), 10.0)]), zero, rng)
    seen = Seen(program, ["t", *map(row, counts)])
    assert (seen.faults[:100] & REJECTED).any(axis=0).all()
    assert np.abs(seen.force[100:140]).max() > 10.0
    assert np.abs(seen.force[290:300]).max() < 0.02
    np.testing.assert_allclose(seen.force[300:], 10.0, atol=0.02)
    np.testing.assert_allclose(seen.cop[-1], PLACES.mean(axis=0), atol=1e-4)


def test_zeros_that_drift_are_followed_while_the_foot_hangs_and_a_load_is_not(program: Path) -> None:
    """By 3 N in a minute; a robot that then stands for half a minute keeps its weight."""
    rng = np.random.default_rng(3)
    n = 60 * int(RATE)
    zero = np.linspace(0.0, 3.0, n)[:, None] * np.array([1.0, -1.0, 1.0, -1.0])
    hanging = counts_of(np.zeros((n, 4)), zero, rng)
    standing = counts_of(np.full((n // 2, 4), WEIGHT / 4), zero[-1], rng)
    lines = ["t", *map(row, hanging), *map(row, standing)]
    followed, left = Seen(program, ["f 2", *lines]), Seen(program, lines)
    assert np.abs(followed.force[200:n]).max() < 0.12
    np.testing.assert_allclose(followed.load[n + 10 :], WEIGHT, atol=0.2)
    assert np.abs(left.force[n - 1]).min() > 2.8


def test_faults_are_told_and_harm_no_other_cell(program: Path) -> None:
    rng = np.random.default_rng(4)
    force = np.full((400, 4), WEIGHT / 4) + rng.standard_normal((400, 1))
    counts = counts_of(force, np.zeros(4), rng)
    lines = list(map(row, counts))
    spike, gone, railed, dead = (
        counts[100].copy(),
        counts[150].copy(),
        counts[200].copy(),
        counts[250:320].copy(),
    )
    spike[0] += int(40.0 / SCALE[0])
    gone[1], railed[2], dead[:, 3] = -(2**63), RAIL, counts[250, 3]
    for k, one in ((100, spike), (150, gone), (200, railed), *zip(range(250, 320), dead, strict=True)):
        lines[k] = row(one)
    seen = Seen(program, lines)
    for k, cell, fault in ((100, 0, SPIKE), (150, 1, MISSING), (200, 2, RAILED), (300, 3, DEAD)):
        wanted = np.zeros(4, dtype=int)
        wanted[cell] = fault
        np.testing.assert_array_equal(seen.faults[k], wanted)
        others = np.arange(4) != cell
        np.testing.assert_allclose(seen.force[k, others], force[k, others], atol=0.02)
        assert abs(seen.force[k, cell] - force[k, cell]) < 8.0
    assert not seen.faults[[99, 101, 149, 151, 199, 201, 249, 330]].any()
    # A foot that lands moves all of its cells: no spike.
    landing = counts_of(np.concatenate([np.zeros((50, 4)), force]), np.zeros(4), rng)
    assert not Seen(program, list(map(row, landing))).faults.any()


@pytest.mark.parametrize("weight", [20.0, 47.0])
def test_a_foot_that_was_tared_under_load_is_tared_again_when_it_hangs(program: Path, weight: float) -> None:
    """It is switched on as the robot stands on it, lifted for two seconds, and put down."""
    rng = np.random.default_rng(5)
    load = np.repeat([weight, 0.0, weight], [120, 160, 160])[:, None] * np.array([0.35, 0.15, 0.3, 0.2])
    lines = ["t", *map(row, counts_of(load, np.array([30.0, -12.0, 4.0, 0.0]), rng))]
    followed, left = Seen(program, ["f 2", *lines]), Seen(program, lines)
    np.testing.assert_allclose(followed.load[110:120], 0.0, atol=0.1)
    assert (followed.faults[120:125] & REJECTED).any(axis=0).all()
    np.testing.assert_allclose(followed.load[240:280], 0.0, atol=0.1)
    np.testing.assert_allclose(followed.load[290:], weight, atol=0.1)
    assert not followed.faults[290:].any()
    # Without a limit nothing says that the foot hangs: the fault stays for as long as it seems to pull.
    np.testing.assert_allclose(left.load[130:280], -weight, atol=0.1)
    assert (left.faults[130:280] & REJECTED).all()


def test_no_centre_of_pressure_of_cells_at_their_rails_or_silent(program: Path) -> None:
    rng = np.random.default_rng(6)
    counts = counts_of(np.full((240, 4), WEIGHT / 4), np.zeros(4), rng)
    counts[60:120, 1] = RAIL
    counts[150:200] = -(2**63)
    seen = Seen(program, list(map(row, counts)))
    assert seen.valid[20:60].all()
    assert not seen.valid[60:120].any()
    assert seen.valid[122:165].all()
    # The last reading counts for a quarter of a second.
    assert seen.valid[150:168].all()
    assert not seen.valid[172:200].any()
    assert seen.valid[201:].all()
    np.testing.assert_array_equal(np.isfinite(seen.cop).all(axis=1), seen.valid)


def test_the_example_runs(tmp_path: Path) -> None:
    sketch = LIBRARY / "examples" / "OneFoot" / "OneFoot.ino"
    (tmp_path / "HX711.h").write_text(HX711)
    loop = "int main() { setup(); for (int k = 0; k < 400; k++) loop(); }"
    program = build(f'{SKETCH}\n#include "{sketch}"\n{loop}', tmp_path)
    lines = subprocess.run([program], capture_output=True, text=True, check=True).stdout.splitlines()
    assert len(lines) == 50
    load, unit, x, _, _, *faults = lines[-1].split()
    # 400,000 counts of each cell more than at the tare, to some 400.
    assert float(load) == pytest.approx(400000 * SCALE.sum(), abs=0.05)
    assert (unit, faults) == ("N,", ["ok"] * 4)
    assert float(x) == pytest.approx(1000 * (SCALE @ PLACES)[0] / SCALE.sum(), abs=0.1)


@pytest.mark.skipif(shutil.which("avr-g++") is None, reason="needs gcc-avr")
def test_four_cells_fit_into_the_smallest_board(tmp_path: Path) -> None:
    """An Arduino Uno has 32 KB of flash and 2 KB of memory: the stack and its serial line need 0.7."""
    (tmp_path / "main.cpp").write_text(
        '#include "SurefootFoot.h"\nconst float x[4] = {1}, y[4] = {1};\nSurefootFoot foot(x, y, 52, 80);\n'
        "long counts[4];\nvolatile float out;\n"
        "int main() { foot.tare(); for (;;) { foot.update(counts); out = foot.load() + foot.x(); } }\n"
    )
    flags = [
        "-mmcu=atmega328p",
        "-Os",
        "-std=gnu++11",
        "-ffunction-sections",
        "-fdata-sections",
        "-Wl,--gc-sections",
    ]
    program = tmp_path / "main.elf"
    command = ["avr-g++", *flags, f"-isystem{LIBRARY / 'src'}", "-o", program, tmp_path / "main.cpp"]
    subprocess.run(command, check=True, capture_output=True)
    printed = subprocess.run(["avr-size", program], capture_output=True, text=True, check=True).stdout
    text, data, bss = map(int, printed.splitlines()[1].split()[:3])
    assert text + data < 14 * 1024
    assert data + bss < 1.2 * 1024
