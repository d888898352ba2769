"""References from encoders and IMU, by a model file, for a robot's own loop."""

import sys
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from subprocess import run
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest

import surefoot
from surefoot.robot import RobotState
from surefoot.robot.robot_state import SampleClock

NAO = Path(str(files("surefoot.envs") / "robots" / "nao.xml"))
UP = np.array([0.0, 0.0, 9.81])

SHAPE = (
    '<collision><origin xyz="0.02 0 -0.195"/><geometry><box size="0.16 0.08 0.01"/></geometry></collision>'
)
LEG = """
<link name="{side}_leg"><inertial><origin xyz="0 0 -0.1"/><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>
<joint name="{side}_hip" type="revolute"><parent link="base"/><child link="{side}_leg"/><axis xyz="0 1 0"/>
  <origin xyz="0 {y} -0.1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<link name="{side}_sole"/><joint name="{side}_fix" type="fixed"><parent link="{side}_leg"/>
  <child link="{side}_sole"/><origin xyz="0 0 -0.2"/></joint>"""
BASE = """<robot name="r"><link name="base"><inertial><origin xyz="0.01 0 0.1"/><mass value="3"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="imu"/><joint name="imu_fix" type="fixed"><parent link="base"/><child link="imu"/>
  <origin xyz="0.01 0 0.05" rpy="0 0 1.5707963267948966"/></joint>"""


def urdf(folder: Path, shape: str = SHAPE) -> Path:
    """Write a robot of 5 kg on two straight legs, whose IMU is turned by 90 degrees."""
    legs = "".join(LEG.format(side=s, y=y, shape=shape) for s, y in (("left", 0.06), ("right", -0.06)))
    path = folder / "robot.urdf"
    path.write_text(f"{BASE}{legs}</robot>")
    return path


def stand(state: RobotState, seconds: float = 2.0, **sample: Any) -> Any:
    """Feed a robot that stands still, and return its last reference."""
    angles = np.zeros(len(state.joint_names))
    for k in range(round(100 * seconds)):
        state.update(angles, np.zeros(3), UP, time=0.01 * k)
    reference = None
    for k in range(10):
        reference = state.reference(time=seconds - 0.2 + state.dt * k, **sample)
    return reference


class Walk(NamedTuple):
    """A NAO that walks for six seconds: what perfect encoders and IMU read, and the truth at 80 Hz."""

    samples: list[tuple[Any, Any, Any, float, int]]  # joints, gyroscope, accelerometer, time, number
    velocity: Any  # of the centre of mass in m/s, shape (480, 3)
    load: Any  # vertical force on each foot in N, shape (480, 2)
    joints: tuple[str, ...]

    def references(self, keep: Any = lambda k: True, **options: Any) -> Iterator[Any]:
        """Return the reference of each sample of the feet; ``keep`` decides which samples are not lost."""
        state, fed = RobotState(NAO, joints=self.joints, **options), 0
        for k in range(480):
            now = (k + 1) / 80.0
            while fed < len(self.samples) and self.samples[fed][3] <= now + 1e-9:
                if keep(fed):
                    state.update(*self.samples[fed][:4])
                fed += 1
            yield state.reference(now)


@pytest.fixture(scope="module")
def walk() -> Walk:
    bare = gym.make("surefoot/NaoWalk-v0", speed=0.04, disable_env_checker=True)
    link = {"rate": 100.0, "delay": 0.0, "jitter": 0.0}
    env = surefoot.wrappers.FootSensors(bare, imu="perfect", encoders="perfect", link=link)
    env.robot.listening = True
    env.reset(seed=3)
    layout, packets, truth = env.robot.telemetry.layout, [*env.robot.packets], []
    for _ in range(480):
        env.step(np.zeros(env.action_space.shape))
        now: Any = env.unwrapped
        truth.append((now.truth.com_velocity[-1], now.truth.wrench_sole[-1][:, 2]))
        packets.extend(env.robot.packets)
    samples = []
    for number, arrival, v in packets:
        parts = v[layout.joint_position], v[layout.gyroscope], v[layout.accelerometer]
        samples.append((*parts, arrival, number))
    velocity, load = (np.array(part) for part in zip(*truth, strict=True))
    return Walk(samples, velocity, load, env.robot.equipment.drawing.joint_names)


def velocity_noise(walk: Walk, references: list[Any], lag: int) -> Any:
    """Standard deviation of the believed velocity's error from one tenth of a second to the next in m/s."""
    off = np.array([one.com_velocity for one in references])[lag:] - walk.velocity[: 480 - lag]
    blocks = off[160:440].reshape(-1, 8, 3).mean(axis=1)
    return np.nanstd(np.diff(blocks, axis=0), axis=0) / np.sqrt(2.0)


