"""The moment filter on a robot whose momentum is exact."""

import numpy as np
import pytest
from _moment import WEIGHT, Errors, move
from _synthetic import DT, LAYOUT, MASS, NOMINAL
from scipy.spatial.transform import Rotation

from surefoot.calibration import (
    FeetLayout,
    Flag,
    FootCalibrator,
    FootLayout,
    MomentumReference,
    OnlineSetup,
    Parameters,
    Reference,
    replay,
)
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.filter import MomentFilter

STATED = Errors.stated()
ACCUSED = Flag.LOST | Flag.SWAPPED | Flag.FLIPPED | Flag.DEAD | Flag.STUCK


def calibrated(log, **options):
    given = {"mass": MASS, "initial": NOMINAL, "lag": 0}
    return replay(LAYOUT, "moment", log.raw, log.reference, DT, **given, **options)


def rmse(estimate, log, start, end=None):
    """Of cells, in shares of the weight, between two times in s."""
    rows = slice(round(start / DT), None if end is None else round(end / DT))
    return float(np.sqrt(np.mean((estimate.force[rows] - log.force[rows]) ** 2))) / WEIGHT


def raw_rmse(log, start):
    rows = slice(round(start / DT), None)
    return float(np.sqrt(np.mean((NOMINAL.force(log.raw[rows]) - log.force[rows]) ** 2))) / WEIGHT


def lifted(share, start=8.0, end=14.0, seconds=20.0):
    time = np.arange(round(seconds / DT)) * DT
    return share * np.clip(np.minimum(time - start, end - time) / 0.3, 0.0, 1.0)


@pytest.mark.parametrize("walking", [True, False])
def test_perfect_sensors_and_beliefs_stay_perfect(walking):
    log = move(0, 12.0, walking=walking)
    np.testing.assert_allclose(calibrated(log).force, log.force, atol=1e-10)


def test_a_robot_that_walks_finds_its_errors():
    log = move(0, 14.0, STATED)
    assert rmse(calibrated(log), log, 8.0) < 0.25 * raw_rmse(log, 8.0)


@pytest.mark.slow
def test_errors_agree_with_the_covariance():
    # 16 parameters of 16 robots, of which half walk; the mean of as many squares strays by 0.09.
    nees = []
    for seed in range(16):
        log = move(100 + seed, 10.0, STATED, walking=seed % 2 == 0)
        last = calibrated(log)
        found = Parameters(last.scale[-1], last.offset[-1]).relative_to(NOMINAL)
        off = np.concatenate(
            [a - b for a, b in zip(found, (part[-1] for part in log.correction), strict=True)]
        )
        nees.append(off @ np.linalg.solve(last.covariance[-1], off) / len(off))
    assert 0.7 < np.mean(nees) < 1.4


def test_innovations_agree_with_what_is_stated():
    # These readings are means over their intervals.
    found = calibrated(move(0, 12.0, STATED), ripple=0.5)
    assert 0.6 < np.nanmean(found.nis) / found.nis_rows.max() < 1.4


def test_what_is_not_seen_stays_and_is_told():
    log = move(3, 6.0, STATED, walking=False)
    estimate = calibrated(log)
    np.testing.assert_allclose(estimate.undetermined[0], 1.0)
    assert rmse(estimate, log, 3.0) < raw_rmse(log, 3.0)
    # A robot that sways shows sums of its cells, and hardly how they are shared.
    walked = calibrated(move(3, 6.0, STATED))
    assert walked.undetermined[-1].mean() < 0.5 * estimate.undetermined[-1].mean()


@pytest.mark.parametrize("share", [0.15, 0.35])
def test_nothing_is_learnt_from_a_robot_that_is_held(share):
    log = move(1, 16.0, STATED, lifted=lifted(share, 6.0, 12.0, 16.0))
    estimate = calibrated(log)
    before = rmse(estimate, log, 4.0, 6.0)
    assert rmse(estimate, log, 6.5, 11.5) < 1.1 * before
    assert rmse(estimate, log, 13.0) < 1.1 * before
    held = ((estimate.flags & Flag.HELD) > 0).any(axis=1)
    assert held[round(6.5 / DT) : round(11.5 / DT)].mean() > 0.5
    assert not held[: round(6.0 / DT)].any()
    assert not held[round(13.5 / DT) :].any()
    assert not (estimate.flags & ACCUSED).any()


