"""What comes out of a calibrated log, and what is said of a log that cannot tell all."""

import dataclasses
import inspect
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from _logs import fails, refusal_of, run

from surefoot.calibration import GRAVITY, Estimate, FootCalibrator, FootLayout, Parameters, replay
from surefoot.calibration.layout import FeetLayout
from surefoot.experiments.cli.calibrate import walk
from surefoot.experiments.logs.clock import find_gaps
from surefoot.experiments.logs.format import Log, LogError, read_log, write_log
from surefoot.experiments.walking import calibrate as module
from surefoot.experiments.walking.agreement import agreement, ground_of_forces, ground_of_motion
from surefoot.experiments.walking.calibrate import CalibratedLog, calibrate_log, standard_deviations
from surefoot.experiments.walking.notices import check_weight, log_notices, result_notices
from surefoot.experiments.walking.tables import Facts, terminal_tables


def calibrate(log: Log, folder: Path, method: str = "none", **options: Any) -> CalibratedLog:
    return calibrate_log(log, method, folder=folder, stem="walk", file="walk.csv", **options)


def balanced(log: Log) -> Log:
    """Stand still and upright over the middle of the cells, which share the weight and make some noise."""
    n = len(log)
    force = log.mass * GRAVITY / 8 + 1e-3 * np.random.default_rng(0).standard_normal((n, 8))
    reference = log.reference._replace(
        com=np.tile((0.02397, 0.0, 0.26), (n, 1)),
        com_acceleration=np.zeros((n, 3)),
        angular_momentum_rate=np.zeros((n, 3)),
        R_level_sole=np.tile(np.eye(3), (n, 2, 1, 1)),
    )
    raw = (force - log.nominal.offset) / log.nominal.scale
    return dataclasses.replace(log, raw=raw, truth=None, reference=reference)


def test_the_default_is_that_of_a_calibrator_in_a_loop(log: Log) -> None:
    default = inspect.signature(walk).parameters["method"].default
    assert FootCalibrator(log.layout, mass=log.mass).method == default


def test_what_is_written(log: Log, tmp_path: Path) -> None:
    result = calibrate(log, tmp_path, "tare")
    walk = pd.read_parquet(result.walk)
    assert len(walk) == len(log)
    assert walk["cop_level_valid"].all()
    assert walk["cop_left_sole_valid"].dtype == bool
    assert np.isfinite(walk.drop(columns="time_s")).all(axis=None)
    told = json.loads(result.parameters.read_text())
    assert told["channels"] == list(log.layout.channel_names)
    np.testing.assert_allclose(
        walk["scale_left_front_left_N_per_count"].iloc[-1], told["scale_N_per_count"][0]
    )
    assert told["notices"] == list(result.notices)
    page = result.page.read_text()
    assert page.count("data:image/svg+xml;base64,") >= 4
    assert "http" not in page.replace("http-equiv", "")
    for part in ("Agreement with the robot", "Errors against the truth", "Parameters", "Flags", "The log"):
        assert part in page
    assert [table.name for table in result.tables] == ["parameters", "agreement", "score", "flags"]


def test_a_real_robot_has_no_errors_to_show(log: Log, tmp_path: Path, undrawn: None) -> None:
    result = calibrate(dataclasses.replace(log, truth=None), tmp_path)
    assert "against the truth" not in result.page.read_text()
    assert [table.name for table in result.tables] == ["parameters", "agreement", "flags"]