def test_velocity_and_contacts_of_a_robot_that_walks_are_the_simulators(walk: Walk) -> None:
    references = list(walk.references())
    lag = RobotState(NAO).lag
    assert (velocity_noise(walk, references, lag) < (0.02, 0.02, 0.006)).all()
    stance, swing = (
        np.array([getattr(one, name) for one in references])[160:] for name in ("stance", "swing")
    )
    load = walk.load[160 - lag : 480 - lag]
    assert load[swing].max() < 1.0  # N on a foot that is said to be in the air
    assert np.median(load[stance]) > 20.0
    assert stance.mean() > 0.3
    assert swing.mean() > 0.05


def test_a_calibrator_of_accelerations_gets_them(walk: Walk) -> None:
    one = list(walk.references(momentum=False))[-1]
    assert isinstance(one, surefoot.calibration.Reference)
    assert np.isfinite(one.com_acceleration).all()


def test_lost_samples_and_nan_leave_a_gap_and_raise_nothing(walk: Walk) -> None:
    lost = np.random.default_rng(0).random(len(walk.samples)) < 0.01
    with_gaps = list(walk.references(keep=lambda k: not lost[k]))
    broken = walk._replace(
        samples=[(np.full_like(j, np.nan), *rest) if lost[k] else (j, *rest)
                 for k, (j, *rest) in enumerate(walk.samples)]
    )  # fmt: skip
    assert lost[60:].sum() > 3
    for one, other in zip(with_gaps, broken.references(), strict=True):
        for part, same in zip(one, other, strict=True):
            np.testing.assert_array_equal(part, same)
    # Time steps stay those of the robot: the velocity is as exact as without a loss.
    assert np.isfinite([one.com[0] for one in with_gaps[160:]]).mean() > 0.7
    assert (velocity_noise(walk, with_gaps, 4) < 0.05).all()


@pytest.mark.parametrize("time", [np.nan, np.inf, -1e9, 1e9])
def test_no_time_raises(time: float) -> None:
    state = RobotState(NAO)
    stand(state)
    state.update(np.zeros(24), np.zeros(3), UP, time)
    state.reference(time)
    for k in range(100):
        state.update(np.zeros(24), np.zeros(3), UP, 3.0 + 0.01 * k)
    assert state.reference(4.0).stance.dtype == bool


def test_a_clock_that_is_set_anew_is_followed() -> None:
    state = RobotState(NAO)
    stand(state)
    for k in range(200):
        state.update(np.zeros(24), np.zeros(3), UP, 1e4 + 0.01 * k)
    forward = [state.reference(1e4 + 1.8 + k / 80) for k in range(10)][-1]
    for k in range(200):
        state.update(np.zeros(24), np.zeros(3), UP, 5.0 + 0.01 * k)
    backward = [state.reference(5.0 + 1.8 + k / 80) for k in range(10)][-1]
    for reference in (forward, backward):
        np.testing.assert_array_equal(reference.stance, True)


def feed(state: RobotState, times: Any, numbers: Any) -> Any:
    """Feed a robot that stands still, and return the reference of the last sample's time."""
    reference = None
    for time, number in zip(times, numbers, strict=True):
        state.update(np.zeros(24), np.zeros(3), UP, float(time), int(number))
        reference = state.reference(float(time))
    return reference


@pytest.mark.parametrize("wrong", ["counter", "counter of a byte", "clock", "both"])
def test_a_counter_or_a_clock_that_begins_again_is_followed(wrong: str) -> None:
    number, state = np.arange(900), RobotState(NAO, dt=0.01)
    time, later = 0.01 * number, number >= 400
    if wrong == "counter of a byte":
        number = number % 256
    elif wrong != "clock":
        number = np.where(later, number - 400, number + 70_000)
    if wrong in ("clock", "both"):
        time = time + 1e4 * (later if wrong == "clock" else ~later)
    reference = feed(state, time, number)
    np.testing.assert_array_equal(reference.stance, True)
    np.testing.assert_allclose(reference.com_velocity, 0.0, atol=1e-9)
    # Half a second after the last sample nothing is known of the robot.
    assert np.isnan(state.reference(float(time[-1]) + 0.5).com).all()


def test_samples_have_the_numbers_of_their_times() -> None:
    """A clock of 98.7 Hz with a jitter of 1 ms, of which samples are lost one by one and in a row."""
    rng = np.random.default_rng(1)
    kept = np.setdiff1d(np.arange(3000), [60, 61, 200, 700, 701, 702, *range(1500, 1600)])
    times = 7.0 + kept / 98.7 + 1e-3 * rng.standard_normal(len(kept))
    clock = SampleClock(times[:50])
    np.testing.assert_array_equal([*clock.numbers, *map(clock.number, times[50:].tolist())], kept)
    assert clock.period == pytest.approx(1.0 / 98.7, rel=1e-3)


