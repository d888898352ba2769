"""Many robots stepped by MuJoCo's own threads: what Gymnasium's copies of the same task do, bit for bit."""

from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import surefoot
from surefoot.envs.batch import BatchVectorEnv
from surefoot.envs.nao.stand import NaoStandEnv
from surefoot.wrappers import TruthRow, VectorFootSensors, VectorSelfCalibration

ROBOTS = 3
STEPS = {"NaoBalance": 120}  # control steps, more than an episode; 200 of other tasks

TASKS: dict[str, dict[str, Any]] = {
    "Exercise": {"robot": "nao", "duration": 2.0, "action_scale": 0.3},
    "NaoBalance": {"stand_time": 0.3, "duration": 1.2, "payload_time": (0.2, 0.5), "push_interval": 0.4},
    "NaoCarry": {"stand_time": 0.5, "duration": 1.4, "payload_time": (0.1, 0.3), "push_interval": 0.4},
    "NaoStand": {"sway": (0.02, 0.03), "sway_period": 1.0, "duration": 1.5, "payload": (0.5, 0.4)},
    "NaoWalk": {"duration": 6.0, "push_impulse": (2.0, 5.0), "push_interval": 0.5},
}


MODES = list(AutoresetMode)


def _made(task: str, mode: str, resets: AutoresetMode = AutoresetMode.NEXT_STEP, **more: Any) -> Any:
    options = {"autoreset_mode": resets}
    more |= options if mode == "vector_entry_point" else {"vector_kwargs": options}
    return gym.make_vec(f"surefoot/{task}-v0", ROBOTS, mode, **more, **TASKS[task])


def _same(one: Any, other: Any, where: str) -> None:
    """Compare nested mappings of arrays, to the last bit and by type."""
    if isinstance(one, dict):
        assert set(one) == set(other), where
        for key in one:
            _same(one[key], other[key], f"{where}/{key}")
    elif isinstance(one, tuple | list):
        for place, (part, its) in enumerate(zip(one, other, strict=True)):
            _same(part, its, f"{where}[{place}]")
    elif one is None:
        assert other is None, where
    elif np.asarray(one).dtype == object:
        _same(list(one), list(other), where)
    else:
        assert np.asarray(one).dtype == np.asarray(other).dtype, where
        assert np.array_equal(one, other, equal_nan=np.asarray(one).dtype.kind == "f"), where


def _steps(rng: np.random.Generator, motors: int = 11, task: str = "") -> Any:
    """Actions under which some robots fall and others do not."""
    for _ in range(STEPS.get(task, 200)):
        size = np.linspace(0.05, 1.0, ROBOTS)[:, None]
        yield (size * rng.standard_normal((ROBOTS, motors))).astype(np.float32)


def _restarted(envs: Any, mode: AutoresetMode, done: Any, where: str) -> None:
    """Reset the robots whose episode is over, where nobody else does."""
    if mode is AutoresetMode.DISABLED and done.any():
        _same(*(env.reset(options={"reset_mask": done.copy()}) for env in envs), where)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "task", [task if task == "NaoBalance" else pytest.param(task, marks=pytest.mark.slow) for task in TASKS]
)
def test_robots_do_what_they_do_alone(task, mode):
    copies, batch = _made(task, "sync", mode), _made(task, "vector_entry_point", mode)
    assert batch.observation_space == copies.observation_space
    assert batch.action_space == copies.action_space
    assert batch.metadata == copies.metadata
    seen, its = copies.reset(seed=5), batch.reset(seed=5)
    _same(seen, its, "reset")
    assert list(seen[0]) == list(its[0])
    begun = 0
    motors = batch.single_action_space.shape[0]
    for step, actions in enumerate(_steps(np.random.default_rng(1), motors, task)):
        seen = copies.step(actions)
        _same(seen, batch.step(actions), f"step {step}")
        begun += int((done := seen[2] | seen[3]).sum())
        assert ("final_obs" in seen[4]) == (mode is AutoresetMode.SAME_STEP and done.any())
        _restarted((copies, batch), mode, done, f"reset after step {step}")
        for i, copy in enumerate(copies.envs):
            own = copy.unwrapped
            for name in ("qpos", "qvel", "xfrc_applied"):
                _same(getattr(own.data, name), getattr(batch._batch, name)[i], name)
            _same(own.truth.rows, batch.truth.rows[i], "rows")
    assert begun >= 3
    _same(copies.get_attr("command"), batch.get_attr("command"), "command")
    # A reset of some robots leaves the others where they are.
    mask = np.array([True, False, True])
    for env in (copies, batch):
        seen, its = its, env.reset(options={"reset_mask": mask.copy()})
    _same(seen, its, "masked reset")
    actions = np.zeros_like(actions)
    _same(copies.step(actions), batch.step(actions), "after it")


