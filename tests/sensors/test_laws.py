"""Laws of spring elements and filters: nonlinearity, mounting, overload, moving average, creep."""

from operator import call

import numpy as np
import pytest
from _refusals import refusals
from _streams import DT, stream

from surefoot.sensors import Mechanics
from surefoot.sensors.stages.creep import creep
from surefoot.sensors.stages.hysteresis import hysteresis
from surefoot.sensors.stages.mechanics import SMALLEST_LOOP, mechanics
from surefoot.sensors.stages.mounting import mounting
from surefoot.sensors.stages.moving_average import moving_average
from surefoot.sensors.stages.nonlinearity import cross_nonlinearity, nonlinearity, random_nonlinearity
from surefoot.sensors.stages.overload import overload

# Nonlinearity


def test_each_term_departs_from_the_line_by_its_share_where_it_says():
    load = np.linspace(0.0, 200.0, 20001)
    for terms, peak in (((0.004, 0.0), 0.5), ((0.0, -0.004), 3.0**-0.5)):
        off = nonlinearity(*terms, 200.0).apply(load, (), np.random.default_rng(0), DT)[0] - load
        worst = np.argmax(np.abs(off))
        assert off[worst] == pytest.approx(sum(terms) * 200.0, rel=1e-6)
        assert load[worst] == pytest.approx(peak * 200.0, abs=0.02)


def test_the_terminals_read_true_and_pulling_as_documented():
    ends = np.array([0.0, 50.0, -50.0, 80.0])
    rng = np.random.default_rng(0)
    read, _ = nonlinearity(0.01, 0.02, 50.0).apply(ends, (), rng, DT)
    np.testing.assert_allclose(read - ends, [0.0, 0.0, -8.0 * 0.01 * 50.0, 0.0], atol=1e-12)
    beyond, _ = nonlinearity(0.01, 0.02, 50.0).apply(np.array([-70.0]), (), rng, DT)
    np.testing.assert_allclose(beyond, -74.0)


def test_channels_bend_each_their_own_way():
    stage = nonlinearity([0.01, -0.02], 0.0, [100.0, 10.0])
    read, _ = stage.apply(np.array([50.0, 5.0]), (), np.random.default_rng(0), DT)
    np.testing.assert_allclose(read, [51.0, 4.8])


@pytest.mark.parametrize("terms", [(0.082, 0.0), (-0.082, 0.0), (0.0, 0.19), (0.0, -0.19), (0.04, -0.1)])
def test_what_is_allowed_grows_with_the_load(terms):
    load = np.linspace(-1.3, 1.3, 2001)
    read, _ = nonlinearity(*terms, 1.0).apply(load, (), np.random.default_rng(0), DT)
    assert (np.diff(read) > 0.0).all()


def test_drawn_terms_are_uniform_within_the_data_sheet():
    loads = np.broadcast_to(np.array([0.0, 50.0, 100.0])[:, None], (3, 32_000))
    off = stream(random_nonlinearity(0.002, 100.0), loads) - loads
    np.testing.assert_allclose(off[[0, 2]], 0.0, atol=1e-12)
    assert np.abs(off[1]).max() == pytest.approx(0.2, rel=0.01)
    # Uniform: the standard deviation is the range over the root of 12.
    assert off[1].std() == pytest.approx(0.4 / 12**0.5, rel=0.02)


def test_coupled_axes_bend_by_their_cubic_terms_and_by_products_of_two():
    scale = np.array([100.0, 10.0, 1.0])
    stage = cross_nonlinearity(0.04, 0.02, scale)
    rng = np.random.default_rng(8)
    states = [stage.init((3,), rng) for _ in range(4000)]

    def off(share):
        load = share * scale
        return np.array([(stage.apply(load, state, rng, DT)[0] - load) / scale for state in states])

    alone = off(np.array([3.0**-0.5, 0.0, 0.0]))
    np.testing.assert_array_equal(alone[:, 1:], 0.0)
    assert np.abs(alone[:, 0]).max() == pytest.approx(0.04, rel=0.01)
    assert alone[:, 0].std() == pytest.approx(0.08 / 12**0.5, rel=0.02)
    # Cubic terms vanish at the full scale, products are the same for both signs, and all stay beyond it.
    two = off(np.array([1.0, 1.0, 0.0]))
    assert two.std(axis=0) == pytest.approx([0.04 / 12**0.5] * 3, rel=0.03)
    np.testing.assert_allclose(off(np.array([-1.0, -1.0, 0.0])), two, atol=1e-12)
    np.testing.assert_allclose(off(np.array([2.0, 3.0, 0.0])), two, atol=1e-12)


def test_no_two_loads_of_coupled_axes_have_one_reading():
    stage = cross_nonlinearity(0.08, 0.018, [1.0] * 6)
    rng = np.random.default_rng(9)
    for _ in range(200):
        state, at = stage.init((6,), rng), rng.uniform(-1.0, 1.0, 6)
        slopes = [
            (stage.apply(at + d, state, rng, DT)[0] - stage.apply(at - d, state, rng, DT)[0]) / 2e-6
            for d in 1e-6 * np.eye(6)
        ]
        assert np.linalg.det(slopes) > 0.0


