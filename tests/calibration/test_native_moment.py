"""The moment filter in C against the Python that specifies it, and its header for a controller."""

import pickle
import subprocess
from pathlib import Path

import numpy as np
import pytest
import test_native_filter as shared
from _moment import DT, Errors, move
from _native import SANITIZED, compile_program
from _synthetic import LAYOUT, MASS, NOMINAL
from test_native_filter import Log, play, robot, same_estimate, setup_of

from surefoot.calibration import FootCalibrator, MomentumReference
from surefoot.calibration.estimate import Flag
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.filter import MomentFilter
from surefoot.calibration.native import c_source
from surefoot.calibration.native.config import moment_constants
from surefoot.native import CALIBRATION, compiler
from surefoot.native.library import _MISSING, _attribute

SAMPLES, AT = 800, 320

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


class MomentumLog:
    """Some seconds of a robot on eight cells whose momentum is known, to be spoilt as a :class:`Log` is."""

    at = AT

    def __init__(self, seed=1, lifted=None, walking=True):
        self.rng = np.random.default_rng([62, seed])
        own = move(seed, SAMPLES * DT, Errors.stated(), walking=walking, lifted=lifted)
        self.force, self.times = NOMINAL.force(own.raw), np.full(SAMPLES, DT)
        self.reference = MomentumReference(*(part.copy() for part in own.reference))
        self.retracted = set()

    def row(self, k):
        return MomentumReference(*(part[k] for part in self.reference))


def held(share=0.2):
    """By a share of the weight, for two seconds."""
    lifted = np.zeros(SAMPLES)
    lifted[AT : AT + 160] = share
    return MomentumLog(lifted=lifted)


def stands():
    return MomentumLog(walking=False)


def walks():
    return MomentumLog()


def spoilt(how):
    def made():
        log = MomentumLog()
        how(log)
        return log

    made.__name__ = how.__name__
    return made


def lost_for_a_while(log):
    log.force[AT : AT + 120, 3] = np.nan


def seldom_read(log):
    log.force[np.arange(SAMPLES) % 3 != 0] = np.nan


def gaps(log):
    for k, dt in (
        (100, 10.0),
        (101, 0.0),
        (200, -1.0),
        (300, np.nan),
        (400, np.inf),
        (500, 1e9),
        (600, 0.05),
    ):
        log.times[k] = dt


def unlike_clocks(log):
    log.times *= log.rng.uniform(0.3, 2.5, SAMPLES)


def bad_references(log):
    for field, at, value in (
        ("com", 200, np.nan),
        ("R_level_sole", 300, np.inf),
        ("com_velocity", 400, 1e30),
    ):
        getattr(log.reference, field)[at : at + 3] = value
    log.reference.com_velocity[500:510, 2] = -30.0
    log.reference.position_sole[600:] += 5.0


def retracted(log):
    log.retracted = {3, AT, AT + 2, 500}


SPOILT = [
    lost_for_a_while, shared.stuck, shared.spikes, shared.missing_and_impossible, seldom_read, gaps,
    unlike_clocks, bad_references, shared.lies, retracted,
]  # fmt: skip
LOGS = [walks, held, stands, *(spoilt(how) for how in SPOILT)]


@pytest.mark.parametrize(
    "made", [log if log is held else pytest.param(log, marks=pytest.mark.slow) for log in LOGS],
    ids=lambda made: made.__name__,
)  # fmt: skip
@pytest.mark.parametrize("lag", [0])
def test_the_library_is_the_python(library, made, lag):
    log = made()
    # A tare of forces that leap by a body weight takes nine digits of a covariance away.
    leap = made.__name__ == "spikes"
    far, often = ({"close": 1e-5, "spread": 10.0}, range(39, SAMPLES, 40)) if leap else ({}, 500)
    state, _ = play(*robot(library, "cells", lag, "moment"), log, exchange=often, **far)
    assert np.isfinite(state.covariance).all()
    assert made is not held or state.belief.chance[1] < 0.5, "it was not let go"


def test_a_robot_that_is_held_is_said_to_be(library):
    _, native = robot(library, "cells", 0, "moment")
    log, state = held(), native.pack()
    flags = [native.update(state, log.force[k], log.row(k), DT).flags[0] & Flag.HELD for k in range(SAMPLES)]
    assert any(flags[AT + 40 : AT + 160])
    assert not any(flags[:AT])


