"""The standing start: what it determines, what it leaves alone, and when it refuses."""

import re

import numpy as np
import pytest
from _refusals import refusals

from surefoot.calibration.layout import FeetLayout, FootLayout, nao_shoe_layout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, Reference
from surefoot.calibration.results import CalibrationRefused, FitResult
from surefoot.calibration.standing import QuietStanding, standing_start

LAYOUT = nao_shoe_layout()
K = LAYOUT.channels
MASS = 5.305
WEIGHT = MASS * GRAVITY
DT = 1 / 80
SOLES = np.array([[0.0, 0.05, 0.0], [0.01, -0.05, 0.0]])
CELLS = np.concatenate(
    [foot.position_cell_sole + sole for foot, sole in zip(LAYOUT.feet, SOLES, strict=True)]
)
NOMINAL = Parameters(scale=np.tile([3.4e-5, -3.4e-5], 4), offset=np.tile([-285.2, 285.2], 4))
PERFECT = Parameters(scale=np.ones(K), offset=np.zeros(K))


def beliefs(com, n):
    """A reference of a robot at rest for n samples."""

    def repeat(values):
        return np.broadcast_to(values, (n, *np.shape(values))).copy()

    still = repeat(np.zeros(3))
    return Reference(
        com=np.broadcast_to(com, (n, 3)).copy(),
        com_acceleration=still,
        angular_momentum_rate=still,
        position_sole=repeat(SOLES),
        R_level_sole=repeat(np.stack([np.eye(3)] * 2)),
        stance=repeat(np.ones(2, dtype=bool)),
        swing=repeat(np.zeros(2, dtype=bool)),
        accelerometer=repeat(np.array([0.0, 0.0, GRAVITY])),
        gyroscope=still,
    )


def standing_forces(rng, n=1):
    """Forces that add up to the weight, and the centre of mass above their balance point, (n, 8), (n, 3)."""
    force = rng.uniform(0.2, 1.0, (n, K))
    force *= WEIGHT / force.sum(axis=1, keepdims=True)
    com = force @ CELLS / WEIGHT
    com[:, 2] = 0.3
    return force, com


def quiet(rng, n=320, noise=0.0):
    """One stance for n samples, with a bad map: counts, reference, and the true map."""
    force, com = standing_forces(rng)
    true = Parameters(1.0 + 0.1 * rng.standard_normal(K), 1.5 * rng.standard_normal(K)).after(NOMINAL)
    raw = (force + noise * rng.standard_normal((n, K)) - true.offset) / true.scale
    return raw, beliefs(com[0], n), true


def robot(start=NOMINAL, **changes):
    return QuietStanding(layout=LAYOUT, mass=MASS, start=start, **changes)


def total_and_cop(force):
    return force.sum(axis=-1), force @ CELLS[:, :2] / force.sum(axis=-1)[..., None]


def refusal(standing, raw, reference, **options):
    with pytest.raises(CalibrationRefused) as caught:
        standing_start(standing, raw, reference, DT, **options)
    return caught.value


def test_quiet_standing_is_the_solution_of_least_change():
    # Against the pseudo-inverse of Eq. 12, written down without the code under test.
    raw, reference, _ = quiet(np.random.default_rng(51))
    fit = standing_start(
        robot(mass_error=0.0, com_error=0.0, cop_noise=1e-5, force_noise=2e-3), raw, reference, DT
    )
    start_force = NOMINAL.force(raw[0])
    places = np.vstack([np.ones(K), CELLS[:, 0], CELLS[:, 1]])
    matrix = np.hstack([places * start_force * 0.1, places * 1.5])
    wanted = WEIGHT * np.array([1.0, *reference.com[0, :2]]) - places @ start_force
    least = np.linalg.pinv(matrix) @ wanted
    np.testing.assert_allclose(fit.correction.scale - 1.0, 0.1 * least[:K], atol=1e-6)
    np.testing.assert_allclose(fit.correction.offset, 1.5 * least[K:], atol=1e-5)
    vgrf, cop = total_and_cop(fit.value.force(raw[0]))
    np.testing.assert_allclose(vgrf, WEIGHT, rtol=1e-5)
    np.testing.assert_allclose(cop, reference.com[0, :2], atol=1e-6)


