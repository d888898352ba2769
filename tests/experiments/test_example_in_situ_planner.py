"""The example of the excitation planner: its poses leave less unknown than as many of a sweep."""

import pytest


@pytest.mark.slow
def test_planned_poses_leave_less_unknown_than_a_raster_sweep(load_script):
    found = load_script("examples/in_situ_planner.py").compare(rounds=2)
    for rows in found.values():
        (first, _), (last, true) = rows
        assert last < first
        assert true < 3.0 * last
    shares = [p / r for (p, _), (r, _) in zip(found["planned"], found["raster"], strict=True)]
    assert max(shares) < 1.0
    assert min(shares) < 0.9
