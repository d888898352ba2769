"""Made logs and episodes: small, seeded, and known to the last digit."""

import dataclasses
import importlib
import sys
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import surefoot  # noqa: F401  (registers the environments)
from surefoot.arrays import stack_rows
from surefoot.calibration.layout import nao_shoe_layout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, MomentumReference, Reference
from surefoot.experiments.logs.format import Log, LogTruth, write_log
from surefoot.experiments.logs.guess import guess_topics
from surefoot.experiments.walks.record import record_walk
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.wrappers import FootSensors, SelfCalibration

NAO = str(files("surefoot.envs.robots").joinpath("nao.xml"))
SAMPLES = 60
MASS = 5.3


@pytest.fixture(scope="session")
def benchmark_script() -> Callable[[str], ModuleType]:
    """Give a function that imports a script of benchmarks/, or skips."""
    folder = Path(__file__).parents[2] / "benchmarks"
    if not folder.is_dir():
        pytest.skip("benchmarks are not part of the wheel")
    if str(folder) not in sys.path:
        sys.path.append(str(folder))  # scripts import each other
    return importlib.import_module


@pytest.fixture(scope="session")
def spoilt() -> ModuleType:
    """The mistakes that are counted for the docs."""
    return importlib.import_module("_spoilt_logs")


@pytest.fixture
def log() -> Log:
    """A robot that sways on both feet; its cells are true and its counts are exact."""
    rng = np.random.default_rng(5)
    layout = nao_shoe_layout()
    time = np.arange(SAMPLES) / 80.0
    position = np.zeros((SAMPLES, 2, 3))
    position[:, 0, 1], position[:, 1, 1] = 0.05, -0.05
    R = np.tile(np.eye(3), (SAMPLES, 2, 1, 1))
    turn = 0.1 * np.sin(time)
    R[:, 0, 0, 0] = R[:, 0, 1, 1] = np.cos(turn)
    R[:, 0, 1, 0], R[:, 0, 0, 1] = np.sin(turn), -np.sin(turn)
    force = MASS * GRAVITY / 8 * (1 + 0.2 * rng.standard_normal((SAMPLES, 8)))
    nominal = Parameters(np.full(8, 2e-5), np.full(8, -160.0))
    vector = rng.standard_normal((SAMPLES, 3))
    reference = Reference(
        com=vector * 0.01 + (0.02, 0.0, 0.26),
        com_acceleration=vector,
        angular_momentum_rate=0.1 * vector,
        position_sole=position,
        R_level_sole=R,
        stance=np.ones((SAMPLES, 2), dtype=bool),
        swing=np.zeros((SAMPLES, 2), dtype=bool),
        accelerometer=vector + np.array([0.0, 0.0, GRAVITY]),
        gyroscope=0.01 * vector,
    )
    return Log(
        time=time,
        raw=(force - nominal.offset) / nominal.scale,
        reference=reference,
        layout=layout,
        mass=MASS,
        nominal=nominal,
        calibrated=None,
        dt=1 / 80,
        lag=2,
        seed=5,
        truth=LogTruth(force, position, R, *(np.tile(part, (SAMPLES, 1)) for part in nominal)),
        about={"speed_m_s": 0.0},
    )


@pytest.fixture
def path(log: Log, tmp_path: Path) -> Path:
    """Write the log, with its description beside it."""
    return write_log(log, tmp_path / "walk.csv")


@pytest.fixture
def full(log: Log) -> Log:
    """Give a log with beliefs of both kinds."""
    reference = log.reference
    momentum = MomentumReference(
        com=reference.com,
        com_velocity=0.1 * reference.com_acceleration,
        angular_momentum=0.1 * reference.angular_momentum_rate,
        position_sole=reference.position_sole,
        R_level_sole=reference.R_level_sole,
        stance=reference.stance,
        swing=reference.swing,
    )
    return dataclasses.replace(log, momentum=momentum)


@pytest.fixture(scope="session")
def walks() -> dict[str, Log]:
    """Give a walk of 16 s from a bad start and from calibrated cells."""
    return record_walk(0.04, 11, 16.0)