@pytest.mark.parametrize(
    ("task", "mode"),
    [
        ("NaoBalance", AutoresetMode.SAME_STEP),
        pytest.param("NaoBalance", AutoresetMode.NEXT_STEP, marks=pytest.mark.slow),
        pytest.param("NaoCarry", AutoresetMode.DISABLED, marks=pytest.mark.slow),
        pytest.param("Exercise", AutoresetMode.NEXT_STEP, marks=pytest.mark.slow),
    ],
)
def test_sensors_and_calibrators_around_them_see_the_same(task, mode):
    copies, batch = (
        VectorSelfCalibration(VectorFootSensors(env), "moment")
        for env in (_made(task, "sync", mode, wrappers=[TruthRow]), _made(task, "vector_entry_point", mode))
    )
    assert batch.observation_space == copies.observation_space
    _same(copies.reset(seed=2), batch.reset(seed=2), "reset")
    motors = batch.single_action_space.shape[0]
    for step, actions in enumerate(_steps(np.random.default_rng(3), motors, task)):
        seen = copies.step(actions)
        _same(seen, batch.step(actions), f"step {step}")
        _restarted((copies, batch), mode, seen[2] | seen[3], f"reset after step {step}")


@pytest.mark.slow
def test_the_number_of_threads_changes_nothing():
    seen = []
    for threads in (1, 3):
        env = _made("NaoWalk", "vector_entry_point", threads=threads)
        env.reset(seed=0)
        seen.append([env.step(actions) for actions in _steps(np.random.default_rng(0))])
    _same(*seen, "threads")


@pytest.mark.slow
def test_a_prelude_is_played_before_each_episode():
    swaying = NaoStandEnv(sway=(0.02, 0.0))
    commands = [swaying.command_at(swaying.draw({}), tick) for tick in range(40)]
    one = NaoStandEnv()
    prelude = surefoot.envs.Prelude.of_commands(
        one.dt, one.motor_names, commands, np.zeros(len(commands), dtype=bool)
    )
    copies = gym.make_vec("surefoot/NaoStand-v0", 2, "sync", prelude=prelude, duration=0.5)
    batch = gym.make_vec("surefoot/NaoStand-v0", 2, "vector_entry_point", prelude=prelude, duration=0.5)
    _same(copies.reset(seed=0), batch.reset(seed=0), "reset")
    rng = np.random.default_rng(0)
    for step in range(150):
        actions = rng.uniform(-0.2, 0.2, (2, 11)).astype(np.float32)
        _same(copies.step(actions), batch.step(actions), f"step {step}")


@pytest.mark.slow
def test_robots_are_drawn_where_they_are():
    env = BatchVectorEnv(NaoStandEnv, 2, render_mode="rgb_array", width=64, height=48)
    env.reset(seed=0)
    first = env.render()
    env.step(np.zeros((2, 11)))
    env.step(np.stack([np.zeros(11), np.ones(11)]))
    for _ in range(20):
        env.step(np.stack([np.zeros(11), np.ones(11)]))
    one, other = env.render()
    assert one.shape == (48, 64, 3)
    assert np.abs(one.astype(float) - first[0]).mean() < np.abs(other.astype(float) - first[1]).mean()
    env.close()


def test_what_is_refused():
    env = BatchVectorEnv(NaoStandEnv, 2)
    with pytest.raises(gym.error.ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros((2, 11)))
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"shape \(2, 11\).*got shape \(11,\)"):
        env.step(np.zeros(11))
    with pytest.raises(ValueError, match="must be finite"):
        env.step(np.full((2, 11), np.nan))
    with pytest.raises(ValueError, match="no render mode 'human'"):
        BatchVectorEnv(NaoStandEnv, 2, render_mode="human")
    with pytest.raises(TypeError, match=r"has no copies, .* vectorization_mode='sync'"):
        deepcopy(env)


