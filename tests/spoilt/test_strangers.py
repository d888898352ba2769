"""Sound walks of a measuring chain that is modelled elsewhere: none is refused, and the feet get no worse."""

import numpy as np
import pytest
from _strangers import draw_chain, record, robot_model, score, write_log

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("robot", ["nao", "op3", "t1"])
def test_a_sound_log_is_answered_and_feet_get_no_worse(robot, tmp_path):
    try:
        model = robot_model(robot)
    except ModuleNotFoundError as missing:
        pytest.skip(str(missing))
    rng = np.random.default_rng([5, 1])
    truth = write_log(tmp_path, record(robot, 5001, 44.0), model, draw_chain(rng, robot), rng)
    found = score(tmp_path, truth)
    assert found["status"] == 0, found["message"]
    # A foot that begins within a millimetre may lose a part of it.
    assert np.linalg.norm(found["learnt"]) <= max(1.1 * np.linalg.norm(found["start"]), 2.0)
