"""The official iCub's leg on the rig: needs the package icub-models."""

import sys
from operator import call

import mujoco
import numpy as np
import pytest
from _refusals import refusals
from test_leg_rig_recording import gravity_wrench

from surefoot.envs.leg_rig.icub import load_icub_leg_spec
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.envs.leg_rig.spec import ADDED_MASSES, limb_beyond, sensor_frames


@pytest.fixture
def _installed():
    pytest.importorskip("icub_models", reason="the extra 'icub' (icub-models) is not installed")


@pytest.mark.usefixtures("_installed")
@pytest.mark.parametrize("side", ["left", "right"])
def test_sensors_and_masses_are_those_of_the_official_model(side):
    model = load_icub_leg_spec(4, side=side).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.nv == 2
    origins, rotations = sensor_frames(data)
    for R in rotations:
        np.testing.assert_allclose(R, np.diag([1.0, -1.0, -1.0]), atol=1e-6)
    assert origins[1, 2] - data.body(f"{side[0]}_hip_2").xpos[2] == pytest.approx(-0.0743, abs=1e-6)
    # Beam and IMU, 0.207 kg, hang on top of what the model has below its sensors.
    assert 4.70 < limb_beyond(model, data, "leg").mass - 0.207 < 4.735
    assert 0.35 < limb_beyond(model, data, "foot").mass - 0.207 < 0.39
    com = rotations[0].T @ (data.body("added_mass").xipos - origins[0])
    np.testing.assert_allclose(com, ADDED_MASSES[4].com_foot, atol=1e-9)
    data.qpos[:] = 0.3, 0.2
    mujoco.mj_kinematics(model, data)
    outward = {"left": 1.0, "right": -1.0}[side]
    moved = data.site("foot_ft").xpos - origins[0]
    assert moved[0] > 0.1
    assert moved[1] * outward > 0.05


@pytest.mark.usefixtures("_installed")
def test_recordings_at_rest_are_gravity():
    for recording in record_rig([1, 5], duration=100.0, rate=5.0, at_rest=True, icub=True):
        for sensor in ("foot", "leg"):
            expected = gravity_wrench(recording, sensor)
            # The model's own rotations are written with 15 digits or less.
            np.testing.assert_allclose(getattr(recording, f"wrench_{sensor}"), expected, atol=1e-6)


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "icub_models", None)
    with pytest.raises(ImportError, match=r"needs the package 'icub-models'.*surefoot\[icub\]"):
        load_icub_leg_spec()


test_bad_options_are_refused = refusals(
    call,
    (lambda: load_icub_leg_spec(side="both"), "'side' must be 'left' or 'right', got 'both'"),
    (lambda: load_icub_leg_spec(12), "no configuration 12"),
    (lambda: record_rig([1], icub=True, floor=True), "neither 'knee_slack' nor 'floor'"),
)
