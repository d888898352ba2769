"""Episodes that begin with a calibrator that has learnt from a motion."""

import numpy as np
import pytest

from surefoot.calibration import Parameters
from surefoot.envs import NaoStandEnv, Prelude
from surefoot.sensors import LoadCells
from surefoot.wrappers import CalibrateFirst, FootSensors, SelfCalibration

STILL = np.zeros(11, dtype=np.float32)


@pytest.fixture(scope="module")
def prelude():
    """Two periods of a sway, with a rest after each."""
    env = NaoStandEnv(sway=(0.03, 0.02), sway_period=2.0)
    commands = [env._command(tick) for tick in range(1, 321)]
    return Prelude.of_commands(env.dt, env.motor_names, commands, np.isin(np.arange(320), (159, 319)))


def feet(prelude, method="moment"):
    return SelfCalibration(FootSensors(NaoStandEnv(prelude=prelude), LoadCells(rate=None)), method)


def test_an_episode_begins_certain(prelude):
    env = CalibrateFirst(feet(prelude), enough=18e-3)
    # A robot for which half of it is enough; others need all.
    _, info = env.reset(seed=7)
    told = info["surefoot"]
    # It stopped after one period: the second was no longer needed.
    assert told["certain"]
    assert told["cop_std"] <= 18e-3
    assert told["prelude_time"] == pytest.approx(prelude.duration / 2.0)
    assert not env.unwrapped.prelude.playing
    assert not env.wanted
    calibration = env.env
    # It has learnt: the feet bear what they bear, and not what the data sheet makes of the counts.
    start, raw = calibration.calibrator.setup.initial, calibration._sensors.raw
    true = env.unwrapped.truth.force_cell[-1].sum()
    learnt, before = (
        np.sum(p.scale * raw + p.offset) - true for p in (Parameters(**told["parameters"]), start)
    )
    assert abs(learnt) < 0.3 * abs(before)
    _, _, _, _, info = env.step(STILL)
    assert info["surefoot"]["certain"]


def test_without_a_stop_all_of_it_is_played_and_doubt_is_told(prelude):
    env = CalibrateFirst(feet(prelude), enough=0.0, again=1.01e-3)
    _, info = env.reset(seed=1)
    assert info["surefoot"]["prelude_time"] == pytest.approx(prelude.duration)
    assert info["surefoot"]["cop_std"] > 1.01e-3
    assert env.wanted


def test_what_it_cannot_do_is_refused(prelude):
    with pytest.raises(ValueError, match="has no prelude to calibrate by; make it with prelude="):
        CalibrateFirst(feet(None))
    with pytest.raises(TypeError, match="needs SelfCalibration below it"):
        CalibrateFirst(NaoStandEnv(prelude=prelude))
    with pytest.raises(ValueError, match="needs a method that says how certain it is, such as 'moment'"):
        CalibrateFirst(feet(prelude, "none")).reset(seed=0)