@pytest.fixture
def undrawn(monkeypatch):
    """Figures that are not drawn: only the words of a page count."""
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **options: Path(path).write_bytes(b"<svg/>"))


class RecordedWalk:
    """A walk of a robot that knows itself exactly: its own references, and what they were made of."""

    def __init__(self, steps: int = 640) -> None:
        bare = gym.make("surefoot/NaoWalk-v0", speed=0.04, duration=12.0, push_impulse=(0.0, 0.0))
        env = SelfCalibration(FootSensors(bare), "moment", errors=NO_ERRORS)
        sensors, base = env.env, env.unwrapped
        env.reset(seed=4)
        packets, raw, time, force, moments = list(sensors.packets), [], [], [], []
        references, momenta = [], []
        for _ in range(steps):
            env.step(np.zeros(11, dtype=np.float32))
            packets += sensors.packets
            raw.append(sensors.raw.copy())
            time.append(sensors.time)
            force.append(base.truth.force_cell[-1].copy())
            momentum = env.reference
            contacts = momentum.stance, momentum.swing
            references.append(env.beliefs.reference(env.reference_time, *contacts))
            momenta.append(momentum)
            moments.append(env.reference_time)
        telemetry, config = sensors.telemetry, sensors.instruments.parts[0].config
        where = telemetry.layout
        columns = {"time_s": [packet.arrival for packet in packets]}
        values = np.array([packet.values for packet in packets])
        columns |= {
            f"joint_{name}_rad": part
            for name, part in zip(base.joint_names, values[:, where.joint_position].T, strict=True)
        }
        for sensor, unit in (("accelerometer", "m_s2"), ("gyroscope", "rad_s")):
            part = values[:, getattr(where, sensor)]
            columns |= {f"{sensor}_{axis}_{unit}": part[:, i] for i, axis in enumerate("xyz")}
        self.motion = pd.DataFrame(columns)
        self.model = env.beliefs.model
        self.force = np.array(force)
        self.own = stack_rows(references)
        self.momentum = stack_rows(momenta)
        self.description = {
            "model": NAO,
            "torso": "torso",
            "imu": "imu",
            "soles": ["left_sole", "right_sole"],
            "dt_s": telemetry.period,
            "delay_s": telemetry.link.delay,
            "readings_age_s": config.nominal_age,
            "averaged": bool(telemetry.averaged),
        }
        self.log = Log(
            time=np.array(time),
            raw=np.array(raw),
            reference=self.own,
            layout=env.layout,
            mass=env.beliefs.model.mass,
            nominal=Parameters(config.nominal_scale, config.nominal_offset),
            calibrated=None,
            dt=base.dt,
            lag=0,
        )
        self.lag = round((time[-1] - config.nominal_age - moments[-1]) / base.dt)


@pytest.fixture(scope="session")
def recorded_walk() -> RecordedWalk:
    """Give eight seconds of a walk, with everything that a robot knows of it."""
    return RecordedWalk()


@pytest.fixture(
    scope="session",
    params=[
        form if form == "mcap" else pytest.param(form, marks=pytest.mark.slow)
        for form in ("ros1", "sqlite3", "mcap")
    ],
)
def ros(request: pytest.FixtureRequest) -> Any:
    """Give a writer of ROS bags of a format."""
    pytest.importorskip("rosbags", reason="needs rosbags: pip install surefoot[ros]")
    from _bags import Ros

    return Ros(request.param)


@pytest.fixture(scope="session")
def bag(ros: Any, recorded_walk: RecordedWalk, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recorded walk as a bag with its description and the mapping file that was guessed."""
    from _bags import describe, topics_of

    path = tmp_path_factory.mktemp(ros.form) / "walk"
    describe(path, recorded_walk)
    path = ros.write(path, topics_of(recorded_walk), seed=1)
    path.with_suffix(".topics.toml").write_text(guess_topics(path, walk=True))
    return path


@pytest.fixture
def no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave a walk's page out, whose figures take seconds."""
    monkeypatch.setattr("surefoot.experiments.walking.calibrate.write_walking_page", lambda path, facts: path)


@pytest.fixture(scope="session")
def bad_start(walks: dict[str, Log]) -> Log:
    return dataclasses.replace(walks["bad-start"], truth=None)