def test_quiet_standing_determines_three_directions_whatever_the_noise():
    for noise in (0.0, 0.003, 0.05):
        raw, reference, _ = quiet(np.random.default_rng(52), noise=noise)
        fit = standing_start(robot(), raw, reference, DT)
        assert fit.stats.rank == 3
        assert fit.stats.unknowns == 16
        assert fit.result is FitResult.PARTLY_DETERMINED


def test_the_start_gets_better_and_single_cells_are_not_invented():
    before, after, cell_before, cell_after = [], [], [], []
    for seed in range(30):
        raw, reference, true = quiet(np.random.default_rng([53, seed]), noise=0.003)
        fit = standing_start(robot(), raw, reference, DT)
        for errors, cells, force in (
            (before, cell_before, NOMINAL.force(raw)),
            (after, cell_after, fit.value.force(raw)),
        ):
            vgrf, cop = total_and_cop(force)
            errors.append(
                [np.abs(vgrf - WEIGHT).mean(), np.linalg.norm(cop - reference.com[:, :2], axis=1).mean()]
            )
            cells.append(np.sqrt(np.mean((force - true.force(raw)) ** 2)))
    force_before, cop_before = np.mean(before, axis=0)
    force_after, cop_after = np.mean(after, axis=0)
    assert force_after < 0.1 * force_before
    assert cop_after < 0.2 * cop_before
    assert np.mean(cell_after) < np.mean(cell_before)


def test_errors_agree_with_the_covariance():
    # Maps, masses and centres of mass drawn as they are said to be: NEES has 16 degrees of freedom.
    rng = np.random.default_rng(54)
    standing = robot(PERFECT, force_noise=0.05, cop_noise=1e-3, minimum_samples=40, duration=0.5, warm_up=0.0)
    nees = []
    for _ in range(60):
        force, com = standing_forces(rng)
        a, b = 1.0 + 0.1 * rng.standard_normal(K), 1.5 * rng.standard_normal(K)
        true_force = force * (1.0 + 0.005 * rng.standard_normal())
        believed_com = com[0] + np.array([*(3e-3 * rng.standard_normal(2)), 0.0])
        reference = beliefs(believed_com, 40)
        reference.com[:, :2] += 1e-3 * rng.standard_normal((40, 2))
        fit = standing_start(standing, np.broadcast_to((true_force - b) / a, (40, K)), reference, DT)
        error = np.concatenate([fit.correction.scale - a, fit.correction.offset - b])
        nees.append(error @ np.linalg.solve(fit.covariance, error))
    # Standard error of the mean: sqrt(2 * 16 / 60) = 0.73.
    np.testing.assert_allclose(np.mean(nees), 16.0, atol=2.4)


def test_a_perfect_start_stays_as_it_is():
    rng = np.random.default_rng(55)
    force, com = standing_forces(rng)
    fit = standing_start(robot(PERFECT), np.broadcast_to(force, (320, K)), beliefs(com[0], 320), DT)
    np.testing.assert_allclose(fit.correction.scale, 1.0, atol=1e-12)
    np.testing.assert_allclose(fit.correction.offset, 0.0, atol=1e-12)
    assert fit.stats.residual_rms < 1e-6


def test_shifting_the_weight_about_determines_all_but_five_combinations_of_offsets():
    rng = np.random.default_rng(56)
    force, com = standing_forces(rng, 400)
    true = Parameters(1.0 + 0.1 * rng.standard_normal(K), 1.5 * rng.standard_normal(K)).after(NOMINAL)
    raw = (force - true.offset) / true.scale
    exact = robot(mass_error=0.0, com_error=0.0, force_noise=1e-3, cop_noise=2e-5, warm_up=0.0, duration=4.0)
    fit = standing_start(exact, raw[:320], beliefs(com[:320], 320), DT)
    assert fit.stats.rank == 11
    np.testing.assert_allclose(fit.value.scale, true.scale, rtol=1e-6)
    vgrf, cop = total_and_cop(fit.value.force(raw[320:]))
    np.testing.assert_allclose(vgrf, WEIGHT, rtol=1e-6)
    np.testing.assert_allclose(cop, com[320:, :2], atol=1e-7)


