"""The window's standing start: when it comes, what it brings, and how sure it is."""

import numpy as np
import pytest
from _synthetic import DT, LAYOUT, MASS, NOMINAL, Faults, walk
from _window import at_rest, run

from surefoot.calibration import GRAVITY, Flag, OnlineSetup, Reference, replay
from surefoot.calibration.window.config import Window, confidence_from_standing


def test_standing_comes_first_and_brings_the_force_right():
    faults = Faults(gain=0.1, offset=1.0)
    only = {"scale_step": 1e-9, "offset_step": 1e-9, "standing_scale_std": 0.1, "standing_offset_std": 0.03}
    for seed in range(4):
        log = walk(seed, duration=0.0, stand=3.2, faults=faults)
        estimate = run(log, faults=faults, **only)
        standing = (estimate.flags[:, 0] & Flag.STANDING) > 0
        assert standing[:199].all()
        assert not standing[201:].any()
        force = np.abs(estimate.vgrf.sum(axis=1) - log.vgrf)
        place = np.linalg.norm(estimate.cop - log.cop, axis=1)
        assert force[250] < max(0.2 * force[150], 0.3)
        # A believed centre of mass that may be 3 mm off is not trusted to the last.
        assert place[250] < max(0.4 * place[150], 1e-3)


def test_drift_during_standing_is_not_taken_for_load():
    faults = Faults(offset_drift=1.0, noise=0.1)
    wide = {"scale_step": 1e-9, "offset_step": 1e-9, "standing_scale_std": 0.1}
    logs = [walk(seed, duration=0.0, stand=4.0, faults=faults) for seed in range(5)]
    scales = [run(log, faults=faults, **wide).scale[-1] / NOMINAL.scale for log in logs]
    assert np.mean(scales) == pytest.approx(1.0, abs=0.02)


def test_a_robot_that_never_stands_still_goes_on_without():
    raw, reference = at_rest(200)
    swaying = reference._replace(gyroscope=reference.gyroscope + 1.0)
    estimate = replay(
        LAYOUT, "window", raw, swaying, DT, mass=MASS, initial=NOMINAL, lag=0, standing_patience=2.0
    )
    standing = (estimate.flags[:, 0] & Flag.STANDING) > 0
    assert standing[:159].all()
    assert not standing[162:].any()


def test_a_robot_that_walks_at_once_has_no_standing_start():
    log = walk(1, duration=3.0, stand=0.2)
    estimate = run(log)
    first_swing = int(np.argmax(log.reference.swing.any(axis=1)))
    assert (estimate.flags[first_swing - 1] & Flag.STANDING).all()
    assert not (estimate.flags[first_swing] & Flag.STANDING).any()


def test_confidence_is_read_off_standing():
    faults = Faults(noise=0.2)
    log = walk(9, duration=0.0, stand=20.0, faults=faults)
    setup = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL, lag=0)
    still = Reference(*(part[:1200] for part in log.reference))
    delta_force, delta_cop = confidence_from_standing(setup, log.raw[:1200], still)
    weight = MASS * GRAVITY
    assert delta_force == pytest.approx(0.2 * np.sqrt(8) / weight, rel=0.1)
    place = np.abs(LAYOUT.feet[0].position_cell_sole[:, 0] - 0.024).mean()
    assert delta_cop == pytest.approx(0.2 * np.sqrt(8) * place / weight / setup.length, rel=0.25)
    Window(delta_force=delta_force, delta_cop=delta_cop)


def test_confidence_needs_samples():
    log = walk(9, duration=0.0)
    setup = OnlineSetup(layout=LAYOUT, mass=MASS, initial=NOMINAL)
    with pytest.raises(ValueError, match="Only 0 of 320 samples are finite and in contact"):
        confidence_from_standing(setup, np.full_like(log.raw, np.nan), log.reference)
