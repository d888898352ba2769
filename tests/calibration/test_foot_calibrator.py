import tracemalloc

import numpy as np
import pytest
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, believed_mass, walk

from surefoot.arrays import HeldRows
from surefoot.calibration import (
    METHODS,
    FeetLayout,
    FootCalibrator,
    FootLayout,
    Moment,
    Parameters,
    Reference,
    SwingTare,
    Window,
    replay,
)
from surefoot.calibration.state import load_state
from surefoot.native import CALIBRATION

FAULTS = Faults.bad()


@pytest.fixture(scope="module")
def log():
    return walk(1, 0.04, 2.0, 1.0, FAULTS)


def rows(log):
    return [Reference(*(part[k] for part in log.reference)) for k in range(len(log.raw))]


def make(method="window", **options):
    options = {"mass": believed_mass(FAULTS), "initial": NOMINAL, **options}
    return FootCalibrator(LAYOUT, method, **options)


@pytest.mark.parametrize("method", list(METHODS))
def test_the_object_is_the_stream_and_the_replay(log, method):
    calibrator = make(method)
    streamed = [calibrator.update(raw, row, DT) for raw, row in zip(log.raw, rows(log), strict=True)]
    replayed = replay(LAYOUT, method, log.raw, log.reference, DT, mass=believed_mass(FAULTS), initial=NOMINAL)
    # That of one robot may run in C, which rounds elsewhere.
    close = {"rtol": 1e-9, "atol": 1e-9}
    for field in ("force", "cop", "cop_foot", "scale", "offset", "flags", "vgrf"):
        expected = np.stack([getattr(estimate, field) for estimate in streamed])
        np.testing.assert_allclose(getattr(replayed, field), expected, **close)
    if METHODS[method].certain:
        np.testing.assert_allclose(replayed.covariance, [part.covariance for part in streamed], **close)
        np.testing.assert_allclose(replayed.force_std, [part.force_std for part in streamed], **close)
    else:
        assert replayed.covariance is None


