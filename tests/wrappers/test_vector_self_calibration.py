"""Calibration around vector environments, in all autoreset modes and for Stable-Baselines3."""

from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

import surefoot  # noqa: F401
from surefoot.wrappers.vector.foot_sensors import VectorFootSensors
from surefoot.wrappers.vector.sb3 import VecFootSensors, VecSelfCalibration
from surefoot.wrappers.vector.self_calibration import VectorSelfCalibration
from surefoot.wrappers.vector.truth_row import TruthRow

ROBOTS = 3
TOLD = {"truth", "parameters", "covariance", "flags", "vgrf", "reference", "lag"}
ACTIONS = np.zeros((ROBOTS, 11), dtype=np.float32)


def _copy(steps: int | None = None, task: str = "Walk", **options: Any) -> TruthRow:
    walk = {"speed": 0.04, "duration": 12.0} if task == "Walk" else {}
    env = gym.make(
        f"surefoot/Nao{task}-v0", max_episode_steps=steps, disable_env_checker=True, **walk, **options
    )
    return TruthRow(env)


def _functions(episode: int | None = None) -> list[Any]:
    lengths = [None if episode is None else episode + 2 * i for i in range(ROBOTS)]
    return [partial(_copy, steps) for steps in lengths]


def _vector(
    episode: int | None = None, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **options: Any
) -> VectorSelfCalibration:
    copies = SyncVectorEnv(_functions(episode), autoreset_mode=mode)
    return VectorSelfCalibration(VectorFootSensors(copies), **options)


def test_what_a_loaded_robot_showed_stands_while_others_are_reset(tmp_path):
    env = _vector(mode=AutoresetMode.DISABLED)
    env.reset(seed=2)
    for _ in range(12):
        shown, *_, told = env.step(ACTIONS)
    env.save(tmp_path / "learnt.npz")
    env.load(tmp_path / "learnt.npz")
    seen, infos = env.reset(options={"reset_mask": np.array([True, False, False])})
    for part, before in shown.items():
        np.testing.assert_array_equal(seen[part][1:], before[1:], err_msg=part)
    for part in ("vgrf", "covariance"):
        np.testing.assert_array_equal(infos["surefoot"][part][1:], told["surefoot"][part][1:], err_msg=part)
    for part in ("foot_force", "cop_foot"):
        assert (env.step(ACTIONS)[0][part] != 0.0).any(), part


@pytest.mark.slow
def test_a_seed_repeats_all_on_the_same_object():
    env = _vector()

    def run(**options: Any) -> list[Any]:
        seen, infos = env.reset(seed=4, **options)
        assert set(infos["surefoot"]) == TOLD | {"contact_probability", "undetermined"}
        shown = []
        for _ in range(160):
            shown.append({**seen, "scale": infos["surefoot"]["parameters"]["scale"]})
            seen, *_, infos = env.step(ACTIONS)
        return shown

    first, again = run(), run()
    masked = run(options={"reset_mask": np.ones(ROBOTS, dtype=bool)})
    for one, *others in zip(first, again, masked, strict=True):
        for other in others:
            for key, part in one.items():
                np.testing.assert_array_equal(part, other[key], err_msg=key)
    assert (first[-1]["scale"] != first[0]["scale"]).any()


@pytest.mark.parametrize(
    "mode",
    [m if m is AutoresetMode.NEXT_STEP else pytest.param(m, marks=pytest.mark.slow) for m in AutoresetMode],
)
def test_old_readings_are_waited_for_alike_in_all_modes(mode):
    cells = {"rate": (10.0, 11.0), "settling": 2}
    copies = SyncVectorEnv(_functions(12), autoreset_mode=mode)
    env = VectorSelfCalibration(VectorFootSensors(copies, cells), lag=8)
    env.reset(seed=2)
    # An age of 0.095 s is 8 samples, which the reference is older than its lag; a reset is one of them.
    wait, run = 8 + 8, 99
    done = np.zeros(ROBOTS, dtype=bool)
    for step in range(160):
        starting = done
        *_, terminated, truncated, infos = env.step(ACTIONS)
        done = terminated | truncated
        begun = {AutoresetMode.NEXT_STEP: starting[2], AutoresetMode.SAME_STEP: done[2]}.get(mode, False)
        run = 0 if begun else run + 1
        unknown = not infos["surefoot"]["reference"]["known"][2]
        # The first references are of a time long before the first packet.
        assert step < 3 or unknown == (run <= wait), run
        if mode is AutoresetMode.DISABLED and done.any():
            env.reset(options={"reset_mask": done.copy()})
            run = 0 if done[2] else run


