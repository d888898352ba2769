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
    commands = [env.command_at(env.draw({}), tick) for tick in range(1, 321)]
    return Prelude.of_commands(env.dt, env.motor_names, commands, np.isin(np.arange(320), (159, 319)))


def feet(prelude, method="moment"):
    return SelfCalibration(FootSensors(NaoStandEnv(prelude=prelude), LoadCells(rate=None)), method)


def test_an_episode_begins_certain(prelude):
    env, lengths, off = CalibrateFirst(feet(prelude), enough=8e-3), set(), []
    for seed in range(2, 6):
        _, info = env.reset(seed=seed)
        told = info["surefoot"]
        assert told["certain"]
        assert told["cop_std"] <= 8e-3
        lengths.add(told["prelude_time"] / prelude.duration)
        assert not env.unwrapped.prelude.playing
        assert not env.wanted
        start, raw = env.env.calibrator.setup.initial, env.env._sensors.raw
        true = env.unwrapped.truth.force_cell[-1].sum()
        off.append(
            [np.sum(p.scale * raw + p.offset) - true for p in (Parameters(**told["parameters"]), start)]
        )
    # Some robots stopped after one period, as the second was no longer needed; others needed both.
    assert lengths == {0.5, 1.0}
    # They have learnt: the feet bear what they bear, and not what the data sheet makes of the counts.
    learnt, before = np.abs(off).mean(axis=0)
    assert learnt < 0.3 * before
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