class TestUncertainty:
    """A method's covariance of (a, b) reaches table, file and page."""

    COVARIANCE = np.diag([*np.full(8, 0.01**2), *np.full(8, 0.2**2)])
    COVARIANCE[0, 8] = COVARIANCE[8, 0] = 0.5 * 0.01 * 0.2

    def estimate(self, log: Log) -> Estimate:
        steps = np.diff(log.time, prepend=log.time[0] - log.dt)
        found = replay(log.layout, "none", log.raw, log.reference, steps, mass=log.mass, initial=log.nominal)
        return found._replace(covariance=np.tile(self.COVARIANCE, (len(log), 1, 1)))

    def test_of_the_map_in_counts(self, log: Log) -> None:
        """Against a million draws of (a, b)."""
        spread = standard_deviations(self.estimate(log), log.nominal)
        assert spread is not None
        a, b = np.random.default_rng(1).multivariate_normal(
            (1.0, 0.0), self.COVARIANCE[np.ix_([0, 8], [0, 8])], 1_000_000
        ).T  # fmt: skip
        assert spread.scale[0, 0] == pytest.approx(np.std(a * log.nominal.scale[0]), rel=5e-3)
        assert spread.offset[0, 0] == pytest.approx(np.std(a * log.nominal.offset[0] + b), rel=5e-3)

    def test_where_it_is_written(
        self, log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undrawn: None
    ) -> None:
        count = np.where(np.arange(len(log)) % 4 == 0, 3, 0)
        estimate = self.estimate(log)._replace(
            force_std=np.full(log.raw.shape, 0.3),
            cop_covariance=np.tile(np.diag([1e-6, 4e-6]), (len(log), 1, 1)),
            nis=np.where(count > 0, 3.6, np.nan),
            nis_rows=count,
        )
        monkeypatch.setattr(module, "replay_log", lambda *_, **__: estimate)
        result = calibrate(log, tmp_path)
        told = json.loads(result.parameters.read_text())
        np.testing.assert_allclose(told["scale_std_N_per_count"], np.full(8, 0.01 * 2e-5))
        walk = pd.read_parquet(result.walk)
        np.testing.assert_allclose(walk["scale_right_rear_right_std_N_per_count"], 0.01 * 2e-5)
        np.testing.assert_allclose(walk["force_left_front_left_std_N"], 0.3)
        np.testing.assert_allclose(walk["cop_level_y_std_m"], 2e-3)
        assert (walk["nis_rows"] == count).all()
        assert told["nis_per_row"] == pytest.approx(1.2)
        assert "Normalised innovations are 1.20 per row" in result.tables[0].note
        assert result.tables[0].rows[7][3:] == ("0.0 ± 1.0", "0.00 ± 0.20")
        assert "bands of ± one standard deviation" in result.page.read_text()

    def test_where_a_method_claims_none(self, log: Log, tmp_path: Path, undrawn: None) -> None:
        result = calibrate(log, tmp_path, "tare")
        assert json.loads(result.parameters.read_text())["scale_std_N_per_count"] is None
        assert not any("_std_" in name for name in pd.read_parquet(result.walk).columns)
        assert "The method has no covariance." in result.page.read_text()


def test_agreement_is_distance_from_the_motion(log: Log) -> None:
    log = balanced(log)
    force = log.nominal.force(log.raw)
    fine = agreement(ground_of_forces(log, force), ground_of_motion(log))
    assert fine.vgrf < 1e-2
    assert fine.cop < 1e-4
    assert fine.rows == len(log) - log.lag
    heavier = agreement(ground_of_forces(log, 1.1 * force), ground_of_motion(log))
    assert heavier.vgrf == pytest.approx(0.1 * log.mass * GRAVITY, rel=1e-2)
    assert heavier.cop < 1e-4
    ahead = log.reference._replace(com=log.reference.com + np.array([0.007, 0.0, 0.0]))
    moved = agreement(
        ground_of_forces(log, force), ground_of_motion(dataclasses.replace(log, reference=ahead))
    )
    assert moved.cop == pytest.approx(0.007, rel=1e-2)
    assert agreement(ground_of_forces(log, force), ground_of_motion(log), settle=99.0).rows == 0


def test_agreement_does_not_see_where_the_level_frame_lies(log: Log) -> None:
    """A frame whose origin leaps from row to row is allowed, and no filter may smear the leaps."""
    log = balanced(log)
    force = 1.1 * log.nominal.force(log.raw)
    still = agreement(ground_of_forces(log, force), ground_of_motion(log))
    leap = 10.0 * np.random.default_rng(2).standard_normal((len(log), 3)) * (1.0, 1.0, 0.0)
    reference = log.reference._replace(
        com=log.reference.com + leap, position_sole=log.reference.position_sole + leap[:, None]
    )
    leaping = dataclasses.replace(log, reference=reference)
    again = agreement(ground_of_forces(leaping, force), ground_of_motion(leaping))
    np.testing.assert_allclose(again[:2], still[:2], rtol=1e-6, atol=1e-12)


