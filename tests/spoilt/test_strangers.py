"""Sound walks of a measuring chain that is modelled elsewhere: none is refused, and no foot gets worse."""

import numpy as np
import pytest
from _strangers import draw_chain, record, robot_model, score, write_log

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("robot", ["nao", "op3", "t1"])
def test_a_sound_log_is_answered_and_no_foot_gets_worse(robot, tmp_path):
    try:
        model = robot_model(robot)
    except ModuleNotFoundError as missing:
        pytest.skip(str(missing))
    rng = np.random.default_rng([5, 1])
    truth = write_log(tmp_path, record(robot, 5001, 44.0), model, draw_chain(rng, robot), rng)
    found = score(tmp_path, truth)
    assert found["status"] == 0, found["message"]
    for learnt, start in zip(found["learnt"], found["start"], strict=True):
        assert learnt <= 1.1 * start + 0.1