@pytest.mark.parametrize("share", [0.05, 0.1])
def test_a_steady_hand_is_no_error_of_the_cells(share):
    """A rail at the side that bears a part of the weight leaves the map and its covariance right."""
    log = move(5, 20.0, STATED, lifted=lifted(share, 2.0, 1e9, 20.0), aside=(0.0, 0.2))
    estimate = calibrated(log)
    assert rmse(estimate, log, 12.0) < 0.5 * raw_rmse(log, 12.0)
    found = Parameters(estimate.scale[-1], estimate.offset[-1]).relative_to(NOMINAL)
    off = np.concatenate([a - b for a, b in zip(found, (part[-1] for part in log.correction), strict=True)])
    assert off @ np.linalg.solve(estimate.covariance[-1], off) / len(off) < 2.0
    assert not (estimate.flags & ACCUSED).any()


def test_a_load_that_stays_is_no_error_of_the_cells():
    log = move(2, 16.0, STATED, lifted=-lifted(0.1, 6.0, 1e9, 16.0))
    estimate = calibrated(log)
    assert rmse(estimate, log, 10.0) < 1.5 * rmse(estimate, log, 4.0, 6.0)


def test_a_load_at_the_side_moves_the_centre_of_mass_and_not_the_cells():
    log = move(2, 16.0, STATED, walking=False, lifted=-lifted(0.1, 8.0, 1e9, 16.0), aside=(0.1, -0.2))
    estimate = calibrated(log)
    position = np.concatenate([foot.position_cell_sole for foot in LAYOUT.feet])
    sole = log.reference.position_sole[0].repeat(4, axis=0)
    cop, truth = (
        force @ (position + sole) / force.sum(axis=1)[:, None] for force in (estimate.force, log.force)
    )
    off = np.linalg.norm((cop - truth)[:, :2], axis=1)
    assert off[round(12.0 / DT) :].mean() < off[round(4.0 / DT) : round(8.0 / DT)].mean() + 0.002


def test_zeros_that_leap_are_tared_at_the_next_swing():
    log = move(4, 10.0, Errors(noise=1e-3))
    raw = log.raw.copy()
    raw[round(5.0 / DT) :] += 0.06 * WEIGHT / NOMINAL.scale  # three newtons on all cells at once
    estimate = calibrated(log._replace(raw=raw))
    assert rmse(estimate, log, 8.0) < 0.008
    assert not (estimate.flags & (Flag.LOST | Flag.SWAPPED)).any()


def test_zeros_that_drift_by_more_than_a_load_are_tared_at_every_swing():
    log = move(4, 24.0, Errors(noise=1e-3))
    drift = (
        0.02 * WEIGHT * DT * np.arange(len(log.raw))[:, None]
    )  # half of the weight on each cell in the end
    estimate = calibrated(log._replace(raw=log.raw + drift / NOMINAL.scale))
    assert rmse(estimate, log, 20.0) < 0.06
    assert not (estimate.flags & ACCUSED).any()


def spoilt(log, kind, at):
    """Readings with a fault of all or of two cells from a sample on."""
    raw, empty = log.raw.copy(), -NOMINAL.offset / NOMINAL.scale
    read = raw[at:] - empty
    raw[at:] = (
        empty
        + {
            "tared": read - read[0],
            "stepped": read + 0.06 * WEIGHT / NOMINAL.scale,
            "stepped a little": read + 0.015 * WEIGHT / NOMINAL.scale,
            "swapped": (read * NOMINAL.scale)[:, [0, 2, 1, *range(3, 8)]] / NOMINAL.scale,
            "flipped": read * np.where(np.arange(8) == 5, -1.0, 1.0),
        }[kind]
    )
    return log._replace(raw=raw)