WEIGHT = "and mass_kg = 5.3 weighs 51.99 N"
ADVICE = (
    "Give scale_N_per_count and offset_N in newtons (without offset_N it is read while a foot swings), "
    "mass_kg in kilograms, and a log in which the robot "
    "stands on its feet."
)
UNITS = {
    "millinewtons": (
        1000.0,
        "1e+03 times as much. A map in millinewtons or a mass in tonnes would look so. ",
    ),
    "kilonewtons": (0.001, "0.001 times as much. A map in kilonewtons or a mass in grams would look so. "),
    "grams-force": (1000 / GRAVITY, "102 times as much. A map in grams-force would look so. "),
    "kilograms-force": (1 / GRAVITY, "0.102 times as much. A map in kilograms-force would look so. "),
    "pounds-force": (0.2248, "0.225 times as much. A map in pounds-force would look so. "),
    "something": (5.0, "5 times as much. "),
}


@pytest.mark.parametrize(("factor", "message"), UNITS.values(), ids=UNITS)
def test_a_map_in_other_units_is_refused(log: Log, tmp_path: Path, factor: float, message: str) -> None:
    log = balanced(log)
    log = dataclasses.replace(log, nominal=Parameters(*(factor * part for part in log.nominal)))
    with pytest.raises(LogError) as refused:
        calibrate(log, tmp_path)
    carried = f"{factor * log.mass * GRAVITY:.3g}"
    start, _, rest = str(refused.value).partition(" N where they carry most, ")
    assert start.startswith("walk.csv: by the nominal map the feet carry ")
    assert float(start.rpartition(" ")[2]) == pytest.approx(float(carried), rel=0.01)
    assert rest == f"{WEIGHT}: {message}{ADVICE}"
    assert not list(tmp_path.iterdir())


def test_the_length_of_a_foot_is_asked_for_where_no_cell_has_a_place(
    log: Log, tmp_path: Path, no_page: None
) -> None:
    feet = [FootLayout(foot.name, foot.wrench_map, foot.channel_names) for foot in log.layout.feet]
    log = dataclasses.replace(balanced(log), layout=FeetLayout(tuple(feet)))
    with pytest.raises(
        LogError, match=r'walk\.csv: .* give it in m in the description: "about": \{"foot_length'
    ):
        calibrate(log, tmp_path)
    calibrate(dataclasses.replace(log, about={"foot_length_m": 0.15}), tmp_path)


def test_a_plate_may_be_empty_most_of_the_time(log: Log) -> None:
    log = balanced(log)
    raw = log.raw.copy()
    raw[2:] = -log.nominal.offset / log.nominal.scale
    check_weight(dataclasses.replace(log, raw=raw), "nominal", log.nominal, "walk.csv")
    light = Parameters(log.nominal.scale / GRAVITY, log.nominal.offset / GRAVITY)
    with pytest.raises(LogError, match="A map in kilograms-force would look so"):
        check_weight(dataclasses.replace(log, raw=raw), "nominal", light, "walk.csv")


def test_a_map_of_the_wrong_sign_is_refused(log: Log, tmp_path: Path) -> None:
    log = dataclasses.replace(balanced(log), nominal=Parameters(*(-part for part in log.nominal)))
    with pytest.raises(LogError) as refused:
        calibrate(log, tmp_path)
    assert str(refused.value) == (
        f"walk.csv: by the nominal map the feet pull the ground with 52 N, {WEIGHT}. The likeliest cause: "
        "all channels have the other sign. Turn the signs of scale_N_per_count and offset_N round: standing "
        "is positive."
    )


def test_a_log_without_a_reading_is_refused(log: Log, tmp_path: Path) -> None:
    log = dataclasses.replace(log, raw=np.full_like(log.raw, np.nan))
    with pytest.raises(LogError) as refused:
        calibrate(log, tmp_path)
    assert str(refused.value) == (
        "walk.csv: columns 'raw_..._count' hold no reading that ever changes in the 60 rows; write the "
        "converters' counts into them."
    )


FEET_DOWN = tuple(
    f"walk.csv: the {foot} foot is never surely in the air ('reference_{foot}_swing' is 0 in all 60 rows), "
    "so that its offsets cannot be separated from its scales; let it swing, or lift it for a second."
    for foot in ("left", "right")
)


def test_a_robot_that_never_moves_is_calibrated_with_a_notice(
    log: Log, tmp_path: Path, undrawn: None
) -> None:
    result = calibrate(balanced(log), tmp_path)
    assert result.notices == (
        *FEET_DOWN,
        "walk.csv: the robot never moves: the centre of pressure that its motion asks for stays within 0.0 "
        "mm, so that only the weight and its place can be learnt and single channels cannot; walk, or shift "
        "the weight over each corner.",
    )
    page = result.page.read_text()
    assert "the robot never moves" in page


