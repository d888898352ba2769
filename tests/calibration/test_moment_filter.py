"""The surefoot estimator over streams: what it finds, what it refuses, and how sure it is of it."""

from dataclasses import replace

import numpy as np
import pytest
from _matched import ANKLES, matched, on_ankles, on_cells
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, believed_mass, errors, walk
from scipy.stats import chi2

from surefoot.calibration import (
    FeetLayout,
    Flag,
    FootLayout,
    OnlineSetup,
    Parameters,
    Reference,
    online_method,
    replay,
)
from surefoot.calibration import _moment_stream as stream_module
from surefoot.calibration.moment_filter import MomentFilterConfig, moment_filter
from surefoot.calibration.state import load_state, save_state

BAD = Faults.bad()


def rows_of(reference, k):
    return Reference(*(part[k] for part in reference))


def run(method, raw, reference, state=None, convert=np.asarray, dt=DT):
    """Stream samples, and hand back the state, the last estimate, and (nis, rows) of each block."""
    state = method.init(convert(raw[0])) if state is None else state
    blocks = []
    for k in range(len(raw)):
        row = Reference(*(convert(part[k]) for part in reference))
        state, estimate = method.update(state, convert(raw[k]), row, dt)
        if estimate.nis is not None and np.isfinite(np.asarray(estimate.nis)).all():
            blocks.append((np.asarray(estimate.nis), np.asarray(estimate.nis_rows)))
    return state, estimate, blocks


def fleet(seeds, speeds=(0.02, 0.04, 0.1), faults=BAD, **options):
    """Walks of several robots side by side."""
    logs = [walk(seed, speed, faults=faults, **options) for speed in speeds for seed in seeds]
    reference = Reference(
        *(np.stack(parts, axis=1) for parts in zip(*(log.reference for log in logs), strict=True))
    )
    return logs, np.stack([log.raw for log in logs], axis=1), reference


def calibrated(raw, reference, faults=BAD, name="surefoot", **options):
    return replay(LAYOUT, name, raw, reference, DT, mass=believed_mass(faults), initial=NOMINAL, **options)


def robot(estimate, i):
    """One robot's share of a batch."""
    return type(estimate)(*(None if part is None else part[:, i] for part in estimate))


@pytest.fixture(scope="module")
def bad_fleet():
    return fleet(range(4))


@pytest.fixture(scope="module")
def ankle_fleet():
    return matched(on_ankles(3, 0.1, 6.0), ANKLES, MomentFilterConfig(cross_talk=0.01), 3, 1)


def test_with_perfect_sensors_only_the_noise_of_the_reference_is_left():
    faults = Faults(acceleration=0.1, rate=0.05, lag=2)
    logs, raw, reference = fleet(range(3), faults=faults)
    estimate = calibrated(raw, reference, faults)
    for i, log in enumerate(logs):
        # One sample of this reference is off by 2.8 mm and 0.5 N.
        cop, vgrf = errors(robot(estimate, i), log, 4.0)
        assert cop < 1.4
        assert vgrf < 0.3
    assert not estimate.flags.any()


def test_a_bad_map_is_found_and_the_error_goes_down(bad_fleet):
    logs, raw, reference = bad_fleet
    estimate, start = calibrated(raw, reference), calibrated(raw, reference, name="none")
    early = [errors(robot(estimate, i), log, 4.0)[0] for i, log in enumerate(logs)]
    late = [errors(robot(estimate, i), log, 14.0) for i, log in enumerate(logs)]
    for i, log in enumerate(logs):
        cop, vgrf = errors(robot(start, i), log, 14.0)
        assert late[i][0] < min(2.5, 0.5 * cop)
        assert late[i][1] < min(0.8, vgrf)
    assert np.mean([cop for cop, _ in late]) < np.mean(early)
    assert not estimate.flags.any()


def test_a_constant_bad_map_is_found_ever_better():
    faults = replace(BAD, gain_drift=0.0, offset_drift=0.0, com=0.0, mass=0.0)
    logs, raw, reference = fleet(range(4), speeds=(0.1,), faults=faults, duration=30.0)
    estimate = calibrated(raw, reference, faults, scale_drift=0.0, offset_drift=0.0)
    wrong = []
    for i, log in enumerate(logs):
        off = estimate.scale[:, i] / NOMINAL.scale - log.correction.scale
        wrong.append(np.sqrt((off**2).mean(axis=1)))
    at = np.mean(wrong, axis=0)[[0, round(8 / DT), round(16 / DT), -1]]
    assert (np.diff(at) < 0.0).all()
    assert at[-1] < 0.25 * at[0]