def test_three_cells_under_a_plate_can_be_determined():
    rng = np.random.default_rng(68)
    cell = np.array([(0.1, 0.0, 0.0), (-0.1, 0.08, 0.0), (-0.1, -0.08, 0.0)])
    plate = FeetLayout((FootLayout.load_cells("plate", cell),))
    force = rng.uniform(0.2, 1.0, (400, 3))
    force *= WEIGHT / force.sum(axis=1, keepdims=True)
    true = Parameters(np.array([1.1, 0.9, 1.05]), np.array([1.0, -2.0, 0.5]))
    flat = beliefs(force @ cell / WEIGHT, 400)
    reference = flat._replace(
        position_sole=np.zeros((400, 1, 3)), R_level_sole=np.tile(np.eye(3), (400, 1, 1, 1))
    )
    standing = QuietStanding(
        layout=plate,
        mass=MASS,
        start=Parameters(np.ones(3), np.zeros(3)),
        mass_error=0.0,
        com_error=0.0,
        force_noise=1e-3,
        cop_noise=2e-5,
        duration=4.0,
    )
    fit = standing_start(standing, (force - true.offset) / true.scale, reference, DT)
    assert fit.result is FitResult.DETERMINED
    np.testing.assert_allclose(fit.value.scale, true.scale, rtol=1e-5)
    np.testing.assert_allclose(fit.value.offset, true.offset, atol=1e-4)


def test_the_stream_is_the_recording():
    raw, reference, _ = quiet(np.random.default_rng(57), noise=0.003)
    raw[100, 3] = np.nan
    reference.gyroscope[120, 1] = 1.0
    standing = robot()
    state = standing.init(raw[0])
    steps = 0
    while not standing.ready(state):
        kept = [np.array(field) for field in state]
        sample = Reference(*(field[steps] for field in reference))
        new = standing.update(state, raw[steps], sample, DT)
        for before, field in zip(kept, state, strict=True):
            np.testing.assert_array_equal(before, field)
        state, steps = new, steps + 1
    found = standing.solve(state)
    fit = standing_start(standing, raw, reference, DT)
    assert fit.duration == pytest.approx(steps * DT)
    assert (int(state.samples), int(state.dropped), int(state.gated)) == (
        fit.stats.samples,
        fit.stats.dropped,
        fit.stats.gated,
    )
    assert (fit.stats.samples, fit.stats.dropped, fit.stats.gated) == (158, 1, 1)
    np.testing.assert_allclose(found.parameters.scale, fit.value.scale, rtol=1e-9)
    np.testing.assert_allclose(found.parameters.offset, fit.value.offset, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, fit.covariance, atol=1e-10)
    assert bool(found.ready)


def test_nothing_seen_is_the_start():
    standing = robot()
    found = standing.solve(standing.init(np.zeros(K)))
    np.testing.assert_array_equal(found.correction.scale, np.ones(K))
    np.testing.assert_allclose(found.parameters.offset, NOMINAL.offset)
    assert found.rank == 0
    np.testing.assert_allclose(np.diagonal(found.covariance), [0.01] * K + [2.25] * K)
    assert not found.ready


def test_goes_on_until_there_are_enough_samples():
    raw, reference, _ = quiet(np.random.default_rng(60), n=800)
    reference.gyroscope[80:320, 0] = 0.5
    fit = standing_start(robot(), raw, reference, DT)
    # Warming up takes 80 samples, 160 more were wanted and moved, as did 80 after them.
    assert fit.duration == pytest.approx(400 * DT)
    assert (fit.stats.samples, fit.stats.gated) == (80, 240)


def test_uses_no_more_of_the_recording_than_it_needs():
    raw, reference, _ = quiet(np.random.default_rng(61), n=800)
    late = raw.copy()
    late[240:] += 5e4
    fit, other = (standing_start(robot(), readings, reference, DT) for readings in (raw, late))
    np.testing.assert_array_equal(fit.value.scale, other.value.scale)
    assert fit.duration == 3.0


