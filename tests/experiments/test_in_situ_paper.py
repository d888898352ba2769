"""The simulated experiment of the in-situ paper: its sensors, its scores, and how well methods do."""

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


@pytest.fixture(scope="module")
def paper(benchmark_script):
    return benchmark_script("in_situ_paper")


@pytest.fixture(scope="module")
def rig(benchmark_script):
    return benchmark_script("rig")


@pytest.fixture(scope="module")
def recordings():
    return record_rig(duration=100.0, rate=5.0)


@pytest.fixture(scope="module")
def found(paper):
    """A small run of the experiment: its rows by table."""
    seeds = range(2)
    parts = {"exact": [paper.exact("foot", 5.0)], "fits": [paper.sweep(seed, 2.0) for seed in seeds]}
    parts["bound"] = [paper.bound(seed, 1.0) for seed in seeds]
    tables = {"sets": parts["fits"], **parts}
    return {name: pd.DataFrame([row for one in of for row in one[name]]) for name, of in tables.items()}


@pytest.mark.slow
def test_the_experiment_has_a_row_for_each_method_and_unseen_set(paper, found):
    assert len(found["fits"]) == 2 * 2 * len(paper.METHODS)
    answered = found["fits"][found["fits"]["refusal"] == ""]
    assert len(found["sets"]) == 4 * len(answered)
    assert sorted(found["sets"]["set"].unique()) == [5, 6, 7, 8]
    for table in (paper.target_table(found), paper.limb_table(found["fits"])):
        assert len(table.rows) in (7, 2 * len(paper.METHODS))


@pytest.mark.slow
def test_refused_fits_miss_the_targets_unless_the_converter_ended(paper, found):
    fits, sets = found["fits"].assign(clipped=False), found["sets"]
    key = {"sensor": "leg", "seed": 1, "method": paper.PUBLISHED}
    mine, theirs = ((part[list(key)] == pd.Series(key)).all(axis=1) for part in (fits, sets))
    fits.loc[mine, ["refusal", "limb_error"]] = ["no", np.nan]
    left = {**found, "fits": fits, "sets": sets[~theirs]}
    assert [one.refused for one in paper.targets(left)] == [0, 4, 4, 3, 1, 0, 0]
    assert not any(one.refused for one in paper.targets(left | {"fits": fits.assign(clipped=mine)}))


def test_a_target_is_met_by_all_numbers_or_missed(paper):
    for values, refused, share in (((0.5, 1.0), 0, 1.0), ((0.5, 1.0), 2, 0.5), ((0.5, 1.1), 0, 0.5)):
        assert paper.Target("x", 1.0, np.array(values), refused).share == share


@pytest.mark.parametrize("sensor", ["foot", "leg"])
def test_the_papers_method_is_exact_without_noise(paper, sensor):
    (row,) = paper.exact(sensor, 5.0)["exact"]
    assert row["error"] < 1e-9


def test_a_sensor_is_the_same_in_all_sets_but_for_its_zeros(rig, recordings):
    config = rig.sensor_config("foot", exact=True)
    counts, truth = rig.read_sensor(config, "foot", recordings, 1)
    wrench = np.stack([one.wrench_foot for one in recordings])
    expected = wrench @ truth.response.T + truth.offsets[:, None]
    assert np.allclose(counts, expected, atol=1e-6 * np.abs(counts).max())
    assert not np.allclose(truth.offsets[0], truth.offsets[1])
    assert np.allclose(truth.offset, truth.offsets[-1])


@pytest.mark.parametrize("exact", [True, False])
def test_a_seed_means_the_same_sensor_whatever_it_reads(rig, recordings, exact):
    config = rig.sensor_config("leg", exact=exact)
    (first, _), (of_two, truth) = (rig.read_sensor(config, "leg", recordings[:n], 4) for n in (1, 2))
    assert np.array_equal(first[0], of_two[0])
    other = rig.read_sensor(config, "leg", recordings[:2], 5)[1]
    assert (np.abs(other.response - truth.response) > 0.0).all()


