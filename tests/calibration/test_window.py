import numpy as np
import pytest
from _refusals import refusals
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, errors, walk
from _window import at_rest, run
from scipy.optimize import least_squares

from surefoot.calibration import (
    GRAVITY,
    FeetLayout,
    Flag,
    FootCalibrator,
    FootLayout,
    OnlineSetup,
    Parameters,
    Reference,
    ground_reference,
    replay,
)
from surefoot.calibration.cop import moment_rows
from surefoot.calibration.front_end.readings import FrontEnd
from surefoot.calibration.window.config import Window
from surefoot.calibration.window.gauss_newton import Weights, gauss_newton, linearise

WEIGHTS = Weights(force=2.0, cop=100.0, threshold=5.0)
FREE = {
    "standing_start": False, "scale_step": 10.0, "offset_step": 10.0, "scale_step_bound": 0.5,
    "offset_step_bound": 0.5, "scale_rate": 100.0, "offset_rate": 100.0, "gross_error": 10.0,
}  # fmt: skip
"""Options that leave the parameters free, for data that tell everything."""


def problem(seed=0, samples=40):
    rng = np.random.default_rng(seed)
    phi = rng.normal(size=(samples, 3, 16)) * 0.3
    phi[:, 0] = rng.uniform(1.0, 10.0, size=(samples, 16))
    theta = np.repeat([1.0, 0.0], 8) + 0.05 * rng.normal(size=16)
    vgrf = phi[:, 0] @ theta + rng.normal(size=samples)
    return phi, theta, vgrf, np.ones(samples)


def rich_log(seed=0, samples=160):
    """Cells carry what they like, soles lie where they like, and the body floats accordingly."""
    rng = np.random.default_rng(seed)
    force = rng.uniform(1.0, 12.0, size=(samples, 8))
    position_sole = np.array([(0.0, 0.05, 0.0), (0.0, -0.05, 0.0)]) + rng.normal(size=(samples, 2, 3)) * 0.03
    position_sole[..., 2] = 0.0
    c, s = np.cos(angle := rng.normal(size=(samples, 2))), np.sin(angle)
    zero, one = np.zeros_like(c), np.ones_like(c)
    rotation = np.stack([c, -s, zero, s, c, zero, zero, zero, one], axis=-1).reshape(samples, 2, 3, 3)
    rows = moment_rows(LAYOUT, position_sole, rotation).sum(axis=1)
    fz, *moment = np.moveaxis((rows @ force[..., None])[..., 0], -1, 0)
    zero = np.zeros((samples, 3))
    return force, Reference(
        com=np.column_stack([moment[0] / fz, moment[1] / fz, np.full(samples, 0.26)]),
        com_acceleration=np.column_stack([zero[:, :2], fz / MASS - GRAVITY]),
        angular_momentum_rate=zero,
        position_sole=position_sole,
        R_level_sole=rotation,
        stance=np.ones((samples, 2), bool),
        swing=np.zeros((samples, 2), bool),
        accelerometer=zero + np.array([0.0, 0.0, GRAVITY]),
        gyroscope=zero,
    )


def together(logs, method, faults):
    """Return root mean square errors of each four of several robots, shape (n, 2)."""
    found = [errors(run(log, method, faults), log, 7.0) for log in logs]
    return np.sqrt(np.mean(np.square(found).reshape(-1, 4, 2), axis=1))


@pytest.mark.parametrize("seed", range(5))
def test_the_jacobian_is_the_derivative_of_the_residuals(seed):
    phi, theta, vgrf, use = problem(seed)
    use[::7] = 0.0
    phi[3, 0] *= 0.01  # below the gate
    _, jacobian = linearise(theta, phi, vgrf, use, WEIGHTS)
    step = 1e-6
    for i in range(16):
        ahead, behind = theta.copy(), theta.copy()
        ahead[i] += step
        behind[i] -= step
        difference = (
            linearise(ahead, phi, vgrf, use, WEIGHTS).residual
            - linearise(behind, phi, vgrf, use, WEIGHTS).residual
        ) / (2 * step)
        np.testing.assert_allclose(jacobian[..., i], difference, rtol=1e-6, atol=1e-6)
    assert not jacobian[3].any()
    assert not jacobian[::7].any()


