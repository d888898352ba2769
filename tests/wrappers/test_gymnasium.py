"""What Gymnasium and Stable-Baselines3 ask of any environment, asked of ours by their own functions."""

import pickle
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium import wrappers
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import SyncVectorEnv
from stable_baselines3.common import env_checker

from surefoot import pickles
from surefoot.envs import InstrumentedEnv
from surefoot.sensors.presets import PERFECT_FORCE_TORQUE
from surefoot.wrappers import (
    FootSensors,
    SampleHistory,
    SelfCalibration,
    TruthRow,
    VectorFootSensors,
    VectorSelfCalibration,
)

ANKLES = "icub-ftsens"
NEEDS_1_4 = pytest.mark.skipif(
    not hasattr(wrappers, "RepeatAction"), reason="Gymnasium has it, or has it right, from 1.4 on"
)
STEPS = 25


def balance(**options: Any) -> gym.Env[Any, Any]:
    return gym.make("surefoot/NaoBalance-v0", **options)


def humanoid() -> gym.Env[Any, Any]:
    return gym.make("Humanoid-v5", include_cfrc_ext_in_observation=False)


def calibrated(env: gym.Env[Any, Any] | None = None, config: str = "hx711-load-cells") -> SelfCalibration:
    return SelfCalibration(FootSensors(balance() if env is None else env, config))


QUICK: dict[str, Callable[[], gym.Env[Any, Any]]] = {
    "NaoBalance": balance,
    "InstrumentedEnv": lambda: InstrumentedEnv(humanoid()),
    "SelfCalibration": calibrated,
    "SelfCalibration of ankles": lambda: calibrated(humanoid(), ANKLES),
    "TruthRow": lambda: TruthRow(humanoid()),
}
SLOW: dict[str, Callable[[], gym.Env[Any, Any]]] = {
    "SelfCalibration, planar": lambda: calibrated(gym.make("Walker2d-v5"), ANKLES),
    "SelfCalibration, soles": lambda: SelfCalibration(FootSensors(humanoid(), soles=True)),
    "G1Lean": lambda: gym.make("surefoot/G1Lean-v0"),
    "Exercise": lambda: gym.make("surefoot/Exercise-v0", robot="nao"),
    "NaoStand": lambda: gym.make("surefoot/NaoStand-v0"),
    "NaoWalk": lambda: gym.make("surefoot/NaoWalk-v0", duration=12.0),
    "NaoCarry": lambda: gym.make("surefoot/NaoCarry-v0"),
    "InstrumentedEnv beside": lambda: InstrumentedEnv(humanoid(), in_place=False),
    "InstrumentedEnv with soles": lambda: InstrumentedEnv(gym.make("Walker2d-v5"), soles=True),
    "FootSensors with faults": lambda: FootSensors(balance(), faults=["at t=0.1 s cell left/2 dies"]),
    "FootSensors, both kinds": lambda: FootSensors(gym.make("surefoot/NaoStand-v0"), ankles=ANKLES),
    "SelfCalibration by a window": lambda: SelfCalibration(FootSensors(balance()), "window"),
    "SampleHistory": lambda: SampleHistory(calibrated()),
    "TruthRow of the NAO": lambda: TruthRow(balance()),
}
ALL = QUICK | SLOW
EACH = pytest.mark.parametrize(
    "make",
    [*QUICK.values(), *(pytest.param(one, marks=pytest.mark.slow) for one in SLOW.values())],
    ids=list(ALL),
)
Make = Callable[[], gym.Env[Any, Any]]


def actions(env: gym.Env[Any, Any], count: int = STEPS) -> list[Any]:
    env.action_space.seed(3)
    return [0.3 * env.action_space.sample() for _ in range(count)]


def roll(env: gym.Env[Any, Any], moves: list[Any]) -> list[Any]:
    return [env.reset(seed=5), *map(env.step, moves)]


@contextmanager
def no_warnings_but(*messages: str) -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for message in messages:
            warnings.filterwarnings("ignore", message=message)
        yield


@EACH
def test_it_passes_gymnasiums_checks(make: Make) -> None:
    with no_warnings_but(
        # Humanoid's own: its observation has no bounds, and its action is not of order one.
        ".*A Box observation space m..imum value is",
        ".*we recommend using a symmetric and normalized space",
        ".*is different from the unwrapped version",
    ):
        check_env(make(), skip_render_check=True)


