"""Calibrations as files: whole and exact in JSON and YAML, and as robots read them."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from _ros2 import PACKAGE, build, needs_cpp, run, spoken, write_parameters
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ import InSituFit, InSituSet, Limb, read_calibration
from surefoot.calibration.in_situ.fit import Hysteresis, ImuErrors, MakerErrors, SetFit, TemperatureEffect
from surefoot.calibration.reference import GRAVITY
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.experiments.force_torque.export import write_json, write_ros2_parameters, write_yaml
from surefoot.experiments.force_torque.icub import read_matrix, write_icub_matrix
from surefoot.experiments.force_torque.tables import Calibrated
from surefoot.sensors.devices.strain_gauge_config import FTSENS_SN039, FTSENS_SN142

FULL_SCALE = np.array([1500.0, 1500.0, 2000.0, 35.0, 35.0, 25.0])


def fit(channels: int = 6, **other: Any) -> InSituFit:
    """A calibration of two sets, with awkward numbers."""
    rng = np.random.default_rng(7)
    k = channels
    root = rng.standard_normal((7 * k + 4, 7 * k + 4)) * 1e-5
    stats = FitStats(1199, 1, 0, 1 / 3, 6 * k + 4, 6 * k + 4, 123.456)
    values: dict[str, Any] = {
        "matrix": rng.standard_normal((6, k)) * 1e-3,
        "offset": 1e4 * rng.standard_normal(k),
        "response": rng.standard_normal((k, 6)) * 1e3,
        "limb": Limb(4.72, np.array([0.1, 1e-17, 1 / 3]), np.diag([0.3, 0.2, 0.1])),
        "covariance": root @ root.T,
        "noise": np.eye(k) * 2.5,
        "result": FitResult.DETERMINED,
        "warnings": ("Mind the knee.",),
        "stats": stats,
        "sets": tuple(
            SetFit(name, 1e4 * rng.standard_normal(k), stats, left)
            for name, left in (("1", 1e-3), ("größer", 2e-3))
        ),
    }
    return InSituFit(**{**values, **other})


def refused() -> InSituFit:
    """A calibration that was refused: all NaN, with the reason."""
    nothing = FitStats(0, 0, 0, np.nan, 0, 40, np.inf)
    return fit(
        matrix=np.full((6, 6), np.nan),
        offset=np.full(6, np.nan),
        covariance=np.full((46, 46), np.nan),
        limb=Limb(np.nan, np.full(3, np.nan)),
        result=FitResult.REFUSED,
        refusals=(CalibrationRefused("Too few masses.", "Add one."),),
        stats=nothing,
        sets=tuple(SetFit(name, np.full(6, np.nan), nothing, np.nan) for name in ("1", "2")),
    )


CALIBRATIONS = {
    "six channels": fit,
    "eight channels": lambda: fit(8),
    "with temperature": lambda: fit(temperature=TemperatureEffect(np.arange(6.0) / 7.0)),
    "turned": lambda: fit(
        imu=ImuErrors(rotation=np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    ),
    "limb without inertia": lambda: fit(limb=Limb(1.0, np.ones(3))),
    "refused": refused,
    "accepted": lambda: fit(
        result=FitResult.ACCEPTED, refusals=(CalibrationRefused("A bump.", "Mind it."),), accepted="I saw it"
    ),
    "with shares": lambda: fit(data_share=np.linspace(0.0, 1.0, 46)),
    "an accelerometer's axes": lambda: fit(imu=ImuErrors(scale=np.array([1.0, 0.96, 1.01]))),
    "leaning": lambda: fit(
        scope="bias, mass and centre of mass; matrix kept (one load)",
        maker=MakerErrors(0.0123, np.linspace(0.0, 1.0, 36).reshape(6, 6)),
        imu=ImuErrors(np.array([0.1, -0.2, 0.3]), 1.01, delay=0.012),
        hysteresis=Hysteresis(np.full(6, 0.01), np.arange(1.0, 7.0), np.linspace(0.97, 1.03, 6)),
    ),
}


def same(one: Any, two: Any) -> None:
    """Compare to the last bit, NaN being NaN."""
    if dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            same(getattr(one, field.name), getattr(two, field.name))
    elif isinstance(one, tuple):
        assert len(one) == len(two)
        for a, b in zip(one, two, strict=True):
            same(a, b)
    elif isinstance(one, CalibrationRefused):
        assert str(one) == str(two)
    elif isinstance(one, np.ndarray | float):
        np.testing.assert_array_equal(one, two)
    else:
        assert one == two


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_json_reads_back_to_the_last_bit(name: str, tmp_path: Path) -> None:
    made = CALIBRATIONS[name]()
    path = write_json(made, tmp_path / "sensor.json", channels=("a",), sensor="SN1", notices=("gap",))
    same(made, read_calibration(path))


def test_yaml_says_the_same_as_json(tmp_path: Path) -> None:
    facts: dict[str, Any] = {"channels": ("a", "b"), "sensor": "SN1", "notices": ("a gap: of 3 s",)}
    told = json.loads(write_json(fit(), tmp_path / "a.json", **facts).read_text())
    assert yaml.safe_load(write_yaml(fit(), tmp_path / "a.yaml", **facts).read_text()) == told
    assert told["sensor"] == "SN1"
    assert told["notices"] == ["a gap: of 3 s"]
    assert [one["name"] for one in told["sets"]] == ["1", "größer"]
    assert any("exerted by the limb on the robot" in line for line in told["conventions"])
    np.testing.assert_allclose(told["matrix_std_N_Nm_per_count"], fit().matrix_std)
    np.testing.assert_allclose(told["offset_std_count"], fit().offset_std)


def test_what_is_no_calibration_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no such file"):
        read_calibration(tmp_path / "nothing.json")
    path = write_json(fit(), tmp_path / "sensor.json")
    told = json.loads(path.read_text())
    for change, said in (
        ("[", r"sensor\.json: is no surefoot-in-situ-calibration 2, .*not JSON: Expecting value"),
        ("[]", "list indices must be integers"),
        (json.dumps({**told, "format_version": 9}), "surefoot-in-situ-calibration 9"),
        (json.dumps({k: v for k, v in told.items() if k != "offset_count"}), r"KeyError\('offset_count'\)"),
        (json.dumps({**told, "result": "perfect"}), "'perfect' is not a valid FitResult"),
    ):
        path.write_text(change)
        with pytest.raises(ValueError, match=said):
            read_calibration(path)


@pytest.mark.parametrize("matrix", [FTSENS_SN039, FTSENS_SN142])
def test_an_icub_matrix_reads_back_within_its_rounding(matrix: Any, tmp_path: Path) -> None:
    path = write_icub_matrix(matrix, FULL_SCALE, tmp_path / "SN.txt")
    found, scale = read_matrix(path)
    np.testing.assert_array_equal(scale, FULL_SCALE)
    half_a_unit = FULL_SCALE / 2**16 / 32767
    assert (np.abs(found - np.array(matrix)) <= half_a_unit[:, None] * (1 + 1e-9)).all()
    # What is on the grid already stays as it is.
    again = write_icub_matrix(found, scale, tmp_path / "again.txt")
    assert again.read_bytes() == path.read_bytes()


def test_the_lines_of_an_icub_matrix(tmp_path: Path) -> None:
    """Entries as shares of full scale per 32767 counts: 0.5 is 4000, -0.25 is E000, -1 is 8000."""
    share = np.zeros((6, 6))
    share[0, 0], share[0, 1], share[5, 5] = 0.5, -0.25, -1.0
    path = write_icub_matrix(share * FULL_SCALE[:, None] / 32767, FULL_SCALE, tmp_path / "SN.txt")
    text = path.read_bytes().decode()
    lines = text.split("\r\n")
    assert lines[:3] == ["4000", "E000", "0000"]
    assert lines[35:] == ["8000", "1", "1500", "1500", "2000", "35", "35", "25", ""]


def test_what_an_icub_cannot_hold_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "SN.txt"
    matrix = np.array(FTSENS_SN039)
    large = matrix.copy()
    large[3, 2] = 35.0 / 32767
    for bad, scale, said in (
        (np.zeros((6, 8)), FULL_SCALE, r"holds a 6 x 6 matrix, got shape \(6, 8\)"),
        (matrix, FULL_SCALE[:5], "six full scales in whole N and N m"),
        (matrix, FULL_SCALE + 0.5, "six full scales in whole N and N m"),
        (large, FULL_SCALE, r"entries in \[-1, 1\), and that of row 3, column 2 is 1 of a full scale of 35"),
        (matrix * np.nan, FULL_SCALE, r"entries in \[-1, 1\)"),
    ):
        with pytest.raises(ValueError, match=said):
            write_icub_matrix(bad, scale, path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_icub_matrix_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "SN.txt"
    lines = write_icub_matrix(FTSENS_SN039, FULL_SCALE, path).read_text().split()
    for bad, said in (
        (lines[:-1], "43 lines .*; got 42 lines"),
        (["4000Z", *lines[1:]], "36 entries of up to four hexadecimal digits"),
        (["XY", *lines[1:]], "36 entries of up to four hexadecimal digits"),
    ):
        path.write_text("\n".join(bad))
        with pytest.raises(ValueError, match=said):
            read_matrix(path)
    with pytest.raises(ValueError, match="no such file"):
        read_matrix(tmp_path / "nothing.txt")


def test_without_the_filter_ros_adds_what_makes_the_drivers_wrench_the_calibrated_one(tmp_path: Path) -> None:
    made = fit()
    path = write_ros2_parameters(made, tmp_path / "ros2.yaml", node="left_foot", frame_id="l_ft")
    told = yaml.safe_load(path.read_text())["left_foot"]["ros__parameters"]
    assert told["frame_id"] == "l_ft"
    assert told["sensor_filter_chain"]["filter1"]["type"] == "surefoot_ros/CalibratedWrench"
    lines = [line[4:] for line in path.read_text().splitlines()]
    (bare,) = (yaml.safe_load("{" + line + "}") for line in lines if line.startswith("offset:"))
    add = [bare["offset"][kind][axis] for kind in ("force", "torque") for axis in "xyz"]
    raw = 1e4 * np.random.default_rng(1).standard_normal(6)
    np.testing.assert_allclose(made.matrix @ raw + add, made.wrench(raw), rtol=1e-12)
    rows = [line[1:-1] for line in lines if line.startswith("[")]
    np.testing.assert_allclose([np.fromstring(row, sep=",") for row in rows], made.matrix, rtol=1e-8)


def test_an_offset_that_follows_the_temperature_needs_one(tmp_path: Path) -> None:
    made = fit(temperature=TemperatureEffect(np.arange(6.0)))
    with pytest.raises(ValueError, match="give the one at which it shall hold"):
        write_ros2_parameters(made, tmp_path / "ros2.yaml")
    assert list(tmp_path.iterdir()) == []


def warm() -> InSituFit:
    """A calibration whose offsets and gains go with the temperature."""
    made = fit(temperature=TemperatureEffect(np.arange(6.0), 25.0, np.linspace(-0.01, 0.02, 6)))
    return dataclasses.replace(made, response=np.linalg.inv(made.matrix))


def test_pages_take_all_that_the_temperature_does_off_the_readings() -> None:
    made, rng = warm(), np.random.default_rng(3)
    load, warmer = rng.standard_normal((9, 6)), rng.uniform(-10.0, 10.0, 9)[:, None]
    cold = load @ made.response.T + made.offset
    raw = (load * (1.0 + warmer * made.temperature.gain)) @ made.response.T + made.offset
    raw = raw + warmer * made.temperature.coefficient
    data = InSituSet(raw, rng.standard_normal((9, 3)), temperature=25.0 + warmer[:, 0])
    log: Any = SimpleNamespace(sets=(data,))
    np.testing.assert_allclose(Calibrated(log, made).sets[0].raw, cold, rtol=1e-9)


MAIN = """
int main(int argc, char **argv) {
    rclcpp::init(argc, argv);
    using namespace rclcpp::node_interfaces;
    using Filter = filters::FilterBase<geometry_msgs::msg::WrenchStamped>;
    auto filter = std::static_pointer_cast<Filter>(exported);
    auto log = std::make_shared<NodeLoggingInterface>();
    auto parameters = std::make_shared<NodeParametersInterface>();
    if (!filter->configure("sensor_filter_chain.filter1.params", "surefoot", log, parameters)) return 0;
    std::function<void(const std::vector<double> &)> hear = [&](const std::vector<double> &v) {
        geometry_msgs::msg::WrenchStamped in, out;
        rclcpp::heard(v, in);
        tf2_ros::attitude = {v[6], v[7], v[8], v[9]};
        if (filter->update(in, out)) std::printf("out"), rclcpp::show(out), std::printf("\\n");
    };
    rclcpp::callbacks["in"] = hear;
    rclcpp::spin(0);
}
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("filter")
    main = folder / "main.cpp"
    main.write_text(f'#include "{PACKAGE / "src" / "calibrated_wrench.cpp"}"\n{MAIN}')
    return build(PACKAGE / "src" / "calibrated_wrench.cpp", folder, main)


