"""The standing task, and with it all that the environments share."""

import pickle
import re

import numpy as np
import pytest
from _refusals import refusals

import surefoot  # noqa: F401
from surefoot.envs.nao.env import NaoEnv
from surefoot.envs.nao.stand import NaoStandEnv

ZERO = np.zeros(11, dtype=np.float32)
SHAPES = {"state": (63,), "foot_force": (8,), "cop_foot": (2, 2), "cop": (2,), "cop_valid": (3,)}


@pytest.fixture
def rendering(monkeypatch):
    """An environment that draws, where this machine can."""
    monkeypatch.setenv("MUJOCO_GL", "egl")
    env = NaoStandEnv(render_mode="rgb_array", width=160, height=120, camera="below")
    env.reset(seed=0)
    try:
        env.render()
    except Exception as error:
        pytest.skip(f"no OpenGL here: {error}")
    yield env
    env.close()


def test_a_seed_brings_the_same_command():
    env = NaoStandEnv()
    env.reset(seed=0)
    command = pickle.dumps(env.command)
    for _ in range(5):
        env.step(np.full(11, 0.5))
    env.reset(seed=0)
    assert pickle.dumps(env.command) == command


def test_observations_stay_in_their_spaces_through_a_fall():
    env = NaoStandEnv(duration=None)
    rng = np.random.default_rng(2)
    observation, _ = env.reset(seed=4)
    falls = 0
    for _ in range(600):
        assert {key: value.shape for key, value in observation.items()} == SHAPES
        assert env.observation_space.contains(observation)
        observation, reward, terminated, _, _ = env.step(rng.choice([-1.0, 1.0], 11))
        assert np.isfinite(reward)
        # Go on for a while after a fall: bodies hit the ground hard then.
        falls += terminated
        if falls == 60:
            observation, _ = env.reset()
            falls = 0
    assert env.observation_space.contains(observation)


def test_the_tables_in_the_docstring_are_the_layout():
    rows = re.findall(r"\| (\d+)-(\d+) \| ``(\w+)``", NaoEnv.__doc__)
    documented = {name: slice(int(first), int(last) + 1) for first, last, name in rows}
    env = NaoStandEnv()
    assert documented == env.state_layout
    actions = re.findall(
        r"\| (\d+) \| [a-z ,-]+ \| -action_scale \| action_scale \| (\w+) \|", NaoEnv.__doc__
    )
    assert tuple(motor for _, motor in actions) == env.motor_names[:11]


def test_the_state_holds_what_its_layout_says():
    env = NaoStandEnv(sway=(0.0, 0.03), sway_period=1.0)
    env.reset(seed=0)
    for _ in range(100):
        observation, *_ = env.step(ZERO)
    state, where, truth = observation["state"], env.state_layout, env.truth
    np.testing.assert_allclose(state[where["joint_position"]], truth.joint_position[-1], rtol=1e-6)
    speeds = [env.model.sensor(f"{name}_velocity").adr[0] for name in env.joint_names]
    np.testing.assert_allclose(state[where["joint_velocity"]], truth.rows[-1, speeds], rtol=1e-6)
    np.testing.assert_allclose(state[where["gyroscope"]], truth.gyroscope[-1], rtol=1e-6)
    roll, pitch = state[where["tilt"]]
    up = truth.R_world_torso[-1, 2]
    np.testing.assert_allclose(
        [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], up, atol=1e-6
    )
    middle = env.command.position_sole[:, :2].mean(axis=0)
    np.testing.assert_allclose(state[where["cop_reference"]], env.command.cop - middle, atol=1e-6)
    np.testing.assert_allclose(state[where["com_reference"]], env.command.com[:2] - middle, atol=1e-6)
    np.testing.assert_allclose(state[where["stance"]], [1.0, 1.0])
    np.testing.assert_allclose(state[where["phase"]], [0.0, 1.0])


