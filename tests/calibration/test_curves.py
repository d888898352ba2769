"""Curves of channels that no line fits: found from weights, and in front of every map."""

from collections.abc import Callable

import numpy as np
import pytest
from _refusals import refusals
from _synthetic import LAYOUT, MASS, NOMINAL, Faults, walk

from surefoot.calibration import Curves, FootCalibrator, Reference
from surefoot.calibration.weights.curves import fit_curve
from surefoot.native import CALIBRATION

LOADS = 9.81 * np.array([0.0, 0.2, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
KNOTS = [[0.0, 2.0, 6.0, 9.0], [0.0, 1.0, 4.0, 9.0]]


def divider(force: np.ndarray) -> np.ndarray:
    """Counts of a force-sensing resistor in a divider of voltage."""
    return 1023.0 * force / (force + 20.0)


def power(force: np.ndarray) -> np.ndarray:
    return 20.0 + 180.0 * force**0.6


@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize(("law", "shape"), [(divider, "monotone cubic"), (power, "power law")])
def test_the_curve_of_a_resistor_is_found(law: Callable, shape: str, turned: float) -> None:
    """Forces between the weights are right to the error that is claimed."""
    rng, load = np.random.default_rng(0), np.repeat(LOADS, 3)
    fit = fit_curve(turned * law(load) + 0.3 * rng.standard_normal(len(load)), load)
    assert fit is not None
    assert fit.shape == shape
    between = np.linspace(LOADS[1], LOADS[-1], 100)
    straight = Curves([fit.knots]).straighten(turned * law(between)[:, None])[:, 0]
    slope = np.ptp(LOADS) / (fit.knots[1, -1] - fit.knots[1, 0])
    force = turned * slope * (straight - (fit.knots[1, 0] if turned > 0.0 else fit.knots[1, -1]))
    error = np.sqrt(np.mean((force - between) ** 2))
    assert error < 1.5 * fit.std
    assert fit.std < 0.2 * fit.line_std


@pytest.mark.parametrize("bow", [0.0, 5e-4])
@pytest.mark.parametrize("repeats", [1, 3])
def test_a_load_cell_has_none(bow: float, repeats: int) -> None:
    """By data sheet its curve is no larger than a two-thousandth of the load."""
    rng, load = np.random.default_rng(1), np.repeat(LOADS, repeats)
    share = load / LOADS[-1]
    code = 84000 + 1e4 * (load + 4.0 * bow * LOADS[-1] * share * (1.0 - share))
    assert fit_curve(np.rint(code + 30 * rng.standard_normal(len(load))), load) is None


def test_noise_and_few_loads_show_none() -> None:
    rng = np.random.default_rng(2)
    assert fit_curve(rng.normal(0.0, 30.0, 24), np.repeat(LOADS, 3)) is None
    assert fit_curve(divider(LOADS[:4]), LOADS[:4]) is None


def test_readings_are_made_straight() -> None:
    curves = Curves([None, KNOTS])
    ends = np.array([[5.0, 0.0], [5.0, 9.0], [5.0, 2.0]])
    np.testing.assert_array_equal(curves.straighten(ends), [[5.0, 0.0], [5.0, 9.0], [5.0, 1.0]])
    # Beyond the ends it goes on straight, by the slope that it has there.
    low, high = (curves.straighten(np.array([[0.0, x - 1e-6], [0.0, x + 1e-6]]))[:, 1] for x in (0.0, 9.0))
    far = curves.straighten(np.array([[0.0, -4.0], [0.0, 15.0]]))[:, 1]
    np.testing.assert_allclose(
        far, [-4.0 * np.diff(low)[0] / 2e-6, 9.0 + 6.0 * np.diff(high)[0] / 2e-6], rtol=1e-4
    )
    assert np.isnan(curves.straighten(np.array([1.0, np.nan]))[1])
    grid = np.linspace(-5.0, 15.0, 400)
    assert (np.diff(curves.straighten(np.column_stack([grid, grid]))[:, 1]) > 0.0).all()


def test_without_a_curve_readings_are_the_same_array() -> None:
    raw = np.array([[1.0, np.nan], [3.0, 4.0]])
    assert Curves([None, None]).straighten(raw) is raw
    kept = raw.copy()
    Curves([None, KNOTS]).straighten(raw)
    np.testing.assert_array_equal(raw, kept)


def test_they_are_plain_values_and_back() -> None:
    plain = Curves([None, KNOTS]).as_plain()
    assert plain == [None, {"count": KNOTS[0], "straight_count": KNOTS[1]}]
    np.testing.assert_array_equal(Curves.from_plain(plain, 2).knots[1], KNOTS)


test_what_is_no_curve_is_refused = refusals(
    lambda given: Curves.from_plain(given, 2),
    ([None], "'curves' must be a list of 2, null for a channel without one."),
    (
        [None, {"count": [0.0, 1.0]}],
        "A curve must be null or have 'count' and 'straight_count', got [None, {",
    ),
    (
        [None, {"count": [0.0, 2.0, 1.0], "straight_count": [0.0, 1.0, 2.0]}],
        "The curve of channel 1 must have two or more finite readings and as many straight ones, both "
        "increasing, got [[0.0, 2.0, 1.0], [0.0, 1.0, 2.0]].",
    ),
    plain=True,
)


@pytest.mark.parametrize("library", [True, False])
def test_a_calibrator_has_them_in_front(library: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if library and CALIBRATION.installed() is None:
        pytest.skip("the library is not built here")
    if not library:
        monkeypatch.setattr(CALIBRATION, "rooms", lambda: ())
    log = walk(1, 0.04, 1.0, 0.5, Faults.bad())
    ends = log.raw[:, 3].min(), log.raw[:, 3].max()
    count = np.linspace(*ends, 5)
    curves = Curves(
        [None] * 3 + [[count, ends[0] + np.array([0.0, 0.2, 0.45, 0.7, 1.0]) * np.ptp(ends)]] + [None] * 4
    )
    plain, same, bent = (
        FootCalibrator(LAYOUT, "moment", mass=MASS, initial=NOMINAL, curves=one)
        for one in (None, Curves([None] * 8), curves)
    )
    assert (same.native() is None) == (not library)
    assert bent.native() is None  # whoever calls the library itself knows of no curves
    straight = curves.straighten(log.raw)
    assert not np.array_equal(straight, log.raw)
    for k, raw in enumerate(log.raw):
        row = Reference(*(part[k] for part in log.reference))
        np.testing.assert_array_equal(bent.update(raw, row).force, plain.update(straight[k], row).force)
    with pytest.raises(ValueError, match=r"'curves' are for 2 channels, but the layout has 8\."):
        FootCalibrator(LAYOUT, mass=MASS, curves=Curves([None, KNOTS]))
