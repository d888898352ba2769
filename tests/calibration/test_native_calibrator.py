"""A calibrator on the library: copies, files, and what it leaves to Python."""

import copy
import pickle

import numpy as np
import pytest
from _ankles import ANKLES
from _native_filters import Log, same_estimate
from _synthetic import LAYOUT, MASS

from surefoot.calibration import FootCalibrator, OnlineSetup, Parameters, Reference
from surefoot.calibration.native import native_filter
from surefoot.native import CALIBRATION, compiler

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


def test_a_robot_that_the_library_is_not_made_for_is_left_to_python(library):
    initial = Parameters(np.ones(12), np.zeros(12))
    setup = OnlineSetup(layout=ANKLES, mass=MASS, initial=initial, foot_length=0.17)
    assert native_filter(library, "moment", setup, {"block": 1.0}) is None
    assert native_filter(library, "window", setup, {}) is None
    assert native_filter(library, "module:mine", setup, {}) is None
    late = OnlineSetup(layout=ANKLES, mass=MASS, initial=initial, foot_length=0.17, lag=9)
    assert native_filter(library, "moment", late, {}) is None
    assert native_filter(None, "moment", setup, {}) is None


@pytest.fixture
def calibrators(library, monkeypatch):
    """The same calibrator by the library and by Python."""
    made = []
    for found in (library, None):
        rooms = (found,) if found else ()
        monkeypatch.setattr(CALIBRATION, "rooms", lambda rooms=rooms: rooms)
        made.append(FootCalibrator(LAYOUT, "moment", mass=MASS, lag=1))
    monkeypatch.setattr(CALIBRATION, "rooms", lambda: (library,))
    return made


def test_a_calibrator_keeps_copies_and_files_of_its_state(calibrators, tmp_path):
    log = Log("cells")
    by_library, by_python = calibrators
    for k in range(400):
        for calibrator in calibrators:
            calibrator.update(log.force[k], log.row(k))
    kept = by_library.state
    by_library.save(tmp_path / "feet.npz")
    others = [copy.deepcopy(by_library), pickle.loads(pickle.dumps(by_library)), *calibrators]
    others.append(FootCalibrator(LAYOUT, "moment", mass=MASS, lag=1))
    others[-1].load(tmp_path / "feet.npz")
    others.append(FootCalibrator(LAYOUT, "moment", mass=MASS, lag=1))
    others[-1].state = kept
    by_python.state = kept
    for k in range(400, 500):
        estimates = [
            other.update(log.force[k].tolist() if k % 2 else log.force[k], log.row(k)) for other in others
        ]
        if k == 450:
            for other in others:
                other.retract()
    for estimate in estimates:
        same_estimate(estimates[3], estimate)
    assert kept.time == pytest.approx(5.0 - 0.1, abs=0.2)
    by_library.reset()
    assert by_library.state is None


def test_samples_of_other_numbers_are_taken_in_by_python_and_the_state_stays_in_the_library(calibrators):
    log = Log("cells")
    for k, dt in enumerate((0.0125, 1, 0.0125)):  # a whole number of seconds as well
        estimates = [calibrator.update(log.force[k], log.row(k), dt) for calibrator in calibrators]
        same_estimate(*estimates)
    by_library, _ = calibrators
    assert by_library.native()[1] is by_library.native()[1]
    assert by_library.state.waiting == 0
    by_library.reset()
    single = Reference(*(part.astype(np.float32) if part.dtype.kind == "f" else part for part in log.row(0)))
    assert by_library.update(log.force[0], single).force.dtype == np.float64
    assert by_library.update(log.force[1], log.row(1)).force.dtype == np.float64


def test_a_state_of_another_robot_is_refused(calibrators):
    by_library, _ = calibrators
    other = FootCalibrator(LAYOUT, "tare", mass=MASS, lag=1)
    other.update(np.zeros(8), Log("cells").row(0))
    with pytest.raises(ValueError, match="A MomentState of a robot of 8 channels cannot go on from"):
        by_library.state = other.state


@pytest.mark.parametrize(
    "spoil",
    [
        lambda raw, row: (raw[:5], row),
        lambda raw, row: (raw[None], row),
        lambda raw, row: (raw, None),
        lambda raw, row: (raw, row._replace(com=row.com[:2])),
        lambda raw, row: (raw, row._replace(com=[0.0, 0.0, 0.3])),
        lambda raw, row: (raw, row._replace(R_level_sole=row.R_level_sole[0])),
        lambda raw, row: (raw, row._replace(stance=row.stance.astype(float))),
        lambda raw, row: (raw, row._replace(swing=row.swing[:1])),
    ],
)
def test_what_is_no_sample_is_refused_in_the_same_words(calibrators, spoil):
    log, said = Log("cells"), []
    for calibrator in calibrators:
        calibrator.update(log.force[0], log.row(0))
        with pytest.raises((ValueError, TypeError)) as caught:
            calibrator.update(*spoil(log.force[1], log.row(1)))
        said.append((caught.type, str(caught.value)))
        calibrator.update(log.force[1], log.row(1))
    assert said[0] == said[1]