@pytest.mark.parametrize(
    ("kind", "walking", "time"),
    [
        ("tared", True, 8.03),
        ("tared", True, 8.43),  # on one foot, a cell bears a third of the weight
        ("tared", False, 8.03),
        ("stepped", True, 8.03),
        ("stepped a little", False, 8.03),
    ],
)
def test_zeros_that_leap_together_are_put_back_and_accuse_nobody(kind, walking, time):
    log = move(6, 14.0, STATED, walking=walking)
    estimate = calibrated(spoilt(log, kind, round(time / DT)))
    assert rmse(estimate, log, 10.0) < 1.2 * rmse(calibrated(log), log, 10.0)
    assert not (estimate.flags & ACCUSED).any()


@pytest.mark.parametrize(
    ("kind", "flag", "cells"), [("swapped", Flag.SWAPPED, (1, 2)), ("flipped", Flag.FLIPPED, (5,))]
)
def test_exchanged_and_flipped_cells_are_found_and_put_right(kind, flag, cells):
    log = move(6, 20.0, STATED)
    estimate = calibrated(spoilt(log, kind, round(8.03 / DT)))
    assert ((estimate.flags[-1] & ACCUSED) == np.where(np.isin(np.arange(8), cells), flag, 0)).all()
    assert rmse(estimate, log, 15.0) < 1.2 * rmse(calibrated(log), log, 15.0)


@pytest.mark.parametrize(("seed", "cell"), [(3, 3), (4, 0), (6, 6)])
def test_a_cell_that_is_dead_from_the_start_is_found_and_no_other(seed, cell):
    log = move(seed, 12.0, STATED)
    raw, empty = log.raw.copy(), -NOMINAL.offset / NOMINAL.scale
    noise = np.random.default_rng(seed).normal(0.0, 0.0005 * WEIGHT, len(raw))
    raw[:, cell] = empty[cell] + noise / NOMINAL.scale[cell]
    estimate = calibrated(log._replace(raw=raw))
    assert (((estimate.flags & ACCUSED) > 0).any(axis=0) == (np.arange(8) == cell)).all()
    assert estimate.flags[-1, cell] & Flag.DEAD


def test_the_others_are_tared_while_a_channel_is_lost_and_it_comes_back():
    log = move(5, 16.0, STATED)
    raw, (gone, back) = log.raw.copy(), (round(t / DT) for t in (3.0, 12.0))
    raw[gone:, [0, 1, 3]] += 0.05 * WEIGHT / NOMINAL.scale[[0, 1, 3]]
    raw[gone:back, 2] = np.nan
    estimate = calibrated(log._replace(raw=raw))
    lost = (estimate.flags & Flag.LOST) > 0
    assert lost[gone + 20 : back, 2].all()
    assert not lost[:, [0, 1, 3, 4, 5, 6, 7]].any()
    assert not lost[back + round(0.5 / DT) :].any()
    swings = log.reference.swing[:, 0].copy()
    swings[: gone + round(3.0 / DT)] = swings[back:] = False
    assert np.abs(estimate.force[swings][:, [0, 1, 3]].mean(axis=0)).max() < 0.01 * WEIGHT
    assert rmse(estimate, log, 14.0) < 0.3 * raw_rmse(log, 14.0)


def test_a_zero_that_leapt_before_the_filter_goes_back_spoils_no_scale():
    """What a foot in the air reads is held against the tare that the filter went back to."""
    log = move(0, 18.0, STATED)
    raw, leapt = log.raw.copy(), round(12.2 / DT)
    raw[leapt:, 1] += 0.2 * WEIGHT / NOMINAL.scale[1]
    calibrator = FootCalibrator(LAYOUT, "moment", mass=MASS, initial=NOMINAL, dt=DT, lag=0)
    error = []
    for k, reading in enumerate(raw):
        if k == round(13.9 / DT):
            calibrator.retract()
        estimate = calibrator.update(reading, MomentumReference(*(part[k] for part in log.reference)))
        error.append(np.asarray(estimate.force) - log.force[k])
    assert np.sqrt(np.mean(np.square(error[round(15.0 / DT) :]))) < 0.008 * WEIGHT