@pytest.mark.parametrize(
    ("layout", "event"),
    [
        ("cells", shared.dropped_for_a_while),
        *(
            pytest.param(*row, marks=pytest.mark.slow)
            for row in (
                *(("cells", event) for event in (*shared.FAULTS, *shared.EVENTS)),
                *(("ankles", event) for event in (shared.clean, shared.gaps, shared.lies)),
                *(("both", event) for event in (shared.clean, shared.missing_and_impossible, shared.dead)),
            )
        ),
    ],
    ids=lambda value: value.__name__ if callable(value) else None,
)
def test_accelerations_are_added_up_alike(library, layout, event):
    """Both are equal but for rounding.

    Rounding grows fast on the made-up ankles, which contradict what the filter knows of shear, and on a foot
    that hangs on: its zero is the small difference of large numbers.
    """
    log = Log(layout)
    event(log)
    log.force = log.force[: AT + 240]
    far = {"close": 1e-8} if layout == "cells" else {"close": 1e-5, "spread": 10.0}
    play(*robot(library, layout, 2, "moment"), log, exchange=range(79, len(log.force), 80), **far)


def test_each_constant_has_one_home(library):
    """None of them is found under its name in two parts of the filter, of which one would hide the other."""
    own, *sources = moment_constants(MomentFilter(setup_of("cells"), Moment()))
    for field in set(library.places["moment_config"]) - {"", *own}:
        found = (_attribute(part, field) for part in sources)
        homes = [home for home in found if home is not _MISSING and not callable(home)]
        assert all(np.array_equal(home, homes[0]) for home in homes), field
    with pytest.raises(KeyError, match="No value for field 'components' of record 'moment_config'"):
        library.constants("moment_config", own)


def test_options_reach_the_library(library):
    log = MomentumLog(seed=4)
    log.force = log.force[:200]
    options = {"block": 0.15, "scale_std": 0.05, "offset_drift": 0.05, "velocity_noise": 0.02, "ripple": 0.5}
    play(*robot(library, "cells", 1, "moment", age=0.006, **options), log, exchange=100)


@pytest.fixture
def calibrators(library, monkeypatch):
    """The same calibrator by the library and by Python."""
    made = []
    for found in (None, library):
        monkeypatch.setattr(CALIBRATION, "rooms", lambda found=found: (found,) if found else ())
        made.append(FootCalibrator(LAYOUT, "moment", mass=MASS, lag=0))
    return made


def test_states_are_kept_and_go_on_in_either(calibrators, tmp_path):
    log = MomentumLog()
    by_python, by_library = calibrators
    for k in range(200):
        for calibrator in calibrators:
            calibrator.update(log.force[k], log.row(k))
    by_library.save(tmp_path / "feet.npz")
    by_python.load(tmp_path / "feet.npz")
    copied = pickle.loads(pickle.dumps(by_library))
    for k in range(200, 260):
        if k == 230:
            for calibrator in (*calibrators, copied):
                calibrator.retract()
        expected, *found = (one.update(log.force[k], log.row(k)) for one in (by_python, by_library, copied))
        for estimate in found:
            same_estimate(expected, estimate)