@pytest.mark.parametrize(
    ("field", "value", "kept"),
    [
        ("accelerometer", [0.0, 0.0, GRAVITY + 0.49], True),
        ("accelerometer", [0.0, 0.0, GRAVITY + 0.51], False),
        ("accelerometer", [0.0, 0.0, GRAVITY - 0.51], False),
        ("accelerometer", [GRAVITY, 0.0, 0.0], True),
        ("gyroscope", [0.0, 0.099, 0.0], True),
        ("gyroscope", [0.0, 0.08, 0.08], False),
    ],
)
def test_stillness_has_its_thresholds(field, value, kept):
    raw, reference, _ = quiet(np.random.default_rng(62), n=100)
    getattr(reference, field)[:] = value
    standing = robot(warm_up=0.0, duration=1.0)
    if kept:
        assert standing_start(standing, raw, reference, DT).stats.gated == 0
    else:
        with pytest.raises(CalibrationRefused, match=r"0 held values .* and 100 lacked contact or moved"):
            standing_start(standing, raw, reference, DT)


def test_refuses_a_robot_in_the_air():
    _, reference, _ = quiet(np.random.default_rng(63))
    raw = np.broadcast_to((4.9 / K - NOMINAL.offset) / NOMINAL.scale, (320, K))
    no = refusal(robot(), raw, reference)
    assert no.reason.startswith("Only 0 of the 80 samples that are needed were usable: of 240 after 1 s")
    assert "240 lacked contact or moved" in no.reason
    assert no.cure.startswith("Stand still for longer")


def test_refuses_a_dead_channel_by_its_name():
    raw, reference, _ = quiet(np.random.default_rng(64))
    raw[:, 6] = np.nan
    assert (
        "240 held values that are not finite (no reading at all from right/rear-left)"
        in refusal(robot(), raw, reference).reason
    )


def test_refuses_a_recording_that_is_too_short():
    raw, reference, _ = quiet(np.random.default_rng(65), n=100)
    assert "Only 20 of the 80 samples" in refusal(robot(), raw, reference).reason


test_refuses_values_without_meaning = refusals(
    lambda changes: QuietStanding(**{"layout": LAYOUT, "mass": MASS, "start": NOMINAL, **changes}),
    ({"mass": 0.0}, "'mass' must be finite and positive, got 0.0."),
    ({"force_noise": np.nan}, "'force_noise' must be finite and positive, got nan."),
    ({"com_error": -1.0}, "'com_error' must be finite and not negative, got -1.0."),
    ({"minimum_samples": 0}, "'minimum_samples' must be a whole number from 1 on, got 0."),
    ({"minimum_samples": np.nan}, "'minimum_samples' must be a whole number from 1 on, got nan"),
    (
        {"start": Parameters(np.full(K, np.nan), np.zeros(K))},
        "'start.scale' holds values that are not finite",
    ),
    ({"start": Parameters(np.ones(4), np.ones(8))}, "'start.scale' must hold one reading for each"),
    plain=True,
)


def test_refuses_shapes_that_do_not_belong_together():
    raw, reference, _ = quiet(np.random.default_rng(67))
    with pytest.raises(ValueError, match=re.escape("'raw' must have shape (samples, channels), got (8,).")):
        standing_start(robot(), raw[0], reference, DT)
    with pytest.raises(
        ValueError, match=re.escape("'raw' holds 319 samples, but fields of the reference hold")
    ):
        standing_start(robot(), raw[1:], reference, DT)
    with pytest.raises(ValueError, match=re.escape("'com' must have shape (3,), got (2,).")):
        standing_start(robot(), raw, reference._replace(com=reference.com[:, :2]), DT)
    state = robot().init(raw[0])
    with pytest.raises(
        ValueError, match=r"'raw' must have shape \(8,\), got \(3, 8\)\. That is of several robots"
    ):
        robot().update(state, raw[:3], reference, DT)
    with pytest.raises(
        ValueError, match=r"'com' must have shape \(3,\), got \(320, 3\)\. That is of several robots"
    ):
        robot().update(state, raw[0], reference, DT)


def test_absurd_readings_are_dropped_and_a_time_without_meaning_is_refused():
    rng = np.random.default_rng(0)
    force, com = standing_forces(rng)
    raw = np.repeat(force, 320, axis=0)
    raw[200, 3] = 1e300
    standing = QuietStanding(layout=LAYOUT, mass=MASS, start=PERFECT)
    assert standing_start(standing, raw, beliefs(com[0], 320), DT).stats.dropped == 1
    for dt in (0.0, np.nan):
        with pytest.raises(ValueError, match=f"'dt' must be finite and positive, got {dt}"):
            standing_start(standing, raw, beliefs(com[0], 320), dt)