def test_the_swing_tare_finds_every_offset_and_the_warp():
    faults = Faults(offset=1.5, lag=2)
    log = walk(2, 0.1, 8.0, 1.0, faults)
    estimate = calibrated(log.raw, log.reference, faults)
    start = log.correction.offset[-1]
    off = estimate.offset[-1] - NOMINAL.offset - start
    warp = np.array([1.0, -1.0, -1.0, 1.0])
    assert np.abs(start.reshape(2, 4) @ warp).min() > 0.5, "there must be a warp to find"
    assert np.abs(off.reshape(2, 4) @ warp).max() < 0.15
    assert np.abs(off).max() < 0.1
    never = log.reference._replace(swing=np.zeros_like(log.reference.swing))
    blind = calibrated(log.raw, never, faults).offset[-1] - NOMINAL.offset - start
    assert np.abs(blind.reshape(2, 4) @ warp).max() > 0.5, "what only a swing shows, nothing else may find"


@pytest.mark.parametrize("feet", [(True, True), (True, False), (False, True)])
def test_a_loaded_foot_that_claims_to_swing_is_refused(feet):
    faults = replace(BAD, gain_drift=0.0, offset_drift=0.0)
    log = walk(0, duration=0.0, stand=10.0, faults=faults)
    claims = log.reference._replace(swing=np.broadcast_to(feet, log.reference.swing.shape).copy())
    honest, lied_to = (calibrated(log.raw, reference, faults) for reference in (log.reference, claims))
    np.testing.assert_allclose(lied_to.scale, honest.scale, rtol=1e-12)
    np.testing.assert_allclose(lied_to.offset, honest.offset, rtol=1e-12)
    assert not (honest.flags & Flag.REJECTED).any()
    assert (lied_to.flags[80:] & Flag.REJECTED).all()


@pytest.mark.parametrize(
    ("stance", "swing"),
    [
        (False, False),
        (True, False),
        pytest.param(
            True,
            True,
            marks=pytest.mark.xfail(
                strict=True,
                reason="a foot that just touches down carries little enough to pass for one that swings",
            ),
        ),
    ],
)
def test_a_walking_robot_with_wrong_contacts_is_not_poisoned(stance, swing):
    logs, raw, reference = fleet(range(4), speeds=(0.04,))
    lied = reference._replace(
        stance=np.full_like(reference.stance, stance), swing=np.full_like(reference.swing, swing)
    )
    estimate, start = calibrated(raw, lied), calibrated(raw, lied, name="none")
    for i, log in enumerate(logs):
        # Without any swing the offsets of single cells stay unknown, and with them the best of it.
        assert errors(robot(estimate, i), log, 10.0)[0] < 1.1 * errors(robot(start, i), log, 10.0)[0]


def test_lifted_off_the_ground_for_a_while_nothing_is_learnt_and_nothing_lost():
    log, at, samples = walk(1, 0.04, 12.0, 2.0, BAD), 640, 800
    nothing = -(log.correction.offset / log.correction.scale)[at]
    hanging = np.repeat(((nothing - NOMINAL.offset) / NOMINAL.scale)[None], samples, axis=0)
    still = [np.repeat(part[:1], samples, axis=0) for part in log.reference]
    raw = np.concatenate([log.raw[:at], hanging, log.raw[at:]])
    reference = Reference(
        *(
            np.concatenate([part[:at], rest, part[at:]])
            for part, rest in zip(log.reference, still, strict=True)
        )
    )
    assert reference.stance[at : at + samples].all(), "the robot must think that it stands"
    estimate, walked = calibrated(raw, reference), calibrated(log.raw, log.reference)
    settled, landed = at + 60, at + samples - 1
    np.testing.assert_array_equal(estimate.scale[settled], estimate.scale[landed])
    np.testing.assert_array_equal(estimate.offset[settled], estimate.offset[landed])
    assert (estimate.flags[settled:landed] & Flag.REJECTED).all()
    assert not (estimate.flags[landed + 60 :] & Flag.REJECTED).any()
    # The error bar goes on growing with the drift.
    assert (estimate.force_std[landed] > estimate.force_std[settled]).all()
    wrong = [np.abs(e.force[-200:] - log.force[-200:]).mean() for e in (estimate, walked)]
    assert wrong[0] < 1.2 * wrong[1]