PROGRAM = """
#include <stdio.h>
#include <stdlib.h>
#include "robot.h"
static unsigned long long bits = 88172645463325252ULL;
static double uniform(void) {
    bits ^= bits << 13, bits ^= bits >> 7, bits ^= bits << 17;
    return (double)(bits >> 11) / 9007199254740992.0;
}
static void spoil(sf_real *values, int n, double share) {
    static const double all[] = {NAN, HUGE_VAL, -HUGE_VAL, 3e38, -3e38, 0.0, 1e-30, 8.4e6, -5.0, 1e3, 60.0};
    for (int i = 0; i < n; i++)
        if (uniform() < share) values[i] = all[(int)(uniform() * 11.0)];
}
int main(int count, char **words) {
    static sf_moment_state state, kept;
    static sf_moment_work work;
    static sf_estimate e;
    long samples = count > 1 ? atol(words[1]) : 0;
    int K = robot.channels, N = sf_states(&robot, &moment);
    if (!sf_moment_fits(&robot, &moment)) return 2;
    sf_moment_init(&robot, &moment, &state, &work);
    kept = state;
    for (long k = 0; k < samples; k++) {
        sf_reference r;
        sf_real raw[SF_CHANNELS], dt = robot.dt;
        double share = sf_clip((1 + 1.2 * sin((double)k * 0.05)) / 2, 0, 1);
        memset(&r, 0, sizeof r);
        r.com[1] = (share - 0.5) * 0.1, r.com[2] = 0.26;
        r.com_acceleration[1] = 0.05 * cos((double)k * 0.05);
        r.momentum = k / 5000 % 2 == 0;
        for (int foot = 0; foot < robot.feet; foot++) {
            double part = foot ? 1 - share : share;
            r.position_sole[3 * foot + 1] = foot ? -0.05 : 0.05;
            for (int i = 0; i < 3; i++) r.R_level_sole[9 * foot + 4 * i] = 1;
            r.stance[foot] = part > 0, r.swing[foot] = part <= 0;
            for (int i = 0; i < K; i++)
                if (robot.foot_of_channel[i] == foot)
                    raw[i] = part * robot.weight * (0.25 + 0.05 * (uniform() - 0.5));
        }
        if (k % 700 < 200) raw[k / 700 % K] = k / 700 % 2 ? NAN : 1;
        if (k % 4000 < 3000) {
            spoil(raw, K, 0.003);
            spoil(r.com, 9, 0.001);
            spoil(r.position_sole, 3 * robot.feet, 0.0005);
            spoil(r.R_level_sole, 9 * robot.feet, 0.0005);
            spoil(&dt, 1, 0.001);
        }
        sf_moment_step(&robot, &moment, &state, &work, raw, &r, dt, &e);
        if (uniform() < 0.0005) sf_moment_retract(&robot, &moment, &state);
        if (uniform() < 0.0005) kept = state;
        if (uniform() < 0.0005) state = kept;
        if (!sf_all_finite(state.belief.mean, 3 * N) || !sf_all_finite(state.belief.covariance, 3 * N * N) ||
            !sf_all_finite(state.belief.chance, 3) ||
            !sf_all_finite(state.published.mean, sf_weighed(&robot)) || !sf_finite(state.tare.rate) ||
            !sf_all_finite(state.covariance, 4 * K * K) || !sf_all_finite(e.force, K) ||
            !sf_all_finite(e.force_std, K) || !sf_all_finite(e.undetermined, K) ||
            !sf_all_finite(e.contact_probability, robot.feet) || sf_finite(e.cop[0]) != e.cop_valid) {
            printf("not finite at sample %ld\\n", k);
            return 1;
        }
    }
    printf("%lu %lu", (unsigned long)sizeof state, (unsigned long)sizeof work);
    return 0;
}
"""


def program(library, folder, monkeypatch, layout, *flags):
    """Compile a program that feeds garbage to the filter of one robot."""
    monkeypatch.setattr(CALIBRATION, "installed", lambda: library)
    (folder / "robot.h").write_text(c_source(setup_of(layout), "moment"))
    (folder / "main.c").write_text(PROGRAM)
    compile_program(folder / "main.c", folder / "main", f"-I{folder}", *flags)
    return folder / "main"


def run(made, samples):
    done = subprocess.run([made, str(samples)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout.split()


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["cells", "ankles", "both"])
def test_garbage_leaves_the_state_finite_and_memory_alone(library, tmp_path, monkeypatch, layout):
    run(program(library, tmp_path, monkeypatch, layout, *SANITIZED), 30_000)


@pytest.mark.parametrize(
    ("layout", "words"),
    [("cells", "takes {} kB and the work {} kB"), ("ankles", "sensors {} and {} kB")],
    ids=["cells", "ankles"],
)
def test_a_state_is_as_large_as_the_page_says(library, tmp_path, monkeypatch, layout, words):
    sizes = [round(int(size) / 1000) for size in run(program(library, tmp_path, monkeypatch, layout), 0)]
    page = Path(__file__).parents[2] / "docs" / "native.md"
    assert not page.exists() or words.format(*sizes) in page.read_text()
