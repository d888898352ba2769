"""Real plates with errors put in; the recordings are found through SUREFOOT_DATA."""

import pytest
from _recordings import DATA, needs

from surefoot.experiments.walks.scenarios import TRUE_MAP

pytestmark = [pytest.mark.slow, needs("foot")]


@pytest.fixture(scope="module")
def score(benchmark_script):
    """Means of a method on a recording, over two draws of errors."""
    script = benchmark_script("real_recordings")
    return lambda name, method: script.score(DATA, name, method, range(2)).mean(numeric_only=True)


@pytest.mark.parametrize("method", ["window", "quasi-static", "moment"])
def test_weight_and_cop_bring_force_and_cop_right(score, method):
    learnt, raw = score("board", method), score("board", "none")
    assert learnt["vgrf"] < 0.2 * raw["vgrf"]
    assert learnt["cop"] < 0.2 * raw["cop"]


def test_a_tare_takes_offsets_out_and_leaves_scales(score):
    tared, raw = score("board", "tare"), score("board", "none")
    assert tared["offset"] < 0.1 * raw["offset"]
    assert tared["scale"] == pytest.approx(raw["scale"])


def test_a_rocked_pole_gets_its_force_back(score):
    learnt, raw = score("pole", "window"), score("pole", "none")
    assert learnt["vgrf"] < 0.2 * raw["vgrf"]
    # A plate that is never empty is not tared.
    assert score("pole", "tare")["cell"] == pytest.approx(raw["cell"])


@pytest.mark.parametrize("name", ["board", "pole"])
def test_errors_that_are_put_in_can_be_undone(score, name):
    floor = score(name, TRUE_MAP)
    assert floor["scale"] < 1e-12
    assert floor["offset"] < 1e-9
    assert floor["cell"] < 1e-9
    assert score(name, "none")["cell"] > 1.0
