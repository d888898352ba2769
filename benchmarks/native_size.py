"""The size of the headers in C on a robot's own computer: code, state and deepest stack, compiled here.

    pip install ziglang
    python benchmarks/native_size.py

Nothing is run: clang, as ziglang ships it, compiles in single precision for size, and the script adds the
frames along the calls that it finds in the assembly. Functions of the C library (memset, sqrtf) come on top.
"""

import ast
import re
import struct
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from surefoot.calibration import FeetLayout, FootLayout, OnlineSetup, Parameters, nao_shoe_layout
from surefoot.calibration.native import c_source
from surefoot.native import FOLDER

TARGETS = {
    "Cortex-M7": ("thumb-linux-musleabihf", "-mcpu=cortex_m7+fp_armv8d16sp"),
    "aarch64": ("aarch64-linux-musl",),
}
FLAGS = ("-std=c99", "-Os", "-ffp-contract=off", "-DSF_SINGLE", "-fno-asynchronous-unwind-tables")
FILTER = """
typedef sf_moment_config own;
typedef sf_moment_state state;
typedef sf_moment_work work;
void begin(const sf_config *c, const own *m, state *s, work *w) { sf_moment_init(c, m, s, w); }
void fell(const sf_config *c, const own *m, state *s) { sf_moment_retract(c, m, s); }
void sample(const sf_config *c, const own *m, state *s, work *w, const sf_real *raw, const sf_reference *r,
            sf_estimate *e) {
    sf_moment_step(c, m, s, w, raw, r, c->dt, e);
}
const unsigned state_size[] = {sizeof(state)}, work_size[] = {sizeof(work)};
"""
BELIEFS = """
#define SF_FEET 2
#define SF_BODIES 26
#define SF_HINGES 24
#define SF_PACKETS 16
#define SF_PLANNED 4
#include "surefoot_beliefs.h"
void begin(sf_beliefs *s) { sf_beliefs_init(s); }
void packet(const sf_model *m, const sf_timing *t, sf_beliefs *s, const sf_real *row) {
    sf_beliefs_packet(m, t, s, (sf_whole)row[0], row[1], row + 2, row + 26, row + 29);
}
void sample(const sf_timing *t, sf_beliefs *s, double time, const unsigned char *planned, sf_belief *out) {
    sf_beliefs_sample(t, s, time, planned, 0, out);
}
const unsigned state_size[] = {sizeof(sf_beliefs)}, work_size[] = {0};
"""


def of_robot(layout: FeetLayout) -> str:
    """Return a program around the filter with the sizes of a robot; its constants are handed in."""
    ones = np.ones(len(layout.channel_names))
    setup = OnlineSetup(layout=layout, mass=5.305, initial=Parameters(ones, 0.0 * ones), foot_length=0.16)
    sizes = [line for line in c_source(setup).splitlines() if line.startswith("#")]
    return "\n".join(sizes) + FILTER


def code_size(data: bytes) -> int:
    """Return the bytes of an object file (ELF) that belong into a robot's flash: code and constants."""
    wide = data[4] == 2
    start, step, count = struct.unpack_from("<Q10xHH" if wide else "<I10xHH", data, 40 if wide else 32)
    return sum(
        size
        for kind, flags, size in (
            struct.unpack_from("<4xIQ16xQ" if wide else "<4xII8xI", data, start + step * k)
            for k in range(count)
        )
        if kind == 1 and flags & 2  # contents that are loaded
    )


def deepest(assembly: str) -> int:
    """Return the deepest stack of any function in bytes, by frames and calls in an assembly."""
    frames: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    name, in_sizes = "", False
    for line in assembly.splitlines():
        if start := re.match(r"\s+\.type\s+(\w+),\s*[%@]function", line):
            name = start[1]
            calls[name] = set()
        elif call := re.match(r"\s+bl?(?:\.w)?\s+(\w+)$", line):
            calls[name].add(call[1])
        elif in_sizes and (size := re.match(r"\s+\.(ascii|byte)\s+(.+)", line)):
            # A number in base 128, the low digits first, as text or as one byte.
            digits = ast.literal_eval(f"b{size[2]}") if size[1] == "ascii" else bytes([int(size[2], 0)])
            frames[name] = sum((digit & 127) << 7 * k for k, digit in enumerate(digits))
        if re.match(r"\s+\.(section|text)", line):
            in_sizes = ".stack_sizes" in line

    @cache
    def below(function: str) -> int:
        return frames[function] + max(
            (below(other) for other in calls[function] if other in frames), default=0
        )

    return max(map(below, frames))


def measure(program: str, target: tuple[str, ...]) -> list[int]:
    """Return the sizes of code, state, work and deepest stack in bytes."""
    with TemporaryDirectory() as folder:
        source, command = Path(folder, "robot.c"), [sys.executable, "-m", "ziglang", "cc", "-target", *target]
        source.write_text(program)
        for option, out in (("-S", "robot.s"), ("-c", "robot.o")):
            options = ["-fstack-size-section", f"-I{FOLDER}", option, "-o", f"{folder}/{out}"]
            subprocess.run([*command, *FLAGS, *options, source], check=True, stderr=subprocess.PIPE)
        assembly = Path(folder, "robot.s").read_text()
        sizes = dict(re.findall(r"^(\w+)_size:\s+\.(?:long|word|zero)\s+(\d+)", assembly, re.MULTILINE))
        sizes["work"] = "0" if program is BELIEFS else sizes["work"]  # written as four zeros
        records = (int(sizes[name]) for name in ("state", "work"))
        return [code_size(Path(folder, "robot.o").read_bytes()), *records, deepest(assembly)]


def main() -> None:
    if find_spec("ziglang") is None:
        raise SystemExit("This needs ziglang, which compiles for other processors: pip install ziglang")
    place = 0.01, 0.0, 0.06
    feet = (FootLayout.force_torque(name, position_sensor_sole=place) for name in ("left", "right"))
    ankles = FeetLayout(tuple(feet))
    programs = {
        "filter, eight load cells": of_robot(nao_shoe_layout()),
        "filter, two ankle sensors": of_robot(ankles),
        "beliefs, NAO, 16 packets": BELIEFS,
    }
    print(
        "| single precision, kB | "
        + " | ".join(f"{name}: code | state | work | stack" for name in TARGETS)
        + " |"
    )
    print("|---" * (1 + 4 * len(TARGETS)) + "|")
    for name, program in programs.items():
        sizes = (f"{size / 1000:.1f}" for target in TARGETS.values() for size in measure(program, target))
        print(f"| {name} | " + " | ".join(sizes) + " |")


if __name__ == "__main__":
    main()
