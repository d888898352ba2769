"""Episode starts: what is kept, and what belonged to the stream."""

import numpy as np
import pytest
from _robots import rows_between, short
from _robots import stream as streamed
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, walk

from surefoot.calibration import METHODS, OnlineSetup, Reference, online_method
from surefoot.calibration.episodes import LEARNT, begin_episode

LAG = 2
# Blocks are full at every 16th sample, states are kept to go back to at every 8th block.
WHOLE = 8 * 16


def build(name):
    setup = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, lag=LAG)
    return online_method(name, setup, **short(name))


@pytest.fixture(scope="module")
def logs():
    return [walk(seed, 0.1, 6.0, 0.5, Faults.bad()) for seed in range(3)]


def stream(method, log, samples, state=None, start=0):
    part = rows_between(log.reference, start, start + samples)
    return streamed(method, log.raw[start : start + samples], part, state)[:2]


def with_learnt(state, other):
    """Return a state that has learnt what another one has, at the same sample."""
    parts = {}
    for name, part in state._asdict().items():
        if isinstance(part, tuple) and name not in LEARNT[type(state)]:
            parts[name] = with_learnt(part, getattr(other, name))
        elif name in LEARNT[type(state)] and name != "step":
            parts[name] = getattr(other, name)
    return state._replace(**parts)


@pytest.mark.parametrize("name", METHODS)
def test_what_is_learnt_is_named_by_its_fields(name):
    def check(state):
        assert set(LEARNT[type(state)]) <= set(state._fields)
        for leaf in state:
            if isinstance(leaf, tuple):
                check(leaf)

    check(build(name).init(np.zeros(8)))


@pytest.mark.parametrize("name", METHODS)
def test_the_rest_is_that_of_a_fresh_state(name, logs):
    method = build(name)
    fresh, (state, _) = method.init(np.zeros(8)), stream(method, logs[1], 105)
    begun = begin_episode(fresh, state)

    def check(begun, fresh, state):
        for field in state._fields:
            now, new, old = (getattr(part, field) for part in (begun, fresh, state))
            if field in LEARNT[type(state)]:
                assert now is old, field
            elif isinstance(now, tuple):
                check(now, new, old)
            else:
                np.testing.assert_array_equal(now, new, err_msg=field)

    check(begun, fresh, state)
    assert not getattr(begun, "front", begun).known


@pytest.mark.parametrize("name", METHODS)
def test_who_is_put_back_keeps_the_map(name, logs):
    method, farthest = build(name), 0.0
    for log in logs:
        state, before = stream(method, log, 200)
        _, after = stream(method, log, 1, begin_episode(method.init(log.raw[0]), state), 200)
        off = np.abs(before.scale / NOMINAL.scale - 1.0) + np.abs(before.offset - NOMINAL.offset)
        farthest = max(farthest, off.max())
        np.testing.assert_array_equal(after.scale, before.scale)
        np.testing.assert_array_equal(after.offset, before.offset)
    assert (farthest > 0.01) == (name != "none")


@pytest.mark.parametrize("name", METHODS)
def test_nothing_is_learnt_across_the_seam(name, logs):
    """What the robot did before it was put back has no say in what it learns after."""
    method, log = build(name), logs[0]
    state, _ = stream(method, log, WHOLE)
    fresh, ends = method.init(log.raw[0]), []
    # Another last second: feet that stood elsewhere, and forces that were not these.
    for last in (log, logs[2]):
        seen, _ = stream(method, last, 100, state, WHOLE)
        back = begin_episode(fresh, with_learnt(seen, state))
        ends.append(stream(method, log, 100, back, WHOLE + 100)[1])
    np.testing.assert_array_equal(ends[0].scale, ends[1].scale)
    np.testing.assert_array_equal(ends[0].offset, ends[1].offset)


def test_forces_before_the_seam_wait_for_no_reference(logs):
    method, log = build("tare"), logs[0]
    state, _ = stream(method, log, 50)
    state = begin_episode(method.init(log.raw[0]), state)
    for k in range(LAG + 1):
        row = Reference(*(part[50 + k] for part in log.reference))
        state, _ = method.update(state, log.raw[50 + k], row, DT)
        assert (state.front.history[0, 8:] == (1.0 if k == LAG else 0.0)).all()


def test_a_state_of_nobodys_method_is_refused():
    with pytest.raises(TypeError, match="What a Reference has learnt is not known"):
        begin_episode(*[Reference(*[np.zeros(3)] * 9)] * 2)
