"""From a log of in-situ sets to a calibration, its files and its page."""

import html
import json
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY
from surefoot.calibration.in_situ import read_calibration
from surefoot.calibration.results import CalibrationRefused
from surefoot.experiments.force_torque import calibrate as module
from surefoot.experiments.force_torque.calibrate import SAMPLE, CalibratedSensor, calibrate_in_situ_log
from surefoot.experiments.force_torque.config import InSituConfig, config_beside
from surefoot.experiments.force_torque.icub import read_matrix
from surefoot.experiments.force_torque.table import WRENCH
from surefoot.experiments.logs.table import LogError

Script = Callable[[str], ModuleType]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> CalibratedSensor:
    return calibrate_in_situ_log(SAMPLE, folder=tmp_path_factory.mktemp("sample"))


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's first five sets, every third row: enough where the figures do not matter."""
    path = tmp_path_factory.mktemp("short") / "in_situ_leg.parquet"
    table = pq.read_table(SAMPLE).filter(pc.field("set") <= 5)
    pq.write_table(table.take(np.arange(0, table.num_rows, 3)), path)
    told = SAMPLE.with_suffix(".toml").read_text()
    path.with_suffix(".toml").write_text(told[: told.index('[[sets]]\nname = "6"')])
    return path


def changed(config: InSituConfig, **tables: dict[str, object]) -> InSituConfig:
    return InSituConfig.read(config.model_dump() | tables, "other")


@pytest.fixture
def no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the page out, whose figures take seconds."""
    monkeypatch.setattr(module, "write_in_situ_page", lambda path, found: path)


@pytest.fixture(scope="module")
def plain(short: Path, tmp_path_factory: pytest.TempPathFactory) -> CalibratedSensor:
    """The short log's calibration without a page, with a reason that nothing needs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "write_in_situ_page", lambda path, found: path)
        return calibrate_in_situ_log(short, folder=tmp_path_factory.mktemp("plain"), accept="no matter what")


def test_all_files_are_written(result: CalibratedSensor) -> None:
    assert sorted(result.files) == ["calibration", "icub", "report", "ros2", "yaml"]
    folder = result.files["report"].parent
    assert sorted(folder.iterdir()) == sorted(result.files.values())
    np.testing.assert_array_equal(read_calibration(result.files["calibration"]).matrix, result.fit.matrix)
    found, scale = read_matrix(result.files["icub"])
    assert np.abs(found - result.fit.matrix).max() <= scale.max() / 2**16 / 32767 * (1 + 1e-9)
    told = json.loads(result.files["calibration"].read_text())
    assert told["sensor"] == "FTSens in a leg (simulated)"
    assert told["channels"] == [f"raw_{i}_count" for i in range(6)]


def test_the_page_shows_every_table_and_figure(result: CalibratedSensor) -> None:
    page = html.unescape(result.files["report"].read_text())
    assert page.count("data:image/png;base64,") == 2
    assert page.count("data:image/svg+xml;base64,") == 1
    for table in result.tables:
        assert f"<b>{table.title}</b>" in page
    for what in ("5 (kept aside)", "The matrix, per count", "Offsets (counts)", "by the factory matrix"):
        assert what in page


def test_sets_that_were_kept_aside_agree(result: CalibratedSensor) -> None:
    """The sample's sensor has 1 % hysteresis: its weights come out to a few grams all the same."""
    axes, masses, places = result.tables[2:]
    aside = [row for row in axes.rows if "kept aside" in row[0]]
    assert len(aside) == 4
    assert all(float(row[6]) < 1.05 < float(row[10]) for row in aside)
    assert all(abs(float(row[4])) < 0.02 for row in masses.rows if "kept aside" in row[0])
    assert all(abs(float(row[5])) < 1.5 for row in places.rows if "kept aside" in row[0])


@pytest.mark.slow
def test_the_scale_is_held_against_the_scales(short: Path, tmp_path: Path) -> None:
    config = changed(config_beside(short), limb={"mass_kg": 6.0})
    result = calibrate_in_situ_log(short, config, folder=tmp_path, stem="leg")
    assert any("limb.mass_kg is 6 kg (-2" in notice for notice in result.notices)
    assert "limb.mass_kg is 6 kg" in result.files["report"].read_text()
    rows = {row[0]: row[1] for row in result.tables[1].rows}
    assert rows["known mass (kg)"] == "6.00"