def test_sensors_read_the_same_with_the_library_and_without(rig, recordings, monkeypatch):
    config = rig.sensor_config("foot")
    counts, truth = rig.read_sensor(config, "foot", recordings[:2], 3)
    monkeypatch.setattr(rig, "native_here", lambda kind, config: None)
    in_python, same = rig.read_sensor(config, "foot", recordings[:2], 3)
    # What lies just between two codes may be rounded to either.
    assert (counts != in_python).sum() <= 2
    np.testing.assert_allclose(same.offsets, truth.offsets, rtol=1e-9)


def test_the_accelerometers_bias_is_found_from_its_readings(rig, recordings):
    rest = record_rig((1,), duration=100.0, rate=20.0, at_rest=True)
    for of_seed in (rig.read_imu(rest, seed) for seed in (0, 1)):
        bias = np.mean(of_seed[0, :, :3] - rest[0].specific_force, axis=0)
        assert np.linalg.norm(bias) > 0.01
        assert rig.accelerometer_bias(of_seed[..., :3]) == pytest.approx(bias, abs=0.01)
    assert rig.XSENS_MTX.accelerometer_bias_std > 0.0


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


def test_wrench_errors_are_shares_of_the_load(paper):
    wrench = np.random.default_rng(8).standard_normal((50, 6))
    response = np.diag([2.0] * 6)
    right = np.linalg.inv(response)
    assert paper.wrench_error(right, response, wrench) == pytest.approx((0.0, 0.0))
    off = np.diag([1.1] * 3 + [0.8] * 3) @ right
    assert paper.wrench_error(off, response, wrench) == pytest.approx((0.1, 0.2))


def test_consistency_is_that_of_chi_square(paper):
    nees = np.random.default_rng(9).chisquare(46, 400)
    mean, low, high = paper.consistency(pd.DataFrame({"nees": nees, "unknowns": 46}))
    assert low < mean < high
    assert low < 1.0 < high
    mean, _, high = paper.consistency(pd.DataFrame({"nees": 1.2 * nees, "unknowns": 46}))
    assert mean > high


@pytest.mark.slow
def test_ten_seeds_reach_the_targets(paper):
    found = {"exact": [paper.exact("foot", 5.0)], "sets": [paper.sweep(seed, 20.0) for seed in range(10)]}
    found |= {"fits": found["sets"], "bound": [paper.bound(seed, 4.0) for seed in range(10)]}
    found = {name: pd.DataFrame([row for one in of for row in one[name]]) for name, of in found.items()}
    *targets, _ = paper.targets(found)
    assert all(one.share == 1.0 for one in targets), targets
    for _, part in found["bound"].groupby("sensor"):
        # The covariance may be too large (NEES is 0.72 for these seeds), but not too small.
        assert paper.consistency(part)[0] < 1.3
    leg = found["fits"][(found["fits"]["method"] == "paper") & (found["fits"]["sensor"] == "leg")]
    assert leg["limb_error"].mean() < -0.03


def test_sets_that_were_not_fitted_get_offsets_of_their_own(paper, rig, recordings):
    config = rig.sensor_config("leg")
    counts, truth = rig.read_sensor(config, "leg", recordings, 0)
    force = np.stack([one.specific_force for one in recordings])
    sets = rig.static_sets("leg", recordings, counts, force)
    found = paper.calibrate(sets, config.nominal_matrix, InSituOptions())["measurement"]
    assert isinstance(found, paper.Calibrated)
    off = (found.offsets - truth.offsets) @ np.linalg.inv(truth.response).T
    assert off.shape == (8, 6)
    # Of offsets of hundreds of newtons; gravity tells least of them along the leg.
    assert np.abs(off[paper.FITTED :, :2]).max() < 0.3
    assert np.abs(off[paper.FITTED :, 2]).max() < 3.0


def test_noise_of_an_accelerometer_bends_no_limb(rig):
    run = record_rig((1, 2), duration=60.0, rate=10.0, speed_deg=12.0, seed=24)
    counts, _ = rig.read_sensor(rig.sensor_config("foot", exact=True), "foot", run, 24)
    felt = np.array([np.hstack([one.specific_force, one.angular_velocity]) for one in run])
    felt[..., :3] += 0.1 * np.random.default_rng(93).standard_normal(felt[..., :3].shape)
    sets = rig.moving_sets("foot", run, counts, felt, np.zeros(3))
    parts = compress(level(sets, fit_sphere(sets)), InSituOptions(), moving=True, temperature=False)
    assert max(map(measure_bending, parts)) < limits.BENDING
