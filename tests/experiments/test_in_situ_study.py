from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from surefoot.calibration.in_situ import InSituOptions, InSituSet, Limb, calibrate_in_situ, limits
from surefoot.calibration.in_situ.check import measure_bending
from surefoot.calibration.in_situ.imu import fit_sphere, level
from surefoot.calibration.in_situ.solver.compress import compress
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.experiments.force_torque.validation import cramer_rao, normalise_error, offset_bounds
from surefoot.experiments.in_situ import cases, instruments, methods
from surefoot.experiments.in_situ.cases import compare_with_bound, exact_errors, sweep_and_calibrate
from surefoot.experiments.in_situ.claims import Limit, consistency, limits_of
from surefoot.experiments.in_situ.instruments import (
    XSENS_MTX,
    accelerometer_bias,
    moving_sets,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)
from surefoot.experiments.in_situ.methods import (
    FITTED,
    METHODS,
    MethodResult,
    calibrate_by_all,
    fit_row,
    wrench_error,
)
from surefoot.experiments.in_situ.page import write_in_situ_study_page
from surefoot.experiments.in_situ.study import InSituStudyOptions, run_in_situ_study
from surefoot.experiments.in_situ.tables import PRINTED
from surefoot.experiments.study.store import JOURNAL


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    options = InSituStudyOptions(
        out=tmp_path_factory.mktemp("study"), seeds=2, jobs=1, rate=2.0, white_rate=1.0, moving_seeds=1,
        kinds=("still",), motions=(0,),
    )  # fmt: skip
    return run_in_situ_study(options)


@pytest.fixture(scope="module")
def recordings():
    return record_rig(duration=100.0, rate=5.0)


@pytest.mark.slow
def test_one_row_for_each_sensor_seed_method_and_set(results):
    assert len(results.fits) == 2 * 2 * len(METHODS)
    assert set(results.fits["method"]) == set(METHODS)
    answered = results.fits[results.fits["refusal"] == ""]
    assert len(results.sets) == 4 * len(answered)
    assert sorted(results.sets["set"].unique()) == [5, 6, 7, 8]
    assert list(results.shown["sensor"]) == ["foot"] * 4 + ["leg"] * 4


@pytest.mark.slow
def test_everything_is_in_files(results):
    out = results.options.out
    for name in ("exact", "fits", "sets", "white", "motions"):
        assert len(pd.read_csv(out / "tables" / f"{name}.csv")) == len(getattr(results, name)) > 0
    assert not list(out.rglob("*.part*"))


@pytest.mark.slow
def test_finished_cases_are_read_and_give_the_same(results):
    journal = results.options.out / "results" / JOURNAL
    before = journal.read_bytes()
    again = run_in_situ_study(results.options)
    assert journal.read_bytes() == before
    for name in ("fits", "sets", "white"):
        pd.testing.assert_frame_equal(getattr(again, name), getattr(results, name))
    assert not results.failures


@pytest.mark.slow
def test_the_page_holds_all_tables_and_the_printed_numbers(results):
    page, tables = write_in_situ_study_page(results)
    text = page.read_text(encoding="utf-8")
    for table in tables:
        assert table.title in text
        assert all(len(row) == len(table.columns) for row in table.rows)
        assert (results.options.out / "tables" / f"page_{table.name}.csv").is_file()
    assert "34.4 / 33.3 / 32.5" in text
    assert "273 / 83 / 81" in text
    assert text.count("data:image/png;base64,") == 2
    assert text.count("data:image/svg+xml;base64,") == 1


@pytest.mark.slow
def test_table_three_leaves_out_the_set_without_a_mass(results):
    tables = {table.name: table for table in write_in_situ_study_page(results).tables}
    axes, masses, places = (tables[name] for name in ("table1", "table2", "table3"))
    assert len(axes.rows) == len(masses.rows) == 8
    assert len(places.rows) == 6
    assert not any("set 7" in row[0] for row in places.rows)


def test_printed_numbers_cover_the_validation_sets():
    assert set(PRINTED) == {(sensor, j) for sensor in ("foot", "leg") for j in (5, 6, 7, 8)}
    ratios = [row.ratio for row in PRINTED.values()]
    assert min(ratios) == pytest.approx(1.05, abs=0.01)
    assert max(ratios) == pytest.approx(1.15, abs=0.01)


@pytest.mark.parametrize("sensor", ["foot", "leg"])
def test_the_papers_method_is_exact_without_noise(sensor):
    (row,) = exact_errors(sensor, 5.0)["exact"]
    assert max(value for key, value in row.items() if key != "sensor") < 1e-9


