"""Episode starts of some robots of a batch."""

import numpy as np
import pytest
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, walk

from surefoot.calibration import METHODS, OnlineSetup, Reference, online_method
from surefoot.calibration.episodes import LEARNT, begin_episode

LAG = 2
SETUP = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, lag=LAG)
SHORT = {"standing_warm_up": 0.1, "standing_duration": 0.2, "standing_samples": 10}
# Blocks are full at every 16th sample, states are kept to go back to at every 8th block.
WHOLE = 8 * 16


def build(name, lag=LAG, **options):
    config = METHODS[name].config
    if config is not None and "standing_warm_up" in config.__dataclass_fields__:
        options = SHORT | options
    setup = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, lag=lag)
    return online_method(name, setup, **options)


@pytest.fixture(scope="module")
def log():
    """Readings (N, 3, K) and references of three walks side by side."""
    walks = [walk(seed, 0.1, 6.0, 0.5, Faults.bad()) for seed in range(3)]
    raw = np.stack([one.raw for one in walks], axis=1)
    parts = zip(*(one.reference for one in walks), strict=True)
    return raw, Reference(*(np.stack(part, axis=1) for part in parts))


def at(log, k):
    raw, reference = log
    return raw[k], Reference(*(part[k] for part in reference))


def stream(method, log, samples, state=None, start=0):
    state = method.init(log[0][0]) if state is None else state
    estimates = []
    for k in range(start, start + samples):
        state, estimate = method.update(state, *at(log, k), DT)
        estimates.append(estimate)
    return state, estimates


def named_leaves(state, path=""):
    for name in state._fields:
        leaf = getattr(state, name)
        if isinstance(leaf, tuple):
            yield from named_leaves(leaf, f"{path}{name}.")
        else:
            yield f"{path}{name}", leaf


def with_learnt(state, other):
    """Return a state that has learnt what another one has."""
    parts = {}
    for name, part in state._asdict().items():
        if isinstance(part, tuple) and name not in LEARNT[type(state)]:
            parts[name] = with_learnt(part, getattr(other, name))
        elif name in LEARNT[type(state)] or name == "altered":
            parts[name] = getattr(other, name)
    return state._replace(**parts)


@pytest.mark.parametrize("name", METHODS)
def test_every_part_of_a_state_is_known(name):
    """A new field must be told to be learnt or of the stream, or be one of the whole numbers of a batch."""

    def check(state):
        assert set(LEARNT[type(state)]) <= set(state._fields)
        for field in state._fields:
            leaf = getattr(state, field)
            if isinstance(leaf, tuple):
                check(leaf)
            elif isinstance(leaf, int):
                assert field in ("step", "all_walking", "altered")
            else:
                assert leaf.shape[0] == 5  # robots come first

    check(build(name).init(np.zeros((5, 8))))


@pytest.mark.parametrize("name", METHODS)
def test_the_others_keep_theirs_bit_for_bit(name, log):
    method = build(name)
    state, _ = stream(method, log, 100)
    _, theirs = stream(method, log, 60, state, 100)
    changed = begin_episode(np.array([False, True, False]), method.init(log[0][0]), state)
    for (path, old), (_, new) in zip(named_leaves(state), named_leaves(changed), strict=True):
        if not isinstance(old, int):
            np.testing.assert_array_equal(new[[0, 2]], old[[0, 2]], err_msg=path)
    # Nor do they notice later on.
    _, ours = stream(method, log, 60, changed, 100)
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(one.force[[0, 2]], other.force[[0, 2]])
        np.testing.assert_array_equal(one.flags[[0, 2]], other.flags[[0, 2]])


@pytest.mark.parametrize("name", METHODS)
def test_who_is_put_back_keeps_the_map(name, log):
    method = build(name)
    state, before = stream(method, log, 200)
    back = begin_episode(np.array([True, True, False]), method.init(log[0][0]), state)
    _, after = stream(method, log, 1, back, 200)
    learns = name != "none"
    start = np.abs(before[-1].scale / NOMINAL.scale - 1.0) + np.abs(before[-1].offset - NOMINAL.offset)
    assert (start.max() > 0.01) == learns
    np.testing.assert_array_equal(after[0].scale, before[-1].scale)
    np.testing.assert_array_equal(after[0].offset, before[-1].offset)


@pytest.mark.parametrize("name", METHODS)
def test_nothing_is_learnt_across_the_seam(name, log):
    """What the robot did before it was put back has no say in what it learns after."""
    method, mask = build(name), np.array([True, True, True])
    state, _ = stream(method, log, WHOLE)
    raw, reference = log
    # Another last second: feet that stood elsewhere, and forces that were not these.
    strange = (raw[:, ::-1], Reference(*(part[:, ::-1] for part in reference)))
    fresh = method.init(raw[0])
    ends = []
    for last in (log, strange):
        seen, _ = stream(method, last, 100, state, WHOLE)
        back = begin_episode(mask, fresh, with_learnt(seen, state))
        _, estimates = stream(method, log, 100, back, WHOLE + 100)
        ends.append(estimates[-1])
    np.testing.assert_array_equal(ends[0].scale, ends[1].scale)
    np.testing.assert_array_equal(ends[0].offset, ends[1].offset)


def test_forces_before_the_seam_wait_for_no_reference(log):
    method = build("tare")
    state, _ = stream(method, log, 50)
    back = begin_episode(np.array([True, False, False]), method.init(log[0][0]), state)
    for k in range(LAG + 1):
        state, _ = method.update(back, *at(log, 50 + k), DT)
        read = state.front.history[..., 0, 8:]
        np.testing.assert_array_equal(read[1:], 1.0)
        assert (read[0] == (1.0 if k == LAG else 0.0)).all()
        back = state


def test_robots_and_methods_must_be_the_same():
    method = build("tare")
    four, five = (method.init(np.zeros((robots, 8))) for robots in (4, 5))
    with pytest.raises(ValueError, match="must be of the same batch of robots"):
        begin_episode(np.ones(4, bool), five, four)
    with pytest.raises(ValueError, match="must be of the same batch of robots"):
        begin_episode(np.ones(5, bool), four, four)
    with pytest.raises(TypeError, match="What a Reference has learnt is not known"):
        begin_episode(np.ones(4, bool), *[Reference(*[np.zeros((4, 3))] * 9)] * 2)
