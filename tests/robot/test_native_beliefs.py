"""Beliefs in C against the Python that specifies them: the same references, soles and states."""

import copy
import pickle
import subprocess
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from _native import SANITIZED, compile_program
from _native_robots import (
    DT,
    PACKETS,
    ROBOTS,
    motion,
    on_feet,
    python,
    robot,
    round_feet,
    same,
    same_info,
)

from surefoot.native import CALIBRATION, compiler
from surefoot.robot.beliefs.momentum import MomentumBeliefs
from surefoot.robot.beliefs.native import NativeBeliefs, c_source, native_beliefs
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.robot.beliefs.references import Beliefs
from surefoot.sensors.telemetry.computer import TelemetryLayout

CORNERS = np.random.default_rng(8).normal(size=(2, 4, 3)) * (0.06, 0.03, 0.001)
PLACES = np.pad(CORNERS, ((0, 0), (0, 0), (0, 1)))

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


@pytest.fixture(scope="module")
def model() -> NominalModel:
    return robot("tree 2")


def commands(seed: int = 0, feet: int = 2):
    """Yield what a robot plans that steps at random."""
    rng, left = np.random.default_rng([73, seed]), np.arange(feet) % 2 == 0
    while True:
        swinging = (None, left, ~left)[int(rng.integers(3))]
        for _ in range(int(rng.integers(1, 30))):
            swing = np.zeros(feet, bool) if swinging is None else swinging
            yield SimpleNamespace(stance=~swing, swing=swing)


def numbers(beliefs: Beliefs | NativeBeliefs, now: float) -> np.ndarray:
    """All that one sample told, in a row."""
    believed = beliefs.believed.reference() if isinstance(beliefs, NativeBeliefs) else beliefs.believed
    soles = np.concatenate(beliefs.soles(now))
    standing = beliefs.known and beliefs.standing
    return np.concatenate([*(part.ravel() for part in believed), soles, [beliefs.known, standing]])


@pytest.mark.parametrize("momentum", [False, True])
@pytest.mark.parametrize(("averaged", "lag", "plans"), [(True, 5, True), (False, 9, False)])
@pytest.mark.parametrize(
    "name",
    [
        name if name == "nao" else pytest.param(name, marks=pytest.mark.slow)
        for name in ROBOTS
        if "feet" not in name  # below
    ],
)
def test_the_library_is_the_python(library, name, averaged, lag, plans, momentum):
    model = robot(name)
    expected = python(model, averaged, lag, PLACES)
    if momentum:
        expected = MomentumBeliefs(expected)
    play(library, expected, lag, plans)


@pytest.mark.parametrize("rolls", [True, False])
@pytest.mark.parametrize(
    ("feet", "momentum"),
    [
        (4, True),
        *(pytest.param(*one, marks=pytest.mark.slow) for one in product((1, 3, 4, 8), (True, False))),
    ],
)
def test_the_library_is_the_python_on_any_number_of_feet(library, feet, momentum, rolls):
    model, places = robot(f"{feet} feet"), round_feet(feet)
    expected = python(model, True, 3, places, rolls)
    if momentum:
        expected = MomentumBeliefs(expected)
    play(library, expected, 3, plans=feet == 3)


def play(library, expected: Beliefs | MomentumBeliefs, lag: int, plans: bool) -> None:
    """Let both take in two thousand packets, and see that they believe the same."""
    model = expected.model
    native = NativeBeliefs(library, expected)
    packets, plan = motion(len(model.joint_names)), commands(feet=model.feet)
    heard, told = 0, ([], [])
    for step in range(PACKETS):
        now = DT * step
        arrived = heard
        while arrived < len(packets) and packets[arrived].arrival <= now:
            arrived += 1
        command, hold = next(plan) if plans else None, 400 <= step < 410
        for beliefs, rows in zip((expected, native), told, strict=True):
            beliefs.update(packets[heard:arrived])
            fell = beliefs.sample(now - lag * DT - 0.004, command, hold)
            rows.append(np.append(numbers(beliefs, now), fell))
        heard = arrived
        if step % 197 == 0:
            same_info(expected.info(), native.info())
        if step in (3, 1001):
            native = copy.deepcopy(native)
    python_told, native_told = map(np.array, told)
    assert heard == len(packets)
    same(python_told, native_told)
    *_, known, standing, fell = python_told.T
    for happened in (known, standing, fell):
        assert 0 < happened.sum() < PACKETS


