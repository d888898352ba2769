"""The search for the mistake that explains why data contradict themselves."""

from functools import partial

import numpy as np
import pytest

from surefoot.calibration.diagnosis import Experience, Fitted, Mistake, investigate
from surefoot.calibration.results import Finding

ROWS, NOISE = 100, 0.01
LOADS = np.linspace(-1.0, 1.0, ROWS)
SYMPTOM = Finding("line", "The readings are no line.", "Read again.")


def sound(seed=0):
    return 2.0 * LOADS + NOISE * np.random.default_rng(seed).standard_normal(ROWS)


def fit(readings):
    """Fit a line of known slope by its level; the size is in that of the noise."""
    level = float(np.mean(readings - 2.0 * LOADS))
    left = readings - 2.0 * LOADS - level
    return Fitted(-0.5 * float(np.sum((left / NOISE) ** 2)), float(np.std(left)) / NOISE, level)


def scale(readings, factor):
    return readings * factor


def shift(readings, step):
    return readings - step * (LOADS > 0.0)


HALF = Mistake("gain", "the gain is half", "double it", partial(scale, factor=2.0))
JUMP = Mistake("jump", "the zero jumps", "read again without a tare", partial(shift, step=0.3), 1, 10)
EXPERIENCE = Experience(unknown=0.2, mimicked=0.1, size=1.0, spread=0.1)


def test_the_mistake_that_leaves_residuals_of_sound_data_is_certain():
    found = investigate(0.5 * sound(), [HALF, JUMP], fit, EXPERIENCE, ROWS)
    assert found.is_certain
    assert found.likely.mistake.kind == "gain"
    assert found.likely.solution == pytest.approx(0.0, abs=0.01)
    assert sum(one.probability for one in found.causes) + found.none + found.unknown == pytest.approx(1.0)
    explained = found.explain(SYMPTOM)
    assert "The likeliest cause: the gain is half (probability" in explained.reason
    assert explained.cure == "Double it."


def test_sound_data_contain_no_mistake():
    found = investigate(sound(), [HALF, JUMP], fit, EXPERIENCE, ROWS)
    assert found.none > 0.9
    assert found.likely is None
    assert found.explain(SYMPTOM) == SYMPTOM


def test_a_mistake_that_is_not_listed_stays_unknown():
    bent = sound() + 0.5 * LOADS**2
    found = investigate(bent, [HALF, JUMP], fit, EXPERIENCE, ROWS)
    assert found.likely is None
    assert found.unknown > 0.9
    assert "None of the 2 mistakes that were tried explains it." in found.explain(SYMPTOM).reason


def test_the_closest_mistake_is_named_without_odds():
    jumped = sound() + 0.3 * (LOADS > 0.0) + 0.05 * LOADS**3
    found = investigate(jumped, [HALF, JUMP], fit, EXPERIENCE, ROWS)
    assert found.likely is None
    explained = found.explain(SYMPTOM)
    assert "The closest of them: the zero jumps, which leaves" in explained.reason
    assert explained.cure == "Read again. Or read again without a tare."


def test_unknowns_and_alternatives_cost_what_they_gain_by_chance():
    plain = JUMP._replace(cause="a", free=0, choices=1)
    jumped = sound() + 0.3 * (LOADS > 0.0)
    found = investigate(jumped, [plain, JUMP], fit, EXPERIENCE, ROWS)
    first, second = found.causes
    assert first.evidence - second.evidence == pytest.approx(0.5 * np.log(ROWS) + np.log(10))


def test_an_absurd_mistake_and_a_singular_fit_are_left_out():
    def fail(readings):
        raise np.linalg.LinAlgError

    absurd = HALF._replace(cause=lambda level: "")
    told = HALF._replace(cause=lambda level: f"the gain is half, and the level {level:.1f}")
    singular = Mistake("none", "nothing", "do nothing", fail)
    found = investigate(0.5 * sound(), [absurd, singular, told], fit, EXPERIENCE, ROWS)
    assert [one.mistake.cause.replace("-", "") for one in found.causes] == [
        "the gain is half, and the level 0.0"
    ]


def test_evidence_is_limited_by_the_readings_that_errors_of_the_model_are_worth():
    few = Experience(unknown=0.2, mimicked=0.1, size=1.0, spread=0.1, readings=3.0, good=1.0, best=0.5)
    found = investigate(0.5 * sound(), [HALF], fit, few, ROWS)
    size = fit(0.5 * sound()).size
    assert found.causes[0].evidence == pytest.approx(3.0 * np.log(size), rel=0.05)
