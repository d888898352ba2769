"""The filter in C against the Python for other numbers of feet than two: balls, cells and six axes."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from _native import SANITIZED
from test_many_feet import DT, MASS, WEIGHT, layout_of, move, read
from test_native_filter import play

from surefoot.calibration import FeetLayout, FootCalibrator, FootLayout, OnlineSetup, Parameters, Reference
from surefoot.calibration.native import ReferenceRecord, c_source, native_filter
from surefoot.calibration.online import online_method
from surefoot.native import CALIBRATION, compiler
from surefoot.native.build import FLAGS

SAMPLES, AT = 400, 160
CORNERS = np.array([(0.02, 0.015, 0.0), (0.02, -0.015, 0.0), (-0.02, 0.015, 0.0), (-0.02, -0.015, 0.0)])
KINDS = {
    "fz": lambda name: FootLayout.point(name, "z"),
    "xyz": lambda name: FootLayout.point(name, "xyz"),
    "cells": lambda name: FootLayout.load_cells(name, CORNERS),
    "six axes": lambda name: FootLayout.force_torque(name, position_sensor_sole=(0.0, 0.0, 0.05)),
}
UP = {"fz": [1.0], "xyz": [0.0, 0.0, 1.0], "cells": [0.3, 0.2, 0.3, 0.2], "six axes": [0, 0, 1.0, 0, 0, 0]}
"""What a newton on a foot is on each of its channels."""

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


class Log:
    """Four seconds of a robot whose feet stand and swing, with a gap, lost readings and a retraction."""

    def __init__(self, feet, kind, momentum):
        force, reference = move(feet, 1)
        load = (force[:SAMPLES, :, None] * UP[kind]).reshape(SAMPLES, -1)
        self.force = read(load, 1)
        self.force[AT, 0] = self.force[AT + 60 : AT + 64] = np.nan
        self.times = np.full(SAMPLES, DT)
        self.times[AT + 90] = 0.08
        self._reference = reference if momentum else accelerations(reference)
        self.retracted = {AT + 120}

    def row(self, k):
        return type(self._reference)(*(part[k] for part in self._reference))


def accelerations(momentum):
    rates = [np.gradient(part, DT, axis=0) for part in (momentum.com_velocity, momentum.angular_momentum)]
    felt = np.zeros((2, *momentum.com.shape))
    felt[0, :, 2] = 9.81
    return Reference(momentum.com, *rates, *momentum[3:], *felt)


def setup_of(feet, kind, lag=0):
    layout = FeetLayout(tuple(KINDS[kind](f"foot {i}") for i in range(feet)))
    initial = Parameters(np.ones(layout.channels), np.zeros(layout.channels))
    return OnlineSetup(layout=layout, mass=MASS, initial=initial, dt=DT, lag=lag, foot_length=0.4)


ROBOTS = [(1, "fz"), (1, "six axes"), (3, "xyz"), (4, "fz"), (4, "cells"), (4, "six axes"), (8, "xyz")]
FAST = (1, "fz"), (3, "xyz"), (4, "cells")


@pytest.mark.parametrize("momentum", [True, False])
@pytest.mark.parametrize(
    ("feet", "kind"), [one if one in FAST else pytest.param(*one, marks=pytest.mark.slow) for one in ROBOTS]
)
def test_the_library_is_the_python(library, feet, kind, momentum):
    setup = setup_of(feet, kind)
    native = native_filter(library, "moment", setup, {})
    assert native is not None
    state, _ = play(
        online_method("moment", setup), native, Log(feet, kind, momentum), exchange=range(39, SAMPLES, 80)
    )
    assert np.isfinite(state.covariance).all()


@pytest.mark.parametrize("method", ["tare", "none"])
def test_other_methods_are_the_python_s(library, method):
    setup, log = setup_of(4, "fz", 2), Log(4, "fz", False)
    log.retracted = set()
    native = native_filter(library, method, setup, {})
    assert native is not None
    play(online_method(method, setup), native, log, exchange=150)


def test_more_feet_than_the_library_has_room_for_are_refused_and_left_to_python(library):
    setup = setup_of(9, "fz")
    assert native_filter(library, "moment", setup, {}) is None
    with pytest.raises(ValueError, match=r"The library is not made for such a robot; .* has its limits"):
        c_source(setup)
    with pytest.raises(
        ValueError, match=r"compiled for at most 8 feet, and the robot has 9; compile it with"
    ):
        ReferenceRecord(library, Reference, 9)
    calibrator = FootCalibrator(layout_of(9), mass=MASS, initial=setup.initial, dt=DT, lag=0, foot_length=0.4)
    log = Log(9, "fz", False)
    estimate = calibrator.update(log.force[0], log.row(0))
    assert calibrator.native() is None
    assert estimate.vgrf.shape == (9,)
    assert abs(estimate.vgrf.sum() - WEIGHT) < WEIGHT


@pytest.mark.skipif(len(CALIBRATION.rooms()) < 2, reason="needs both libraries")
@pytest.mark.parametrize("momentum", [True, False])
def test_a_library_with_less_room_is_the_same_to_the_last_bit(momentum):
    small, large = CALIBRATION.rooms()
    sizes = [room.places["moment_state"][""][2] for room in (small, large)]
    assert sizes[0] < 0.12 * sizes[1]
    setup, log = setup_of(2, "cells"), Log(2, "cells", momentum)
    both = [native_filter(room, "moment", setup, {}) for room in (small, large)]
    states = [native.pack() for native in both]
    for k in range(SAMPLES):
        found = [
            native.update(state, log.force[k], log.row(k), float(log.times[k]))
            for native, state in zip(both, states, strict=True)
        ]
        for one, other in zip(*found, strict=True):
            assert np.array_equal(one, other, equal_nan=True) if one is not None else other is None
    assert FootCalibrator(setup.layout, mass=MASS, initial=setup.initial, dt=DT).library is small
    assert native_filter(small, "moment", setup_of(2, "six axes"), {}) is None


@pytest.mark.skipif(len(CALIBRATION.rooms()) < 2, reason="needs both libraries")
def test_a_reference_of_another_library_is_taken_by_its_values():
    setup, log = setup_of(2, "cells"), Log(2, "cells", True)
    one, other = (FootCalibrator(setup.layout, mass=MASS, initial=setup.initial, dt=DT) for _ in "ab")
    record = ReferenceRecord(CALIBRATION.rooms()[1], type(log.row(0)), 2)
    for k in range(60):
        record.fill(log.row(k))
        found, wanted = one.update(log.force[k], record), other.update(log.force[k], log.row(k))
        assert np.array_equal(found.force, wanted.force, equal_nan=True)


def feed_garbage(path):
    """Feed wrong readings to the moment filter of a library, for two feet on cells."""
    library, rng = CALIBRATION.load(Path(path)), np.random.default_rng(1)
    poison = [np.nan, np.inf, -np.inf, 1e30, 5e3, 0.0, -50.0]
    for trial in range(4):
        log = Log(2, "cells", trial % 2 == 0)
        native = native_filter(library, "moment", setup_of(2, "cells"), {})
        state = native.pack()
        for k in range(3 * SAMPLES):
            raw, row = log.force[k % SAMPLES].copy(), log.row(k % SAMPLES)
            if rng.random() < 0.1:
                raw[rng.integers(8)] = rng.choice(poison)
            if trial > 1 and k > SAMPLES:
                raw[[1, 2, 5]] = raw[2], raw[1], -raw[5]
            native.update(state, raw, row, DT * float(rng.choice([1.0, 1.0, 1.0, 0.01, 0.3, 1e-4, 3.0])))
            if rng.random() < 0.005:
                native.retract(state)
        assert np.isfinite(state.python().covariance).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "sources", [CALIBRATION.sources, CALIBRATION.sources.smaller], ids=["large", "small"]
)
def test_garbage_stays_in_its_memory(tmp_path, sources):
    """With sanitizers that look for misuse of memory, in the sizes of both libraries."""
    asan = subprocess.run(["cc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    assert sources.compile(tmp_path / "watched.so", (*FLAGS[:1], *SANITIZED)) is None
    program = f"from test_native_feet import feed_garbage; feed_garbage({str(tmp_path / 'watched.so')!r})"
    watch = {"LD_PRELOAD": asan.stdout.strip(), "ASAN_OPTIONS": "detect_leaks=0"}
    here = {
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1]), *sys.path])
    }
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | watch | here,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