@pytest.fixture(scope="module")
def standing():
    logs, raw, reference = fleet(range(4), speeds=(0.0,), duration=0.0, stand=60.0)
    return logs, raw, calibrated(raw, reference)


def test_standing_still_the_total_is_the_weight(standing):
    logs, _, estimate = standing
    for i, log in enumerate(logs):
        # The believed mass is half a percent off, the believed centre of mass 3 mm along each axis.
        assert errors(robot(estimate, i), log, 10.0)[1] < 0.5
        assert errors(robot(estimate, i), log, 10.0)[0] < 10.0


@pytest.mark.xfail(
    strict=True,
    reason="noise of the readings is taken for excitation: gains shrink, and seem known, while nothing moves",
)
def test_standing_still_gains_stay_put(standing):
    _, _, estimate = standing
    moved = estimate.scale[-1] / NOMINAL.scale - 1.0
    assert np.abs(moved).max() < MomentFilterConfig().scale_std
    assert np.sqrt(np.diagonal(estimate.covariance[-1, 0])[:8]).min() > 0.8 * MomentFilterConfig().scale_std


def on_other_cells(counts, seed=4):
    """The walk of both feet on other numbers of cells, with gains and offsets that are wrong."""
    rng = np.random.default_rng([29, seed])
    log = walk(seed, 0.1, 12.0, 1.0, Faults(acceleration=0.1, rate=0.05))
    wrench = np.einsum("fwk,nk->nfw", LAYOUT.wrench_map, log.force)
    places = {3: [(0.11, 0.0), (-0.06, 0.06), (-0.06, -0.06)], 5: [(0.1, 0.05), (0.11, -0.05), (0.02, 0.0)]}
    places[5] += [(-0.06, 0.05), (-0.05, -0.05)]
    feet = FeetLayout(
        tuple(FootLayout.load_cells(f"foot-{i}", places[count]) for i, count in enumerate(counts))
    )
    force = np.concatenate(
        [wrench[:, i] @ np.linalg.pinv(foot.wrench_map).T for i, foot in enumerate(feet.feet)], axis=1
    )
    gain, offset = 1.0 + 0.1 * rng.normal(size=feet.channels), rng.normal(size=feet.channels)
    return feet, log, force, gain * force + offset + 0.03 * rng.normal(size=force.shape)


@pytest.mark.parametrize("counts", [(3, 3), (5, 5), (3, 5)])
def test_three_cells_are_enough_and_five_not_too_many(counts):
    feet, log, force, raw = on_other_cells(counts)
    estimate, start = (
        replay(feet, name, raw, log.reference, DT, mass=MASS, lag=0) for name in ("surefoot", "none")
    )
    assert errors(estimate, log, 8.0)[0] < 2.5
    assert errors(start, log, 8.0)[0] > 4.0
    wrong = [np.sqrt(((e.force[-400:] - force[-400:]) ** 2).mean()) for e in (estimate, start)]
    assert wrong[0] < 0.5 * wrong[1]


def test_a_plate_alone_is_calibrated_by_who_moves_on_it():
    rng = np.random.default_rng(31)
    log = walk(5, 0.0, 15.0, 1.0, Faults(acceleration=0.1, rate=0.05))
    corners = np.array([(0.2, 0.15), (0.2, -0.15), (-0.2, 0.15), (-0.2, -0.15)])
    plate = FeetLayout((FootLayout.load_cells("plate", corners),))
    moment = np.column_stack([log.vgrf, log.vgrf * log.cop[:, 1], -log.vgrf * log.cop[:, 0]])
    force = moment @ np.linalg.pinv(plate.feet[0].wrench_map[2:5]).T
    raw = force * (1.0 + 0.1 * rng.normal(size=4)) + rng.normal(size=4)
    n = len(raw)
    reference = log.reference._replace(
        position_sole=np.zeros((n, 1, 3)),
        R_level_sole=np.broadcast_to(np.eye(3), (n, 1, 3, 3)).copy(),
        stance=np.ones((n, 1), bool),
        swing=np.zeros((n, 1), bool),
    )
    estimate, start = (
        replay(plate, name, raw, reference, DT, mass=MASS, lag=0) for name in ("surefoot", "none")
    )
    assert errors(estimate, log, 8.0)[0] < 2.5
    assert errors(start, log, 8.0)[0] > 4.0


