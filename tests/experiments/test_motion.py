"""Rehearsals and plans of a robot's own calibration motion."""

import numpy as np
import pytest

from surefoot.controllers import CalibrationMotion
from surefoot.experiments import motion as module
from surefoot.experiments.motion import Limits, Rehearsal, plan_motion, rehearse

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def stage():
    return Rehearsal("nao")


def test_a_robot_is_offered_what_it_can_do(stage):
    robot, refused = rehearse(stage, ["squat @ 1.4", "sway forward 1.4 @ 1.4", "sway forward 9"])
    assert set(robot.motions) == {"squat @ 1.4"}
    assert "comes as close to an edge as" in refused["sway forward 1.4 @ 1.4"]
    assert "The legs reach" in refused["sway forward 9"]
    squat = robot.motions["squat @ 1.4"]
    # Perfect cells bear the robot's weight, but for the squat's own acceleration.
    assert squat.force[30:].sum(axis=1).mean() == pytest.approx(9.81 * robot.mass, rel=0.02)
    _, refused = rehearse(stage, ["squat @ 1.4"], Limits(torque=0.3))
    assert refused["squat @ 1.4"].endswith("of its torque")


def test_a_plan_is_played_and_written(monkeypatch, tmp_path):
    offered = [["squat @ 1.4"], ["sway forward 1.4 @ 1.4", "sway forward 1 @ 1.4"], ["lift @ 1.4"]]
    monkeypatch.setattr(module, "list_motions", lambda: offered)
    planned = plan_motion("nao", 12.0)
    names = [name for names in offered for name in names]
    assert set(planned.plan.motions) <= set(names) - {"sway forward 1.4 @ 1.4"}
    assert "lift @ 1.4" in planned.plan.motions
    assert planned.prelude.duration == pytest.approx(planned.plan.time[-1], abs=0.1)
    segments, rates, refused = (table.rows for table in planned.tables)
    assert [row[0] for row in segments] == list(planned.plan.motions)
    assert {row[0] for row in rates} == {"squat @ 1.4", "sway forward 1 @ 1.4", "lift @ 1.4"}
    assert [row[0] for row in refused] == ["sway forward 1.4 @ 1.4"]
    planned.prelude.write(tmp_path / "nao_motion.csv")
    player = CalibrationMotion.read(tmp_path / "nao_motion.csv")
    assert player.motors == planned.prelude.motors
    commands = planned.prelude.commands
    for target, swing in zip(commands.joint_target, commands.swing, strict=True):
        np.testing.assert_allclose(player({}), target, atol=1e-6)
        np.testing.assert_array_equal(player.swing, swing)
    assert player.done