def test_fresh_seeds_and_options_start_fresh():
    def starts(env: VectorSelfCalibration) -> np.ndarray:
        return np.array([robot.initial for robot in env.calibration.robots])

    env = _vector(20, fresh=True, initial="calibrated")
    env.reset(seed=1)
    first = starts(env)
    for _ in range(22):
        env.step(ACTIONS)
    np.testing.assert_array_equal((starts(env) != first).any(axis=(1, 2)), [True, False, False])
    env = _vector(initial="calibrated")
    env.reset(seed=1)
    np.testing.assert_array_equal(starts(env), first)
    env.step(ACTIONS)
    env.reset()
    np.testing.assert_array_equal(starts(env), first)
    env.reset(options={"surefoot": {"calibration": "fresh"}})
    assert (starts(env) != first).any(axis=(1, 2)).all()
    env.reset(seed=1)
    np.testing.assert_array_equal(starts(env), first)


def test_what_does_not_fit_is_refused_at_the_door():
    copies = SyncVectorEnv(_functions())
    with pytest.raises(TypeError, match="found none below it"):
        VectorSelfCalibration(copies)
    felt = VectorFootSensors(copies)
    with pytest.raises(TypeError, match="one is enough"):
        VectorSelfCalibration(VectorSelfCalibration(felt))
    with pytest.raises(ValueError, match="Method 'windows' does not exist"):
        VectorSelfCalibration(felt, "windows")
    with pytest.raises(ValueError, match="no option 'speed'"):
        VectorSelfCalibration(felt, speed=3)
    with pytest.raises(ValueError, match="shorter 'lag'"):
        VectorSelfCalibration(felt, lag=200).reset(seed=0)
    with pytest.raises(ValueError, match=r"BeliefErrors\.scale"):
        VectorSelfCalibration(felt, errors={"scale": -1.0})
    with pytest.raises(TypeError, match="goes right around"):
        VecSelfCalibration(DummyVecEnv(_functions()))
    with pytest.raises(TypeError, match=r"wrappers=\[TruthRow\]"):
        VecFootSensors(DummyVecEnv([lambda: gym.make("surefoot/NaoStand-v0")]))


def test_feet_without_cells_are_as_long_as_drawn_or_given():
    felt = VectorFootSensors(SyncVectorEnv(_functions()), "icub-force-torque")
    places = felt.sensors.drawing.position_cell_sole
    drawn = VectorSelfCalibration(felt).calibration.setup.options["foot_length"]
    assert drawn == pytest.approx(np.ptp(places[0, :, 0]), rel=1e-12)
    given = VectorSelfCalibration(felt, foot_length=0.1).calibration.setup
    assert given.options["foot_length"] == 0.1


def test_sb3_shows_what_gymnasium_shows():
    near = _vector(20, AutoresetMode.SAME_STEP, initial="calibrated")
    far = VecSelfCalibration(VecFootSensors(DummyVecEnv(_functions(20))), initial="calibrated")
    far.seed(6)
    seen = near.reset(seed=[6, 7, 8])[0], far.reset()
    assert far.observation_space == near.single_observation_space
    ends = 0
    for _ in range(45):
        for key in seen[0]:
            np.testing.assert_array_equal(seen[0][key], seen[1][key], err_msg=key)
        observations, _, terminated, truncated, known = near.step(ACTIONS)
        others, _, dones, infos = far.step(ACTIONS)
        seen = observations, others
        np.testing.assert_array_equal(dones, terminated | truncated)
        for robot in np.flatnonzero(dones):
            final, other = known["final_obs"][robot], infos[robot]["terminal_observation"]
            assert final.keys() == other.keys()
            for key in final:
                np.testing.assert_array_equal(final[key], other[key], err_msg=key)
            ends += 1
    assert ends >= 5
    truth = near.step(ACTIONS)[4]["surefoot"]["truth"]
    far.step(ACTIONS)
    np.testing.assert_array_equal(far.venv.truth["vgrf"], truth["vgrf"])


