"""The excitation planner: its information against brute force, and what its poses are worth."""

from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest
from _in_situ import ADDED_COM_LEG, ADDED_MASS, LEG_MATRIX, SENSORS, wrench_of_gravity
from _tracked import NOISE_ROOT, OFFSET, RESPONSE, make_fit

from surefoot.calibration.in_situ import (
    InSituOptions,
    InSituSet,
    KnownLimb,
    MassCandidate,
    calibrate_in_situ,
    plan_excitation,
    prior_from_factory,
    prior_from_fit,
)
from surefoot.calibration.in_situ.excitation import GOALS
from surefoot.calibration.results import CalibrationRefused, FitResult

MASSES = [MassCandidate(m, com) for m, com in zip(ADDED_MASS, ADDED_COM_LEG, strict=True)]
_, MASS, COM, _ = SENSORS["leg"]
SIZE = np.array([48.0, 48.0, 48.0, 10.0, 10.0, 10.0])


def grid(n):
    """Gravity at n x n angles of the hip, row by row."""
    front, side = np.meshgrid(
        np.radians(np.linspace(-35.0, 35.0, n)), np.radians(np.linspace(-45.0, 45.0, n)), indexing="ij"
    )
    a, b = front.ravel(), side.ravel()
    return 9.81 * np.stack([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)], axis=-1)


@pytest.fixture(scope="module")
def prior():
    return prior_from_factory(LEG_MATRIX, KnownLimb(5.2, 0.3, np.array([0.0, 0.0, 0.2]), 0.03))


def reading_rows(prior, gravity, mass, masses):
    """Rows of a reading by (D, m, m c, offsets), by finite differences of the model in whitened counts."""
    k = 6

    def read(theta):
        A = prior.response @ (np.eye(6) + theta[:36].reshape(6, 6))
        m = prior.limb.mass + theta[36] + masses[mass].mass
        mc = prior.limb.mass_com + theta[37:40] + masses[mass].mass * np.asarray(masses[mass].com)
        offset = theta[40 + k * mass : 40 + k * (mass + 1)]
        return A @ np.concatenate([m * gravity, np.cross(mc, gravity)]) + offset

    size = 40 + k * len(masses)
    steps = 1e-4 * np.eye(size)
    J = np.stack([(read(step) - read(-step)) / 2e-4 for step in steps], axis=1)
    return np.linalg.solve(np.linalg.cholesky(prior.noise), J)


class Brute:
    """Information of readings by matrices of information, with rows by finite differences."""

    def __init__(self, prior, gravity, masses, samples):
        self.samples = samples
        size = 40 + 6 * len(masses)
        self.start = np.zeros((size, size))
        self.start[:40, :40] = prior.covariance
        for first in range(40, size, 6):
            self.start[first : first + 6, first : first + 6] = prior.new_offset
        self.before = np.linalg.inv(self.start)
        self.rows = cache(lambda pose: reading_rows(prior, gravity[pose[0]], pose[1], masses))

    def after(self, poses):
        """Covariance once (orientation, mass) pairs were read."""
        information = self.before
        for H in map(self.rows, poses):
            information = information + self.samples * H.T @ H
        return np.linalg.inv(information)

    def information(self, poses, goal):
        """Half the fall of log det of the goal's covariance."""
        q = slice(40, 46) if goal == "offset" else GOALS[goal]
        before, after = self.start[q, q], self.after(poses)[q, q]
        return 0.5 * (np.linalg.slogdet(before)[1] - np.linalg.slogdet(after)[1])