def write_tool(folder: Path, gravity: Floats, limb_kg: float | None = None, unit: float = 1.0) -> Path:
    """Write a driver's wrench of a tool of 0.8 kg, divided by a unit in N, and the limb's given mass."""
    path = folder / "tool.csv"
    wrench = np.hstack([0.8 * gravity, np.cross([0.004, -0.006, 0.04], gravity)])
    wrench += np.array([2.0, 1.0, -5.0, 0.1, 0.2, 0.0])
    wrench += np.random.default_rng(8).normal(0.0, [0.03] * 3 + [0.001] * 3, wrench.shape)
    names = [f"gravity_{axis}_m_s2" for axis in "xyz"] + list(WRENCH)
    table = pd.DataFrame(np.hstack([gravity, wrench / unit]), columns=names)
    table.to_csv(path, index=False)
    limb = "" if limb_kg is None else f"[limb]\nmass_kg = {limb_kg}\n"
    path.with_suffix(".toml").write_text(f'[columns]\ntime = ""\n[units]\nraw = "N"\n{limb}')
    return path


def test_a_tool_that_turned_in_one_plane_has_a_page(tmp_path: Path) -> None:
    angle = np.linspace(-1.0, 1.4, 30)
    gravity = GRAVITY * np.column_stack([np.zeros(30), np.sin(angle), -np.cos(angle)])
    result = calibrate_in_situ_log(write_tool(tmp_path, gravity), folder=tmp_path)
    assert result.files["report"].exists()
    assert result.fit.limb.mass == pytest.approx(0.8, abs=0.02)
    assert any("in one plane only" in notice for notice in result.notices)


def test_newtons_that_contradict_the_given_mass_of_the_limb_are_refused(
    tmp_path: Path, undrawn: None
) -> None:
    gravity = Rotation.random(40, random_state=6).apply([0.0, 0.0, -GRAVITY])
    with pytest.raises(
        CalibrationRefused, match=r"limb\.mass_kg is 0\.8 kg \(-89\.8 %\).* kgf that are read as N"
    ):
        calibrate_in_situ_log(write_tool(tmp_path, gravity, 0.8, 9.80665), folder=tmp_path)
    assert not calibrate_in_situ_log(write_tool(tmp_path, gravity, 0.8), folder=tmp_path).fit.refusals


def test_without_factory_matrix_full_scale_and_masses(short: Path, tmp_path: Path, no_page: None) -> None:
    """One column a table less, no iCub file, and a notice that the sign cannot be checked."""
    config = changed(config_beside(short), factory={}, sensor={}, limb={}, fit={})
    result = calibrate_in_situ_log(short, config, folder=tmp_path)
    assert "icub" not in result.files
    assert any("one needs sensor.full_scale" in notice for notice in result.notices)
    assert any("no factory matrix" in notice for notice in result.notices)
    assert all("factory" not in column for table in result.tables for column in table.columns)
    assert "No known mass of the limb" in result.tables[1].note


def test_a_matrix_that_an_icub_cannot_hold_is_left_out(short: Path, tmp_path: Path, no_page: None) -> None:
    config = changed(config_beside(short), sensor={"full_scale": [100.0, 100, 100, 35, 35, 25]})
    result = calibrate_in_situ_log(short, config, folder=tmp_path)
    assert "icub" not in result.files
    assert any("No matrix in the iCub's format was written" in notice for notice in result.notices)