def test_forces_and_pressure_are_those_of_the_truth():
    env = NaoStandEnv(sway=(0.02, 0.03), sway_period=2.0)
    env.reset(seed=0)
    for _ in range(40):
        env.step(ZERO)
    for _ in range(120):
        observation, _, _, _, info = env.step(ZERO)
        truth, given = env.truth, info["surefoot"]["truth"]
        mean = truth.wrench_sole.mean(axis=0)
        np.testing.assert_allclose(given["force_cell"], truth.force_cell.mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(given["wrench_sole"], mean, atol=1e-9)
        np.testing.assert_allclose(given["wrench_ankle"], truth.wrench_ankle.mean(axis=0), atol=1e-12)
        np.testing.assert_allclose(given["com"], truth.com.mean(axis=0), atol=1e-12)
        ratio = np.stack([-mean[:, 4], mean[:, 3]], axis=-1) / mean[:, 2:3]
        np.testing.assert_allclose(given["cop_foot"], ratio, atol=1e-9)
        wrench = truth.wrench_sole[-1]
        cop_foot = np.stack([-wrench[:, 4], wrench[:, 3]], axis=-1) / wrench[:, 2:3]
        np.testing.assert_allclose(observation["foot_force"], truth.force_cell[-1], rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(observation["cop_foot"], cop_foot, atol=1e-6)
        ahead = truth.R_world_sole[-1, :, :2, 0].sum(axis=0)
        ahead /= np.linalg.norm(ahead)
        arm = truth.cop_world() - truth.position_sole[-1, :, :2].mean(axis=0)
        expected = [ahead @ arm, ahead[0] * arm[1] - ahead[1] * arm[0]]
        np.testing.assert_allclose(observation["cop"], expected, atol=1e-6)
        np.testing.assert_allclose(given["cop"], expected, atol=5e-3)  # half a step ago
        np.testing.assert_array_equal(observation["cop_valid"], [1, 1, 1])


def test_without_contact_the_last_pressure_is_held_and_flagged():
    env = NaoStandEnv()
    env.reset(seed=0)
    for _ in range(40):
        before, *_ = env.step(ZERO)
    env.data.qpos[2] += 0.5
    env.step(ZERO)
    after, _, _, _, info = env.step(ZERO)
    np.testing.assert_array_equal(after["cop_valid"], [0, 0, 0])
    np.testing.assert_allclose(after["cop"], before["cop"], atol=1e-3)
    np.testing.assert_allclose(after["cop_foot"], before["cop_foot"], atol=1e-3)
    assert not info["surefoot"]["truth"]["cop_valid"].any()
    assert not info["surefoot"]["truth"]["cop_world"].any()
    assert not info["surefoot"]["truth"]["cop_foot"].any()


@pytest.mark.parametrize(
    "options", [{}, {"sway": (0.02, 0.03)}, {"push_impulse": (0.2, 0.4), "push_interval": 1.0}]
)
def test_the_zero_action_stands(options):
    env = NaoStandEnv(duration=6.0, **options)
    observation, _ = env.reset(seed=1)
    steps, errors = 0, []
    terminated = truncated = False
    while not (terminated or truncated):
        observation, _, terminated, truncated, _ = env.step(ZERO)
        steps += 1
        reference = observation["state"][env.state_layout["cop_reference"]]
        errors.append(observation["cop"] - reference)
    assert (steps, terminated, truncated) == (480, False, True)
    if "push_impulse" not in options:
        assert np.sqrt(np.mean(np.square(errors[160:]))) < 0.002


@pytest.mark.parametrize("axis", [0, 1])
def test_the_robot_sways_to_the_side_that_is_asked_for(axis):
    """A positive amplitude moves the centre of mass forward, or left, in the first half of a period."""
    env = NaoStandEnv(sway=tuple(0.03 * (np.arange(2) == axis)), sway_period=4.0, joint_noise=0.0)
    env.reset(seed=0)
    planned, true = [], []
    for _ in range(320):
        env.step(ZERO)
        planned.append(env.command.com[axis])
        true.append(env.truth.com[-1, axis])
    planned, true = np.array(planned) - planned[0], np.array(true) - true[0]
    # The sway fades in: its second half is the larger one.
    assert planned[:160].max() > 0.005
    assert planned[160:].min() < -0.01
    np.testing.assert_allclose(true, planned, atol=0.003)


def test_a_hard_push_ends_the_episode():
    env = NaoStandEnv(push_impulse=(6.0, 6.0), push_interval=0.5)
    for seed in range(3):
        env.reset(seed=seed)
        assert any(env.step(ZERO)[2] for _ in range(400))


def test_pushes_have_the_impulse_that_was_asked_for():
    env = NaoStandEnv(push_impulse=(0.2, 0.3), push_interval=0.6)
    env.reset(seed=7)
    torso = env.model.body("torso").id
    forces = []
    for _ in range(640):
        env.step(ZERO)
        forces.append(env.data.xfrc_applied[torso, :3].copy())
    forces = np.array(forces)
    assert not forces[:, 2].any()
    changed = np.flatnonzero(np.any(np.diff(forces, axis=0, prepend=0.0) != 0.0, axis=1))
    lengths = np.diff(np.append(changed, len(forces)))
    pushing = [i for i in changed if forces[i].any()]
    assert len(pushing) > 4
    whole = [(i, n) for i, n in zip(changed, lengths, strict=True) if forces[i].any() and n == 8]
    impulses = [np.linalg.norm(forces[i]) * n / 80.0 for i, n in whole]
    assert len(impulses) >= len(pushing) / 2
    assert all(0.2 <= impulse <= 0.3 for impulse in impulses)


def test_targets_move_no_faster_than_the_motors_and_stay_in_their_limits():
    env = NaoStandEnv(action_scale=3.0)
    env.reset(seed=0)
    low, high = env.model.actuator_ctrlrange.T
    speed = env.model.actuator_user[:, 0]
    rng = np.random.default_rng(0)
    last = env.data.ctrl.copy()
    for _ in range(60):
        env.step(rng.choice([-1.0, 1.0], 11))
        assert (np.abs(env.data.ctrl - last) <= speed / 80.0 + 1e-12).all()
        assert (env.data.ctrl >= low).all()
        assert (env.data.ctrl <= high).all()
        last = env.data.ctrl.copy()


def test_actions_beyond_their_bounds_are_clipped():
    direction = np.array([1.0, -1.0] * 5 + [1.0])
    seen = []
    for factor in (1.0, 30.0):
        env = NaoStandEnv()
        env.reset(seed=0)
        seen.append([env.step(factor * direction)[0]["state"] for _ in range(10)])
    np.testing.assert_array_equal(*seen)


def test_episodes_draw_their_friction_and_their_start():
    env = NaoStandEnv(friction=(0.4, 1.2))
    friction, starts = [], []
    for seed in range(20):
        env.reset(seed=seed)
        friction.append(env.model.pair_friction[:, :2].copy())
        starts.append(env.data.qpos[7:].copy())
    assert all((drawn == drawn[0, 0]).all() for drawn in friction)
    drawn = np.array(friction)[:, 0, 0]
    assert 0.4 <= drawn.min() < 0.7 < 0.9 < drawn.max() <= 1.2
    assert 0.001 < np.std(starts, axis=0).max() <= 0.005


test_bad_options_are_refused = refusals(
    lambda options: NaoStandEnv(**options),
    ({"cell_stiffness": [1.0] * 7 + [-1.0]}, "'cell_stiffness' must hold eight positive"),
    ({"camera": "roof"}, "no camera 'roof'; choose one of .*'track'"),
    ({"render_mode": "ascii"}, "no render mode 'ascii'; choose one of .*'rgb_array'"),
    ({"height": 5000}, "at most 1920 x 1080"),
    ({"friction": (0.9, 0.5)}, "'friction' must be"),
    ({"joint_noise": -0.1}, "'joint_noise' must be finite and not negative"),
    ({"duration": 0.0}, "'duration' must be finite and positive"),
    ({"sway": (0.1, 0.0)}, "'sway' must be"),
)


def test_frames_show_the_robot_and_its_markers(rendering):
    plain = rendering.render()
    assert plain.shape == (120, 160, 3)
    assert plain.dtype == np.uint8
    assert plain.std() > 5.0
    np.testing.assert_array_equal(plain, rendering.render())
    rendering.markers = [((0.01, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0), 0.02)]
    marked = rendering.render().astype(int)
    red = (marked[..., 0] > 120) & (marked[..., 1] < 60) & (marked[..., 2] < 60)
    assert 20 < red.sum() < 2000
    rendering.markers = []
    np.testing.assert_array_equal(plain, rendering.render())


def test_a_window_without_a_screen_is_refused(monkeypatch):
    monkeypatch.setattr("glfw.init", lambda: False)
    env = NaoStandEnv(render_mode="human")
    with pytest.raises(RuntimeError, match="no screen; use render_mode='rgb_array'"):
        env.reset(seed=0)