@pytest.mark.parametrize("cross_talk", [0.0, 0.01])
def test_ankle_sensors_are_calibrated_from_walking(cross_talk):
    truth = on_ankles(3, 0.1, 20.0)
    drawn = matched(truth, ANKLES, MomentFilterConfig(cross_talk=cross_talk), 20, 1)
    unknowns = drawn.unknowns
    state, estimate, _ = run(moment_filter(drawn.setup, drawn.config), drawn.raw, drawn.reference)
    rms = lambda values: np.sqrt((values**2).mean(axis=0))  # noqa: E731
    gain = state.mean[:, unknowns.scale]
    after, before = rms(gain - drawn.gain[-1]), rms(unknowns.start[unknowns.scale] - drawn.gain[-1])
    # Shear, and the twist above all, are small; what they excite little is found late.
    assert after[unknowns.own].mean() < 0.8 * before[unknowns.own].mean()
    assert after.mean() < before.mean()
    offset = state.mean[:, unknowns.offset] * unknowns.unit
    assert (rms(offset - drawn.offset[-1]) < 0.3 * rms(drawn.offset[-1])).all()
    wrong = [rms(force - truth.force[-1]) for force in (estimate.force, drawn.raw[-1])]
    assert (wrong[0] < 0.5 * wrong[1]).all()
    if cross_talk:
        full = np.einsum("rij,rj->ri", estimate.matrix, drawn.raw[-1]) + offset
        np.testing.assert_allclose(full, estimate.force, atol=1e-9)
    else:
        assert estimate.matrix is None


def test_single_precision_is_close_after_many_steps():
    log = walk(1, 0.1, 20.0, 2.0, BAD)
    force = NOMINAL.force(log.raw)
    identity = Parameters(np.ones(8), np.zeros(8))
    single = Reference(
        *(part.astype(np.float32) if part.dtype.kind == "f" else part for part in log.reference)
    )
    double, narrow = (
        replay(LAYOUT, "surefoot", raw, reference, DT, mass=MASS, initial=identity)
        for raw, reference in ((force, log.reference), (force.astype(np.float32), single))
    )
    assert narrow.force.dtype == narrow.covariance.dtype == narrow.cop_covariance.dtype == np.float32
    spread = np.sqrt(np.diagonal(double.covariance, axis1=-2, axis2=-1))
    assert (np.abs(narrow.scale - double.scale) < 0.05 * spread[:, :8]).all()
    assert (np.abs(narrow.offset - double.offset) < 0.05 * spread[:, 8:]).all()
    np.testing.assert_allclose(narrow.force, double.force, atol=0.02)
    np.testing.assert_allclose(narrow.force_std, double.force_std, rtol=0.02)


def test_ankle_sensors_in_a_batch_are_themselves_one_by_one(ankle_fleet):
    method = moment_filter(ankle_fleet.setup, ankle_fleet.config)
    _, together, blocks = run(method, ankle_fleet.raw, ankle_fleet.reference)
    for i in range(3):
        row = Reference(*(part[:, i] for part in ankle_fleet.reference))
        _, alone, single = run(method, ankle_fleet.raw[:, i], row)
        for field, a, b in zip(together._fields, together, alone, strict=True):
            if a is not None:
                np.testing.assert_allclose(a[i], b, rtol=1e-9, atol=1e-9, err_msg=field)
        np.testing.assert_allclose([nis[i] for nis, _ in blocks], [nis for nis, _ in single], rtol=1e-6)


