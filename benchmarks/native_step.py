"""The time of the native step of everything: sensors, telemetry, beliefs, filter and view of a NAO, in C.

    python benchmarks/native_step.py
    python benchmarks/native_step.py --steps 600 --robots 1 4096 --rounds 1
    python benchmarks/native_step.py --write

The last one writes the table of docs/speed.md again, on a machine with nothing else to do.

A walk is recorded once through the wrappers: the inputs of the native step, and the forces that it makes of
that. A small program is compiled with the headers and the robot's constants, with arrays as large as this
robot needs. It steps N robots over the recording, each with a state and random numbers of its own, started at
other moments so that their blocks do not fill together. First it must make the forces of the recording.

Told are microseconds of a robot's step: means over 16 steps, two blocks of the filter, of which the middle
one counts, as others use the machine as well; median and 99th percentile of single steps of one robot; and
means of the parts, which are timed in runs of their own. *Swept* is with 8 MB of data and 64 kB of code
touched before each step, as between two steps of a simulation. No test asserts these figures.
"""

import argparse
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from step import DATA, save

import surefoot  # noqa: F401
from surefoot.calibration.native import c_source as of_filter
from surefoot.native import CALIBRATION, c_header, compiler, require
from surefoot.native.build import FLAGS, FOLDER
from surefoot.robot.beliefs.native import c_source as of_beliefs
from surefoot.robot.native import view_record
from surefoot.wrappers import FootSensors, SelfCalibration

PARTS = "sensors", "telemetry", "beliefs", "filter", "view"
CLOSE = 1e-9  # how far forces may be from those of the recording, of themselves and in N
PROGRAM = r"""
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { K = SF_CHANNELS, J = SF_JOINTS, SENSORS = 0, TELEMETRY, BELIEFS, FILTER, VIEW, PARTS };
typedef struct { /* of one control step */
    sf_real load[ROWS * K], position[ROWS * J], inertial[ROWS * 6];
    unsigned char planned[4];
    double about, now;
} input;
typedef struct {
    sf_cells cells;
    sf_telemetry telemetry;
    sf_momentum_beliefs beliefs;
    sf_moment_state filter;
    sf_held held;
    sf_random stream[2];
    sf_real counts[K];
    sf_estimate estimate;
    sf_shown shown;
    int at;
} robot_state;
static sf_moment_work work;
static sf_real arrived[SF_LINK_ROOM * SF_PACKET];
static double spent[PARTS], mark, price;
static int timed, of_process;

static double clock_now(void) {
    struct timespec now;
    clock_gettime(of_process ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC, &now);
    return 1e6 * (double)now.tv_sec + 1e-3 * (double)now.tv_nsec;
}
static void passed(int part) {
    if (!timed) return;
    double now = clock_now();
    spent[part] += now - mark - price, mark = now;
}

static void step(robot_state *r, const input *all) {
    const input *in = all + r->at;
    const sf_feet feet = {.cells_config = &cells_config, .cells = &r->cells, .cells_stream = r->stream,
                          .dt = STEP, .first = FIRST, .more = MORE};
    int count, begins = r->at++ == 0;
    sf_belief belief;
    sf_real soles[4 * SF_FEET];
    if (timed) mark = clock_now();
    if (begins) sf_feet_begin(&feet, in->load, ROWS, NULL, r->counts);
    else sf_feet_step(&feet, in->load, ROWS, NULL, r->counts);
    passed(SENSORS);
    if (begins)
        count = sf_telemetry_init(&telemetry_config, &r->telemetry, in->position, in->inertial, 1,
                                  r->stream + 1, arrived);
    else
        count = sf_telemetry_advance(&telemetry_config, &r->telemetry, in->position, in->inertial, in->now,
                                     r->stream + 1, arrived);
    passed(TELEMETRY);
    for (const sf_real *row = arrived; count > 0; count--, row += SF_PACKET)
        sf_momentum_packet(&model, &timing, &r->beliefs, (sf_whole)row[0], (double)row[1], row + 2,
                           row + 2 * J + 7, row + 2 * J + 4);
    sf_momentum_sample(&timing, &r->beliefs, in->about, in->planned, 0, &belief);
    passed(BELIEFS);
    if (belief.fell) sf_moment_retract(&robot, &moment, &r->filter);
    sf_moment_step(&robot, &moment, &r->filter, &work, r->counts, &belief.reference, robot.dt, &r->estimate);
    passed(FILTER);
    sf_beliefs_soles(&timing, &r->beliefs.beliefs, in->now, soles);
    sf_view_show(&robot, &view, &r->held, &r->estimate, soles, &r->shown);
    passed(VIEW);
}

static void sweep(void) {
    static volatile char data[8 << 20];
    for (size_t i = 0; i < sizeof data; i += 64) data[i]++;
#ifdef __GNUC__
    __asm__ volatile(".rept 65536\n nop\n .endr");
#endif
}

/* A file, and how many steps are in it: writes the forces of all. Behind that robots, whether swept, whether
   parts are timed, steps before, moments from which robots go on, and steps: writes times. */
int main(int argc, char **argv) {
    int length = atoi(argv[2]), robots = argc > 3 ? atoi(argv[3]) : 1, swept = argc > 3 && atoi(argv[4]);
    input *all = calloc((size_t)length, sizeof *all);
    robot_state *r = calloc((size_t)robots + 1, sizeof *r), *source = r + robots;
    FILE *file = fopen(argv[1], "rb");
    double row[ROWS * (K + J + 6) + 6];
    for (int t = 0; t < length && fread(row, sizeof row, 1, file); t++) {
        const double *from = row;
        for (int i = 0; i < ROWS * K; i++) all[t].load[i] = (sf_real)*from++;
        for (int i = 0; i < ROWS * J; i++) all[t].position[i] = (sf_real)*from++;
        for (int i = 0; i < ROWS * 6; i++) all[t].inertial[i] = (sf_real)*from++;
        for (int i = 0; i < 4; i++) all[t].planned[i] = *from++ != 0;
        all[t].about = from[0], all[t].now = from[1];
    }
    source->cells = drawn;
    source->stream[0] = cells_stream, source->stream[1] = telemetry_stream;
    source->held.cop_std[0] = source->held.cop_std[1] = view.cop_bound;
    sf_momentum_beliefs_init(&source->beliefs);
    sf_moment_init(&robot, &moment, &source->filter, &work);
    for (int t = 0; argc == 3 && t < length; t++) {
        step(source, all);
        for (int i = 0; i < K; i++) row[i] = source->estimate.force[i];
        fwrite(row, sizeof *row, K, stdout);
    }
    if (argc == 3) return 0;
    int before = atoi(argv[6]), moments = atoi(argv[7]), steps = atoi(argv[8]);
    for (int t = 0; t < before + moments; t++) {
        for (int n = t - before; n >= 0 && n < robots; n += moments) {
            r[n] = *source;
            for (int i = 0; i < 2; i++) r[n].stream[i].key += (uint64_t)n << 32;
        }
        step(source, all);
    }
    timed = atoi(argv[5]);
    /* Others may have the core for a while; single steps are too short for this clock. */
    of_process = timed || robots > 1;
    price = 1;
    for (int i = 0; i < 10000; i++) {
        mark = clock_now();
        double taken = clock_now() - mark;
        if (taken < price) price = taken;
    }
    for (int t = 0; t < steps; t++) {
        memset(spent, 0, sizeof spent);
        if (swept) sweep();
        double begin = clock_now();
        for (int n = 0; n < robots; n++) step(r + n, all);
        double whole = clock_now() - begin;
        fwrite(timed ? spent : &whole, sizeof whole, timed ? PARTS : 1, stdout);
    }
    return 0;
}
"""