def test_more_feet_than_there_is_room_for_are_refused(library, monkeypatch):
    monkeypatch.setattr(CALIBRATION, "installed", lambda: library)
    model = on_feet(9)
    beliefs = python(model)
    with pytest.raises(
        ValueError, match=r"compiled for at most 8 feet, and the robot has 9; compile it with"
    ):
        NativeBeliefs(library, beliefs)
    assert native_beliefs(beliefs) is beliefs


def test_a_reference_may_be_asked_for_any_moment(library, model):
    expected = python(model)
    native = NativeBeliefs(library, expected)
    stance, swing = np.array([True, False]), np.array([False, True])
    packets = motion(len(model.joint_names))[:200]
    for count in (1, 3, 4, 120):
        expected.update(packets[:count])
        native.update(packets[:count])
        for time in (-1.0, 0.0, 0.7012, 1.5, 9.0):
            one, two = (beliefs.reference(time, stance, swing) for beliefs in (expected, native))
            for name, part in one._asdict().items():
                same(part, getattr(two, name), name)
            same(expected.soles(time), native.soles(time))


def test_an_episode_begins_with_nothing_believed(library, model):
    native, fresh = (NativeBeliefs(library, python(model)) for _ in range(2))
    native.update(motion(len(model.joint_names))[:60])
    native.sample(0.4, None)
    assert native.begin_episode() is native
    same_info(fresh.info(), native.info())
    for packet in motion(len(model.joint_names))[60:120]:
        np.testing.assert_array_equal(numbers(native, 0.0), numbers(fresh, 0.0))
        for beliefs in (native, fresh):
            beliefs.update((packet,))
            beliefs.sample(packet.arrival - 0.1, None)
    assert native.known


def test_other_masses_are_believed_from_then_on(library, model):
    packets = motion(len(model.joint_names))[:60]
    expected = python(model)
    native, kept = NativeBeliefs(library, expected), model.masses
    for part in (packets[:30], packets[30:]):
        expected.update(part)
        native.update(part)
        model.masses = model.masses._replace(mass=model.masses.mass * np.linspace(1.0, 1.3, len(kept.mass)))
    for beliefs in (expected, native):
        beliefs.sample(0.4, None)
    same(numbers(expected, 0.4), numbers(native, 0.4))
    assert native.known
    model.masses = kept


def test_copies_go_on_alike(library, model, monkeypatch):
    monkeypatch.setattr(CALIBRATION, "installed", lambda: library)
    packets = motion(len(model.joint_names))[:80]
    native = native_beliefs(python(model))
    assert isinstance(native, NativeBeliefs)
    native.update(packets[:60])
    native.sample(0.4, None)
    others = [copy.deepcopy(native), pickle.loads(pickle.dumps(native))]
    monkeypatch.setattr(CALIBRATION, "installed", lambda: None)
    with pytest.raises(RuntimeError, match="The library is missing"):
        pickle.loads(pickle.dumps(native))
    monkeypatch.undo()
    monkeypatch.setattr(type(library), "source", "another")
    other = pickle.dumps(native)
    monkeypatch.undo()
    with pytest.raises(ValueError, match="This NativeBeliefs was pickled by a library of other sources"):
        pickle.loads(other)
    for other in others:
        same_info(native.info(), other.info())
    native.update(packets[60:])
    native.sample(0.6, None)
    for other in others:
        other.update(packets[60:])
        other.sample(0.6, None)
        same_info(native.info(), other.info())


def test_a_robot_that_the_library_is_not_made_for_is_left_to_python(library, monkeypatch):
    monkeypatch.setattr(CALIBRATION, "installed", lambda: library)
    model = ROBOTS["nao"]()
    late = python(model, lag=80)
    assert native_beliefs(late) is late
    # Rows of other joints would be read across their ends.
    fewer = Beliefs(model, TelemetryLayout(len(model.joint_names) - 4), 0.01, 0.02, True)
    assert native_beliefs(fewer) is fewer
    monkeypatch.setattr(model, "tree", lambda: None)
    assert not isinstance(native_beliefs(python(model)), NativeBeliefs)