def test_torch_gives_the_same_numbers_for_ankle_sensors(ankle_fleet):
    torch = pytest.importorskip("torch")
    method = moment_filter(ankle_fleet.setup, ankle_fleet.config)
    _, expected, _ = run(method, ankle_fleet.raw, ankle_fleet.reference)
    _, found, _ = run(
        method, ankle_fleet.raw, ankle_fleet.reference, convert=lambda v: torch.as_tensor(np.array(v))
    )
    for field, a, b in zip(expected._fields, expected, found, strict=True):
        if a is not None:
            assert isinstance(b, torch.Tensor), field
            np.testing.assert_allclose(a, b.numpy(), rtol=1e-9, atol=1e-9, err_msg=field)


def test_saved_in_mid_block_it_goes_on_bit_for_bit(ankle_fleet, tmp_path):
    method = moment_filter(ankle_fleet.setup, ankle_fleet.config)
    raw, reference = ankle_fleet.raw, ankle_fleet.reference
    cut = 203
    head = Reference(*(part[:cut] for part in reference))
    tail = Reference(*(part[cut:] for part in reference))
    state, _, _ = run(method, raw[:cut], head)
    save_state(tmp_path / "state.npz", state)
    restored = load_state(tmp_path / "state.npz", method.init(raw[0]))
    (_, one, _), (_, two, _) = (run(method, raw[cut:], tail, state=start) for start in (state, restored))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_is_claimed_of_forces_and_of_the_centre_of_pressure_follows_from_the_parameters():
    log = walk(3, 0.1, 6.0, 1.0, BAD)
    estimate = calibrated(log.raw, log.reference)
    rng, k = np.random.default_rng(3), 400
    S, F0 = estimate.covariance[k], NOMINAL.force(log.raw[k])
    row = np.concatenate([np.diag(F0), np.eye(8)], axis=1)
    np.testing.assert_allclose(estimate.force_std[k] ** 2, np.diag(row @ S @ row.T), rtol=1e-9)
    place = np.concatenate(
        [
            log.reference.position_sole[k, i, :2] + foot.position_cell_sole[:, :2]
            for i, foot in enumerate(LAYOUT.feet)
        ]
    )

    def cop(change):
        force = estimate.force[k] + row @ change
        return place.T @ force / force.sum()

    np.testing.assert_allclose(cop(np.zeros(16)), estimate.cop[k], atol=1e-12)
    step = 1e-6
    J = np.stack([(cop(step * e) - cop(-step * e)) / (2 * step) for e in np.eye(16)], axis=1)
    np.testing.assert_allclose(estimate.cop_covariance[k], J @ S @ J.T, rtol=1e-6, atol=1e-12)
    assert np.isfinite(rng.multivariate_normal(np.zeros(16), S)).all()


def test_innovations_are_told_when_a_block_ends_and_only_then():
    log = walk(0, 0.1, 2.0, 1.0, BAD)
    method = online_method("surefoot", OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL))
    state = method.init(log.raw[0])
    for k in range(len(log.raw)):
        state, estimate = method.update(state, log.raw[k], rows_of(log.reference, k), DT)
        if (k + 1) % 16:
            assert estimate.nis is None or np.isnan(estimate.nis)
            assert estimate.nis_rows is None or estimate.nis_rows == 0
        elif k > 48:
            assert estimate.nis > 0.0
            assert estimate.nis_rows in (24, 28)


def consistency(truth, layout, runs=200, **options):
    """NEES of (a, b) of many runs, their number, and (nis, rows) of each block."""
    config = MomentFilterConfig(timing_noise=0.0, swing_noise=2e-4, **options)
    drawn = matched(truth, layout, config, runs, 5)
    state, _, blocks = run(moment_filter(drawn.setup, config), drawn.raw, drawn.reference)
    unknowns = drawn.unknowns
    known = unknowns.gains + unknowns.channels
    # What the last block told is of its middle samples, and what wanders after them is not in it.
    last = len(drawn.raw) // config.every * config.every - config.settle - 1
    true = np.concatenate([drawn.gain[last], drawn.offset[last] / unknowns.unit], axis=-1)
    error = state.mean[:, :known] - true
    solved = np.linalg.solve(state.covariance[:, :known, :known], error[..., None])[..., 0]
    return (error * solved).sum(axis=-1), known, blocks


