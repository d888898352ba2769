"""The recipe for Stable-Baselines3 in examples/: what is seen and commanded; that it trains."""

from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

SHORT = {"duration": 0.3, "stand_time": 0.1, "payload_time": (0.05, 0.1)}


@pytest.fixture(scope="module")
def recipe(load_script: Callable[[str], ModuleType]) -> ModuleType:
    return load_script("examples/sb3_balance.py")


def test_postures_move_after_the_stand_and_begin_anew_with_an_episode(recipe: ModuleType) -> None:
    venv = recipe.robots(2, **SHORT)
    venv.seed(0)
    seen = venv.reset()
    full, moved = np.ones((2, 4)), []
    for _ in range(6):
        assert seen.shape == (2, 15)
        assert np.isfinite(seen).all()
        moved.append(np.abs(seen[:, -4:]).max())
        seen, paid, done, infos = venv.step(full)
        assert (paid <= 0.05 * 4 * 3.0).all()
        if done.all():
            break
    assert done.all()
    assert moved[2] == 0.0 < moved[-1]
    assert all(np.abs(info["terminal_observation"][-4:]).min() > 0.0 for info in infos)
    assert (seen[:, -4:] == 0.0).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:SelfCalibration has learnt nothing")  # in episodes of 0.3 s nobody can
def test_it_trains(recipe: ModuleType) -> None:
    model = recipe.ppo(recipe.robots(2, **SHORT))
    before = model.policy.action_net.weight.detach().clone()
    model.learn(1024)
    assert not np.allclose(before, model.policy.action_net.weight.detach())