def test_one_foot_that_swings_needs_no_notice(log: Log) -> None:
    swing = np.zeros((len(log), 2), dtype=bool)
    swing[10:20, 1] = True
    log = dataclasses.replace(log, reference=log.reference._replace(swing=swing))
    assert log_notices(log, "walk.csv") == FEET_DOWN[:1]


def test_a_channel_that_is_out_is_a_notice(log: Log, tmp_path: Path, no_page: None) -> None:
    raw = log.raw.copy()
    raw[:, 1] = np.nan
    raw[:, 6] = 8_000_000.0
    result = calibrate(dataclasses.replace(log, raw=raw), tmp_path)
    assert result.notices[:2] == (
        "walk.csv (all along): Column 'raw_left_front_right_count' contains no reading. Check its cable and "
        "its name.",
        "walk.csv (all along): 'raw_right_rear_left_count' stays at 8000000 from then on, while others "
        "change. Check its cable and its converter.",
    )
    walk = pd.read_parquet(result.walk)
    assert np.isfinite(walk.filter(like="force_")).all(axis=None)
    flags = result.tables[-1]
    assert flags.rows[0][0] == "no reading arrived; the last one is held"
    assert flags.rows[0][1] == "100.00 %"
    assert flags.rows[0][3] == "left, front-right"


def test_a_channel_that_dies_is_a_notice(bad_start: Log) -> None:
    assert log_notices(bad_start, "walk.csv") == ()
    raw = bad_start.raw.copy()
    raw[700:, 3] = 70_000.0
    (notice,) = log_notices(dataclasses.replace(bad_start, raw=raw), "walk.csv")
    assert notice == (
        f"walk.csv ({bad_start.time[700]:.6g} s): 'raw_left_rear_right_count' stays at 70000 from then on, "
        "while others change. Check its cable and its converter."
    )


@pytest.mark.parametrize(
    ("missing", "why"),
    [
        (
            0.05,
            "33 % of the rows lack a reading of a channel, of which little is learnt; fill single missing "
            "readings between their neighbours, or log all channels in every row.",
        ),
        (0.0, "It was exact already: feet in the air read 0 N by it."),
    ],
)
def test_why_a_tare_learnt_nothing(log: Log, missing: float, why: str) -> None:
    air = np.arange(len(log)) < 30
    raw = np.where(air[:, None], -log.nominal.offset / log.nominal.scale, log.raw)
    raw[np.random.default_rng(1).random(raw.shape) < missing] = np.nan
    swing = np.tile(air[:, None], 2)
    log = dataclasses.replace(log, raw=raw, lag=0, reference=log.reference._replace(swing=swing))
    estimate = replay(log.layout, "none", raw, log.reference, mass=log.mass, initial=log.nominal)
    start = "walk.csv: nothing was learnt: the tare map is the one at the start. "
    assert result_notices(log, "tare", log.nominal, estimate, "walk.csv") == (start + why,)


@pytest.mark.parametrize(("gap", "slower"), [(0.2, 1.0), (0.0, 8.0)])
def test_lost_rows_and_slow_chips_need_no_option(log: Log, tmp_path: Path, gap: float, slower: float) -> None:
    """Rows at 10 a second are all farther apart than 0.1 s."""
    time = slower * log.time + gap * (np.arange(len(log)) >= 30) + 5e-4 * (np.arange(len(log)) % 2)
    path = write_log(dataclasses.replace(log, time=time, dt=slower * log.dt), tmp_path / "walk.csv")
    read = read_log(path)
    assert find_gaps(np.diff(read.time)).sum() == (gap > 0.0)


def test_gaps_are_bridged_on_request(log: Log, tmp_path: Path, no_page: None) -> None:
    gap = dataclasses.replace(log, time=log.time + 22.6 * (np.arange(len(log)) >= 30))
    path = write_log(gap, tmp_path / "walk.csv")
    fails(
        ["calibrate", "walk", path, "--method", "none"],
        "walk.csv: column 'time_s' leaps by 22.6 s at row 30 (at most 0.3 s); cut the log there and "
        "calibrate the parts one by one, or bridge it with --split-gaps.",
    )
    result = run("calibrate", "walk", path, "--method", "none", "--split-gaps")
    assert (
        "Note: walk.csv: column 'time_s' leaps 1 times by more than 0.1 s, the longest by 22.6 s; after each "
        "the filters start again, and what was learnt is kept.\n" in result.stdout
    )
    assert "the clock jumped; filters start again" in result.stdout
    assert "one by one" not in result.stdout
    both = ["--split-gaps", "--zero-phase"]
    fails(
        ["calibrate", "walk", path, "--method", "none", *both],
        "walk.csv: --zero-phase filters across gaps in time, which this log has; leave "
        "it out, or cut the log there.",
    )