def filtered(program: Path, folder: Path, raw: Any, attitude: Rotation, **settings: Any) -> Any:
    """Return the wrenches (N, 6) that come out for readings (N, 6), and the lines that are printed."""
    inside = {"sensor_filter_chain": {"filter1": {"params": settings}}}
    files = write_parameters(folder / "parameters", folder / "ros2.yaml", node="left_foot", **inside)
    lines = [spoken(10**9, "in", [*r, *q]) for r, q in zip(raw, attitude.as_quat(), strict=True)]
    printed = run(program, files, lines)
    return np.array([line[3:] for line in printed if line[0] == "out"], dtype=float), printed


@needs_cpp
@pytest.mark.parametrize("made", [fit, warm])
@pytest.mark.parametrize("channels", [6, 8])
def test_the_filter_gives_the_calibrated_wrench(
    program: Path, tmp_path: Path, made: Any, channels: int
) -> None:
    """Of eight gauges the driver reports the matrix times the readings: a message has six numbers."""
    if channels == 8 and made is warm:
        pytest.skip("the made one has six channels")
    calibrated = fit(channels) if made is fit else warm()
    temperature = None if made is fit else 40.0
    write_ros2_parameters(calibrated, tmp_path / "ros2.yaml", temperature=temperature, node="left_foot")
    rng = np.random.default_rng(4)
    raw = 1e4 * rng.standard_normal((20, channels))
    attitude = Rotation.random(20, random_state=5)
    wrench = calibrated.wrench(raw, temperature=temperature)
    driver = raw if channels == 6 else raw @ calibrated.matrix.T
    out, printed = filtered(program, tmp_path, driver, attitude)
    np.testing.assert_allclose(out, wrench, rtol=1e-12, atol=1e-11)
    assert printed[0][1] == "sensor"
    out, _ = filtered(program, tmp_path, driver, attitude, gravity_frame="world")
    # tf gives the rotation from the world's axes to the sensor's.
    down = attitude.apply(np.tile((0.0, 0.0, -GRAVITY), (20, 1)))
    np.testing.assert_allclose(out, calibrated.limb.compensate(wrench, down), rtol=1e-12, atol=1e-11)


@needs_cpp
def test_what_does_not_fit_is_named_by_the_filter(program: Path, tmp_path: Path) -> None:
    write_ros2_parameters(fit(), tmp_path / "ros2.yaml", node="left_foot")
    level = Rotation.identity(1)
    for settings, problem in (
        (
            {"matrix": [1.0]},
            "The parameter 'sensor_filter_chain.filter1.params.matrix' has 1 numbers, and 36 are "
            "needed, or none.",
        ),
        (
            {"gravity_frame": "map"},
            "The tool's weight cannot be taken off without the attitude of 'sensor' in 'map': "
            "no frame sensor or map",
        ),
    ):
        out, printed = filtered(program, tmp_path, np.ones((1, 6)), level, **settings)
        assert out.size == 0
        assert [" ".join(line) for line in printed] == [f"error {problem}"]
