"""Episodes that begin with a calibrator that has learnt from a motion."""

import numpy as np
import pytest

from surefoot.envs import ExerciseEnv, NaoStandEnv
from surefoot.sensors import LoadCells
from surefoot.wrappers import CalibrateFirst, FootSensors, SelfCalibration

STILL = np.zeros(11, dtype=np.float32)


@pytest.fixture(scope="module")
def prelude():
    stage = ExerciseEnv("nao", joint_noise=0.0, velocity_noise=0.0)
    return stage.motion.prelude(["step @ 1.4", "squat @ 1.4"], stage.dt)


def feet(prelude, method="moment"):
    return SelfCalibration(FootSensors(NaoStandEnv(prelude=prelude), LoadCells(rate=None)), method)


def test_an_episode_begins_certain(prelude):
    env = CalibrateFirst(feet(prelude), enough=2.5e-3)
    _, info = env.reset(seed=1)
    told = info["surefoot"]
    # It stopped after the steps: the squat was no longer needed.
    assert told["certain"]
    assert told["cop_std"] <= 2.5e-3
    assert prelude.duration - 0.5 < told["prelude_time"] < prelude.duration + 2.5
    assert not env.unwrapped.prelude.playing
    assert not env.wanted
    calibration = env.env
    start = calibration.calibrator.setup.initial
    truth = np.array(calibration._sensors.true_parameters())
    wrong = [np.abs(np.array(found) - truth)[0] / np.abs(truth[0]) for found in (start, told["parameters"])]
    assert wrong[1].mean() < wrong[0].mean()
    _, _, _, _, info = env.step(STILL)
    assert info["surefoot"]["certain"]


@pytest.mark.slow
def test_without_a_stop_all_of_it_is_played_and_doubt_is_told(prelude):
    env = CalibrateFirst(feet(prelude), enough=0.0, again=1.01e-3)
    _, info = env.reset(seed=1)
    assert info["surefoot"]["prelude_time"] == pytest.approx(prelude.duration + 3.0, abs=0.05)
    assert info["surefoot"]["cop_std"] > 1.01e-3
    assert env.wanted


def test_what_it_cannot_do_is_refused(prelude):
    with pytest.raises(ValueError, match="has no prelude to calibrate by; make it with prelude="):
        CalibrateFirst(feet(None))
    with pytest.raises(TypeError, match="needs SelfCalibration below it"):
        CalibrateFirst(NaoStandEnv(prelude=prelude))
    with pytest.raises(ValueError, match="needs a method that says how certain it is, such as 'moment'"):
        CalibrateFirst(feet(prelude, "none")).reset(seed=0)