EAGER = pytest.mark.xfail(
    strict=True, reason="with ankle sensors the squared errors are a tenth larger than claimed"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("walker", "layout"),
    [
        pytest.param(on_cells, LAYOUT, id="cells"),
        pytest.param(on_ankles, ANKLES, id="ankles", marks=EAGER),
    ],
)
def test_errors_are_as_large_as_claimed(walker, layout, monkeypatch):
    # Noise that is known needs neither a gate nor a factor that follows it.
    monkeypatch.setattr(stream_module, "_NOISE_MEMORY", 0.0)
    nees, known, blocks = consistency(walker(1, 0.1, 12.0), layout, gate=1e6)
    low, high = chi2.ppf([0.025, 0.975], len(nees) * known) / len(nees)
    nis, rows = (np.array(part) for part in zip(*blocks, strict=True))
    low_nis, high_nis = chi2.ppf([0.025, 0.975], rows[-1].sum())
    assert low_nis < nis[-1].sum() < high_nis
    assert 0.98 < nis.sum() / rows.sum() < 1.02
    assert low < nees.mean() < high


@pytest.mark.slow
@pytest.mark.parametrize(("walker", "layout"), [(on_cells, LAYOUT), (on_ankles, ANKLES)])
def test_without_errors_of_the_reference_errors_are_as_large_as_claimed(walker, layout, monkeypatch):
    monkeypatch.setattr(stream_module, "_NOISE_MEMORY", 0.0)
    right = {"com_std": 0.0, "mass_std": 0.0, "acceleration_std": 0.0, "delay_std": 0.0}
    nees, known, blocks = consistency(walker(1, 0.1, 12.0), layout, gate=1e6, **right)
    low, high = chi2.ppf([0.005, 0.995], len(nees) * known) / len(nees)
    nis, rows = (np.array(part) for part in zip(*blocks, strict=True))
    assert 0.97 < nis.sum() / rows.sum() < 1.03
    assert low < nees.mean() < high * 1.05


def garbage(rng, values, share, dtype):
    largest = float(np.finfo(dtype).max)
    poison = np.array([np.nan, np.inf, -np.inf, largest, -largest, 0.0, 1e-30, 8.4e6, -5.0, 1e3], dtype=dtype)
    hit = rng.random(values.shape) < share
    values[hit] = rng.choice(poison, hit.sum())


