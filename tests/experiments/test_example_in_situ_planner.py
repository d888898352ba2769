"""The example of the excitation planner: its poses leave less unknown than as many of a sweep."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "in_situ_planner.py"


@pytest.mark.slow
def test_planned_poses_leave_less_unknown_than_a_raster_sweep():
    if not EXAMPLE.is_file():
        pytest.skip("the examples are not part of the wheel")
    spec = importlib.util.spec_from_file_location("in_situ_planner", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    found = example.compare(rounds=2)
    for rows in found.values():
        (first, _), (last, true) = rows
        assert last < first
        assert true < 3.0 * last
    shares = [p / r for (p, _), (r, _) in zip(found["planned"], found["raster"], strict=True)]
    assert max(shares) < 1.0
    assert min(shares) < 0.9