def test_what_is_refused_leaves_nothing_behind(short: Path, tmp_path: Path) -> None:
    config = changed(config_beside(short), fit={"sets": ["1", "2"]}, factory={})
    with pytest.raises(CalibrationRefused, match=r"in_situ_leg\.parquet: .*mass.*--accept REASON goes on"):
        calibrate_in_situ_log(short, config, folder=tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_refusal_that_is_accepted_is_said_in_every_file(short: Path, tmp_path: Path, undrawn: None) -> None:
    config = config_beside(short)
    sets = [one.model_dump() for one in config.sets or ()]
    sets[2] |= {"added_mass_kg": 1.3 * sets[2]["added_mass_kg"]}
    strict = changed(config, sets=sets)
    reason = "the sensor is <old>,\nand known to be"
    result = calibrate_in_situ_log(short, strict, folder=tmp_path, accept=reason)
    assert sorted(result.files) == ["calibration", "report", "ros2", "yaml"]
    for path in result.files.values():
        text = " ".join(html.unescape(path.read_text()).replace("\\n", " ").split())
        assert "the sensor is <old>, and known to be" in text, path
        assert "The added masses contradict each other" in text, path
    assert read_calibration(result.files["calibration"]).accepted == reason
    assert any(notice.startswith("Refused: ") for notice in result.notices)
    assert any("has no room for what was refused" in notice for notice in result.notices)


def test_a_reason_without_a_refusal_is_not_needed(plain: CalibratedSensor) -> None:
    assert "icub" in plain.files
    assert any("Nothing was refused" in notice for notice in plain.notices)


def test_a_drivers_newtons_are_calibrated_as_counts_are(
    tmp_path: Path, short: Path, plain: CalibratedSensor, undrawn: None
) -> None:
    """By the maker's matrix the counts become a driver's wrench; the true wrench stays what it was."""
    config = config_beside(short)
    matrix, counted = config.factory.matrix, pq.read_table(short)
    assert matrix is not None
    names = [f"raw_{i}_count" for i in range(6)]
    driven = np.column_stack([counted.column(name).to_numpy() for name in names]) @ matrix.T

    def write(path: Path, wrench: Floats) -> Path:
        table = counted.drop_columns(names)
        for name, column in zip(WRENCH, wrench.T, strict=True):
            table = table.append_column(name, [column])
        pq.write_table(table, path)
        return path

    path = write(tmp_path / "driver.parquet", driven)
    sheet = {"full_scale": config.sensor.full_scale}
    told = config.model_dump() | {"units": {"raw": "N"}, "factory": {}, "sensor": sheet}
    newtons = InSituConfig.read(told, "driver.toml")
    result = calibrate_in_situ_log(path, newtons, folder=tmp_path)
    # Where the data leave a matrix to the maker's, each of the two may choose another share of it.
    load = driven - driven.mean(axis=0)
    true = load @ (plain.fit.matrix @ np.linalg.inv(matrix)).T
    off = load @ result.fit.matrix.T - true
    assert (np.sqrt(np.mean(off**2, axis=0)) < 0.03 * np.sqrt(np.mean(true**2, axis=0))).all()
    assert abs(result.fit.limb.mass - plain.fit.limb.mass) < plain.fit.limb_mass_std
    assert "icub" not in result.files
    page = html.unescape(result.files["report"].read_text())
    assert "Offsets (N, N m)" in page
    assert "count" not in page.split("<h2>2.")[1]
    assert json.loads(result.files["calibration"].read_text())["raw_unit"] == "N, N m"
    # Nobody gave a factory matrix that messages could blame.
    assert "of full scale of the driver's" in page
    assert "driver's, longest (N)" in page
    assert "factory" not in page
    in_mm = write(tmp_path / "N_mm.parquet", driven * np.repeat([1.0, 1000.0], 3))
    with pytest.raises(CalibrationRefused, match=r"driver's matrix .* driver's torques are N mm") as no:
        calibrate_in_situ_log(in_mm, newtons, folder=tmp_path)
    assert "factory" not in str(no.value)


def test_values_and_their_deviations_end_at_one_decimal(result: CalibratedSensor) -> None:
    """Two digits of the deviation, and no power of ten."""
    page = html.unescape(result.files["report"].read_text())
    pairs = re.findall(r"<td>(-?[0-9.e+-]+) ± ([0-9.e+-]+)</td>", page)
    assert len(pairs) == 36
    limb = [row[1:] for row in result.tables[1].rows if row[2] != "–"]
    assert len(limb) == 4
    for value, deviation in (*pairs, *limb):
        assert "e" not in value + deviation
        assert len(value.partition(".")[2]) == len(deviation.partition(".")[2])
        assert len(deviation.replace(".", "").lstrip("0")) == 2


def test_the_sample_is_what_its_script_makes_and_holds_no_truth(
    tmp_path: Path, benchmark_script: Script
) -> None:
    script = benchmark_script("in_situ_sample")
    columns, _, response = made_so = script.make_sample()
    script.make_sample = lambda seed=None: made_so
    path = script.write_sample(tmp_path / "again.parquet")
    assert path.with_suffix(".toml").read_text() == SAMPLE.with_suffix(".toml").read_text()
    made, shipped = pq.read_table(path), pq.read_table(SAMPLE)
    assert made.schema.equals(shipped.schema)
    for name in made.column_names:
        # Machines differ in the last digits, which may move a count by one.
        a, b = (table.column(name).to_numpy().astype(float) for table in (made, shipped))
        np.testing.assert_allclose(a, b, atol=1.0 if "count" in name else 0.02)
    assert not any("truth" in name for name in columns)
    factory = config_beside(SAMPLE).factory.matrix
    assert factory is not None
    assert np.abs(factory @ response - np.eye(6)).max() > 0.05


def test_the_makers_matrix_can_be_kept(short: Path, tmp_path: Path, undrawn: None) -> None:
    config = config_beside(short)
    fit = config.fit.model_dump() | {"keep_matrix": True, "sets": ("1",)}
    factory = config.factory.matrix
    assert factory is not None
    # One set shows too little of this aged matrix for a contradiction.
    result = calibrate_in_situ_log(
        short, changed(config, fit=fit, limb={}), folder=tmp_path, accept="it is aged on purpose"
    )
    np.testing.assert_array_equal(result.fit.matrix, factory)
    assert result.fit.scope == "bias, mass and centre of mass; matrix kept (one load)"
    assert any(result.fit.scope in notice for notice in result.notices)
    assert read_calibration(result.files["calibration"]).scope == result.fit.scope
    with pytest.raises(LogError, match="keeps the maker's matrix, and 'factory' names none; name it there"):
        calibrate_in_situ_log(short, changed(config, fit=fit, limb={}, factory={}), folder=tmp_path)