def test_numbers_of_the_robot_need_no_even_times() -> None:
    rng = np.random.default_rng(2)
    number = np.setdiff1d(np.arange(2000), [500, 501, 900])
    arrival = np.maximum.accumulate(0.01 * number + 0.004 * rng.standard_normal(len(number)))
    clock = SampleClock(arrival[:50], number[:50].tolist())
    for time, one in zip(arrival[50:].tolist(), number[50:].tolist(), strict=True):
        assert clock.number(time, one) == one
    assert clock.period == pytest.approx(0.01, rel=2e-3)
    assert clock.origin + clock.period * 1999 == pytest.approx(19.99, abs=2e-3)


@pytest.mark.parametrize(
    "feet",
    [None, ("left_leg", "right_leg"), ("left_sole", "right_sole")],
    ids=["guessed", "bodies with shapes", "frames"],
)
def test_a_urdf_stands_on_its_soles(tmp_path: Path, feet: Any) -> None:
    """The IMU's x axis is the torso's y axis: the robot leans neither way."""
    path = urdf(tmp_path, "" if feet and feet[0] == "left_sole" else SHAPE)
    state = RobotState(path, feet=feet, imu="imu")
    assert state.joint_names == ("left_hip", "right_hip")
    reference = stand(state)
    np.testing.assert_array_equal(reference.stance, True)
    # The legs weigh 1 kg each and are straight below the hips.
    np.testing.assert_allclose(reference.com[0] - reference.position_sole[:, 0], 0.01 * 3 / 5, atol=1e-6)
    np.testing.assert_allclose(reference.position_sole[:, 1] - reference.com[1], [0.06, -0.06], atol=1e-6)
    np.testing.assert_allclose(reference.com[2] - reference.position_sole[:, 2], 0.28, atol=1e-6)


def test_a_weighed_robot_keeps_its_proportions(tmp_path: Path) -> None:
    drawn, weighed = RobotState(urdf(tmp_path)), RobotState(urdf(tmp_path), mass=5.4)
    assert (drawn.mass, weighed.mass) == pytest.approx((5.0, 5.4))
    np.testing.assert_allclose(stand(drawn).com, stand(weighed).com, atol=1e-9)


def test_a_plan_decides_contacts(tmp_path: Path) -> None:
    reference = stand(RobotState(urdf(tmp_path)), stance=[True, False], swing=[False, True])
    assert reference.stance.tolist() == [True, False]
    assert reference.swing.tolist() == [False, True]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"feet": ("toe", "heel")}, "feet 'toe' is not in the model; it has the sites"),
        ({"imu": "left_leg"}, "imu 'left_leg' is not fixed to the torso 'base' but to 'left_leg'"),
        ({"joints": ("left_hip",)}, "'joints' lacks .'right_hip'.; measure them, or give their angles"),
        ({"joints": ("left_hip", "hip")}, "must name joints of the model, each once"),
        ({"mass": 5000.0}, "'mass' is 5000.0 kg, and the model's masses add up to 5 kg"),
        ({"rate": 0.0}, "'rate' must be finite and at least 0.001, got 0.0"),
    ],
)
def test_a_wrong_option_is_named(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RobotState(urdf(tmp_path), **options)


def test_a_wrong_rate_or_shape_is_named() -> None:
    state = RobotState(NAO, rate=200.0)
    with pytest.raises(ValueError, match=r"came 100 times a second, and 'rate' is 200"):
        stand(state)
    with pytest.raises(ValueError, match=r"came 100 times a second"):  # and again, not only once
        stand(state)
    with pytest.raises(ValueError, match=r"'stance' and 'swing' must have shape \(2,\), a value for each"):
        state.reference(0.0, stance=[True], swing=[False])
    with pytest.raises(ValueError, match=r"'gyroscope' must have shape \(3,\), got \(4,\)"):
        state.update(np.zeros(24), np.zeros(4), UP, 0.0)
    with pytest.raises(FileNotFoundError, match=r"There is no model file 'gone\.xml'"):
        RobotState("gone.xml")


def test_it_needs_mujoco_and_no_gymnasium() -> None:
    absent = ("gymnasium", "mink", "torch", "pandas", "matplotlib", "pydantic")
    code = f"import sys; sys.modules.update(dict.fromkeys({absent})); from surefoot.robot import RobotState; "
    run([sys.executable, "-c", f"{code}RobotState({str(NAO)!r})"], check=True)
