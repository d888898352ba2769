"""Telemetry in C against the Python that specifies it: the same packets and states, step by step."""

from pathlib import Path

import numpy as np
import pytest
from _native import SANITIZED, compile_program, run_program

from surefoot.native import SENSORS, Record, compiler
from surefoot.sensors import Encoders, Imu, Link, preset
from surefoot.sensors.randomness import Stream
from surefoot.sensors.telemetry.computer import Hardware, Telemetry
from surefoot.sensors.telemetry.native import NativeTelemetry, telemetry_of

STEPS, BLOWN_UP, CLOSE = 2000, 1000, 1e-9

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")

COARSE = Imu(accelerometer_scale_std=0.02, gyroscope_scale_std=0.01, misalignment_std=0.01)
ONE_AXIS = Imu(accelerometer_resolution=0.0, gyroscope_range=0.0, averaged=False)
PERFECT = preset("perfect", Imu), preset("perfect", Encoders), preset("perfect", Link)

TABLE = {
    "usual": (24, Imu(), Encoders(), Link(), 1 / 80, 10),
    "an odd number of joints": (17, Imu(), Encoders(), Link(), 0.015, 5),
    "no joints": (0, Imu(), Encoders(), Link(), 1 / 80, 10),
    "one row a step": (12, Imu(), Encoders(), Link(rate=50.0), 0.02, 1),
    "perfect": (24, *PERFECT, 1 / 80, 10),
    # Moments of this step differ from sums of steps by rounding.
    "perfect but averaged": (3, Imu(**{**vars(PERFECT[0]), "averaged": True}), *PERFECT[1:], 0.015, 4),
    "axes that are off": (6, COARSE, Encoders(bits=0), Link(jitter=0.0), 1 / 80, 10),
    "no mean": (6, ONE_AXIS, Encoders(noise_std=0.0), Link(), 1 / 80, 10),
    "a packet each substep": (4, Imu(), Encoders(), Link(rate=800.0, delay=0.004), 1 / 80, 10),
    "slow packets": (4, Imu(), Encoders(), Link(rate=13.0, delay=0.3, jitter=0.05), 1 / 80, 10),
    "jitter that holds packets up": (4, Imu(), Encoders(), Link(delay=0.02, jitter=0.04), 0.01, 2),
    "late": (40, Imu(), Encoders(), Link(rate=150.0, delay=0.2, jitter=0.01), 1 / 80, 10),
}


class Motion:
    """What a robot does: it sways, turns, falls freely for a while, and lands hard.

    What it feels goes through both bounds of the specific force that shows what is up, again and again.
    """

    def __init__(self, joints: int, dt: float, substeps: int, seed: int = 0) -> None:
        rng = np.random.default_rng([7, seed])
        self.dt, self.substeps = dt, substeps
        self.rate = rng.uniform(1.0, 9.0, joints + 6)
        self.phase = rng.uniform(0.0, 6.0, joints + 6)
        self.size = np.concatenate([rng.uniform(0.1, 1.0, joints), [2.0, 2.0, 5.5, 1.0, 1.0, 12.0]])

    def step(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        times = self.dt * (k + np.arange(1, self.substeps + 1)[:, None] / self.substeps)
        rows = self.size * np.sin(self.rate * times + self.phase)
        position, inertial = rows[:, :-6], rows[:, -6:].copy()
        if k % 500 > 400:
            inertial[:, :3] = 0.0
        elif k % 500 == 400:
            inertial[:, :3] = (30.0, -40.0, 90.0)
        else:
            inertial[:, 2] += 9.81
        return position, inertial


def same_packets(expected, found) -> None:
    assert len(found) == len(expected)
    for one, two in zip(expected, found, strict=True):
        assert (two.number, two.arrival) == (one.number, pytest.approx(one.arrival, rel=CLOSE))
        np.testing.assert_allclose(two.values, one.values, rtol=CLOSE, atol=1e-12)


def same_state(expected, found) -> None:
    assert type(found) is Record
    ((imu, (walk, *_)), attitude, position, velocity), inertial, substeps, due, number, under_way = expected
    parts = {
        "bias": imu.bias, "matrix": imu.matrix, "error": walk.error, "up": attitude.up,
        "gyroscope_bias": attitude.bias, "position": position, "velocity": velocity,
        "inertial": inertial, "substeps": substeps, "due": due, "number": number, "waiting": len(under_way),
    }  # fmt: skip
    for name, part in parts.items():
        if not isinstance(part, tuple) or part:  # axes that are exact have no matrix
            np.testing.assert_allclose(found.now[name], part, rtol=CLOSE, atol=1e-12, err_msg=name)


QUICK = ("usual", "axes that are off", "jitter that holds packets up")


@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in TABLE]
)
def test_the_library_is_the_python(library, name: str) -> None:
    arguments = TABLE[name]
    joints, _, _, _, dt, substeps = arguments
    python, native = Telemetry(*arguments), NativeTelemetry(library, *arguments)
    motion, rngs = Motion(joints, dt, substeps), [Stream.of(3), Stream.of(3)]
    rest = np.array([0.1, 0.0, 9.8, 0.0, 0.0, 0.01])
    packets, expected = python.init(np.full(joints, 0.2), rest, rngs[0])
    others, found = native.init(np.full(joints, 0.2), rest, rngs[1])
    came = 0
    for k in range(STEPS):
        same_packets(packets, others)
        came += len(packets)
        if k % 97 == 0:
            same_state(expected, found)
        truth, time = motion.step(k), (k + 1) * dt
        if k == BLOWN_UP:
            truth = tuple(np.full_like(part, np.nan) for part in truth)
        packets, expected = python.advance(*truth, time, expected, rngs[0])
        others, found = native.advance(*truth, time, found, rngs[1])
    same_state(expected, found)
    assert np.isfinite(found.now["up"]).all()
    assert np.isfinite(found.now["velocity"]).all()
    assert rngs[1].standard_normal() == pytest.approx(float(rngs[0].standard_normal()), rel=CLOSE)
    assert came > 0.9 * STEPS * dt / python.period