def test_nobody_steps_a_robot_whose_episode_is_over():
    env = BatchVectorEnv(NaoStandEnv, 2, autoreset_mode="Disabled", duration=0.05)
    env.reset(seed=0)
    for _ in range(4):
        *_, truncated, _ = env.step(np.zeros((2, 11)))
    assert truncated.all()
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(gym.error.ResetNeeded, match=r"robots \[1\] are over.*reset_mask.: terminations \|"):
        env.step(np.zeros((2, 11)))
    env.reset(options={"reset_mask": np.array([False, True])})
    env.step(np.zeros((2, 11)))


def test_robots_share_a_model_but_for_what_an_episode_changes():
    robots = BatchVectorEnv(NaoStandEnv, ROBOTS, **TASKS["NaoStand"])
    alone = [NaoStandEnv(**TASKS["NaoStand"]) for _ in range(ROBOTS)]
    robots.reset(seed=4)
    for i, env in enumerate(alone):
        env.reset(seed=4 + i)
    assert len({id(env.model) for env in robots.envs}) == len({id(env.data) for env in robots.envs}) == 1
    drawn = robots.get_attr("model")[0].body_mass.copy()
    for _ in range(40):  # a payload comes after 0.4 s
        robots.step(np.zeros((ROBOTS, 11), np.float32))
        for env in alone:
            env.step(np.zeros(11, np.float32))
    models, data = robots.get_attr("model"), robots.get_attr("data")
    for model, now, env in zip(models, data, alone, strict=True):
        for name in (*env.varied, "body_subtreemass", "dof_M0"):
            assert np.array_equal(getattr(model, name), getattr(env.model, name)), name
        assert np.array_equal(now.qpos, env.data.qpos)
    assert models[0].body_mass.sum() == pytest.approx(drawn.sum() + 0.5)
    assert len({model.pair_friction.tobytes() for model in models}) == ROBOTS
    robots.reset(seed=4)
    assert np.array_equal(robots.get_attr("model")[1].body_mass, drawn)


def test_a_call_that_fails_leaves_no_payload_in_the_model_of_all_robots():
    robots = BatchVectorEnv(NaoStandEnv, 2, payload=(0.5, 0.0))
    robots.reset(seed=0)
    shared = robots.envs[0].model
    drawn = shared.body_mass.copy()
    for _ in range(2):
        robots.step(np.zeros((2, 11)))
    assert (robots.get_attr("model")[0].body_mass != drawn).any()
    with pytest.raises(AttributeError, match="no_such_name"):
        robots.call("no_such_name")
    assert np.array_equal(shared.body_mass, drawn)


class DampedEnv(NaoStandEnv):
    """Draws a damping for each episode, and does not name it."""

    def place(self, command, target):
        super().place(command, target)
        self.model.dof_damping[6:] = self.np_random.uniform(0.1, 5.0)


def test_a_task_names_what_its_episodes_change_in_the_model(monkeypatch):
    with pytest.raises(
        ValueError, match=r"DampedEnv changes \['dof_damping'\] of the model at a reset.*varied'"
    ):
        BatchVectorEnv(DampedEnv, 2).reset(seed=0)
    monkeypatch.setattr(DampedEnv, "varied", (*NaoStandEnv.varied, "dof_damping"))
    robots = BatchVectorEnv(DampedEnv, 2)
    robots.reset(seed=0)
    one, other = (model.dof_damping[6] for model in robots.get_attr("model"))
    assert one != other


class ViewingEnv(NaoStandEnv):
    """Keeps a view of the state, as fast tasks do."""

    def __init__(self, **options):
        super().__init__(**options)
        self.height = self.data.qpos[2:3]

    def place(self, command, target):
        super().place(command, target)
        self.height += 0.05


def test_each_robot_of_a_task_that_keeps_views_is_placed_by_them():
    robots = BatchVectorEnv(ViewingEnv, 3)
    robots.reset(seed=0)
    heights = robots._batch.qpos[:, 2]
    assert np.ptp(heights) < 0.01
    assert (heights > 0.36).all()