@pytest.mark.parametrize("method", list(METHODS))
def test_saved_and_loaded_it_goes_on_bit_for_bit(log, method, tmp_path):
    first, second = make(method), make(method)
    path = tmp_path / "feet.calibration"
    for k, (raw, row) in enumerate(zip(log.raw, rows(log), strict=True)):
        expected = first.update(raw, row)
        if k == 129:
            first.save(path)
            second.load(path)
        if k >= 130:
            found = second.update(raw, row)
    for a, b in zip(expected, found, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("library", ["installed", "none"])
@pytest.mark.parametrize("begun", [False, True])
def test_several_robots_at_once_are_refused_with_the_way_out(log, library, begun, monkeypatch):
    if library == "none":
        monkeypatch.setattr(CALIBRATION, "rooms", lambda: ())
    calibrator, row = make("moment"), rows(log)[0]
    if begun:
        calibrator.update(log.raw[0], row)
    way_out = r" That is of several robots, .* make a FootCalibrator for each, or .* VectorSelfCalibration\."
    with pytest.raises(ValueError, match=r"'raw' must have shape \(8,\), got \(3, 8\)\." + way_out):
        calibrator.update(log.raw[:3], Reference(*(part[:3] for part in log.reference)))
    with pytest.raises(
        ValueError, match=r"'reference\.com' must have shape \(3,\), got \(3, 3\)\." + way_out
    ):
        calibrator.update(log.raw[0], Reference(*(part[:3] for part in log.reference)))
    with pytest.raises(ValueError, match=r"'raw' must hold one reading for each of the 8 channels"):
        calibrator.update(log.raw[0, :5], row)
    assert np.isfinite(calibrator.update(log.raw[0], row).force).all()


def test_a_state_of_something_else_is_refused(log, tmp_path):
    window, tare = make(), make("tare")
    window.update(log.raw[0], rows(log)[0])
    window.save(tmp_path / "window.npz")
    with pytest.raises(ValueError, match="was saved for method 'window', but this is 'tare'"):
        tare.load(tmp_path / "window.npz")
    left, right = (FootLayout.load_cells(name, LAYOUT.feet[0].position_cell_sole) for name in ("a", "b"))
    other = FootCalibrator(FeetLayout((left, right)), "window", mass=MASS)
    with pytest.raises(
        ValueError, match=r"was saved for channels 'left/front-left .*, but this is 'a/front-left"
    ):
        other.load(tmp_path / "window.npz")
    tare.update(log.raw[0], rows(log)[0])
    with pytest.raises(ValueError, match="holds the state of another method"):
        load_state(tmp_path / "window.npz", tare.state)
    with pytest.raises(ValueError, match="was saved for lag '2', but this is '5'"):
        make(lag=5).load(tmp_path / "window.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(ValueError, match="is not a saved state"):
        window.load(tmp_path / "other.npz")


def test_there_is_nothing_to_save_before_the_first_sample(tmp_path):
    with pytest.raises(RuntimeError, match=r"nothing to save before the first update\(\)"):
        make().save(tmp_path / "nothing.npz")


def test_reset_begins_from_the_starting_map(log):
    calibrator = make()
    for raw, row in zip(log.raw, rows(log), strict=True):
        learnt = calibrator.update(raw, row)
    assert not np.array_equal(learnt.scale, NOMINAL.scale)
    calibrator.reset()
    assert calibrator.state is None
    np.testing.assert_array_equal(calibrator.update(log.raw[0], rows(log)[0]).scale, NOMINAL.scale)


def test_counts_may_be_whole_numbers_single_precision_or_a_list(log):
    counts = np.round(log.raw[0]).astype(np.int64)
    row = rows(log)[0]
    expected = make().update(counts.astype(float), row)
    for given in (counts, counts.astype(np.float32), counts.tolist()):
        np.testing.assert_array_equal(make().update(given, row).force, expected.force)


def test_without_a_map_readings_are_newtons(log):
    calibrator = FootCalibrator(LAYOUT, "none", mass=MASS)
    force = np.arange(8.0)
    np.testing.assert_array_equal(calibrator.update(force, rows(log)[0]).force, force)


def test_options_of_the_robot_and_of_the_method_are_told_apart(log):
    calibrator = make(force_threshold=60.0, window=0.25, cutoff=None)
    assert not calibrator.update(log.raw[0], rows(log)[0]).cop_valid
    with pytest.raises(ValueError, match="Method 'tare' has no option 'window'"):
        make("tare", window=0.25)
    with pytest.raises(ValueError, match="Method 'wndow' does not exist"):
        make("wndow")
    with pytest.raises(ValueError, match="'delta_cop' must be finite and positive, got -1"):
        make(delta_cop=-1.0)


def test_a_log_of_another_length_is_refused(log):
    short = log.reference._replace(com=log.reference.com[:-1])
    with pytest.raises(
        ValueError, match=r"'reference\.com' must have one row for each of the 240 rows of 'raw'"
    ):
        replay(LAYOUT, "window", log.raw, short, DT, mass=MASS)
    with pytest.raises(ValueError, match=r"'raw' must have shape \(samples, channels\), got \(8,\)\.$"):
        replay(LAYOUT, "window", log.raw[0], log.reference, DT, mass=MASS)
    several = (
        r"must have shape \(samples, channels\), got \(240, 1, 8\)\. That is of several robots, .* for each"
    )
    with pytest.raises(ValueError, match=several):
        replay(LAYOUT, "window", log.raw[:, None], log.reference, DT, mass=MASS)
    with pytest.raises(ValueError, match="'raw' must hold one reading for each of the 8 channels"):
        replay(LAYOUT, "window", log.raw[:, :5], log.reference, DT, mass=MASS)


def test_zero_phase_learns_from_filtered_readings_and_applies_to_all(log):
    options = {"mass": believed_mass(FAULTS), "initial": NOMINAL}
    hindsight = replay(LAYOUT, "window", log.raw, log.reference, DT, zero_phase=True, **options)
    causal = replay(LAYOUT, "window", log.raw, log.reference, DT, **options)
    np.testing.assert_allclose(hindsight.scale * log.raw + hindsight.offset, hindsight.force, atol=1e-8)
    assert not np.array_equal(hindsight.scale, causal.scale)
    scale = hindsight.scale[-1] / causal.scale[-1]
    np.testing.assert_allclose(scale, 1.0, atol=0.05)
    none = replay(LAYOUT, "none", log.raw, log.reference, DT, zero_phase=True, **options)
    np.testing.assert_allclose(none.force, NOMINAL.force(log.raw), atol=1e-9)


def test_zero_phase_holds_what_is_missing(log):
    raw = log.raw.copy()
    raw[100:103, 2] = np.nan
    estimate = replay(LAYOUT, "window", raw, log.reference, DT, zero_phase=True, mass=MASS, initial=NOMINAL)
    assert np.isfinite(estimate.force).all()
    assert (estimate.flags[100:103, 2] & 1).all()
    held = (estimate.force[102, 2] - estimate.offset[102, 2]) / estimate.scale[102, 2]
    assert held == pytest.approx(raw[99, 2], rel=1e-9)


def test_a_state_of_another_setup_and_files_of_another_kind_are_refused(log, tmp_path):
    path = tmp_path / "feet.npz"
    first = make()
    first.update(log.raw[0], rows(log)[0])
    first.save(path)
    assert [file.name for file in tmp_path.iterdir()] == ["feet.npz"]
    moved = Parameters(NOMINAL.scale, NOMINAL.offset + 1.0)
    for options, name in (
        ({"mass": 9.0}, "mass"),
        ({"dt": 0.02}, "dt"),
        ({"initial": moved}, "initial.offset"),
    ):
        with pytest.raises(ValueError, match=f"was saved for {name} '"):
            make(**options).load(path)
    (tmp_path / "half").write_bytes(path.read_bytes()[:500])
    with pytest.raises(ValueError, match="is not a saved state: it is another file or damaged"):
        first.load(tmp_path / "half")


@pytest.mark.parametrize("method", ["moment", "window", "tare"])
def test_a_robot_with_another_battery_keeps_its_map(method, log, tmp_path):
    """By 0.1 kg of 5.3. The map of the cells in counts and newtons is the same."""
    before = make(method)
    for raw, row in zip(log.raw, rows(log), strict=True):
        learnt = before.update(raw, row)
    before.save(tmp_path / "feet.npz")
    heavier = make(method, mass=before.setup.mass + 0.1)
    with pytest.warns(UserWarning, match=r"had a mass of 5\.\d+ kg, and now it has 5\.\d+ kg\. The map"):
        heavier.load(tmp_path / "feet.npz")
    found = heavier.update(log.raw[-1], rows(log)[-1])
    np.testing.assert_allclose(found.scale, learnt.scale, rtol=1e-3)
    np.testing.assert_allclose(found.offset, learnt.offset, atol=0.2)  # N of 53
    assert np.abs(learnt.offset - NOMINAL.offset).max() > 0.1
    if found.covariance is not None:
        np.testing.assert_allclose(np.diagonal(found.covariance), np.diagonal(learnt.covariance), rtol=0.1)
    heavier.save(tmp_path / "feet.npz")
    heavier.load(tmp_path / "feet.npz")  # now without a word


def test_all_that_differs_of_another_robot_is_named(log, tmp_path):
    window = make()
    window.update(log.raw[0], rows(log)[0])
    window.save(tmp_path / "feet.npz")
    left, right = (FootLayout.load_cells(name, LAYOUT.feet[0].position_cell_sole) for name in ("a", "b"))
    other = FootCalibrator(FeetLayout((left, right)), "tare", mass=MASS, dt=0.02)
    with pytest.raises(
        ValueError, match=r"for method 'window', .* for channels 'left.* for dt '0\.0125', but"
    ):
        other.load(tmp_path / "feet.npz")


def test_a_damaged_file_is_refused_whatever_is_damaged(log, tmp_path):
    calibrator = make()
    calibrator.update(log.raw[0], rows(log)[0])
    calibrator.save(tmp_path / "feet.npz")
    whole = (tmp_path / "feet.npz").read_bytes()
    rng, refused = np.random.default_rng(0), 0
    for _ in range(200):
        broken = bytearray(whole)
        for place in rng.integers(len(whole), size=rng.integers(1, 20)):
            broken[place] = rng.integers(256)
        (tmp_path / "feet.npz").write_bytes(bytes(broken))
        try:
            calibrator.load(tmp_path / "feet.npz")
        except ValueError as error:
            refused += "feet.npz" in str(error)
    assert refused > 150


def test_zero_phase_keeps_an_absurd_reading_from_its_neighbours(log):
    options = {"zero_phase": True, "mass": MASS, "initial": NOMINAL}
    raw, missing = log.raw.copy(), log.raw.copy()
    raw[100, 2], missing[100, 2] = 1e20, np.nan
    found = replay(LAYOUT, "window", raw, log.reference, DT, **options)
    expected = replay(LAYOUT, "window", missing, log.reference, DT, **options)
    np.testing.assert_array_equal(found.scale, expected.scale)
    with pytest.raises(ValueError, match="'dt' must be finite and positive, got 0"):
        replay(LAYOUT, "window", raw, log.reference, 0.0, **options)


@pytest.mark.parametrize(
    ("method", "options"), [("window", {"every": 8.0, "iterations": 2.0}), ("moment", {"lag": 2.0})]
)
def test_counts_may_be_floats_as_files_have_them(log, method, options, monkeypatch):
    each_row = rows(log)
    for libraries in (CALIBRATION.rooms(), ()):
        monkeypatch.setattr(CALIBRATION, "rooms", lambda found=libraries: found)
        whole = {name: int(value) for name, value in options.items()}
        given, meant = make(method, **options), make(method, **whole)
        for k in range(100):
            ours, theirs = (each.update(log.raw[k], each_row[k]) for each in (given, meant))
        np.testing.assert_array_equal(ours.scale, theirs.scale)


def test_arguments_without_meaning_are_refused(log):
    for lag in (np.inf, np.nan, None):
        with pytest.raises(ValueError, match=f"'lag' must be a whole number from 0 on, got {lag}"):
            make(lag=lag)
    with pytest.raises(ValueError, match="'every' must be a whole number from 1 on, got inf"):
        make(every=np.inf)
    with pytest.raises(TypeError, match="must be a FootLayout, got NoneType; leave a missing foot out"):
        FeetLayout((LAYOUT.feet[0], None))
    with pytest.raises(TypeError, match="'reference' must be a Reference, got NoneType"):
        make().update(log.raw[0], None)


def test_options_may_be_a_value_that_names_its_method():
    by_value = FootCalibrator(LAYOUT, Moment(scale_std=0.2, ripple=1.0), mass=MASS)
    by_name = FootCalibrator(LAYOUT, "moment", mass=MASS, scale_std=0.2, ripple=1.0)
    assert (by_value.method, by_value._options) == (by_name.method, by_name._options)
    assert FootCalibrator(LAYOUT, Window(iterations=2), mass=MASS).method == "window"
    assert FootCalibrator(LAYOUT, SwingTare(), mass=MASS).method == "tare"
    with pytest.raises(ValueError, match=r"'ripple' is given twice, in Moment\(...\) and as a keyword"):
        FootCalibrator(LAYOUT, Moment(ripple=1.0), mass=MASS, ripple=2.0)


def test_a_replay_keeps_little_more_than_a_kilobyte_for_each_sample(log):
    """Its results are arrays, and a covariance that changes once in several samples is kept once."""
    times = 12
    raw = np.concatenate([log.raw] * times)
    reference = Reference(*(np.concatenate([part] * times) for part in log.reference))
    known = {"mass": believed_mass(FAULTS), "initial": NOMINAL}
    replay(LAYOUT, "moment", log.raw, log.reference, DT, **known)  # libraries and constants are loaded
    tracemalloc.start()
    try:
        found = replay(LAYOUT, "moment", raw, reference, DT, **known)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1100 * len(raw) + 2**18  # 112 of them are values at a common moment
    assert found.covariance.shape == (len(raw), 16, 16)
    whole = np.asarray(found.covariance)
    diagonal = np.arange(16)
    np.testing.assert_array_equal(found.covariance[-1], whole[-1])
    np.testing.assert_array_equal(found.covariance[50:90], whole[50:90])
    np.testing.assert_array_equal(found.covariance[:, diagonal, diagonal], whole[:, diagonal, diagonal])
    np.testing.assert_array_equal(found.covariance[..., 0, 1], whole[..., 0, 1])


HELD = HeldRows(np.arange(8.0).reshape(2, 2, 2), np.array([0, 0, 1]))
KEYS = [
    -1,
    slice(1, None),
    np.array([True, False, True]),
    np.ones((3, 2), dtype=bool),
    (slice(None), [0, 1], [0, 1]),
    ([0, 2], 0),
    ([0, 2], [0, 1]),
    (..., 0),
    (slice(None), None, 1),
]


@pytest.mark.parametrize("key", KEYS, ids=str)
def test_rows_that_are_stored_once_are_indexed_as_an_array(key):
    np.testing.assert_array_equal(HELD[key], np.asarray(HELD)[key], strict=True)