# Mounting


def impacts(count: int) -> np.ndarray:
    """Loads of two feet: the left is put down over three readings and lifted at once, the right rests."""
    cycle = np.zeros((7, 8))
    cycle[:, :4] = np.array([0.0, 0.0, 5.0, 10.0, 15.0, 15.0, 15.0])[:, None]
    return np.tile(cycle, (count, 1))


def test_an_impact_moves_a_foot_along_its_modes_with_their_spreads():
    loads = np.tile(impacts(30), (1, 100))
    offset = (stream(mounting(8.0, 0.7, 0.2), loads) - loads).reshape(-1, 100, 8)
    np.testing.assert_array_equal(offset[:, :, 4:], 0.0)
    jumps = np.diff(offset[:, :, :4], axis=0)
    when = np.flatnonzero(np.abs(jumps).max(axis=(1, 2)) > 1e-9)
    # Once each cycle at touch-down, at its first reading, and once at lift-off.
    np.testing.assert_array_equal(np.sort(when % 7), np.repeat([1, 6], [30, 29]))
    corners = np.array([[1, 1, 1, 1], [1, -1, -1, 1], [1, -1, 1, -1], [1, 1, -1, -1]])
    modes = (jumps[when] @ corners.T / 4.0).reshape(-1, 4)
    np.testing.assert_allclose(modes[:, 2:], 0.0, atol=1e-10)
    # A standard deviation of 5,900 draws is good to 0.9 %, a correlation to 0.013.
    np.testing.assert_allclose(modes[:, :2].std(axis=0), [0.2, 0.7], rtol=0.04)
    assert abs(np.corrcoef(modes[:, :2].T)[0, 1]) < 0.05


def test_the_warp_shows_in_neither_load_nor_moments():
    loads = impacts(5)
    zero = (stream(mounting(8.0, 0.7), loads) - loads)[-1, :4]
    corners = np.array([[0.07, 0.03], [0.07, -0.03], [-0.05, 0.03], [-0.05, -0.03]])
    assert np.abs(zero).min() > 0.1
    np.testing.assert_allclose(zero.sum(), 0.0, atol=1e-12)
    np.testing.assert_allclose(zero @ corners, 0.0, atol=1e-12)


def test_nothing_jumps_below_the_threshold():
    loads = impacts(20)
    np.testing.assert_array_equal(stream(mounting(61.0, 5.0, 5.0), loads), loads)


def test_a_gap_is_no_impact_and_hides_none():
    rest, stand = impacts(1)[1:3]
    loads = np.stack([rest, np.nan * rest, rest, np.nan * rest, stand])
    read = stream(mounting(8.0, 0.7), loads)
    np.testing.assert_array_equal(read[:4], loads[:4])
    assert (read[4, :4] != stand[:4]).all()


# Overload


def test_an_overload_leaves_its_share_for_good_and_only_once():
    loads = np.array([0.0, 140.0, 0.0, 170.0, 0.0, 160.0, 0.0, np.nan, 190.0, 0.0, -155.0, 0.0])[:, None]
    zero = (stream(overload(0.1, 150.0), loads) - loads)[:, 0]
    expected = [0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0, np.nan, 4.0, 4.0, 3.5, 3.5]
    np.testing.assert_allclose(zero, expected, atol=1e-12)


def test_each_cell_has_its_own_limit():
    loads = np.array([[100.0, 100.0], [0.0, 0.0]])
    np.testing.assert_allclose(stream(overload(0.5, [90.0, 120.0]), loads)[1], [5.0, 0.0])


# Moving average


@pytest.mark.parametrize("count", [4, 5, 8])
def test_a_sine_comes_out_as_the_formula_says_and_late_by_the_group_delay(count):
    time = np.arange(2000) * DT
    delay = (count - 1) * DT / 2.0
    for frequency in (0.3, 2.0, 5.5):
        omega = 2.0 * np.pi * frequency
        read = stream(moving_average(count), np.sin(omega * time)[:, None])[200:, 0]
        basis = np.stack([np.sin(omega * time[200:]), np.cos(omega * time[200:])], axis=1)
        (in_phase, quadrature), *_ = np.linalg.lstsq(basis, read, rcond=None)
        half = omega * DT / 2.0
        expected = np.sin(count * half) / (count * np.sin(half)) * np.exp(-1j * omega * delay)
        assert in_phase + 1j * quadrature == pytest.approx(expected, abs=1e-9)


def test_a_step_settles_after_its_readings():
    step = np.repeat([0.0, 1.0], [3, 12])[:, None]
    np.testing.assert_allclose(stream(moving_average(4), step)[2:8, 0], [0.0, 0.25, 0.5, 0.75, 1.0, 1.0])