def walk(steps: int) -> tuple[str, NDArray[np.float64], NDArray[np.float64]]:
    """Record a walk: the robot's constants in C, the inputs of the native step, and its forces."""
    require(CALIBRATION.installed())
    duration = steps / 80.0 + 5.0
    env: Any = gym.make("surefoot/NaoWalk-v0", disable_env_checker=True, speed=0.04, duration=duration)
    env = SelfCalibration(FootSensors(env, "hx711-load-cells"), "moment")
    env.reset(seed=0)
    sensors, beliefs = env._sensors.robot, env.beliefs
    sensing = sensors.backend
    rows, forces = [], []
    for _ in range(steps):
        parts = sensing.records.parts["load"], *sensing._telemetry.inputs, beliefs._planned
        rows.append(np.concatenate([*map(np.ravel, parts), [env.reference_time, sensors.time]]))
        forces.append(env.estimate.force)
        if env.step(np.zeros(env.action_space.shape))[2]:
            raise SystemExit(f"The robot fell after {len(rows)} steps of the walk that is to be recorded.")
    return constants(env, sensors), np.array(rows), np.array(forces)


def constants(env: Any, sensors: Any) -> str:
    """Return the robot in C: its constants, and its cells and random numbers as an episode begins."""
    equipment, telemetry = sensors.equipment, sensors.telemetry
    streams, cells = equipment.streams(0), equipment.instruments.native["cells"]
    library = require(CALIBRATION.installed())
    assert cells is not None
    drawn = cells.pack(equipment.instruments.init(streams).cells)
    first, *more = equipment.instruments.first_steps(telemetry.dt)
    channels, joints = len(drawn.now["period"]), len(telemetry.inputs[0][0])
    sizes = dict.fromkeys(("LOAD_CELLS", "ON_WIRE"), channels)
    of_cells = {"PLAYS": "plays", "CREEPS": "creeps", "SETTLING": "settling", "UNDER_WAY": "wire_under_way"}
    sizes |= {name: max(1, int(cells.constants[field])) for name, field in of_cells.items()}
    records = {"sf_cells_config cells_config": cells.constants, "sf_cells drawn": drawn.now}
    records |= {f"sf_random {name}_stream": streams[name].record for name in ("cells", "telemetry")}
    of_telemetry = {"sf_telemetry_config telemetry_config": telemetry.config}
    parts = (
        "#include <math.h>\n#define nan NAN\n#define inf INFINITY\n#define SF_PACKETS 16\n",
        f"enum {{ ROWS = {len(telemetry.inputs[0])}, MORE = {len(more)} }};\n",
        f"#define STEP {telemetry.dt!r}\n#define FIRST {first!r}\n",
        of_filter(env.calibrator.setup),
        of_beliefs(env.beliefs._spec),
        c_header("surefoot_view.h", {}, {"sf_view view": view_record(library, env.robot._view)}),
        c_header("surefoot_feet.h", sizes, records).replace(".wire_", ".wire."),
        c_header("surefoot_telemetry.h", {"JOINTS": joints, "LINK_ROOM": 16}, of_telemetry),
    )
    return "".join(parts)


