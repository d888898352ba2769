"""Each step from what the robot's motion contradicts to a repair, on its own."""

import numpy as np
import pytest
from _synthetic import LAYOUT, MASS

from surefoot.calibration import GRAVITY, Flag, OnlineSetup, Parameters
from surefoot.calibration.moment.hypotheses import SUSPICION, TRUST, Contradiction, Evidence, Hypotheses
from surefoot.calibration.moment.rows import Residuals

K, ROWS, WEIGHT = 8, 12, MASS * GRAVITY
CHANGE = np.array([0.024, 0.024, 0.05])
SETUP = OnlineSetup(layout=LAYOUT, mass=MASS, initial=Parameters(np.ones(K), np.zeros(K)))
HYPOTHESES = Hypotheses(SETUP, np.ones(K, bool), CHANGE)
FIRST, SECOND = 2, 5
PAIR = [(i, j) for i in range(K) for j in range(K) if i < j].index((FIRST, SECOND))
WRONG = {
    "out": (HYPOTHESES.out.start + FIRST, lambda force: 0.0 * force[:, [FIRST]], [FIRST]),
    "flipped": (HYPOTHESES.flipped.start + FIRST, lambda force: -force[:, [FIRST]], [FIRST]),
    "straight": (
        HYPOTHESES.straight.start + PAIR,
        lambda force: force[:, [SECOND, FIRST]],
        [FIRST, SECOND],
    ),
    "crossed": (
        HYPOTHESES.crossed.start + PAIR,
        lambda force: -force[:, [SECOND, FIRST]],
        [FIRST, SECOND],
    ),
}


def residuals(values, variance=1.0):
    there = np.ones(len(values))
    mean = np.mean(np.clip(values**2 / variance, 0.0, 30.0))
    return Residuals(values, np.full(len(values), variance), there, float(mean))


def block(kind=None, load=(0.0, 0.0, 0.0), seed=1):
    """A block in which a channel is wrong, or a load was put on; and how each force follows from others."""
    rng = np.random.default_rng(seed)
    true, places = rng.normal(size=(ROWS, K)) * 10.0, rng.normal(size=(ROWS, K)) / WEIGHT
    # Each force as a sum of others' that holds exactly in these rows, so that what is out can be replaced.
    others = np.array([0.5 * np.eye(K)[(i + 1) % K] for i in range(K)])
    true[:, FIRST] = 0.5 * true[:, (FIRST + 1) % K]
    read = true.copy()
    if kind is not None:
        _, misread, channels = WRONG[kind]
        read[:, channels] = misread(true)
    columns = rng.normal(size=(ROWS, 3))
    left = np.sum(places * (true - read), axis=-1) + columns @ np.asarray(load)
    seen = Contradiction(
        residuals=residuals(left, 1e-4),
        places=places,
        reading=read,
        scale=np.ones(K),
        force=read,
        load=columns,
        mass=0.0,
    )
    return seen, others


@pytest.mark.parametrize("kind", WRONG)
def test_the_right_hypothesis_leaves_nothing(kind):
    seen, others = block(kind)
    error, change = HYPOTHESES.changes(seen, others)
    assert error.shape == change.shape == (ROWS, HYPOTHESES.count)
    left = np.abs(seen.residuals.residual[:, None] + change).max(axis=0)
    assert left[WRONG[kind][0]] < 1e-12
    assert np.abs(seen.residuals.residual).max() > 0.1
    # That the channel is out explains it as well, as the others make it up exactly.
    assert (np.delete(left, [WRONG[kind][0], HYPOTHESES.out.start + FIRST]) > 1e-3).all()


def gathered(seen, others, blocks, **before):
    """The evidence after some blocks of the same kind."""
    known = {
        "doubt": 0.0,
        "scores": np.zeros(HYPOTHESES.count + 2),
        "size": np.zeros(HYPOTHESES.count),
    }
    known |= {"load": np.zeros((3, 4)), **before}
    error, change = HYPOTHESES.changes(seen, others)
    for _ in range(blocks):
        evidence = HYPOTHESES.evidence(seen, error, change, **known)
        known = {name: getattr(evidence, name) for name in known}
    return evidence


def test_evidence_is_that_of_whole_blocks():
    seen, others = block("flipped")
    first, second, third = (gathered(seen, others, n) for n in (1, 2, 3))
    # The fault begins somewhere in the first block, which is no evidence.
    assert (first.doubt, second.doubt, third.doubt) == (1.0, 2.0, 3.0)
    assert not first.scores.any()
    right = WRONG["flipped"][0]
    assert second.scores[0] == pytest.approx(seen.residuals.mean)
    assert second.scores[0] > SUSPICION
    assert second.scores[1 + right] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(third.scores[:-1], second.scores[:-1])
    assert second.latest[right] == pytest.approx(2.0 * np.abs(seen.reading[:, FIRST]).max())
    np.testing.assert_array_equal(third.size, second.size)