@pytest.mark.parametrize("goal", list(GOALS))
def test_information_is_the_fall_of_the_goals_uncertainty(prior, goal):
    gravity, masses = grid(3), MASSES[:2]
    plan = plan_excitation(prior, gravity, masses, count=5, goal=goal, samples=10)
    brute, total = Brute(prior, gravity, masses, 10), 0.0
    for taken, pose in enumerate(plan.poses):
        total += pose.information
        poses = [(p.orientation, p.mass) for p in plan.poses[: taken + 1]]
        assert total == pytest.approx(brute.information(poses, goal), rel=1e-5, abs=1e-5)
    assert plan.total == pytest.approx(total)
    for orientation, mass in ((0, 0), (4, 1)):
        wanted = brute.information([(orientation, mass)], goal)
        assert plan.pose_information[orientation, mass] == pytest.approx(wanted, rel=1e-4, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("goal", ["calibration", "mass", "offset"])
def test_a_block_is_near_the_best_of_all(prior, goal):
    gravity, masses = grid(3), [MASSES[0]]
    plan = plan_excitation(prior, gravity, masses, count=3, block=3, goal=goal, samples=10)
    brute = Brute(prior, gravity, masses, 10)
    chosen = combinations_with_replacement(range(len(gravity)), 3)
    best = max(brute.information([(o, 0) for o in one], goal) for one in chosen)
    assert plan.total <= best + 1e-5
    assert plan.total > 0.99 * best


def random_poses(rng, gravity, count):
    return [(int(rng.integers(len(gravity))), i % len(MASSES)) for i in range(count)]


def raster_poses(gravity, count):
    """Sweep the grid evenly, once with each mass."""
    shares = [len(part) for part in np.array_split(np.arange(count), len(MASSES))]
    return [
        (int(o), mass) for mass, n in enumerate(shares) for o in np.linspace(0, len(gravity) - 1, n).round()
    ]


@pytest.mark.slow
def test_planned_poses_leave_less_uncertainty_than_random_or_raster_ones(prior):
    gravity, rng = grid(7), np.random.default_rng(0)
    plan = plan_excitation(prior, gravity, MASSES, count=30, samples=20)
    others = [raster_poses(gravity, 30), *(random_poses(rng, gravity, 30) for _ in range(5))]
    brute = Brute(prior, gravity, MASSES, 20)
    # Over 40 unknowns 4 nats are a tenth off every deviation.
    assert plan.total > max(brute.information(poses, "calibration") for poses in others) + 4.0
    before, after = np.diag(plan.before), np.diag(plan.after)
    assert (after < before).all()


def sensors(rng):
    X = np.where(np.eye(6, dtype=bool), 0.2, 0.03 * np.repeat([1500.0, 35.0], 3)[:, None])
    X = np.where(np.eye(6, dtype=bool), X, X / np.repeat([1500.0, 35.0], 3))
    return RESPONSE @ (np.eye(6) + 0.5 * X * rng.standard_normal((6, 6)))


def read(response, poses, gravity, rng, samples):
    sets = []
    for j, mass in enumerate(MASSES):
        g = np.repeat(gravity[[o for o, held in poses if held == j]], samples, axis=0)
        M = wrench_of_gravity(MASS, COM) + wrench_of_gravity(mass.mass, np.asarray(mass.com))
        noise = rng.standard_normal((len(g), 6)) @ NOISE_ROOT.T
        zero = OFFSET + NOISE_ROOT @ (100.0 * rng.standard_normal(6))
        raw = g @ M.T @ response.T + zero + noise
        sets.append(InSituSet(raw, g, mass.mass, mass.com, name=f"set {j + 1}"))
    return sets


@pytest.mark.slow
def test_planned_poses_leave_smaller_errors_than_random_or_raster_ones(prior):
    gravity = grid(7)
    plan = plan_excitation(prior, gravity, MASSES, count=30, samples=20, goal="matrix")
    planned = [(pose.orientation, pose.mass) for pose in plan.poses]
    options = InSituOptions(hysteresis=False, factory_std=(0.2,) * 6)
    squares = {"planned": [], "random": [], "raster": []}
    for seed in range(16):
        rng = np.random.default_rng([43, seed])
        response = sensors(rng)
        ways = (planned, random_poses(rng, gravity, 30), raster_poses(gravity, 30))
        for name, poses in zip(squares, ways, strict=True):
            sets = read(response, poses, gravity, rng, 20)
            fit = calibrate_in_situ(sets, factory_matrix=LEG_MATRIX, options=options, accept="noise")
            D = (fit.matrix @ response - np.eye(6)) * SIZE / SIZE[:, None]
            squares[name].append(np.mean(D**2))
    errors = {name: np.sqrt(np.mean(values)) for name, values in squares.items()}
    assert errors["planned"] < 0.9 * errors["raster"]
    assert errors["planned"] < 0.9 * errors["random"]


def after(prior, gravity, masses, poses):
    """The prior once these poses were read: their sets are over, and their offsets gone with them."""
    covariance = Brute(prior, gravity, masses, 100).after(poses)[:40, :40]
    return replace(prior, covariance=covariance)


def test_a_third_mass_is_proposed_when_two_were_seen(prior):
    gravity = grid(5)
    corners = [0, 4, 12, 20, 24]
    seen = after(prior, gravity, MASSES, [(o, mass) for mass in (0, 1) for o in corners])
    plan = plan_excitation(seen, gravity, MASSES[:3], count=4, goal="matrix")
    assert [pose.mass for pose in plan.poses] == [2] * 4
    # Lemma 2: what the two left open is worth far more than another look at them.
    assert plan.mass_information[2] > 5.0 * plan.mass_information[:2].max()
    complete = after(seen, gravity, MASSES, [(o, 2) for o in corners])
    again = plan_excitation(complete, gravity, MASSES[:3], count=4, goal="matrix")
    assert again.mass_information[2] < 0.5 * plan.mass_information[2]


def test_a_reading_with_a_new_mass_and_an_unknown_offset_brings_little(prior):
    gravity = grid(3)
    known = MassCandidate(*MASSES[1][:2], offset_covariance=NOISE_ROOT @ NOISE_ROOT.T)
    plan = plan_excitation(prior, gravity, [MASSES[1], known], count=1, block=1)
    assert (plan.pose_information[:, 1] > 10.0 * plan.pose_information[:, 0]).all()
    assert plan.poses[0].mass == 1


def test_a_fit_is_a_prior():
    gravity = grid(3)
    plan = plan_excitation(make_fit(), gravity, MASSES, count=8)
    assert plan.total > 0.0
    wanted = prior_from_fit(make_fit()).covariance
    np.testing.assert_array_equal(plan.before, wanted)
    # D of C' = (1 + D)^-1 C, as the fit's covariance was made of half a per cent of scale.
    np.testing.assert_allclose(np.sqrt(np.diag(wanted))[[0, 7, 14, 21, 28, 35]], 0.005, rtol=1e-9)


def test_more_samples_and_more_poses_bring_more(prior):
    gravity = grid(3)
    totals = [
        plan_excitation(prior, gravity, MASSES, count=count, samples=samples).total
        for count, samples in ((8, 10), (8, 100), (16, 100))
    ]
    assert totals[0] < totals[1] < totals[2]


def test_what_has_no_meaning_is_refused(prior):
    gravity = grid(3)
    with pytest.raises(ValueError, match="'goal' must be one of"):
        plan_excitation(prior, gravity, goal="everything")
    with pytest.raises(ValueError, match="'count' must be a whole number"):
        plan_excitation(prior, gravity, count=0)
    with pytest.raises(ValueError, match="'gravity' must be finite"):
        plan_excitation(prior, gravity[:, :2])
    with pytest.raises(ValueError, match="at least one mass"):
        plan_excitation(prior, gravity, [])
    with pytest.raises(ValueError, match="'mass' must not be negative"):
        plan_excitation(prior, gravity, [MassCandidate(-1.0)])
    with pytest.raises(ValueError, match="rank 6"):
        prior_from_factory(np.zeros((6, 6)), KnownLimb(5.0, 0.5))
    with pytest.raises(ValueError, match="'scale_std' must be positive"):
        prior_from_factory(LEG_MATRIX, KnownLimb(5.0, 0.5), scale_std=0.0)
    refused = make_fit(result=FitResult.REFUSED, refusals=(CalibrationRefused("Too few.", "More."),))
    with pytest.raises(ValueError, match="this fit was refused"):
        plan_excitation(refused, gravity)