def fuzz(robots, samples, dtype, sweep):
    """Feed garbage to many robots, then a clean walk; nothing may be lost, and all must converge."""
    rng = np.random.default_rng(41)
    logs, raw, reference = fleet(range(4), speeds=(0.1,), duration=samples * DT + 12.0, stand=0.5)
    identity = Parameters(np.ones(8), np.zeros(8))
    setup = OnlineSetup(layout=LAYOUT, mass=believed_mass(BAD), initial=identity)
    method = moment_filter(setup)
    raw = NOMINAL.force(raw)

    def tiled(part, k):
        return np.tile(part[k], (robots // 4, *[1] * (part.ndim - 2))).astype(
            dtype if part.dtype.kind == "f" else part.dtype
        )

    state = method.init(tiled(raw, 0))
    for k in range(samples):
        reading, row = tiled(raw, k), Reference(*(tiled(part, k) for part in reference))
        garbage(rng, reading, 0.02, dtype)
        for field, part in zip(Reference._fields, row, strict=True):
            if part.dtype.kind == "f":
                garbage(rng, part, 0.002, dtype)
            else:
                lie = rng.random(part.shape) < 0.1
                part[lie] = ~part[lie]
            if rng.random() < 0.02:
                getattr(row, field)[: robots // 8] = rng.choice([0, 1]) if part.dtype == bool else np.nan
        dt = float(rng.choice([DT] * 60 + [0.0, -1.0, np.nan, np.inf, 1e9, 1e-12]))
        state, estimate = method.update(state, reading, row, dt)
        for field in ("force", "wrench", "vgrf", "scale", "offset", "covariance", "force_std"):
            assert np.isfinite(getattr(estimate, field)).all(), field
        valid = estimate.cop_valid
        np.testing.assert_array_equal(np.isfinite(estimate.cop).all(axis=-1), valid)
        assert np.isfinite(estimate.cop_covariance[valid]).all()
        if k % sweep == 0:
            S = state.covariance.astype(np.float64)
            np.testing.assert_array_equal(S, np.swapaxes(S, -1, -2))
            std = np.sqrt(np.einsum("...ii->...i", S))
            std[std == 0.0] = 1.0
            scaled = S / (std[..., :, None] * std[..., None, :])
            assert np.linalg.eigvalsh(scaled).min() > -1e-5
    wrong = []
    for k in range(samples, samples + round(12.0 / DT)):
        row = Reference(*(tiled(part, k) for part in reference))
        state, estimate = method.update(state, tiled(raw, k), row, DT)
        if k >= samples + round(10.0 / DT):
            true = np.tile([log.cop[k] for log in logs], (robots // 4, 1))
            wrong.append(np.linalg.norm(estimate.cop - true, axis=-1))
    altered = Flag.LOST | Flag.FLIPPED | Flag.SWAPPED
    lost = ((estimate.flags & altered) != 0).any(axis=-1)
    return 1e3 * np.sqrt((np.array(wrong) ** 2).mean(axis=0)), lost


@pytest.fixture(scope="module")
def fuzzed():
    return fuzz(40, 160, np.float64, sweep=16)


def test_fuzzed_samples_lose_nothing(fuzzed):
    wrong, lost = fuzzed
    assert wrong[~lost].max() < 6.0
    assert lost.mean() < 0.25


@pytest.mark.xfail(
    strict=True,
    reason="one missing sample after a gap loses a channel, which stays lost; a false FLIPPED stays as well",
)
def test_channels_come_back_when_the_garbage_stops(fuzzed):
    assert not fuzzed[1].any()


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_hundred_thousand_fuzzed_samples_lose_nothing(dtype):
    wrong, lost = fuzz(500, 200, dtype, sweep=20)
    assert wrong[~lost].max() < 6.0
    assert lost.mean() < 0.25


@pytest.mark.slow
def test_a_million_fuzzed_samples_lose_nothing():
    wrong, lost = fuzz(4000, 250, np.float64, sweep=125)
    assert np.isfinite(wrong).all()
    assert np.mean(wrong[~lost] < 4.0) > 0.95


@pytest.mark.parametrize("field", ["com", "com_acceleration", "angular_momentum_rate", "position_sole"])
def test_units_a_thousand_times_off_are_refused_and_flagged(field):
    log = walk(1, 0.04, 4.0, 1.0, BAD)
    wrong = log.reference._replace(**{field: 1e3 * getattr(log.reference, field)})
    estimate = calibrated(log.raw, wrong)
    assert np.isfinite(estimate.force).all()
    moved = np.abs(estimate.scale[-1] / NOMINAL.scale - 1.0)
    assert moved.max() < 0.5


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"every": 0}, ValueError, "'every' must be a whole number from 1 on, got 0."),
        ({"every": 16.5}, ValueError, "'every' must be a whole number from 1 on, got 16.5."),
        ({"average": 3}, ValueError, "'average' must divide 'every', got 3 and 16."),
        ({"settle": -1}, ValueError, "'settle' must be a whole number from 1 on, got -1."),
        ({"gate": 0.0}, ValueError, "'gate' must be positive and finite, got 0.0."),
        ({"scale_std": -0.1}, ValueError, "'scale_std' must be positive and finite, got -0.1."),
        ({"offset_std": np.inf}, ValueError, "'offset_std' must be positive and finite, got inf."),
        ({"force_noise": np.nan}, ValueError, "'force_noise' must be positive and finite, got nan."),
        ({"cop_noise": "1"}, TypeError, "'cop_noise' must be a number, got '1' of type str."),
        ({"swing_noise": 0}, ValueError, "'swing_noise' must be positive and finite, got 0."),
        ({"reject": -2.0}, ValueError, "'reject' must be positive and finite, got -2.0."),
        *(
            ({name: -1.0}, ValueError, f"'{name}' must not be negative and must be finite, got -1.0.")
            for name in (
                "cross_talk", "scale_drift", "offset_drift", "timing_noise", "com_std", "mass_std",
                "acceleration_std", "delay_std", "swing_load",
            )
        ),
        (
            {"windw": 1},
            ValueError,
            "Method 'surefoot' has no option 'windw'. Available: ['every', 'average', 'scale_std',",
        ),
    ],
)  # fmt: skip
def test_options_without_meaning_are_refused(options, error, message):
    setup = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL)
    with pytest.raises(error) as raised:
        online_method("surefoot", setup, **options)
    assert str(raised.value).startswith(message)