@EACH
def test_it_passes_the_checks_of_sb3(make: Make) -> None:
    with no_warnings_but(
        # A policy flattens what is no vector by itself.
        ".*has an unconventional shape",
        "We recommend you to use a symmetric and normalized Box",
        ".*Box observation space maximum and minimum values are",
    ):
        env_checker.check_env(make(), skip_render_check=True)


@EACH
def test_two_of_a_kind_match_and_so_does_one_of_its_spec(make: Make) -> None:
    env = make()
    check_environments_match(env, make(), STEPS, info_comparison="equivalence")
    assert env.spec is not None
    for spec in (pickle.loads(pickle.dumps(env.spec)), EnvSpec.from_json(env.spec.to_json())):
        check_environments_match(env, gym.make(spec), 3, info_comparison="equivalence")


@pytest.mark.parametrize(
    "copied", [deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["deep", "pickle"]
)
@EACH
def test_a_copy_goes_on_as_the_original_does(make: Make, copied: Any) -> None:
    env = make()
    moves = actions(env)
    fresh = copied(env)
    assert data_equivalence(roll(env, moves), roll(fresh, moves), exact=True)
    late = copied(env)
    env.reset()
    late.reset()
    for _ in range(5):
        env.step(moves[0])
        late.step(moves[0])
    # In the middle of an episode, and neither disturbs the other.
    last = copied(late)
    for move in moves:
        expected = env.step(move)
        assert data_equivalence(expected, late.step(move), exact=True)
    for move in moves[:-1]:
        last.step(move)
    assert data_equivalence(expected, last.step(moves[-1]), exact=True)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*while copying the environment spec")
def test_a_robot_without_file_is_copied_without_its_spec() -> None:
    from surefoot.envs.robots.library import load_robot_spec

    env = gym.make("surefoot/Exercise-v0", robot=load_robot_spec("nao"))
    moves = actions(env, 3)
    assert env.spec is None
    assert data_equivalence(roll(deepcopy(env), moves), roll(env, moves), exact=True)


@pytest.mark.slow
def test_a_scene_that_was_drawn_can_be_copied() -> None:
    env = balance(render_mode="rgb_array", width=32, height=32)
    env.reset(seed=0)
    frame = env.render()
    copy = deepcopy(env)
    np.testing.assert_array_equal(copy.render(), frame)
    env.close()
    copy.close()


def test_sensors_leave_the_episode_to_the_environment() -> None:
    check_environments_match(
        humanoid(), FootSensors(humanoid(), ANKLES), 15, skip_obs=True, info_comparison="superset"
    )
    check_environments_match(balance(), FootSensors(balance()), STEPS, skip_obs=True)


def named(wraps: dict[str, Any], *new: str) -> list[Any]:
    """Return parameters of a test; those that are new need Gymnasium 1.4."""
    return [
        pytest.param(wrap, id=name, marks=[NEEDS_1_4] if name in new else []) for name, wrap in wraps.items()
    ]


def _flat(wrap: Any) -> Any:
    return lambda env: wrap(wrappers.FlattenObservation(env))


AROUND: dict[str, Any] = {
    "AddRenderObservation": wrappers.AddRenderObservation,
    "Autoreset": wrappers.Autoreset,
    "ClipAction": wrappers.ClipAction,
    "ClipReward": lambda env: wrappers.ClipReward(env, -1.0, 1.0),
    "DelayObservation": lambda env: wrappers.DelayObservation(env, 2),
    "DiscretizeAction": lambda env: wrappers.DiscretizeAction(env, 2),
    "DtypeObservation": _flat(lambda env: wrappers.DtypeObservation(env, np.float64)),
    "FilterObservation": lambda env: wrappers.FilterObservation(env, ["state", "cop"]),
    "FlattenObservation": wrappers.FlattenObservation,
    "FrameStackObservation": lambda env: wrappers.FrameStackObservation(env, 3),
    "MaxAndSkipObservation": _flat(wrappers.MaxAndSkipObservation),
    "NormalizeObservation": _flat(wrappers.NormalizeObservation),
    "NormalizeReward": wrappers.NormalizeReward,
    "OrderEnforcing": wrappers.OrderEnforcing,
    "PassiveEnvChecker": wrappers.PassiveEnvChecker,
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
    "RepeatAction": lambda env: wrappers.RepeatAction(env, 2),
    "RescaleAction": lambda env: wrappers.RescaleAction(env, -0.5, 0.5),
    "RescaleObservation": _flat(lambda env: wrappers.RescaleObservation(env, 0.0, 1.0)),
    "ReshapeObservation": _flat(
        lambda env: wrappers.ReshapeObservation(env, (1, *env.observation_space.shape))
    ),
    "StickyAction": lambda env: wrappers.StickyAction(env, 0.2),
    "TimeAwareObservation": lambda env: wrappers.TimeAwareObservation(wrappers.TimeLimit(env, 100)),
}


THEIRS = pytest.mark.filterwarnings(
    "ignore:.*precision lowered by casting", "ignore:overflow encountered in cast"
)


@THEIRS
@pytest.mark.parametrize("wrap", named(AROUND, "DiscretizeAction", "RepeatAction"))
def test_gymnasiums_wrappers_go_around(wrap: Any) -> None:
    env = wrap(calibrated(balance(render_mode="rgb_array", width=32, height=32)))
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    for _ in range(4):
        assert env.observation_space.contains(observation)
        observation, reward, *_ = env.step(env.action_space.sample())
        assert np.isfinite(reward)
    env.close()


def test_tensors_go_in_and_come_out() -> None:
    pytest.importorskip("array_api_compat", reason="needs gymnasium[torch]")
    env = wrappers.NumpyToTorch(calibrated(humanoid(), ANKLES))
    env.reset(seed=0)
    observation, *_, info = env.step(torch.zeros(17))
    assert all(isinstance(part, torch.Tensor) for part in observation.values())
    assert isinstance(info["surefoot"]["truth"]["cop_valid"], torch.Tensor)
    assert isinstance(info["surefoot"]["reference"]["com"], torch.Tensor)


def many(around: Any = None) -> Any:
    envs = SyncVectorEnv([lambda: TruthRow(balance())] * 2)
    envs = VectorSelfCalibration(VectorFootSensors(envs))
    return envs if around is None else around(envs)


def test_infos_of_many_become_a_list_and_tensors() -> None:
    pytest.importorskip("array_api_compat", reason="needs gymnasium[torch]")
    plain, listed, tensors = many(), many(wrappers.vector.DictInfoToList), many(wrappers.vector.NumpyToTorch)
    for envs in (plain, listed, tensors):
        envs.reset(seed=0)
    still = np.zeros((2, 11), dtype=np.float32)
    infos, each, converted = (
        envs.step(torch.zeros(2, 11) if envs is tensors else still)[4]["surefoot"]
        if envs is not listed
        else envs.step(still)[4]
        for envs in (plain, listed, tensors)
    )
    assert {type(infos[name]) for name in ("truth", "parameters", "reference")} == {dict}
    for part, name in (("truth", "cop_foot"), ("parameters", "scale"), ("reference", "com")):
        for robot in (0, 1):
            np.testing.assert_array_equal(each[robot]["surefoot"][part][name], infos[part][name][robot])
        np.testing.assert_array_equal(converted[part][name].numpy(), infos[part][name])
    # What is told is its own: the next step changes nothing of it.
    kept = deepcopy(infos)
    plain.step(still)
    assert data_equivalence(kept, infos, exact=True)


VECTOR: dict[str, Any] = {
    "ClipAction": wrappers.vector.ClipAction,
    "ClipReward": lambda envs: wrappers.vector.ClipReward(envs, -1.0, 1.0),
    "FilterObservation": lambda envs: wrappers.vector.FilterObservation(envs, ["state", "cop"]),
    "FlattenObservation": wrappers.vector.FlattenObservation,
    "NormalizeReward": wrappers.vector.NormalizeReward,
    "RecordEpisodeStatistics": wrappers.vector.RecordEpisodeStatistics,
    "RescaleAction": lambda envs: wrappers.vector.RescaleAction(envs, -0.5, 0.5),
    "NormalizeObservation": lambda envs: wrappers.vector.NormalizeObservation(
        wrappers.vector.FlattenObservation(envs)
    ),
}


@THEIRS
@pytest.mark.parametrize("wrap", named(VECTOR, "NormalizeObservation"))
def test_gymnasiums_wrappers_go_around_many(wrap: Any) -> None:
    envs = many(wrap)
    envs.action_space.seed(0)
    observations, _ = envs.reset(seed=0)
    for _ in range(3):
        assert envs.observation_space.contains(observations)
        observations, rewards, *_ = envs.step(envs.action_space.sample())
        assert np.isfinite(rewards).all()


def test_a_deep_copy_of_many_goes_on_as_they_do() -> None:
    envs = many()
    envs.reset(seed=0)
    still = np.zeros((2, 11), dtype=np.float32)
    for _ in range(10):
        envs.step(still)
    copy = deepcopy(envs)
    for _ in range(20):
        assert data_equivalence(envs.step(still), copy.step(still), exact=True)


BELOW: dict[str, Any] = {
    "FrameStackObservation": lambda env: wrappers.FrameStackObservation(env, 3),
    "DelayObservation": lambda env: wrappers.DelayObservation(env, 2),
    "TransformObservation": lambda env: wrappers.TransformObservation(env, lambda seen: seen, None),
    "TimeAwareObservation": lambda env: wrappers.TimeAwareObservation(wrappers.TimeLimit(env, 100)),
    "NormalizeObservation": wrappers.NormalizeObservation,
}


@pytest.mark.parametrize("name", BELOW)
def test_below_sensors_a_state_is_changed_only_where_nothing_is_taken_out_of_it(name: str) -> None:
    wrap = BELOW[name]
    plain, other = FootSensors(humanoid(), ANKLES), FootSensors(wrap(humanoid()), ANKLES)
    for (one, *_), (two, *_) in zip(*(roll(env, actions(env, 10)) for env in (plain, other)), strict=True):
        np.testing.assert_array_equal(one["foot_raw"], two["foot_raw"])
    if name != "NormalizeObservation":
        for owner in (FootSensors, TruthRow):
            with pytest.raises(
                TypeError, match=rf"but {name} below it .* around all sensors: {owner.__name__}"
            ):
                owner(wrap(balance()))


@pytest.mark.parametrize(
    "wrap",
    [pytest.param(AROUND["RepeatAction"], marks=NEEDS_1_4), wrappers.Autoreset],
    ids=["repeats", "resets"],
)
def test_what_repeats_or_resets_goes_around_all(wrap: Any) -> None:
    def play(env: Any) -> None:
        env.reset(seed=0)
        for _ in range(100):
            env.step(np.zeros(11, dtype=np.float32))

    def short() -> Any:
        return wrappers.TimeLimit(balance(), 20)

    with pytest.raises(RuntimeError, match="repeats or skips steps, or resets by itself, around SelfCalib"):
        play(SelfCalibration(wrap(FootSensors(short()))))
    with pytest.raises(
        RuntimeError, match=r"repeats or skips steps, or resets by itself, around FootSensors"
    ):
        play(FootSensors(wrap(short())))
    with pytest.raises(RuntimeError, match=r"repeats or skips steps, or resets by itself, around TruthRow"):
        play(TruthRow(wrap(short())))


@pytest.mark.parametrize("name", ["NaoBalance", "InstrumentedEnv", "SelfCalibration of ankles"])
def test_infos_have_no_nan(name: str) -> None:
    env = ALL[name]()
    moves = 3.0 * np.array(actions(env, 60))
    unsure = 0
    for made in roll(env, list(moves)):
        told = made[-1]["surefoot"]
        for part in (told, *(part for part in told.values() if isinstance(part, dict))):
            for key, value in part.items():
                assert isinstance(value, dict) or value is None or np.isfinite(value).all(), key
        unsure += not told["truth"]["cop_valid"].all()
    assert unsure


def test_perfect_ankles_feel_what_is_told() -> None:
    env = FootSensors(humanoid(), PERFECT_FORCE_TORQUE)
    env.reset(seed=0)
    *_, info = env.step(np.zeros(17))
    told = info["surefoot"]["truth"]
    assert "force_cell" not in told
    assert not told["cop_valid"][1:].any()
    np.testing.assert_allclose(told["vgrf"], env.source.truth.vgrf())
    np.testing.assert_allclose(told["cop_world"], np.nan_to_num(env.source.truth.cop_world()), rtol=1e-12)


@pytest.mark.parametrize("kind", [FootSensors, SelfCalibration])
def test_pickles_of_another_version_are_refused(kind, monkeypatch) -> None:
    """Before anything in them is looked at, which may be of classes that are gone."""
    env = FootSensors(gym.make("surefoot/NaoBalance-v0", disable_env_checker=True))
    env = SelfCalibration(env, "none") if kind is SelfCalibration else env
    env.reset(seed=0)
    kept = pickle.dumps(env).replace(b"envs.nao", b"envs.old")
    with pytest.raises(ModuleNotFoundError):
        pickle.loads(kept)
    monkeypatch.setattr(pickles, "version", lambda: "99")
    with pytest.raises(ValueError, match=f"This {kind.__name__} was pickled by surefoot"):
        pickle.loads(kept)
    state = env.__getstate__()
    del state["_made"]
    with pytest.raises(ValueError, match=f"This {kind.__name__} was pickled by an older surefoot"):
        kind.__new__(kind).__setstate__(state)