def test_a_fault_is_found_while_a_cell_of_the_other_foot_is_out():
    log = move(5, 14.0, STATED)
    log = spoilt(log, "flipped", round(8.03 / DT))
    log.raw[round(4.0 / DT) :, 2] = np.nan
    accused = (calibrated(log).flags & ACCUSED) > 0
    assert (accused.any(axis=0) == np.isin(np.arange(8), (2, 5))).all()
    assert accused[-1, 2]


def test_bursts_and_gaps_teach_as_well():
    log, rng = move(5, 10.0, STATED), np.random.default_rng(0)
    raw, missing = log.raw.copy(), rng.random(len(log.raw)) < 0.3
    raw[missing] = np.nan
    estimate = calibrated(log._replace(raw=raw))
    # What is held is wrong where the load changes; samples that came are judged.
    late = ~missing & (np.arange(len(raw)) > round(7.0 / DT))
    off = estimate.force[late] - log.force[late]
    assert np.sqrt(np.mean(off**2)) < 0.25 * np.sqrt(np.mean((NOMINAL.force(log.raw) - log.force)[late] ** 2))


def test_accelerations_are_added_up():
    """A reference that holds accelerations of the same motion teaches almost as much."""
    log = move(6, 10.0, Errors(scale=0.12, offset=0.03, noise=1e-3))
    belief, still = log.reference, np.zeros((len(log.raw), 3))
    rate = np.diff(belief.angular_momentum, axis=0, prepend=belief.angular_momentum[:1]) / DT
    reference = Reference(
        com=belief.com,
        com_acceleration=np.diff(belief.com_velocity, axis=0, prepend=belief.com_velocity[:1]) / DT,
        angular_momentum_rate=rate,
        position_sole=belief.position_sole,
        R_level_sole=belief.R_level_sole,
        stance=belief.stance,
        swing=belief.swing,
        accelerometer=still,
        gyroscope=still,
    )
    estimate = calibrated(log._replace(reference=reference))
    assert rmse(estimate, log, 7.0) < 0.3 * raw_rmse(log, 7.0)


def test_axes_that_turn_are_no_error():
    """Accelerations come in axes that head as the robot does; what they teach does not depend on it."""
    log = move(7, 3.0, Errors(scale=0.12, offset=0.03))
    belief = log.reference
    rate = np.diff(belief.angular_momentum, axis=0, prepend=belief.angular_momentum[:1]) / DT
    acceleration = np.diff(belief.com_velocity, axis=0, prepend=belief.com_velocity[:1]) / DT
    still = np.zeros((len(log.raw), 3))

    def seen(turned):
        angle = turned * 0.5 * np.arange(len(log.raw)) * DT
        cos, sin, zero, one = np.cos(angle), np.sin(angle), 0.0 * angle, 1.0 + 0.0 * angle
        R = np.moveaxis(np.array([[cos, -sin, zero], [sin, cos, zero], [zero, zero, one]]), -1, 0)
        vectors = [np.einsum("nij,nj->ni", R, part) for part in (belief.com, acceleration, rate)]
        soles = np.einsum("nij,nfj->nfi", R, belief.position_sole)
        return Reference(
            *vectors, soles, R[:, None] @ belief.R_level_sole, belief.stance, belief.swing, still, still
        )

    ahead, turning = (calibrated(log._replace(reference=seen(turned))) for turned in (0.0, 1.0))
    np.testing.assert_allclose(turning.force, ahead.force, atol=1e-8 * WEIGHT)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tilted_attitude_is_not_taken_for_errors_of_cells(axis):
    """An IMU mounted 5 degrees off turns everything that the robot believes, so its soles are not level."""
    R = Rotation.from_euler("xy"[axis], 5.0, degrees=True).as_matrix()
    log = move(4, 20.0, STATED, walking=False)
    vectors = "com", "com_velocity", "angular_momentum", "position_sole"
    tilted = {name: getattr(log.reference, name) @ R.T for name in vectors}
    tilted["R_level_sole"] = R @ log.reference.R_level_sole
    estimate = calibrated(log._replace(reference=log.reference._replace(**tilted)))
    assert rmse(estimate, log, 10.0) < 1.25 * rmse(calibrated(log), log, 10.0)
    assert not (estimate.flags & int(Flag.WORSE_THAN_START)).any()