def test_a_mass_that_is_not_the_models_is_a_notice(log: Log) -> None:
    about = {"model": "nao.xml", "model_mass_kg": 5.8}
    notices = log_notices(dataclasses.replace(log, about=about), "walk.csv")
    assert notices[0] == (
        "walk.csv: mass_kg = 5.3 is not the model's 5.8 kg; its centre of mass and angular momentum are the "
        "model's. Weigh the robot, and correct the model."
    )


UNITS_OF_REFERENCES = {
    "millimetres": (
        {f"reference_com_{axis}_m": 1000.0 for axis in "xyz"},
        "columns 'reference_com_x_m' to '_z_m' lie 26",
        " from the soles, and no robot's centre of mass is farther than 5 m from them; give both in metres "
        "and in one frame.",
    ),
    "accelerations in g": (
        {f"reference_accelerometer_{axis}_m_s2": 1 / GRAVITY for axis in "xyz"},
        "columns 'reference_accelerometer_x_m_s2' to '_z_m_s2' have a median length of ",
        ", and a robot at rest feels 9.81 m/s^2; give m/s^2, gravity included.",
    ),
}


@pytest.mark.parametrize(("factors", "start", "end"), UNITS_OF_REFERENCES.values(), ids=UNITS_OF_REFERENCES)
def test_references_in_other_units_are_refused(path: Path, factors: Any, start: str, end: str) -> None:
    table = pd.read_csv(path)
    table.assign(**{name: factor * table[name] for name, factor in factors.items()}).to_csv(path, index=False)
    reason = refusal_of(path)
    assert reason.startswith(f"walk.csv: {start}")
    assert reason.endswith(end)


def test_instruments_of_a_foot_survive_the_file(log: Log, tmp_path: Path) -> None:
    feet = tuple(
        FootLayout.load_cells(
            foot.name, foot.position_cell_sole, mass_below=0.1, com_below_sole=(0.02, 0, 0.01)
        )
        for foot in log.layout.feet
        if foot.position_cell_sole is not None
    )
    path = write_log(dataclasses.replace(log, layout=FeetLayout(feet)), tmp_path / "walk.parquet")
    sensor = read_log(path).layout.feet[1].sensors[0]
    assert sensor.mass_below == 0.1
    assert sensor.channels == slice(0, 4)
    np.testing.assert_array_equal(sensor.com_below_sole, (0.02, 0, 0.01))
    np.testing.assert_array_equal(sensor.wrench_map, feet[1].wrench_map)


JUNK = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e12, 0.0, -1.0, 1e-300, 1e8)


def test_junk_is_refused_or_survived(log: Log, tmp_path: Path) -> None:
    """Whatever stands in cells or columns of a table: a reason, or finite forces; never a warning or NaN."""
    path = write_log(dataclasses.replace(log, truth=None), tmp_path / "walk.csv")
    table = pd.read_csv(path).astype(float)
    rng = np.random.default_rng(7)
    reasons = []
    for _ in range(60):
        spoilt = table.copy()
        for _ in range(rng.integers(1, 4)):
            column, value = rng.choice(table.columns), JUNK[rng.integers(len(JUNK))]
            if rng.random() < 0.3:
                spoilt[column] = value
            else:
                spoilt.loc[rng.integers(len(table)), column] = value
        spoilt.to_csv(path, index=False)
        try:
            found = read_log(path)
            check_weight(found, "nominal", found.nominal, "walk.csv")
        except LogError as error:
            reasons.append(str(error))
            continue
        log_notices(found, "walk.csv")
        estimate = replay(
            found.layout, "none", found.raw, found.reference, mass=found.mass, initial=found.nominal
        )
        facts = Facts(found, "nominal", found.nominal, estimate, 0.0)
        assert np.isfinite(estimate.force).all()
        assert np.isfinite(facts.before).all()
        assert len(terminal_tables(facts)) == 2
    assert 12 < len(reasons) < 56
    assert all(reason.startswith("walk.csv: ") for reason in reasons)