def test_methods_see_what_a_robot_has(recordings, monkeypatch):
    seen = []

    def spy(sets, nominal, options):
        seen.append((sets, nominal, options))
        return dict.fromkeys(METHODS, "not asked")

    monkeypatch.setattr(cases, "calibrate_by_all", spy)
    monkeypatch.setattr(cases, "record_rig", lambda **_: recordings)
    rows = sweep_and_calibrate((0,), 5.0)
    assert {row["refusal"] for row in rows["fits"]} == {"not asked"}
    assert rows["sets"] == []
    for (sets, nominal, options), sensor in zip(seen, ("foot", "leg"), strict=True):
        config = sensor_config(sensor)
        assert np.array_equal(nominal, config.nominal_matrix)
        assert options == InSituOptions(code_range=config.code_range)
        for data, recording in zip(sets, recordings, strict=True):
            assert np.array_equal(data.raw, np.round(data.raw))
            assert not np.allclose(data.gravity, -recording.specific_force, atol=1e-3)
            assert data.added_mass == recording.added_mass
            assert data.angular_velocity is None


def test_a_sensor_is_the_same_in_all_sets_but_for_its_zeros(recordings):
    config = sensor_config("foot", exact=True)
    counts, truth = read_sensor(config, "foot", recordings, 1)
    wrench = np.stack([one.wrench_foot for one in recordings])
    expected = wrench @ truth.response.T + truth.offsets[:, None]
    assert np.allclose(counts, expected, atol=1e-6 * np.abs(counts).max())
    assert not np.allclose(truth.offsets[0], truth.offsets[1])
    assert np.allclose(truth.offset, truth.offsets[-1])


@pytest.mark.parametrize("exact", [True, False])
def test_a_seed_means_the_same_sensor_whatever_it_reads(recordings, exact):
    config = sensor_config("leg", exact=exact)
    (first, _), (of_two, truth) = (read_sensor(config, "leg", recordings[:n], 4) for n in (1, 2))
    assert np.array_equal(first[0], of_two[0])
    other = read_sensor(config, "leg", recordings[:2], 5)[1]
    assert (np.abs(other.response - truth.response) > 0.0).all()


def test_sensors_read_the_same_with_the_library_and_without(recordings, monkeypatch):
    config = sensor_config("foot")
    counts, truth = read_sensor(config, "foot", recordings[:2], 3)
    monkeypatch.setattr(instruments, "native_here", lambda kind, config: None)
    in_python, same = read_sensor(config, "foot", recordings[:2], 3)
    # What lies just between two codes may be rounded to either.
    assert (counts != in_python).sum() <= 2
    np.testing.assert_allclose(same.offsets, truth.offsets, rtol=1e-9)


def test_the_accelerometers_bias_is_found_from_its_readings(recordings):
    rest = record_rig((1,), duration=100.0, rate=20.0, at_rest=True)
    for of_seed in (read_imu(rest, seed) for seed in (0, 1)):
        bias = np.mean(of_seed[0, :, :3] - rest[0].specific_force, axis=0)
        assert np.linalg.norm(bias) > 0.01
        assert accelerometer_bias(of_seed[..., :3]) == pytest.approx(bias, abs=0.01)
    assert XSENS_MTX.accelerometer_bias_std > 0.0


def test_the_paper_filters_three_seconds_whatever_the_rate(recordings, monkeypatch):
    windows = []

    def spy(signal, window):
        windows.append(window)
        return signal

    monkeypatch.setattr(methods, "savitzky_golay", spy)
    for rate in (10.0, 100.0):
        n = 400
        data = InSituSet(np.zeros((n, 6)), np.zeros((n, 3)), time=np.arange(n) / rate)
        methods.filter_set(data)
    assert windows == [31, 31, 301, 301]


def small_problem(rng, n=200):
    limb = Limb(2.0, np.array([0.05, -0.02, 0.3]))
    places = [(0.0, np.zeros(3)), (0.7, np.array([0.2, 0.1, 0.1])), (0.5, np.array([-0.1, 0.3, 0.4]))]
    places.append((0.6, np.array([0.1, -0.2, -0.1])))
    response = rng.standard_normal((6, 6)) + 5.0 * np.eye(6)
    gravity = rng.standard_normal((n, 3))
    gravity *= 9.81 / np.linalg.norm(gravity, axis=1, keepdims=True)
    sets = [InSituSet(np.zeros((n, 6)), gravity, mass, com) for mass, com in places]
    return sets, response, limb