def test_the_contact_probability_is_sure_of_steps():
    log = move(8, 8.0, STATED)
    estimate = calibrated(log)
    rows = slice(round(4.0 / DT), None)
    loads = np.add.reduceat(log.force[rows], (0, 4), axis=1)
    for foot in (0, 1):
        stands = loads[:, foot] > 0.05 * WEIGHT
        probability = estimate.contact_probability[rows, foot]
        assert (probability[stands] > 0.5).mean() > 0.99
        assert (probability[~stands] < 0.5).mean() > 0.99


def test_what_was_learnt_of_late_is_taken_back():
    log = move(9, 6.0, STATED)
    calibrator = FootCalibrator(LAYOUT, "moment", mass=MASS, initial=NOMINAL, lag=0)
    scales = []
    for k in range(len(log.raw)):
        row = MomentumReference(*(part[k] for part in log.reference))
        scales.append(calibrator.update(log.raw[k], row).scale)
    calibrator.retract()
    still = MomentumReference(*(part[-1] for part in log.reference))
    back = calibrator.update(log.raw[-1], still).scale
    late = [k for k, scale in enumerate(scales) if np.array_equal(scale, back)]
    assert 1.4 < (len(scales) - late[-1]) * DT < 3.2


def test_what_a_robot_learns_as_it_falls_is_taken_back_and_lying_teaches_nothing():
    """Nobody reports the fall: soles that stand on edge show it."""
    log = move(2, 16.0, STATED)
    fall, lie = round(9.0 / DT), round(10.0 / DT)
    raw, R = log.raw.copy(), log.reference.R_level_sole.copy()
    rng = np.random.default_rng(3)
    raw[fall:lie] += 0.2 * WEIGHT * rng.normal(size=(lie - fall, 8)) / NOMINAL.scale
    raw[lie:] = raw[:1] + 0.02 * WEIGHT * rng.normal(size=(len(raw) - lie, 8)) / NOMINAL.scale
    R[lie:] = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    swing = log.reference.swing.copy()
    swing[lie:] = True
    estimate = calibrated(
        log._replace(raw=raw, reference=log.reference._replace(R_level_sole=R, swing=swing))
    )
    assert (estimate.flags[lie + 1 :] & int(Flag.REJECTED)).all()
    lying = estimate.scale[lie:]
    np.testing.assert_array_equal(lying, lying[:1] + np.zeros_like(lying))
    before = [estimate.scale[k] for k in range(round(6.0 / DT), fall)]
    assert any(np.array_equal(lying[0], scale) for scale in before)