def test_a_lost_reading_does_not_spoil_the_next():
    loads = np.array([1.0, 1.0, np.nan, 1.0, 1.0])[:, None]
    np.testing.assert_allclose(stream(moving_average(3), loads), loads)


# Creep


SHARES, CONSTANTS = (0.02, -0.005, 0.01), (0.5, 8.0, 120.0)


def expected_step(time):
    return 1.0 + sum(s * (1.0 - np.exp(-time / tau)) for s, tau in zip(SHARES, CONSTANTS, strict=True))


@pytest.mark.parametrize("dt", [0.01, 0.7, 60.0])
def test_a_step_creeps_as_the_exponentials_say(dt):
    loads = np.tile([40.0, -3.0], (50, 1))
    expected = loads * expected_step(dt * np.arange(1, 51)[:, None])
    np.testing.assert_allclose(stream(creep(SHARES, CONSTANTS), loads, dt=dt), expected, rtol=1e-12)


def test_the_answer_does_not_depend_on_the_step():
    """A load of stairs, each read once or in many uneven parts."""
    rng = np.random.default_rng(1)
    element = creep(SHARES, CONSTANTS)
    whole = parts = element.init((4,), rng)
    for load in rng.normal(0.0, 20.0, (30, 4)):
        duration = rng.uniform(0.01, 20.0)
        at_once, whole = element.apply(load, whole, rng, duration)
        for share in rng.dirichlet(np.ones(9)):
            bit_by_bit, parts = element.apply(load, parts, rng, duration * share)
        np.testing.assert_allclose(bit_by_bit, at_once, rtol=1e-11, atol=1e-11)


def test_unloading_creeps_back_to_nothing():
    rng = np.random.default_rng(2)
    element = creep(SHARES, CONSTANTS)
    _, state = element.apply(np.array([100.0]), element.init((1,), rng), rng, 50.0)
    left, state = element.apply(np.array([0.0]), state, rng, 3.0)
    loaded = expected_step(53.0) - expected_step(3.0)
    np.testing.assert_allclose(left, 100.0 * loaded, atol=1e-12)
    left, _ = element.apply(np.array([0.0]), state, rng, 1e5)
    np.testing.assert_allclose(left, 0.0, atol=1e-12)


def test_no_time_changes_nothing_and_loads_add_up():
    rng = np.random.default_rng(3)
    element = creep(SHARES, CONSTANTS)
    fresh = element.init((3,), rng)
    at_once, _ = element.apply(np.ones(3), fresh, rng, 0.0)
    np.testing.assert_array_equal(at_once, 1.0)
    one, other = rng.normal(size=(2, 20, 3))
    read = {}
    for name, loads in (("one", one), ("other", other), ("both", one + other)):
        state = fresh
        for load in loads:
            read[name], state = element.apply(load, state, rng, 0.3)
    np.testing.assert_allclose(read["both"], read["one"] + read["other"], rtol=1e-12)


# All of them in one element


@pytest.mark.parametrize(
    ("fields", "stage"),
    [
        ({"nonlinearity": 0.01}, random_nonlinearity(0.01, 40.0)),
        ({"hysteresis": 0.01}, hysteresis(0.01, 40.0, smallest=SMALLEST_LOOP)),
        ({"creep_shares": (0.1,), "creep_time_constants": (2.0,)}, creep((0.1,), (2.0,))),
        (
            {"mounting_warp_std": 2.0, "mounting_common_std": 0.5, "impact_threshold": 30.0},
            mounting(30.0, 2.0, 0.5),
        ),
        ({"overload_share": 0.1, "safe_overload": 0.5}, overload(0.1, 20.0)),
    ],
    ids=lambda part: next(iter(part)) if isinstance(part, dict) else "",
)
def test_each_field_of_the_mechanics_is_one_stage_with_its_numbers(fields, stage):
    loads = np.random.default_rng(7).normal(10.0, 20.0, (50, 8))
    read = stream(mechanics(Mechanics(**fields), 40.0), loads)
    np.testing.assert_array_equal(read, stream(stage, loads))
    assert (read != loads).any()


# Bad input


test_impossible_laws_are_refused = refusals(
    call,
    (lambda: nonlinearity(float("nan"), 0.0, 1.0), "'quadratic' and 'cubic' must be finite"),
    (lambda: nonlinearity(0.26, 0.0, 1.0), "must leave readings that grow"),
    (lambda: cross_nonlinearity(0.1, 0.02, [1.0] * 6), r"keep 5.2 cubic \+ 30 cross below 1"),
    (lambda: mounting(1.0, 1.0).init((6,), None), r"whole feet of 4 cells, got shape \(6,\)"),
    (lambda: overload(1.1, 1.0), "'share' must be at most 1, got 1.1"),
    (lambda: creep((0.1,), ()), "as many 'shares' as 'time_constants', got 1 and 0"),
)