def reading(theta, sets):
    A, mass, first = theta[:36].reshape(6, 6), theta[36], theta[37:40]
    found = []
    for j, data in enumerate(sets):
        offset = theta[40 + 6 * j : 46 + 6 * j]
        moment = first + data.added_mass * np.asarray(data.added_com)
        wrench = np.hstack([(mass + data.added_mass) * data.gravity, np.cross(moment, data.gravity)])
        found.append((wrench @ A.T + offset).ravel())
    return np.concatenate(found)


def test_the_bound_is_that_of_numerical_slopes():
    rng = np.random.default_rng(5)
    sets, response, limb = small_problem(rng, n=30)
    root = rng.standard_normal((6, 6)) / 3.0 + np.eye(6)
    noise = root @ root.T
    theta = np.concatenate([response.ravel(), [limb.mass], limb.mass_com, rng.standard_normal(24)])
    steps = 1e-6 * np.eye(len(theta))
    J = np.stack([(reading(theta + h, sets) - reading(theta - h, sets)) / 2e-6 for h in steps], axis=1)
    white = np.linalg.solve(np.linalg.cholesky(noise), J.reshape(-1, 6, len(theta)))
    white = white.reshape(-1, len(theta))
    expected = np.linalg.inv(white.T @ white)
    bound = cramer_rao(sets, response, limb, noise)
    assert np.allclose(bound, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
    assert offset_bounds(bound, response, 4).shape == (4, 6, 6)


def test_there_is_no_bound_where_sets_leave_an_unknown_open():
    sets, response, limb = small_problem(np.random.default_rng(6))
    with pytest.raises(ValueError, match="leave some unknown open"):
        cramer_rao(sets[:2], response, limb, np.eye(6))


def test_nees_grows_with_the_square_of_the_error():
    rng = np.random.default_rng(7)
    sets, response, limb = small_problem(rng, n=400)
    theta = np.concatenate([response.ravel(), [limb.mass], limb.mass_com, np.zeros(24)])
    raw = reading(theta, sets).reshape(4, 400, 6) + 0.01 * rng.standard_normal((4, 400, 6))
    fit = calibrate_in_situ([replace(one, raw=counts) for one, counts in zip(sets, raw, strict=True)])
    near = normalise_error(fit, response, np.zeros(6), limb)
    exact = np.linalg.pinv(fit.matrix)
    assert 15.0 < near < 110.0
    at = normalise_error(fit, exact, fit.offset, fit.limb)
    assert at == pytest.approx(0.0, abs=1e-6)
    off = Limb(fit.limb.mass + 3.0 * fit.limb_mass_std, fit.limb.mass_com)
    twice = Limb(fit.limb.mass + 6.0 * fit.limb_mass_std, fit.limb.mass_com)
    once = normalise_error(fit, exact, fit.offset, off)
    assert once >= 9.0 * (1.0 - 1e-6)
    assert normalise_error(fit, exact, fit.offset, twice) == pytest.approx(4.0 * once)


def test_wrench_errors_are_shares_of_the_load():
    wrench = np.random.default_rng(8).standard_normal((50, 6))
    response = np.diag([2.0] * 6)
    right = np.linalg.inv(response)
    assert wrench_error(right, response, wrench) == pytest.approx((0.0, 0.0))
    off = np.diag([1.1] * 3 + [0.8] * 3) @ right
    assert wrench_error(off, response, wrench) == pytest.approx((0.1, 0.2))


def test_a_refused_calibration_has_no_numbers_and_says_why(recordings):
    _, truth = read_sensor(sensor_config("leg"), "leg", recordings[:1], 0)
    row = fit_row("because", truth, recordings[0].wrench_leg)
    assert row["refusal"] == "because"
    assert np.isnan(row["limb_error"])


def test_targets_count_refused_fits_as_missed():
    within = Limit("x", 1.0, np.array([0.5, 1.0]))
    assert within.met
    assert within.share == 1.0
    refused = Limit("x", 1.0, np.array([0.5, 1.0]), refused=2)
    assert not refused.met
    assert refused.share == 0.5
    assert not Limit("x", 1.0, np.array([0.5, 1.1])).met
    assert not Limit("x", 1.0, np.zeros(0)).met


@pytest.mark.slow
def test_a_refused_seed_misses_its_sets(results):
    before = {target.name: target for target in limits_of(results)}
    fits, sets = results.fits.copy(), results.sets
    first = (fits["sensor"] == "leg") & (fits["seed"] == 1) & (fits["method"] == "measurement")
    fits.loc[first, ["refusal", "limb_error"]] = ["no", np.nan]
    fits["clipped"] = False
    gone = (sets["sensor"] == "leg") & (sets["seed"] == 1) & (sets["method"] == "measurement")
    after = {t.name: t for t in limits_of(replace(results, fits=fits, sets=sets[~gone]))}
    for name, lost in (("semi-axis", 4), ("added mass", 4), ("position", 3), ("weight", 1)):
        key = next(known for known in before if name in known)
        assert after[key].refused == lost
        assert len(after[key].values) == len(before[key].values) - lost
    rightly = limits_of(replace(results, fits=fits.assign(clipped=first), sets=sets[~gone]))
    assert not any(target.refused for target in rightly)


def test_consistency_is_that_of_chi_square():
    rng = np.random.default_rng(9)
    nees = rng.chisquare(46, 400)
    right = consistency(pd.DataFrame({"nees": nees, "unknowns": 46}))
    assert right.inside
    assert right.low < 1.0 < right.high
    assert not consistency(pd.DataFrame({"nees": 1.2 * nees, "unknowns": 46})).inside
    assert not consistency(pd.DataFrame({"nees": [np.nan], "unknowns": 46})).inside


def test_options_refuse_what_cannot_be_done():
    with pytest.raises(ValueError, match="'seeds' must be positive, got 0"):
        InSituStudyOptions(seeds=0)
    quick = InSituStudyOptions(seeds=50).quickly()
    assert quick.seeds == 2
    assert quick.rate == 10.0


@pytest.mark.slow
def test_ten_seeds_reach_the_targets():
    seeds = (tuple(range(5)), tuple(range(5, 10)))
    found = [sweep_and_calibrate(batch, 20.0) for batch in seeds]
    fits = pd.DataFrame([row for one in found for row in one["fits"]])
    ours = fits[fits["method"] == "measurement"]
    assert (ours["refusal"] == "").all()
    assert ours["limb_error"].abs().max() < 0.01
    paper = fits[(fits["method"] == "paper") & (fits["sensor"] == "leg")]
    assert paper["limb_error"].mean() < -0.03
    sets = pd.DataFrame([row for one in found for row in one["sets"]])
    sets = sets[sets["method"] == "measurement"]
    assert sets["ratio"].max() < 1.03
    assert sets["mass_error"].max() < 0.01
    assert sets["place_error"].max() < 0.01
    white = pd.DataFrame([r for batch in seeds for r in compare_with_bound(batch, "still", 4.0)["white"]])
    for _, part in white.groupby("sensor"):
        assert part["force_square"].sum() < 1.3**2 * part["force_bound"].sum()
        assert part["torque_square"].sum() < 1.3**2 * part["torque_bound"].sum()
        assert 0.75 < consistency(part).mean < 1.3


def test_sets_that_were_not_fitted_get_offsets_of_their_own(recordings):
    config = sensor_config("leg")
    counts, truth = read_sensor(config, "leg", recordings, 0)
    force = np.stack([one.specific_force for one in recordings])
    sets = static_sets("leg", recordings, counts, force)
    found = calibrate_by_all(sets, config.nominal_matrix, InSituOptions())["measurement"]
    assert isinstance(found, MethodResult)
    off = (found.offsets - truth.offsets) @ np.linalg.inv(truth.response).T
    assert off.shape == (8, 6)
    # Of offsets of hundreds of newtons; gravity tells least of them along the leg.
    assert np.abs(off[FITTED:, :2]).max() < 0.3
    assert np.abs(off[FITTED:, 2]).max() < 3.0


def test_noise_of_an_accelerometer_bends_no_limb():
    run = record_rig((1, 2), duration=60.0, rate=10.0, speed_deg=12.0, seed=24)
    counts, _ = read_sensor(sensor_config("foot", exact=True), "foot", run, 24)
    felt = np.array([np.hstack([one.specific_force, one.angular_velocity]) for one in run])
    felt[..., :3] += 0.1 * np.random.default_rng(93).standard_normal(felt[..., :3].shape)
    sets = moving_sets("foot", run, counts, felt, np.zeros(3))
    parts = compress(level(sets, fit_sphere(sets)), InSituOptions(), moving=True, temperature=False)
    assert max(map(measure_bending, parts)) < limits.BENDING