def test_one_may_listen_later() -> None:
    copies = [lambda: TruthRow(gym.make("Humanoid-v5", include_cfrc_ext_in_observation=False))] * 2
    sensed = VectorFootSensors(gym.vector.SyncVectorEnv(copies), "icub-force-torque")
    sensed.reset(seed=0)
    still = np.zeros((2, 17), dtype=np.float32)
    sensed.step(still)
    envs = VectorSelfCalibration(sensed)
    envs.reset()
    for _ in range(3):
        observations, *_ = envs.step(still)
    assert np.isfinite(observations["foot_force"]).all()


SEEN = ("foot_load", "cop_foot", "cop", "cop_valid")


def _saturated(model: Any, venv: Any) -> float:
    """Share of the first layer's outputs beyond 0.99, over units and varied observations."""
    rng, seen = np.random.default_rng(0), [venv.reset()]
    for _ in range(60):
        # Falls and goes on: hardly two observations are alike.
        action = rng.uniform(-0.5, 0.5, (venv.num_envs, *venv.action_space.shape)).astype(np.float32)
        seen.append(venv.step(action)[0])
    observed = {key: np.concatenate([one[key] for one in seen]) for key in seen[0]}
    assert np.ptp(observed["state"], axis=0).max() > 1.0
    assert np.ptp(observed["foot_load"], axis=0).max() > 0.1
    with torch.no_grad():
        features = model.policy.extract_features(model.policy.obs_to_tensor(observed)[0])
        first: Any = model.policy.mlp_extractor.policy_net[:2](features)
    return float((first.abs() > 0.99).float().mean())


@pytest.mark.parametrize("steps", [64, pytest.param(1024, marks=pytest.mark.slow)])
def test_a_policy_of_sb3_sees_its_feet_and_counts_would_blind_it(steps: int) -> None:
    torch.set_num_threads(1)
    shares = {}
    for show in (SEEN, (*SEEN, "foot_raw")):
        copies = [partial(_copy, None, "Balance", stand_time=0.1)] * 2
        venv = VecSelfCalibration(VecFootSensors(DummyVecEnv(copies), fresh=True), show=show)
        some = {"n_steps": min(steps // 2, 128), "n_epochs": 4}
        model = PPO("MultiInputPolicy", venv, **some, seed=0, device="cpu")
        shares[show] = [_saturated(model, venv)]
        model.learn(steps)
        shares[show].append(_saturated(model, venv))
    assert max(shares[SEEN]) < 0.05
    assert min(shares[(*SEEN, "foot_raw")]) > 0.95


@pytest.mark.parametrize("show", [("foot_load", "cop"), ("cop", "foot_raw"), ("foot_force", "foot_load")])
def test_what_is_shown_of_many_is_chosen_and_the_same_everywhere(show: tuple[str, ...]) -> None:
    envs = _vector(show=show)
    venv = VecSelfCalibration(VecFootSensors(DummyVecEnv(_functions())), show=show)
    assert set(envs.single_observation_space) == set(venv.observation_space) == {"state", *show}
    seen, _ = envs.reset(seed=0)
    assert envs.observation_space.contains(seen)
    assert set(seen) == set(venv.reset()) == {"state", *show}
    if "foot_force" in show:
        weight = 9.81 * envs.calibration.setup.mass
        np.testing.assert_allclose(weight * seen["foot_load"], seen["foot_force"], rtol=1e-5)
