"""The filter's one step against textbooks that share no code with it."""

import numpy as np
import pytest

from surefoot.calibration.kalman import kalman_step

NEVER = 1e9
"""A gate that no innovation reaches."""


def problem(seed, unknowns=7, rows=4):
    rng = np.random.default_rng([11, seed])
    root = rng.normal(size=(unknowns, unknowns))
    return (
        rng,
        rng.normal(size=unknowns),
        root @ root.T + 0.1 * np.eye(unknowns),
        rng.normal(size=(rows, unknowns)),
        rng.uniform(0.05, 2.0, rows),
    )


def take(mean, covariance, H, y, variance, learnt=None, gate=NEVER):
    learnt = np.ones(len(mean)) if learnt is None else learnt
    return kalman_step(mean, covariance, H, y, variance, learnt.astype(mean.dtype), gate)


@pytest.mark.parametrize("seed", range(5))
def test_one_step_is_the_information_form(seed):
    rng, mean, P, H, R = problem(seed)
    y = rng.normal(size=4)
    step = take(mean, P, H, y, R)
    information = np.linalg.inv(P) + H.T @ (H / R[:, None])
    found = np.linalg.solve(information, np.linalg.solve(P, mean) + H.T @ (y / R))
    np.testing.assert_allclose(step.mean, found, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(step.covariance, np.linalg.inv(information), rtol=1e-10, atol=1e-10)
    innovation = y - H @ mean
    nis = innovation @ np.linalg.inv(H @ P @ H.T + np.diag(R)) @ innovation
    assert step.nis == pytest.approx(nis, rel=1e-10)
    assert step.rows == 4


def test_many_steps_are_one_least_squares_over_the_whole_path():
    rng, mean, P, *_ = problem(3, unknowns=5)
    walk = rng.uniform(0.01, 0.2, 5)
    steps, N = 6, 5
    H, y = rng.normal(size=(steps, 3, N)), rng.normal(size=(steps, 3))
    R = rng.uniform(0.1, 1.0, (steps, 3))

    # Whitened equations of the path x_1 ... x_n: the prior, each walk and each row; no recursion.
    whiten = np.linalg.inv(np.linalg.cholesky(P + np.diag(walk)))
    equations, right = np.zeros((0, steps * N)), np.zeros(0)

    def add(block, columns, value):
        nonlocal equations, right
        row = np.zeros((len(value), steps * N))
        for where, part in zip(columns, block, strict=True):
            row[:, where * N : (where + 1) * N] = part
        equations, right = np.vstack([equations, row]), np.concatenate([right, value])

    add([whiten], [0], whiten @ mean)
    for k in range(steps):
        if k:
            root = np.diag(1.0 / np.sqrt(walk))
            add([-root, root], [k - 1, k], np.zeros(N))
        add([H[k] / np.sqrt(R[k])[:, None]], [k], y[k] / np.sqrt(R[k]))
    path, *_ = np.linalg.lstsq(equations, right, rcond=None)
    triangle = np.linalg.qr(equations, mode="r")
    inverse = np.linalg.inv(triangle)
    spread = (inverse @ inverse.T)[-N:, -N:]

    covariance = P
    for k in range(steps):
        step = take(mean, covariance + np.diag(walk), H[k], y[k], R[k])
        mean, covariance = step.mean, step.covariance
    np.testing.assert_allclose(mean, path[-N:], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(covariance, spread, rtol=1e-10, atol=1e-10)


def test_more_rows_than_unknowns_are_the_information_form_too():
    rng, mean, P, H, R = problem(8, unknowns=4, rows=9)
    y = rng.normal(size=9)
    step = take(mean, P, H, y, R)
    information = np.linalg.inv(P) + H.T @ (H / R[:, None])
    np.testing.assert_allclose(step.covariance, np.linalg.inv(information), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        step.mean, np.linalg.solve(information, np.linalg.solve(P, mean) + H.T @ (y / R)), rtol=1e-9
    )


def test_rows_of_zeros_say_nothing():
    rng, mean, P, H, R = problem(1)
    y = rng.normal(size=4)
    H[2], y[2] = 0.0, 0.0
    step = take(mean, P, H, y, R)
    less = take(mean, P, np.delete(H, 2, 0), np.delete(y, 2), np.delete(R, 2))
    np.testing.assert_allclose(step.mean, less.mean, atol=1e-12)
    np.testing.assert_allclose(step.covariance, less.covariance, atol=1e-12)
    assert step.nis == pytest.approx(float(less.nis), rel=1e-12)
    assert step.rows == 3


@pytest.mark.parametrize("seed", range(3))
def test_a_considered_unknown_stays_and_is_reckoned_with(seed):
    rng, mean, P, *_ = problem(seed)
    learnt = np.array([1, 1, 0, 1, 1, 0, 1.0])
    best, considered = learnt > 0.5, learnt < 0.5
    x, S = mean, P
    for _ in range(8):
        H, y, R = rng.normal(size=(3, 7)), rng.normal(size=3), rng.uniform(0.1, 1.0, 3)
        V = H @ S @ H.T + np.diag(R)
        # Schmidt (1966), block by block: the optimal gain of what is estimated, none for the rest.
        gain = np.linalg.solve(V, H @ S[:, best]).T
        expected = S.copy()
        expected[np.ix_(best, best)] -= gain @ V @ gain.T
        expected[np.ix_(best, considered)] -= gain @ H @ S[:, considered]
        expected[np.ix_(considered, best)] = expected[np.ix_(best, considered)].T
        step = take(x, S, H, y, R, learnt)
        np.testing.assert_array_equal(step.mean[considered], mean[considered])
        np.testing.assert_allclose(step.mean[best], x[best] + gain @ (y - H @ x), rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(step.covariance, expected, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(
            step.covariance[np.ix_(considered, considered)], P[np.ix_(considered, considered)], rtol=1e-12
        )
        x, S = step.mean, step.covariance


def test_with_considered_unknowns_the_claimed_covariance_is_the_real_one():
    rng, _, P, *_ = problem(2, unknowns=4)
    learnt, draws = np.array([1, 1, 1, 0.0]), 20_000
    truth = rng.normal(size=(draws, 4)) @ np.linalg.cholesky(P).T
    x, S = np.zeros((draws, 4)), P
    for _ in range(5):
        H, R = rng.normal(size=(2, 4)), np.array([0.3, 0.05])
        y = truth @ H.T + rng.normal(size=(draws, 2)) * np.sqrt(R)
        # The gain, the same for all draws, is what an innovation of one in each row moves.
        steps = [take(np.zeros(4), S, H, one, R, learnt) for one in np.eye(2)]
        x, S = x + (y - x @ H.T) @ np.array([step.mean for step in steps]), steps[0].covariance
    whitened = np.linalg.solve(np.linalg.cholesky(S), (x - truth).T)
    # Entries of a sample covariance scatter by sqrt(2 / draws) and less.
    np.testing.assert_allclose(whitened @ whitened.T / draws, np.eye(4), atol=5.0 * np.sqrt(2.0 / draws))


@pytest.mark.parametrize("size", [4.0, 10.0, 100.0, 1e6])
def test_an_outlier_pulls_no_harder_than_a_row_at_the_gate(size):
    _, mean, P, H, R = problem(4, rows=1)
    spread = np.sqrt(H @ P @ H.T + R)[0]

    def pull(deviations):
        step = take(mean, P, H, H @ mean + deviations * spread, R, gate=3.0)
        return step, np.abs(step.mean - mean).max()

    at_gate, beyond = pull(3.0), pull(size)
    assert beyond[1] <= at_gate[1] * (1.0 + 1e-12)
    assert beyond[0].nis == pytest.approx(9.0)
    below, ungated = pull(2.9)[0], take(mean, P, H, H @ mean + 2.9 * spread, R)
    np.testing.assert_array_equal(below.mean, ungated.mean)
    np.testing.assert_array_equal(below.covariance, ungated.covariance)
    # What an outlier told was not worth much, and that is what is claimed.
    assert (np.diag(beyond[0].covariance) >= np.diag(at_gate[0].covariance) - 1e-12).all()
    assert (np.diag(beyond[0].covariance) <= np.diag(P) + 1e-12).all()


def test_an_outlier_leaves_the_other_rows_their_say():
    rng, mean, P, H, R = problem(6)
    truth = mean + np.linalg.cholesky(P) @ rng.normal(size=7)
    y = H @ truth + 0.1 * np.sqrt(R) * rng.normal(size=4)
    spoilt = y.copy()
    spoilt[1] += 100.0 * np.sqrt((H @ P @ H.T)[1, 1] + R[1])
    without = take(mean, P, np.delete(H, 1, 0), np.delete(y, 1), np.delete(R, 1))
    gated, trusting = take(mean, P, H, spoilt, R, gate=3.0), take(mean, P, H, spoilt, R)
    away = [np.linalg.norm(step.mean - without.mean) for step in (gated, trusting)]
    assert away[0] < 0.1 * away[1]


@pytest.mark.slow
@pytest.mark.parametrize("learnt", [np.ones(12), np.array([1.0] * 10 + [0.0] * 2)])
def test_ten_thousand_steps_in_single_precision_stay_positive(learnt):
    rng = np.random.default_rng(9)
    std = np.array([0.12] * 4 + [0.03] * 4 + [0.01, 0.005, 0.002, 0.004])
    walk = (1e-3 * std) ** 2 * learnt
    wide, narrow = (
        (np.zeros(12, dtype), np.diag(std**2).astype(dtype), walk.astype(dtype))
        for dtype in (np.float64, np.float32)
    )
    truth = std * rng.normal(size=12)
    for _ in range(10_000):
        H = rng.normal(size=(3, 12)) * rng.choice([1e-3, 1.0], size=(3, 1))
        y, R = H @ truth + 0.005 * rng.normal(size=3), np.full(3, 0.005**2)
        results = []
        for mean, S, drift in (wide, narrow):
            rows = (part.astype(mean.dtype) for part in (H, y, R))
            step = take(mean, S + np.diag(drift), *rows, learnt, 3.0)
            results.append((step.mean, step.covariance, drift))
        wide, narrow = results
    assert narrow[1].dtype == np.float32
    np.testing.assert_array_equal(narrow[1], narrow[1].T)
    scaled = narrow[1].astype(np.float64) / np.outer(std, std)
    assert np.linalg.eigvalsh(scaled).min() > 0.0
    spread = np.sqrt(np.diag(wide[1]))
    assert (np.abs(narrow[0] - wide[0]) < 0.02 * spread + 1e-6).all()
    np.testing.assert_allclose(np.sqrt(np.diag(narrow[1])), spread, rtol=0.01)