def test_the_iterations_reach_the_minimum_that_scipy_finds():
    phi, theta, vgrf, use = problem(1)
    spread = np.full(16, 0.05)

    def cost(unknown):
        r = linearise(unknown, phi, vgrf, use, WEIGHTS).residual.ravel()
        return np.concatenate([r, (unknown - theta) / spread])

    expected = least_squares(cost, theta, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    found = gauss_newton(
        theta, phi, vgrf, use, WEIGHTS,
        spread=spread, bound=np.full(16, np.inf), iterations=20,
    )  # fmt: skip
    assert found.solvable
    np.testing.assert_allclose(found.theta, expected, atol=1e-7)


def test_a_bound_shortens_a_step_and_keeps_its_direction():
    phi, theta, vgrf, use = problem(2)
    solve = {"spread": np.ones(16), "iterations": 1}
    full = gauss_newton(theta, phi, vgrf, use, WEIGHTS, bound=np.full(16, np.inf), **solve).theta - theta
    short = gauss_newton(theta, phi, vgrf, use, WEIGHTS, bound=np.full(16, 1e-3), **solve).theta - theta
    assert np.abs(short).max() == pytest.approx(1e-3)
    np.testing.assert_allclose(short / np.abs(short).max(), full / np.abs(full).max(), rtol=1e-9)


@pytest.mark.parametrize("cutoff", [10.0, None])
@pytest.mark.parametrize("lag", [0, 3])
def test_without_noise_all_that_shows_is_recovered(cutoff, lag):
    """Fourteen of sixteen parameters show; the warp of each foot's offsets makes no force and no moment."""
    force, reference = rich_log()
    reference = Reference(*(np.concatenate([part[:1]] * lag + [part])[: len(force)] for part in reference))
    rng = np.random.default_rng(1)
    truth = Parameters(1.0 + 0.1 * rng.normal(size=8), rng.normal(size=8))
    reported = (force - truth.offset) / truth.scale
    estimate = replay(LAYOUT, "window", reported, reference, DT, mass=MASS, lag=lag, cutoff=cutoff, **FREE)
    np.testing.assert_allclose(estimate.scale[-1], truth.scale, atol=1e-9)
    wrench_map = LAYOUT.wrench_map
    np.testing.assert_allclose(wrench_map @ estimate.offset[-1], wrench_map @ truth.offset, atol=1e-9)
    np.testing.assert_allclose(estimate.wrench[-1], wrench_map @ force[-1], atol=1e-9)
    warp = np.array([1.0, -1.0, -1.0, 1.0])
    for error in (estimate.offset[-1] - truth.offset).reshape(2, 4):
        np.testing.assert_allclose(error, error[0] * warp, atol=1e-9)


def test_directions_that_the_data_do_not_excite_stay():
    raw, reference = at_rest(200)
    estimate = replay(
        LAYOUT, "window", raw * 1.001, reference, DT, mass=MASS, initial=NOMINAL, lag=0, standing_start=False
    )
    correction = Parameters(estimate.scale[-1], estimate.offset[-1]).relative_to(NOMINAL)
    change = np.concatenate([correction.scale - 1.0, correction.offset])
    force = NOMINAL.force(raw[0] * 1.001)
    rows = moment_rows(LAYOUT, reference.position_sole[0], reference.R_level_sole[0]).sum(axis=0)
    seen = np.concatenate([rows * force, rows], axis=1)
    config = Window()
    spread = np.repeat([config.scale_step, config.offset_step * MASS * GRAVITY], 8)
    _, _, directions = np.linalg.svd(seen * spread)
    whitened = directions @ (change / spread)
    assert np.abs(whitened[:3]).max() > 0.1
    np.testing.assert_allclose(whitened[3:], 0.0, atol=1e-6)


def test_perfect_sensors_and_beliefs_change_nothing():
    log = walk(0, speed=0.1, duration=5.0, stand=3.0)
    estimate = run(log)
    np.testing.assert_allclose(estimate.force, log.force, atol=1e-3)
    assert errors(estimate, log, 4.0)[0] < 0.01


@pytest.mark.slow
def test_a_bad_start_is_corrected_and_a_good_one_is_not_spoilt():
    for faults, factor in ((Faults.bad(), 0.7), (Faults.mild(), 1.5)):
        logs = [walk(seed, speed, 9.0, 3.0, faults) for speed in (0.02, 0.1) for seed in (11, 12, 13, 14)]
        found, raw = (together(logs, method, faults) for method in ("window", "none"))
        assert (found < raw * (factor, 1.0)).all()


def test_leaving_out_the_motion_makes_it_worse_the_faster_the_robot_walks():
    log = walk(5, 0.1, 4.0, 2.0, Faults(lag=2))
    window = errors(run(log, faults=Faults(lag=2)), log, 4.0)
    quasi_static = errors(run(log, "quasi-static", faults=Faults(lag=2)), log, 4.0)
    assert quasi_static[0] > 3.0 * window[0]
    assert quasi_static[1] > 3.0 * window[1]


def test_the_lag_must_be_told():
    log = walk(5, 0.1, 4.0, 2.0, Faults(lag=3))
    told = errors(run(log, faults=Faults(lag=3)), log, 4.0)
    untold = errors(run(log, faults=Faults(lag=0)), log, 4.0)
    assert untold[0] > 2.0 * told[0]


def test_without_contact_nothing_is_learnt():
    raw, reference = at_rest(120)
    estimate = replay(
        LAYOUT, "window", raw * 0.0 - NOMINAL.offset / NOMINAL.scale, reference, DT, mass=MASS,
        initial=NOMINAL, lag=0, standing_start=False,
    )  # fmt: skip
    assert (estimate.flags[-1] == Flag.NO_CONTACT).all()
    np.testing.assert_array_equal(estimate.offset[-1], NOMINAL.offset)
    assert not estimate.cop_valid.any()
    assert np.isnan(estimate.cop).all()
    assert np.isfinite(estimate.force).all()


def test_singular_normal_equations_are_flagged_and_change_nothing():
    raw, reference = at_rest(120)
    estimate = replay(
        LAYOUT, "window", NOMINAL.force(raw), reference, DT, mass=MASS, lag=0, standing_start=False,
        scale_step=1e9, offset_step=1e9,
    )  # fmt: skip
    assert (estimate.flags[-1] == Flag.SINGULAR).all()
    np.testing.assert_array_equal(estimate.scale[-1], 1.0)


def test_parameters_change_no_faster_than_the_limit():
    faults = Faults(gain=0.2, offset=3.0, lag=0)
    log = walk(2, duration=6.0, faults=faults)
    limit = {
        "scale_rate": 0.05,
        "offset_rate": 0.01,
        "standing_start": False,
        "scale_step": 0.1,
        "offset_step": 0.05,
    }
    estimate = run(log, faults=faults, **limit)
    a = estimate.scale / NOMINAL.scale
    b = estimate.offset - a * NOMINAL.offset
    assert np.abs(np.diff(a, axis=0)).max() <= 0.05 * 4 * DT * (1 + 1e-6)
    assert np.abs(np.diff(b, axis=0)).max() <= 0.01 * MASS * GRAVITY * 4 * DT * (1 + 1e-6)
    assert np.abs(np.diff(a, axis=0)).max() > 0.04 * 4 * DT


def test_scales_stay_where_a_sensor_can_be():
    raw, reference = at_rest(400)
    heavy = 1.35 * NOMINAL.force(raw)
    estimate = replay(
        LAYOUT, "window", heavy, reference, DT, mass=MASS, lag=0, standing_start=False,
        scale_range=(0.95, 1.05), offset_range=0.01, scale_step=1.0, offset_step=1.0,
        scale_rate=10.0, offset_rate=10.0,
    )  # fmt: skip
    assert estimate.scale.min() == pytest.approx(0.95)
    assert np.abs(estimate.offset).max() <= 0.01 * MASS * GRAVITY * (1 + 1e-12)


def landing(spike):
    """A robot that sets its right foot down, with a knock on one cell just then."""
    log = walk(0, duration=0.0, stand=2.0)
    raw, reference = at_rest(100, log)
    force = NOMINAL.force(raw)
    stance = np.ones((100, 2), bool)
    stance[:82, 1] = False
    force[82:86, 5] += spike
    force += 1e-9 * np.sin(np.arange(100.0))[:, None]  # readings of converters are never all equal
    return force, reference._replace(stance=stance, swing=~stance)


def test_a_knock_as_a_foot_lands_is_rejected():
    def moved(spike, **options):
        force, reference = landing(spike)
        estimate = replay(
            LAYOUT, "window", force, reference, DT, mass=MASS, lag=0, standing_start=False, **options
        )
        return np.abs(estimate.offset[-1]).max() + np.abs(estimate.scale[-1] - 1.0).max()

    assert moved(0.0) < 1e-6
    assert moved(8.0) < 0.5 * moved(8.0, outlier_threshold=1e6)


def test_what_no_calibration_error_explains_is_never_used():
    raw, reference = at_rest(200)
    force = NOMINAL.force(raw)
    force[100:140:5, 2] += 200.0
    estimate = replay(LAYOUT, "window", force, reference, DT, mass=MASS, lag=0, standing_start=False)
    np.testing.assert_allclose(estimate.scale[-1], 1.0, atol=1e-9)
    np.testing.assert_allclose(estimate.offset[-1], 0.0, atol=1e-9)


def test_samples_beside_a_missing_one_are_left_out():
    raw, reference = at_rest(90)
    force = NOMINAL.force(raw)
    force[60:] *= 1.1
    force[60::3, 1] = np.nan
    estimate = replay(LAYOUT, "window", force, reference, DT, mass=MASS, lag=0, standing_start=False)
    # From sample 60 on there are never five good samples in a row: the error cannot be seen.
    np.testing.assert_allclose(estimate.scale[-1], 1.0, atol=1e-9)


def test_a_gap_in_time_empties_the_window():
    raw, reference = at_rest(120)
    steps = np.full(120, DT)
    steps[100] = 3.0
    estimate = replay(
        LAYOUT, "window", raw, reference, steps, mass=MASS, initial=NOMINAL, lag=0, standing_start=False
    )
    assert (estimate.flags[99] == 0).all()
    assert (estimate.flags[100] & Flag.GAP).all()
    assert (estimate.flags[103] == Flag.NO_CONTACT).all()
    assert (estimate.flags[119] == 0).all()


def ankle_layout():
    sensor = np.eye(6)
    sensor[3:, :3] = [[0.0, 0.09, 0.0], [-0.09, 0.0, 0.0], [0.0, 0.0, 0.0]]
    names = ("fx", "fy", "fz", "tx", "ty", "tz")
    return FeetLayout((FootLayout("left", sensor, names), FootLayout("right", sensor, names)))


@pytest.mark.parametrize("layout", [LAYOUT, ankle_layout(), FeetLayout((LAYOUT.feet[0],))])
def test_the_front_end_agrees_with_the_equations_of_their_own_modules(layout):
    rng = np.random.default_rng(3)
    feet = len(layout.feet)
    setup = OnlineSetup(
        layout=layout, mass=MASS, initial=Parameters(np.ones(layout.channels), np.zeros(layout.channels)),
        foot_length=0.17, lag=0,
    )  # fmt: skip
    rotation = np.linalg.qr(rng.normal(size=(7, feet, 3, 3)) * 0.1 + np.eye(3))[0]
    rotation *= np.sign(np.linalg.det(rotation))[..., None, None]
    reference = Reference(
        com=rng.normal(size=(7, 3)) * 0.02 + (0, 0, 0.26),
        com_acceleration=rng.normal(size=(7, 3)),
        angular_momentum_rate=rng.normal(size=(7, 3)) * 0.2,
        position_sole=rng.normal(size=(7, feet, 3)) * 0.1,
        R_level_sole=rotation,
        stance=np.ones((7, feet), bool),
        swing=np.zeros((7, feet), bool),
        accelerometer=np.ones((7, 3)),
        gyroscope=np.zeros((7, 3)),
    )
    force = rng.uniform(5.0, 20.0, size=(7, layout.channels))
    for quasi_static in (False, True):
        front_end = FrontEnd(setup, quasi_static=quasi_static)
        for k in range(7):
            row = Reference(*(part[k] for part in reference))
            _, sample = front_end.observe(front_end.init(force[k]), force[k], row, DT)
            expected = moment_rows(layout, row.position_sole, row.R_level_sole)
            np.testing.assert_allclose(sample.rows, expected, atol=1e-12)
            height = row.position_sole[:, 2].min()
            ground = ground_reference(row, MASS, height=height, quasi_static=quasi_static)
            vgrf, cop, possible = front_end.motions.ground(sample.motion)
            assert possible
            np.testing.assert_allclose(vgrf, ground.vgrf, atol=1e-12)
            np.testing.assert_allclose(cop, ground.cop, atol=1e-12)
            again = front_end.motions.unflatten(sample.motion, sample.stance, sample.swing)
            for given, kept in zip(row, again, strict=True):
                np.testing.assert_array_equal(given, kept)


test_options_without_meaning_are_refused = refusals(
    lambda options: Window(**options),
    ({"window": 0.0}, "'window' must be finite and positive, got 0.0"),
    ({"delta_force": -1.0}, "'delta_force' must be finite and positive, got -1.0"),
    ({"cutoff": -3.0}, "'cutoff' must be finite and positive, got -3.0"),
    ({"every": 0}, "'every' must be a whole number from 1 on, got 0"),
    ({"iterations": 2.5}, "'iterations' must be a whole number from 1 on, got 2.5"),
    ({"transition": -0.1}, "'transition' must be finite and not negative, got -0.1"),
    ({"scale_range": (1.1, 2.0)}, "'scale_range' must enclose 1"),
    ({"minimum_share": 1.5}, "'minimum_share' must be a share from 0 to 1, got 1.5"),
    ({"standing_samples": 0}, "'standing_samples' must be a whole number from 1 on, got 0"),
)


def test_one_foot_alone_is_calibrated_too():
    plate = FeetLayout((LAYOUT.feet[0],))
    rng = np.random.default_rng(5)
    samples = 480
    wave = np.sin(np.arange(samples)[:, None] * DT * 2 * np.pi * (0.7, 1.1))
    cop = (0.024, 0.007) + wave * (0.05, 0.03) + rng.normal(size=(samples, 2)) * 1e-4
    corner = np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])
    local = (cop - (0.02397, 0.00676)) / (0.085, 0.049)
    force = MASS * GRAVITY * (1 + corner[:, 0] * local[:, :1]) * (1 + corner[:, 1] * local[:, 1:]) / 4
    zero = np.zeros((samples, 3))
    reference = Reference(
        com=np.column_stack([cop, np.full(samples, 0.26)]),
        com_acceleration=zero,
        angular_momentum_rate=zero,
        position_sole=zero[:, None],
        R_level_sole=np.broadcast_to(np.eye(3), (samples, 1, 3, 3)),
        stance=np.ones((samples, 1), bool),
        swing=np.zeros((samples, 1), bool),
        accelerometer=zero + np.array([0.0, 0.0, GRAVITY]),
        gyroscope=zero,
    )
    gain = np.array([1.1, 0.95, 1.0, 0.9])
    for method in ("window", "quasi-static", "tare", "none"):
        estimate = replay(plate, method, gain * force, reference, DT, mass=MASS, lag=0)
        assert estimate.cop_foot.shape == (samples, 1, 2)
        error = np.linalg.norm(estimate.cop - cop, axis=1)[-50:].mean()
        if method in ("window", "quasi-static"):
            assert error < 0.5 * unlearnt_error(gain, force, cop)


def unlearnt_error(gain, force, cop):
    position = LAYOUT.feet[0].position_cell_sole[:, :2]
    reported = gain * force
    raw = reported @ position / reported.sum(axis=1, keepdims=True)
    return np.linalg.norm(raw - cop, axis=1)[-50:].mean()


def test_an_update_is_one_every_four_samples():
    log = walk(2, duration=2.0, stand=1.0, faults=Faults.bad())
    estimate = run(log, faults=Faults.bad(), standing_start=False)
    changed = np.flatnonzero(np.abs(np.diff(estimate.scale, axis=0)).max(axis=1) > 0) + 1
    assert len(changed) > 10
    assert (changed % 4 == 3).all()


def test_a_slow_stream_is_told_how_to_do_without_the_filter():
    with pytest.raises(ValueError, match=r"Give a lower one, or 'cutoff=None' to filter nothing\."):
        FootCalibrator(LAYOUT, "window", mass=MASS, dt=0.05)
    assert FootCalibrator(LAYOUT, "window", mass=MASS, dt=0.05, cutoff=None).setup.dt == 0.05