def test_a_foot_that_lands_before_its_plan_is_not_tared():
    """On soft ground: in the last third of a told swing the foot bears a third of the weight."""
    log = move(2, 16.0, STATED)
    swing, raw = log.reference.swing, log.raw.copy()
    for foot in (0, 1):
        ends = np.flatnonzero(np.diff(swing[:, foot].astype(int)) < 0)
        for end in ends:
            begin = end - np.argmin(swing[end::-1, foot]) + 1
            late = slice(end - (end - begin) // 3, end + 1)
            raw[late, 4 * foot : 4 * foot + 4] += WEIGHT / 12.0 / NOMINAL.scale[:4]
    estimate = calibrated(log._replace(raw=raw))
    zero = estimate.scale[-1] * log.raw[-1] + estimate.offset[-1] - log.force[-1]
    assert np.abs(zero).max() < 0.02 * WEIGHT


@pytest.mark.parametrize("flat", [True, False])
def test_a_ball_stands_however_it_is_turned(flat):
    """The same forces, of soles whose frames stand on edge."""
    on_edge = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    turned = np.kron(np.eye(2), on_edge.T)
    feet = (
        FootLayout(foot.name, turned @ foot.wrench_map, foot.channel_names, flat=flat) for foot in LAYOUT.feet
    )
    log = move(2, 4.0, STATED)
    beliefs = log.reference._replace(R_level_sole=log.reference.R_level_sole @ on_edge)
    known = {"mass": MASS, "initial": NOMINAL, "lag": 0, "foot_length": 0.17}
    estimate = replay(FeetLayout(tuple(feet)), "moment", log.raw, beliefs, DT, **known)
    rejected = (estimate.flags & int(Flag.REJECTED)).all(axis=1)
    assert rejected[8:].mean() == flat


def test_words_that_are_wrong_for_one_sample_spoil_little():
    log, rng = move(1, 14.0, STATED), np.random.default_rng(4)
    raw, hit = log.raw.copy(), rng.random(log.raw.shape) < 0.03
    raw[hit] += (0.1 * WEIGHT / NOMINAL.scale + np.zeros_like(raw))[hit]
    found, wrong = (calibrated(one) for one in (log, log._replace(raw=raw)))
    assert not (wrong.flags & int(ACCUSED)).any()
    sound = ~hit.any(axis=1)
    sound[: round(8.0 / DT)] = False
    off = [np.sqrt(np.mean((one.force - log.force)[sound] ** 2)) for one in (found, wrong)]
    assert off[1] < 1.5 * off[0]


def test_other_methods_want_accelerations():
    calibrator = FootCalibrator(LAYOUT, "tare", mass=MASS, initial=NOMINAL, lag=0)
    log = move(0, 0.1)
    with pytest.raises(TypeError, match="'reference' must be a Reference, got MomentumReference"):
        calibrator.update(log.raw[0], MomentumReference(*(part[0] for part in log.reference)))
    with pytest.raises(ValueError, match="'zero_phase' filters accelerations, which a MomentumReference"):
        replay(LAYOUT, "moment", log.raw, log.reference, DT, mass=MASS, initial=NOMINAL, zero_phase=True)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"block": 0.0}, "'block' must be finite and positive, got 0.0"),
        ({"scale_drift": -1.0}, "'scale_drift' must be finite and not negative, got -1.0"),
        ({"velocity_noise": np.nan}, "'velocity_noise' must be finite and positive, got nan"),
    ],
)
def test_an_option_without_meaning_is_refused(option, message):
    with pytest.raises(ValueError, match=message):
        Moment(**option)


def test_a_block_is_full_when_its_time_is():
    setup = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, lag=0, dt=DT)
    made = MomentFilter(setup, Moment())
    log = move(0, 3.0)
    for step in (DT, 2.0 * DT):
        state, learnt = made.init(log.raw[0]), []
        for k in range(80):
            row = MomentumReference(*(part[k] for part in log.reference))
            state, _ = made.update(state, log.raw[k], row, step)
            learnt.append(state.time)
        assert np.diff(np.unique(learnt)).min() == pytest.approx(0.1, abs=1.01 * step)
        assert state.time == pytest.approx(79 * step, abs=0.11)


@pytest.mark.parametrize(("step", "leaps"), [(0.1, True), (0.5, False)])
def test_zeros_leap_by_no_more_than_a_tare_believes(step, leaps):
    """Readings of a robot that falls step by some weights at a blow."""
    log = move(6, 6.0, STATED, walking=False)
    raw = log.raw.copy()
    raw[round(4.03 / DT) :] += step * WEIGHT / NOMINAL.scale
    calibrator = FootCalibrator(LAYOUT, "moment", mass=MASS, initial=NOMINAL, dt=DT, lag=0)
    for k, row in enumerate(raw):
        calibrator.update(row, MomentumReference(*(part[k] for part in log.reference)))
    assert calibrator.state.shift.any() == leaps
