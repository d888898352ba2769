"""Partial resets of calibrators, and calibrators that do not learn."""

import numpy as np
import pytest
import torch
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, walk

from surefoot.calibration import METHODS, OnlineSetup, Reference, online_method
from surefoot.calibration.episodes import COUNTERS, LEARNT, begin_episode, select, update_frozen

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


def stream(method, log, samples, state=None, start=0, update=None):
    state = method.init(log[0][0]) if state is None else state
    estimates = []
    for k in range(start, start + samples):
        state, estimate = (update or method.update)(state, *at(log, k), DT)
        estimates.append(estimate)
    return state, estimates


def named_leaves(state, path=""):
    for name in state._fields:
        leaf = getattr(state, name)
        if isinstance(leaf, tuple):
            yield from named_leaves(leaf, f"{path}{name}.")
        else:
            yield f"{path}{name}", leaf


@pytest.mark.parametrize("name", METHODS)
def test_every_part_of_a_state_is_known(name):
    """A new field must be told to be learnt or of the stream, and a new counter what becomes of it."""

    def check(state):
        assert set(LEARNT[type(state)]) <= set(state._fields)
        for field in state._fields:
            leaf = getattr(state, field)
            if isinstance(leaf, tuple):
                check(leaf)
            elif isinstance(leaf, int):
                assert field in COUNTERS
            else:
                assert leaf.shape[0] == 5  # robots come first

    check(build(name).init(np.zeros((5, 8))))


@pytest.mark.parametrize("name", METHODS)
def test_the_others_keep_theirs_bit_for_bit(name, log):
    method = build(name)
    state, _ = stream(method, log, 100)
    _, theirs = stream(method, log, 60, state, 100)
    for change in (select, begin_episode):
        changed = change(np.array([False, True, False]), method.init(log[0][0]), state)
        for (path, old), (_, new) in zip(named_leaves(state), named_leaves(changed), strict=True):
            if not isinstance(old, int):
                np.testing.assert_array_equal(new[[0, 2]], old[[0, 2]], err_msg=path)
        # Nor do they notice later on.
        _, ours = stream(method, log, 60, changed, 100)
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(one.force[[0, 2]], other.force[[0, 2]])
            np.testing.assert_array_equal(one.flags[[0, 2]], other.flags[[0, 2]])


@pytest.mark.parametrize("name", METHODS)
def test_who_forgets_is_served_as_one_who_begins(name, log):
    method = build(name)
    state, _ = stream(method, log, WHOLE)
    forgot = select(np.array([True, False, True]), method.init(log[0][0]), state)
    _, ours = stream(method, log, 160, forgot, WHOLE)
    _, theirs = stream(method, log, 160, None, WHOLE)
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one.force[[0, 2]], other.force[[0, 2]], atol=1e-9)


def test_a_standing_start_begins_anew_for_who_forgets(log):
    method = build("window")
    state, _ = stream(method, log, 200)
    assert state.all_walking == 1
    forgot = select(np.array([True, False, False]), method.init(log[0][0]), state)
    assert forgot.all_walking == 0
    np.testing.assert_array_equal(forgot.walking, [False, True, True])


@pytest.mark.parametrize("name", ["moment", "window"])
def test_who_forgets_between_blocks_learns_all_the_same(name, log):
    method = build(name)
    state, _ = stream(method, log, WHOLE + 7)
    forgot = select(np.array([True, False, False]), method.init(log[0][0]), state)
    _, ours = stream(method, log, 300, forgot, WHOLE + 7)
    _, fresh = stream(method, log, 300, None, WHOLE + 7)
    scale, as_alone = ours[-1].scale[0] / NOMINAL.scale, fresh[-1].scale[0] / NOMINAL.scale
    assert np.abs(as_alone - 1.0).max() > 0.02
    np.testing.assert_allclose(scale, as_alone, atol=0.03)


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
    # Another last second: the same map, but feet that stood elsewhere, and forces that were not these.
    strange = (raw[:, ::-1], Reference(*(part[:, ::-1] for part in reference)))
    fresh = method.init(raw[0])
    ends = []
    for last in (log, strange):
        seen, _ = stream(method, last, 15, state, WHOLE, lambda *args: update_frozen(method, *args))
        _, estimates = stream(method, log, 100, begin_episode(mask, fresh, seen), WHOLE + 15)
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


@pytest.mark.parametrize(("name", "lag"), [*((name, LAG) for name in METHODS), ("moment", 0)])
def test_who_is_frozen_learns_nothing_and_reads_on(name, lag, log):
    method = build(name, lag)
    state, before = stream(method, log, 200)
    frozen = lambda *args: update_frozen(method, *args)  # noqa: E731
    after, during = stream(method, log, 40, state, 200, frozen)
    for path, kept in named_leaves(state):
        if path.split(".")[0] in LEARNT[type(state)] or isinstance(kept, int):
            np.testing.assert_array_equal(dict(named_leaves(after))[path], kept, err_msg=path)
    for k, estimate in enumerate(during):
        np.testing.assert_array_equal(estimate.scale, before[-1].scale)
        mapped = before[-1].scale * log[0][200 + k] + before[-1].offset
        np.testing.assert_allclose(estimate.force, mapped, atol=1e-8)
        assert estimate.cop_valid.all()
    thawed = begin_episode(np.ones(3, bool), method.init(log[0][0]), after)
    _, later = stream(method, log, 120, thawed, 240)
    assert (name == "none") == (later[-1].offset == before[-1].offset).all()


def test_a_clock_that_jumps_does_not_end_the_frost(log):
    method = build("moment")
    state, before = stream(method, log, 100)
    after, estimate = update_frozen(method, state, *at(log, 100), 10.0)
    np.testing.assert_array_equal(after.covariance, state.covariance)
    np.testing.assert_array_equal(estimate.scale, before[-1].scale)


@pytest.mark.parametrize("name", ["moment", "window"])
def test_who_learns_at_every_sample_cannot_be_frozen(name, log):
    options = {"every": 1} | ({"average": 1} if name == "moment" else {})
    method = build(name, **options)
    with pytest.raises(ValueError, match="'every' of 2 or more"):
        stream(method, log, 60, update=lambda *args: update_frozen(method, *args))


def test_torch_selects_as_numpy_does(log):
    method = build("moment")
    state, _ = stream(method, log, 40)
    to_torch = lambda tree: type(tree)(  # noqa: E731
        *(
            to_torch(part)
            if isinstance(part, tuple)
            else part
            if isinstance(part, int)
            else torch.asarray(part)
            for part in tree
        )
    )
    mask, fresh = np.array([True, False, True]), method.init(log[0][0])
    for change in (select, begin_episode):
        ours = dict(named_leaves(change(mask, fresh, state)))
        theirs = change(torch.asarray(mask), to_torch(fresh), to_torch(state))
        for path, leaf in named_leaves(theirs):
            np.testing.assert_array_equal(np.asarray(leaf), ours[path], err_msg=path)


def test_robots_and_methods_must_be_the_same():
    method = build("tare")
    four, five = (method.init(np.zeros((robots, 8))) for robots in (4, 5))
    with pytest.raises(ValueError, match="must be of the same batch of robots"):
        select(np.ones(4, bool), five, four)
    with pytest.raises(ValueError, match="must be of the same batch of robots"):
        select(np.ones(5, bool), four, four)
    with pytest.raises(TypeError, match="What a Reference has learnt is not known"):
        begin_episode(np.ones(4, bool), *[Reference(*[np.zeros((4, 3))] * 9)] * 2)
