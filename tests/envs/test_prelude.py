"""A robot's motion before an episode: planned, written, read, and played."""

import numpy as np
import pytest

from surefoot.envs import ExerciseEnv, NaoStandEnv, NaoWalkEnv, Prelude
from surefoot.envs.exercise.moves import list_motions, motions_of
from surefoot.envs.prelude import BLEND_TIME, Player


@pytest.fixture(scope="module")
def stage():
    return ExerciseEnv("nao", joint_noise=0.0, velocity_noise=0.0)


@pytest.fixture(scope="module")
def short(stage):
    return stage.motion.prelude(["squat @ 1.4", "lift @ 1.4"], stage.dt)


def zero(env):
    return np.zeros(env.action_space.shape, dtype=np.float32)


def played(env):
    """Step through the prelude; whether the robot fell, and the commands."""
    commands = []
    while env.prelude.playing:
        _, _, fell, _, _ = env.step(zero(env))
        commands.append(env.command)
        if fell:
            return True, commands
    return False, commands


def test_what_is_written_is_read(short, tmp_path):
    short.write(tmp_path / "motion.csv")
    read = Prelude.read(tmp_path / "motion.csv")
    assert read.motors == short.motors
    assert read.dt == pytest.approx(short.dt)
    parts = zip((*read.commands[:-1], read.rest), (*short.commands[:-1], short.rest), strict=True)
    for one, other in parts:
        assert one.shape == other.shape
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
    text = (tmp_path / "motion.csv").read_text()
    (tmp_path / "bad.csv").write_text(text.replace("com_x_m", "com_x"))
    with pytest.raises(
        ValueError, match=r"lacks the columns \['com_x_m'\]; write it with surefoot calibrate"
    ):
        Prelude.read(tmp_path / "bad.csv")


def test_every_motion_starts_and_ends_in_the_middle(stage):
    first = stage.motion.qpos
    for names in list_motions():
        moves = motions_of(names[-1])
        assert [move.ends for move in moves] == [*[False] * (len(moves) - 1), True]
        plan = stage.motion.prelude([names[-1]], stage.dt)
        assert plan.rest.sum() == 1
        assert plan.rest[-1]
        middle = stage.motion._postures.com
        np.testing.assert_allclose(plan.commands.com[[0, -1]], [middle, middle], atol=1e-3)
        # Targets go on where they were: nothing jumps from one move to the next.
        assert np.abs(np.diff(plan.commands.joint_target, axis=0)).max() < 0.12
        assert not (plan.commands.stance & plan.commands.swing).any()
        assert plan.commands.swing.any(axis=0).sum() == (2 if names[-1].startswith("lift") else 0)
    np.testing.assert_array_equal(stage.motion.qpos, first)


def test_a_tempo_is_a_factor_on_all_speeds(stage):
    slow, fast = (stage.motion.prelude([f"sway left 1 @ {tempo}"], stage.dt) for tempo in (0.5, 1.0))
    assert slow.duration == pytest.approx(2.0 * fast.duration, abs=2 * stage.dt)
    assert np.abs(fast.commands.com_velocity).max() == pytest.approx(
        2.0 * np.abs(slow.commands.com_velocity).max(), rel=0.02
    )


@pytest.mark.parametrize(
    ("name", "match"),
    [
        ("dance", "There is no motion 'dance'. There are 'sway' with one of"),
        ("", "There is no motion ''"),
        ("sway up 1", "There is no motion 'sway up 1'"),
        ("sway left 1 @ fast", "There is no motion"),
        (
            "sway left 9",
            "reach from -1.6 to 1.6 along 'left', and a motion goes from 0 to 9; give it a smaller",
        ),
    ],
)
def test_unknown_motions_are_refused(stage, name, match):
    with pytest.raises(ValueError, match=match):
        stage.motion.prelude([name], stage.dt)


def test_a_walk_begins_after_its_prelude_as_it_does_without(short):
    walks = [NaoWalkEnv(duration=6.0, push_impulse=(0.0, 0.0), prelude=one) for one in (short, None)]
    commands = []
    for env in walks:
        env.reset(seed=0)
        fell, before = played(env)
        assert not fell
        length = round((short.duration + 2 * BLEND_TIME) / env.dt) if env is walks[0] else 0
        assert abs(len(before) - length) <= 2
        rows = []
        for _ in range(160):
            _, _, fell, truncated, _ = env.step(zero(env))
            assert not fell
            assert not truncated
            rows.append(env.command.joint_target)
        commands.append(rows)
        if before:
            targets = np.array(
                [env.pattern.command(0).joint_target, *(c.joint_target for c in before), rows[0]]
            )
            assert np.abs(np.diff(targets, axis=0)).max() < 0.05
    np.testing.assert_array_equal(*commands)


def test_it_stops_where_the_robot_rests_and_nowhere_else(short):
    env = NaoWalkEnv(duration=6.0, push_impulse=(0.0, 0.0), prelude=short)
    env.reset(seed=0)
    steps, rests = 0, 0
    while env.prelude.playing:
        env.step(zero(env))
        steps += 1
        rests += env.prelude.resting
        env.prelude.stop()
    assert rests == 1
    squat = round((2 * BLEND_TIME + np.flatnonzero(short.rest)[0] * short.dt) / env.dt)
    assert abs(steps - squat) <= 3


def test_an_exercise_begins_after_its_prelude(stage, short):
    stage.prelude = Player(short, short.motors, stage.dt)
    stage.reset(seed=3)
    fell, commands = played(stage)
    assert not fell
    assert len(commands) == len(short.rest)
    np.testing.assert_array_equal(commands[10].joint_target, short.commands.joint_target[10])
    stage.step(zero(stage))
    first = stage.command_at(stage.state.plan, 1)
    np.testing.assert_array_equal(stage.command.joint_target, first.joint_target)


def test_a_prelude_of_another_robot_or_place_is_refused(short):
    with pytest.raises(ValueError, match=r"'prelude' moves .* but the robot's motors are"):
        NaoStandEnv(prelude=short._replace(motors=("knee", *short.motors[1:])))
    moved = short.commands.position_sole + np.array([0.0, 0.02, 0.0])
    aside = NaoStandEnv(prelude=short._replace(commands=short.commands._replace(position_sole=moved)))
    with pytest.raises(ValueError, match="'prelude' has its soles 20 mm from where the episode begins"):
        aside.reset(seed=0)
