"""The node of the ROS 2 package, compiled against stand-ins for ROS: its numbers are those of Python."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from _ros2 import PACKAGE, build, needs_cpp, run, spoken, write_parameters

from surefoot.calibration import FeetLayout, Flag, FootCalibrator, FootLayout, OnlineSetup, Parameters
from surefoot.experiments.logs.format import Log, read_log, write_log
from surefoot.experiments.logs.model import load_model
from surefoot.experiments.logs.motion import ACCELEROMETER, GYROSCOPE
from surefoot.experiments.walking.calibrate import calibrate_log
from surefoot.experiments.walking.ros2 import node_parameters, write_node_parameters
from surefoot.robot import Beliefs, TelemetryLayout
from surefoot.robot.beliefs.momentum import MomentumBeliefs
from surefoot.robot.beliefs.native import native_beliefs
from surefoot.robot.model_file import touching_points
from surefoot.sensors.transport.link import Packet

FROZEN, TARED, HUNG, TOLD, END = 400, 420, 480, 520, 640
"""Samples at which it is frozen and goes on, a tare is asked for in the middle of a walk, a robot is lifted,
its feet are said to hang, and all ends."""

STEP = 2.0  # by how many newtons all zeros leap as the robot is lifted
pytestmark = [pytest.mark.slow, needs_cpp]


@pytest.fixture(scope="module")
def log(recorded_walk: Any, tmp_path_factory: pytest.TempPathFactory) -> Log:
    """The walk as a log of joints and IMU, without the head, which is held."""
    walk, path = recorded_walk, tmp_path_factory.mktemp("log") / "walk.csv"
    walk.motion.drop(columns=["joint_HeadYaw_rad"]).to_csv(path.with_suffix(".motion.csv"), index=False)
    side = write_log(walk.log, path).with_suffix(".json")
    told = json.loads(side.read_text())
    del told["lag_samples"]
    own = {"table": "walk.motion.csv", "held_rad": {"HeadYaw": 0.0}}
    side.write_text(json.dumps(told | {"motion": walk.description | own}))
    return read_log(path)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(PACKAGE / "src" / "feet_node.cpp", tmp_path_factory.mktemp("node"))


@pytest.fixture(scope="module")
def parameters(log: Log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `surefoot calibrate walk --ros2` writes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("surefoot.experiments.walking.calibrate.write_walking_page", lambda path, facts: path)
        made = calibrate_log(
            log, "tare", folder=tmp_path_factory.mktemp("made"), stem="walk", file="walk.csv", ros2=True
        )
    assert made.ros2 is not None
    assert not any("ROS 2" in note for note in made.notices)
    return made.ros2


def told(path: Path) -> Any:
    return yaml.safe_load(path.read_text())["surefoot"]["ros__parameters"]


class Replay:
    """The same in Python, from the log alone."""

    def __init__(self, log: Log, initial: Parameters, lag: int) -> None:
        facts = log.motion
        assert facts is not None
        model, _ = load_model(facts, "walk.csv")
        self.lag, self.age, self.dt = lag, facts.readings_age_s, log.dt
        self.layout, self.period = TelemetryLayout(len(model.joint_names)), facts.dt_s
        link = facts.dt_s, facts.delay_s, facts.averaged
        points = touching_points(log.layout)
        beliefs = Beliefs(model, self.layout, *link, lag=lag, dt=log.dt, touching=points)
        self.beliefs = native_beliefs(MomentumBeliefs(beliefs))
        self.calibrator = FootCalibrator(log.layout, mass=log.mass, initial=initial, dt=log.dt, lag=lag)
        self.number, self.came, self.last, self.tare = -1, 0.0, 0, range(0)

    def packet(self, time: float, angle: Any, force: Any, spin: Any) -> None:
        silent = self.number >= 0 and time - self.came > 3.0 * self.period
        self.number += round((time - self.came) / self.period) if silent else 1
        self.came = time
        values = np.zeros(self.layout.size)
        values[self.layout.joint_position] = angle
        values[self.layout.accelerometer], values[self.layout.gyroscope] = force, spin
        self.beliefs.update((Packet(self.number, time, values),))

    def sample(self, k: int, time_ns: int, raw: Any, hold: bool) -> Any:
        if self.beliefs.sample(1e-9 * time_ns - self.lag * self.dt - self.age, None, hold):
            self.calibrator.retract()
        reference = self.beliefs.believed.reference()
        if k in self.tare:
            reference = reference._replace(stance=np.zeros(2, bool), swing=np.ones(2, bool))
        dt = 1e-9 * (time_ns - self.last) if self.last else self.dt
        self.last = time_ns
        return self.calibrator.update(raw, reference, dt)


@pytest.fixture(scope="module")
def walked(log: Log, recorded_walk: Any, program: Path, parameters: Path, tmp_path_factory: Any) -> Any:
    """A walk, and a robot that is lifted: what the node prints, what Python finds, and the folder."""
    names = told(parameters)["joints"]
    initial = Parameters(log.nominal.scale, log.nominal.offset + 0.5)
    folder = tmp_path_factory.mktemp("run")
    start = write_parameters(
        folder / "parameters",
        parameters,
        scale_N_per_count=initial.scale.tolist(),
        offset_N=initial.offset.tolist(),
        save_to=str(folder / "saved.yaml"),
        tare_s=0.8,
    )
    replay = Replay(log, initial, int(told(parameters)["robot"]["lag"][0]))
    motion, raw = recorded_walk.motion, log.raw.copy()
    angle = motion[[f"joint_{name}_rad" for name in names]].to_numpy().copy()
    angle[:, names.index("HeadYaw")] = 0.0
    imu = motion[[*ACCELEROMETER, *GYROSCOPE]].to_numpy().copy()
    empty = np.array([raw[np.abs(recorded_walk.force[:, i]) < 0.3, i].mean() for i in range(8)])
    raw[HUNG:] = empty + STEP / initial.scale + (raw - raw.mean(axis=0))[: END - HUNG] * 1e-3
    arrivals = np.rint(1e9 * motion["time_s"].to_numpy()).astype(int) + 10**9
    times = np.rint(1e9 * log.time).astype(int) + 10**9
    epoch = arrivals[0]
    # Lifted with straight legs, it hangs still; its own joints say that it stands.
    angle[arrivals > times[HUNG]], imu[arrivals > times[HUNG]] = angle[0], imu[0]
    lines, expected, fed = [spoken(times[0], "counts", [1.0]), spoken(times[0], "~/tare")], [], 0
    for k in range(END):
        while fed < len(arrivals) and arrivals[fed] <= times[k]:
            if fed == 150:
                # Some are lost.
                fed += 5
                continue
            replay.packet(1e-9 * (arrivals[fed] - epoch), angle[fed], imu[fed, :3], imu[fed, 3:])
            columns = [value for name, value in zip(names, angle[fed], strict=True) if name != "HeadYaw"]
            lines.append(spoken(arrivals[fed], "joint_states", [9.0, *columns]))
            lines.append(spoken(arrivals[fed], "imu", imu[fed]))
            fed += 1
        if k in (FROZEN, TARED):
            lines.append(spoken(times[k], "~/freeze", [float(k == FROZEN)]))
        if k in (TARED + 1, TOLD):
            lines.append(spoken(times[k], "~/tare"))
            replay.tare = range(k + replay.lag, k + replay.lag + round(0.8 / log.dt))
        lines.append(spoken(times[k], "counts", raw[k]))
        expected.append(replay.sample(k, int(times[k] - epoch), raw[k], FROZEN <= k < TARED))
        if k % 80 == 79:
            lines.append(spoken(times[k], "timer"))
    lines += [spoken(times[-1], name) for name in ("~/save", "~/stop", "timer", "~/tare", "~/start")]
    return run(program, start, lines), expected, folder, raw, initial


def of_topic(printed: list[list[str]], topic: str, skip: int = 1) -> Any:
    return np.array([line[skip:] for line in printed if line[0] == topic], dtype=float)


def test_the_node_publishes_what_python_finds_to_the_last_digit(walked: Any, log: Log) -> None:
    printed, expected, _, raw, initial = walked
    for topic, wanted in {
        "~/force": [np.concatenate([one.force, one.force_std]) for one in expected],
        "~/map": [np.concatenate([one.scale, one.offset]) for one in expected],
        "~/flags": [one.flags for one in expected],
    }.items():
        np.testing.assert_array_equal(of_topic(printed, topic), np.array(wanted), err_msg=topic)
    cop = of_topic(printed, "~/cop", 2)
    np.testing.assert_array_equal(cop[:, :2], [one.cop for one in expected])
    map_start = initial.scale * raw + initial.offset
    for f, foot in enumerate(log.layout.feet):
        wrench = of_topic(printed, f"~/wrench_{foot.name}", 3)
        np.testing.assert_array_equal(wrench, [one.wrench[f] for one in expected])
        start = map_start[:, 4 * f : 4 * f + 4] @ foot.wrench_map.T
        subtracted = of_topic(printed, f"~/subtracted_{foot.name}", 3)
        np.testing.assert_allclose(subtracted + wrench, start[: len(wrench)], atol=1e-9)
    learnt = of_topic(printed, "~/map")
    assert np.abs(learnt[FROZEN, 8:] - initial.offset).max() > 0.1


def test_a_robot_that_hangs_is_tared(walked: Any) -> None:
    """And one that walks is not, whatever it is told: a foot that bears load does not hang."""
    printed, expected, *_ = walked
    force = of_topic(printed, "~/force")[:, :8]
    assert np.abs(force[TOLD - 10 : TOLD].mean(axis=0)).mean() > 0.7 * STEP
    assert np.abs(force[-10:].mean(axis=0)).max() < 0.1 * STEP
    walking = np.array([one.force for one in expected])[TARED + 20 : HUNG].sum(axis=1).mean()
    assert walking > 40.0


def test_services_answer_and_diagnostics_tell(walked: Any) -> None:
    printed, expected, folder, *_ = walked
    said = [" ".join(line) for line in printed]
    assert said[0] == "warned A message of 'counts' has 1 numbers, and 8 are needed; it was left out."
    answers = [
        line for line in said if line.startswith("~/") and line.split()[1] in "01" and line[2] in "fst"
    ]
    services = [
        line for line in answers if line.split()[0] in ("~/freeze", "~/tare", "~/save", "~/stop", "~/start")
    ]
    saved = folder / "saved.yaml"
    hang = "~/tare 1 all feet are taken to hang in the air for the next 0.8 s"
    assert services == [
        "~/tare 0 'joint_states' never had the joint LHipYawPitch",
        "~/freeze 1 nothing is learnt",
        "~/freeze 1 learning goes on",
        hang,
        hang,
        f"~/save 1 written to {saved}",
        "~/stop 1 stopped; ~/start begins again",
        "~/tare 0 stopped; ~/start first",
        "~/start 1 begun from the starting map",
    ]
    last = expected[-1]
    kept = told(saved)
    assert kept == {"scale_N_per_count": last.scale.tolist(), "offset_N": last.offset.tolist()}
    diagnostics = [line.split("|") for line in said if line.startswith("/diagnostics")]
    levels = [line[0].split()[-1] for line in diagnostics]
    assert diagnostics[2][2] == "learning"
    assert diagnostics[-1][2] == "stopped"
    assert levels[2] == "0"
    second = dict(part.split("=") for part in diagnostics[2][3:])
    assert second["samples"] == "80"
    flags = np.bitwise_or.reduce([one.flags for one in expected[160:240]], axis=0)
    names = [" ".join(flag.name for flag in Flag if flag & int(word)) for word in flags]
    assert [value for key, value in second.items() if key.startswith("flags ")] == names
    some = [one for one in expected[160:240] if one.nis_rows > 0 and np.isfinite(one.nis)]
    nis = sum(one.nis for one in some) / sum(one.nis_rows for one in some)
    assert float(second["nis per row"]) == pytest.approx(nis, rel=5e-3)
    assert float(second["undetermined share"]) == pytest.approx(expected[239].undetermined.max(), rel=5e-3)
    assert dict(part.split("=") for part in diagnostics[-1][3:])["tare of left"].endswith(" s ago")


def test_parameters_that_lack_something_are_named(program: Path, parameters: Path, tmp_path: Path) -> None:
    whole = told(parameters)
    for change, problem in (
        (
            {},
            "The parameter 'robot.dt' is missing; `surefoot calibrate walk "
            "LOG --ros2` writes it, of a log with joints, an IMU and a drawing.",
        ),
        ({"offset_N": [0.0]}, "The parameter 'offset_N' needs 8 numbers, one a channel."),
        (
            {"model": {**whole["model"], "bodies": [1e3]}},
            "The parameters are of a robot that this node has no room for.",
        ),
        (
            {"timing": {**whole["timing"], "dt": [0.1, 0.1]}},
            "The parameter 'timing.dt' has more numbers than there is room for.",
        ),
        (
            {"feet": ["left"]},
            "The parameters 'channels', 'joints', 'feet' and 'sole_frames' must name all of each.",
        ),
        (
            {"readings_age_s": 0},
            "parameter 'readings_age_s' has invalid type: expected [double] got [integer]",
        ),
    ):
        path = tmp_path / "parameters"
        write_parameters(path, parameters, **change)
        if "missing" in problem:
            path.write_text(
                "\n".join(line for line in path.read_text().splitlines() if "robot.dt " not in line)
            )
        printed = run(program, path, [spoken(1, "counts", np.zeros(8))])
        assert [" ".join(line) for line in printed] == [f"error {problem}", "nobody counts"]


def test_it_goes_through_the_states_of_a_lifecycle(program: Path, parameters: Path, tmp_path: Path) -> None:
    start = write_parameters(tmp_path / "parameters", parameters, autostart=False)
    counts, steps = (
        spoken(10**9, "counts", np.zeros(8)),
        "configure counts activate counts deactivate counts cleanup",
    )
    lines = [
        counts if one == "counts" else spoken(10**9, one)
        for one in f"{steps} configure activate counts".split()
    ]
    printed = [line[0] for line in run(program, start, lines)]
    sample = [
        "~/force",
        "~/map",
        "~/flags",
        "~/cop",
        *[f"~/{what}_{foot}" for foot in ("left", "right") for what in ("wrench", "subtracted")],
    ]
    assert printed == ["nobody", *sample, "nobody", *sample]


def test_ankle_sensors_come_as_wrenches(recorded_walk: Any, program: Path, tmp_path: Path) -> None:
    """A sample is whole when both feet have come; one that comes again shows that the other's was lost."""
    layout = FeetLayout(
        tuple(
            FootLayout.force_torque(name, position_sensor_sole=(0.0, 0.0, 0.045))
            for name in ("left", "right")
        )
    )
    initial = Parameters(np.ones(12), np.zeros(12))
    setup = OnlineSetup(layout=layout, mass=5.3, initial=initial, lag=4, foot_length=0.17)
    names = recorded_walk.model.joint_names
    beliefs = Beliefs(recorded_walk.model, TelemetryLayout(len(names)), 0.01, 0.0, True, lag=4)
    given = node_parameters(setup, MomentumBeliefs(beliefs), joints=dict.fromkeys(names, np.nan))
    path = write_node_parameters(tmp_path / "ankles.yaml", given, "mine")
    left, right = np.arange(1.0, 7.0), np.arange(7.0, 13.0)
    lines = [
        spoken(time * 10**7, f"wrench_{foot}", wrench)
        for time, foot, wrench in (
            (100, "left", left), (101, "right", right), (102, "right", 2.0 * right),
            (103, "left", 2.0 * left), (104, "left", 3.0 * left), (105, "left", 4.0 * left),
        )
    ]  # fmt: skip
    printed = run(program, write_parameters(tmp_path / "parameters", path), lines)
    force, flags = of_topic(printed, "~/force")[:, :12], of_topic(printed, "~/flags").astype(int)
    both = np.concatenate([left, right])
    np.testing.assert_allclose(force, [both, 2.0 * both, np.concatenate([3.0 * left, 2.0 * right])])
    missing = (flags & int(Flag.MISSING)) > 0
    np.testing.assert_array_equal(missing, [[False] * 12, [False] * 12, [False] * 6 + [True] * 6])
    stamps = [line[2] for line in printed if line[0] == "~/wrench_left"]
    assert stamps == ["1.010000000", "1.030000000", "1.040000000"]