@pytest.mark.parametrize("name", ["usual", "axes that are off"])
def test_hardware_is_kept_and_exchanged(library, name: str) -> None:
    arguments = TABLE[name]
    joints = arguments[0]
    python, native = Telemetry(*arguments), NativeTelemetry(library, *arguments)
    rng, rest = Stream.of(5), np.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    _, first = python.init(np.zeros(joints), rest, rng)
    hardware = python.hardware(first)
    rngs = [Stream.of(6), Stream.of(6)]
    _, expected = python.init(np.zeros(joints), rest, rngs[0], hardware)
    _, found = native.init(np.zeros(joints), rest, rngs[1], hardware)
    same_state(expected, found)
    other = Hardware(*native.hardware(native.init(np.zeros(joints), rest, rng)[1]))
    changed = native.with_hardware(found, other)
    same_state(python.with_hardware(expected, other), changed)
    same_state(expected, found)


def test_what_does_not_fit_is_python(library, monkeypatch) -> None:
    monkeypatch.setattr(SENSORS, "installed", lambda: library)
    assert type(telemetry_of(*TABLE["usual"])) is NativeTelemetry
    for joints, link in ((65, Link()), (6, Link(jitter=0.5)), (6, Link(jitter=1e12))):
        assert type(telemetry_of(joints, Imu(), Encoders(), link, 1 / 80, 10)) is Telemetry
    with pytest.raises(ValueError, match=r"Link\.rate must be at most 800 per second"):
        telemetry_of(6, Imu(), Encoders(), Link(rate=900.0), 1 / 80, 10)
    monkeypatch.setattr(SENSORS, "installed", lambda: None)
    assert type(telemetry_of(*TABLE["usual"])) is Telemetry


def test_a_step_may_have_other_rows(library) -> None:
    python, native = Telemetry(*TABLE["usual"]), NativeTelemetry(library, *TABLE["usual"])
    rngs = [Stream.of(3), Stream.of(3)]
    expected, found = (
        telemetry.init(np.zeros(24), np.zeros(6), rng)[1]
        for telemetry, rng in zip((python, native), rngs, strict=True)
    )
    for k, rows in enumerate((10, 5, 5, 10)):
        truth = [part[:rows] for part in Motion(24, 1 / 80, 10).step(k)]
        packets, expected = python.advance(*truth, (k + 1) / 80, expected, rngs[0])
        others, found = native.advance(*truth, (k + 1) / 80, found, rngs[1])
        same_packets(packets, others)
    same_state(expected, found)


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fuzz") / "fuzz"
    compile_program(Path(__file__).parent / "fuzz_telemetry.c", path, *SANITIZED)
    return path


@pytest.mark.parametrize("name", ["usual", "a packet each substep", "jitter that holds packets up"])
def test_garbage_stays_within_the_arrays(library, fuzzer, tmp_path, name: str) -> None:
    (tmp_path / "config").write_bytes(NativeTelemetry(library, *TABLE[name]).config.tobytes())
    run_program(fuzzer, tmp_path / "config")