def test_what_does_not_fit_is_found(library):
    tree, timing = (
        ROBOTS["nao"]().tree(),
        {"window": 1, "joined": 1, "gravity": 9.81, "period": 0.01, "dt": 0.0125, "feet": 2, "points": 4},
    )
    sizes = {"bodies": len(tree["mass"]), "hinges": len(tree["axis"])}

    def fits(timing, **changes):
        model = library.record_of("model", {**sizes, **tree, **changes})
        record = library.record_of("timing", timing)
        return library.functions.surefoot_beliefs_fit(model.ctypes.data, record.ctypes.data)

    assert fits(timing)
    for change in (
        {"bodies": 65},
        {"hinges": -1},
        {"site_body": np.array([0, 1, 99])},
        {"mass": 0.0 * tree["mass"]},
        {"parent": tree["parent"] + 40},
        {"hinge_body": tree["hinge_body"][::-1]},
    ):
        assert not fits(timing, **change), change
    for change in (
        {"window": 0}, {"window": 65}, {"period": 0.0}, {"dt": np.nan}, {"feet": 0}, {"feet": 9},
        {"points": 17}, {"points": 0},
    ):  # fmt: skip
        assert not fits({**timing, **change}), change


@pytest.mark.parametrize("flags", [("-O0",), pytest.param(SANITIZED, marks=pytest.mark.slow)])
def test_a_robot_alone_believes_the_same(model, library, monkeypatch, tmp_path, flags):
    """A program in C, with nothing of Python; and with sanitizers that look for misuse of memory."""
    monkeypatch.setattr(CALIBRATION, "installed", lambda: library)
    (tmp_path / "robot.h").write_text(c_source(python(model)))
    (tmp_path / "main.c").write_text(PROGRAM)
    compile_program(tmp_path / "main.c", tmp_path / "main", *flags)
    native, told, lines = NativeBeliefs(library, python(model)), [], []
    for packet in motion(len(model.joint_names))[:400]:
        native.update((packet,))
        native.sample(packet.arrival - 0.1, None)
        told.append(native.believed.reference())
        lines.append(np.array([packet.number, packet.arrival, *packet.values]))
    done = subprocess.run(
        [tmp_path / "main"], input=np.concatenate(lines).tobytes(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = np.array([float(word) for word in done.stdout.split()]).reshape(-1, 6)
    same(np.array([(*row.com, *row.com_acceleration) for row in told]), found)
    assert np.isfinite(found).any()


@pytest.mark.slow
@pytest.mark.parametrize("flags", [(), ("-DSF_SINGLE",)])
def test_a_million_samples_of_garbage_are_survived(model, library, monkeypatch, tmp_path, flags):
    monkeypatch.setattr(CALIBRATION, "installed", lambda: library)
    (tmp_path / "robot.h").write_text(c_source(python(model)))
    source = Path(__file__).parent / "fuzz_beliefs.c"
    compile_program(source, tmp_path / "fuzz", f"-I{tmp_path}", *SANITIZED, *flags)
    done = subprocess.run([tmp_path / "fuzz", "1000000"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


PROGRAM = """
#include <stdio.h>
#include "robot.h"
int main(void) {
    static sf_beliefs beliefs;
    sf_belief belief;
    double row[2 + 2 * SF_HINGES + 8], *values = row + 2, *imu = values + 2 * SF_HINGES + 2;
    if (!sf_beliefs_fit(&model, &timing)) return 1;
    sf_beliefs_init(&beliefs);
    while (fread(row, sizeof row, 1, stdin) == 1) {
        if (sf_measured(values, 2 * SF_HINGES + 8))
            sf_beliefs_packet(&model, &timing, &beliefs, (sf_whole)row[0], row[1], values, imu + 3, imu);
        sf_beliefs_sample(&timing, &beliefs, row[1] - 0.1, NULL, 0, &belief);
        for (int i = 0; i < 3; i++) printf("%.17g ", belief.reference.com[i]);
        for (int i = 0; i < 3; i++) printf("%.17g ", belief.reference.com_acceleration[i]);
    }
    return 0;
}
"""