def test_a_load_is_fitted_to_all_blocks_and_must_be_one_that_a_robot_can_carry():
    load = np.array([0.01, -0.02, -0.06])
    evidence = gathered(*block(load=load), 3)
    assert evidence.scores[-1] < 0.05 * evidence.scores[0]
    assert evidence.load_possible
    for impossible in (
        [0.01, -0.02, 0.06],
        [0.3, 0.0, 0.0],
    ):  # it lacks mass; the mass would be outside the foot
        assert not gathered(*block(load=impossible), 3).load_possible


def test_doubt_ends_when_all_is_calm_or_after_long():
    seen, others = block("flipped")
    calm, _ = block()
    assert gathered(calm, others, 1).doubt == 0.0
    assert gathered(calm, others, 1, doubt=2.0, scores=np.zeros(HYPOTHESES.count + 2)).doubt == 0.0
    assert gathered(seen, others, 10).doubt == 10.0
    assert gathered(seen, others, 11).doubt == 0.0


def evidence(scores, *, doubt=3.0, load=20.0, possible=True, latest=WEIGHT, size=WEIGHT):
    """Evidence in which hypotheses leave what is said and all others leave 20."""
    of_channels = np.full(HYPOTHESES.count, 20.0)
    for index, score in scores.items():
        of_channels[index] = score
    return Evidence(
        doubt=doubt,
        scores=np.concatenate([[20.0], of_channels, [load]]),
        size=np.full(HYPOTHESES.count, size),
        latest=np.full(HYPOTHESES.count, latest),
        load=np.zeros((3, 4)),
        load_possible=possible,
    )


FLIPPED, OTHER = WRONG["flipped"][0], HYPOTHESES.flipped.start + SECOND


@pytest.mark.parametrize(
    ("found", "trust", "lost", "believed"),
    [
        (evidence({FLIPPED: 1.0}), TRUST, None, "fault"),
        (evidence({FLIPPED: 1.0}, doubt=1.0), TRUST, None, None),
        (evidence({FLIPPED: 1.0}), TRUST - 1.0, None, None),
        (evidence({FLIPPED: 9.0}), TRUST, None, None),
        (evidence({FLIPPED: 4.0, OTHER: 5.0}), TRUST, None, None),
        # The same channel explained otherwise is no rival, and putting it right is preferred to losing it.
        (evidence({FLIPPED: 4.0, FIRST: 4.0}), TRUST, None, "fault"),
        (evidence({FLIPPED: 1.0}), TRUST, FIRST, None),
        (evidence({FLIPPED: 1.0}, latest=0.01 * WEIGHT), TRUST, None, None),
        (evidence({FLIPPED: 1.0}, load=1.5), TRUST, None, None),
        (evidence({FLIPPED: 1.0}, load=1.5, possible=False), TRUST, None, "fault"),
        (evidence({}, load=1.0), TRUST, None, "load"),
        (evidence({}, load=1.0, doubt=2.0), TRUST, None, None),
        (evidence({}, load=1.0, possible=False), TRUST, None, None),
        (evidence({FLIPPED: 3.0}, load=1.0), TRUST, None, None),
        (evidence({FLIPPED: 3.0}, load=1.0, latest=0.0, size=0.0), TRUST, None, "load"),
    ],
)
def test_what_is_believed(found, trust, lost, believed):
    gone = np.zeros(K) if lost is None else np.eye(K)[lost]
    decision = HYPOTHESES.decide(found, trust, gone)
    assert decision == (FLIPPED if believed == "fault" else None, believed == "load")


@pytest.mark.parametrize("kind", ["flipped", "straight", "crossed"])
def test_a_repair_undoes_what_is_wrong(kind):
    index, misread, channels = WRONG[kind]
    true = np.arange(1.0, K + 1.0)[None]
    read = true.copy()
    read[:, channels] = misread(true)
    wiring, flags = HYPOTHESES.repair(index, np.eye(K), np.zeros(K, np.int64))
    np.testing.assert_array_equal(read @ wiring.T, true)
    named = Flag.FLIPPED if kind == "flipped" else Flag.SWAPPED
    np.testing.assert_array_equal(flags[channels], int(named))
    assert np.count_nonzero(flags) == len(channels)
    # Found once more it was no fault but a repair too much.
    again, flags = HYPOTHESES.repair(index, wiring, flags)
    np.testing.assert_array_equal(again, np.eye(K))
    assert not flags.any()


def test_only_cells_under_one_plate_are_suspected():
    cells = np.arange(K) < 4
    found = evidence({FLIPPED: 1.0, HYPOTHESES.flipped.start + 6: 0.1})
    few = Hypotheses(SETUP, cells, CHANGE)
    assert few.count == 2 * K + 2 * 6
    scores = np.concatenate([[20.0], np.full(few.count, 20.0), [20.0]])
    scores[1 + few.flipped.start + 6] = 0.1
    size = np.full(few.count, WEIGHT)
    found = found._replace(scores=scores, size=size, latest=size)
    assert few.decide(found, TRUST, np.zeros(K)).fault is None