def compile_program(source: str, folder: Path) -> Path:
    """Compile the program, and return where it is."""
    program, text = folder / "robot", folder / "robot.c"
    text.write_text(source + PROGRAM)
    options = [*FLAGS, "-D_POSIX_C_SOURCE=199309L", f"-I{FOLDER}"]
    subprocess.run([*(compiler() or ("cc",)), *options, "-o", program, text, "-lm"], check=True)
    return program


def check(program: Path, data: Path, forces: NDArray[np.float64]) -> None:
    """Hold the program's forces against those of the recording."""
    done = subprocess.run([program, data, str(len(forces))], check=True, stdout=subprocess.PIPE)
    found = np.frombuffer(done.stdout).reshape(forces.shape)
    wrong = ~(np.abs(found - forces) <= CLOSE * (1.0 + np.abs(forces)))
    if wrong.any():
        step = int(wrong.any(axis=1).argmax())
        raise SystemExit(
            f"The program must make the forces of the recording to {CLOSE}; at step {step} it made "
            f"{found[step]} N in the place of {forces[step]} N: compile both libraries anew "
            "('python -m surefoot.native')."
        )


def measure(program: Path, data: Path, length: int, robots: int, swept: bool, steps: int) -> list[float]:
    """Return the time of a robot's step in us: its mean, median and 99th percentile, and the parts' means."""
    # The walk goes on, and 512 moments hold all phases of a block and many of a stride.
    before, moments = length // 5, min(512, length // 4)
    steps = min(length - before - moments, steps)
    told: list[float] = []
    for parts in (0, 1):
        words = length, robots, int(swept), parts, before, moments, steps
        done = subprocess.run([program, data, *map(str, words)], check=True, stdout=subprocess.PIPE)
        times = np.frombuffer(done.stdout).reshape(steps, -1) / robots
        blocks = times[: steps // 16 * 16].reshape(-1, 16, times.shape[1]).mean(axis=1)
        told += np.median(blocks, axis=0).tolist()
        if not parts:
            told += np.percentile(times, (50, 99)).tolist() if robots == 1 else [np.nan] * 2
    return told


def main(given: list[str] | None = None) -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=2000, help="of the recording")
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 64, 1024, 4096])
    parser.add_argument("--rounds", type=int, default=3, help="in turns, of which the middle is told")
    folder = "folder for the table; by default docs/data/native-step"
    parser.add_argument("--write", type=Path, nargs="?", const=DATA / "native-step", help=folder)
    arguments = parser.parse_args(given)
    source, rows, forces = walk(arguments.steps)
    cases = [(robots, swept) for robots in arguments.robots for swept in (True, False)[robots > 1 :]]
    with TemporaryDirectory() as name:
        data = Path(name) / "walk"
        rows.tofile(data)
        program = compile_program(source, Path(name))
        check(program, data, forces)
        taken = [
            [
                measure(program, data, len(rows), robots, swept, max(48, 100_000 // robots // 16 * 16))
                for robots, swept in cases
            ]
            for _ in range(arguments.rounds)
        ]
    heads, lines = ["robots", "mean, µs", "median", "99 %", *PARTS], []
    for (robots, swept), times in zip(cases, np.median(taken, axis=0).tolist(), strict=True):
        words = ["" if np.isnan(one) else f"{one:.2f}" for one in times]
        lines.append([f"{robots:,}{', swept' * swept}", *words])
    for line in (heads, ["---"] * len(heads), *lines):
        print("| " + " | ".join(line) + " |")
    if arguments.write:
        save(arguments.write, "step", heads, lines)


if __name__ == "__main__":
    main()
