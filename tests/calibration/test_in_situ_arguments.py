"""Arguments of in-situ calibration without meaning, and its limits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from _in_situ_leg import leg_sets
from _refusals import refusals

from surefoot.calibration.in_situ import InSituOptions, InSituSet, KnownLimb, calibrate_in_situ, limits


def calibrate(make):
    sets, options = make(leg_sets())
    calibrate_in_situ(sets, **options)


test_bad_arguments = refusals(
    calibrate,
    (lambda s: ([], {}), "Give at least one set of readings."),
    (
        lambda s: ([s[0], replace(s[1], raw=np.ones((600, 7)))], {}),
        "All sets must have the same number of channels, got [6, 7].",
    ),
    (
        lambda s: (s, {"accept": " \n"}),
        "'accept' must say why a refusal may be passed, got ' \\n'; leave it empty if none may.",
    ),
    (lambda s: (s, {"factory_matrix": np.eye(5)}), "'factory_matrix' must have shape (6, 6), got (5, 5)."),
    (lambda s: (s, {"factory_matrix": np.ones((6, 6))}), "'factory_matrix' must be finite and of rank 6"),
    plain=True,
)


test_bad_sets = refusals(
    lambda change: InSituSet(**{"raw": np.ones((5, 6)), "gravity": np.ones((5, 3)), "name": "one"} | change),
    ({"raw": np.ones((5, 4))}, "'raw' must have shape (n, k) with k >= 6, got (5, 4)."),
    ({"gravity": np.ones((4, 3))}, "'gravity' must have shape (5, 3), got (4, 3)."),
    ({"angular_velocity": np.ones((5, 3))}, "give angular velocity and acceleration together"),
    ({"time": [0.0, 1.0, 1.0, 2.0, 3.0]}, "'time' must be finite and increase from sample to sample."),
    ({"added_mass": -0.1}, "'added_mass' must be at least 0 kg and finite, got -0.1."),
    ({"added_com": [0.0, np.nan, 0.0]}, "'added_com' must be finite"),
    plain=True,
)


test_bad_options = refusals(
    lambda change: InSituOptions(**change),
    ({"factory_std": (0.1, 0.1)}, "'factory_std' must hold six positive shares, one an axis"),
    ({"code_range": (5.0, 5.0)}, "'code_range' must be (lowest, highest), got (5.0, 5.0)."),
    plain=True,
)


def test_every_limit_has_a_unit_and_a_source_and_is_used():
    table = {name: value for name, value in vars(limits).items() if isinstance(value, limits.Limit)}
    assert len(table) > 40
    assert all(value.unit and value.source for value in table.values())
    package = Path(limits.__file__).parent
    code = " ".join(path.read_text() for path in package.rglob("*.py"))
    assert [name for name in table if f"limits.{name}" not in code] == []


def test_a_known_limb_is_checked():
    with pytest.raises(ValueError, match="'mass_std' must be finite and positive, got 0"):
        KnownLimb(1.0, 0)
    with pytest.raises(ValueError, match="'com' must be three finite numbers in m"):
        KnownLimb(1.0, 0.1, com=np.ones(2))


def test_a_rotation_needs_a_limb_at_rest():
    sets = leg_sets()
    still = np.zeros((600, 3))
    moving = [replace(one, angular_velocity=still, angular_acceleration=still) for one in sets]
    with pytest.raises(ValueError, match="'estimate_rotation' needs a limb at rest"):
        calibrate_in_situ(moving, options=InSituOptions(estimate_rotation=True))
