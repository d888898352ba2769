"""Foot sensors behind the hooks of manager-based simulators, played by small doubles of their managers."""

import copy
import inspect
from abc import ABC, abstractmethod
from types import SimpleNamespace

import _gpu  # noqa: F401  (skips without Warp, and compiles fast)
import pytest
import torch

from surefoot.wrappers.gpu.foot_sensors import FootSensorsModule
from surefoot.wrappers.gpu.hooks import modifier_class, noise_model_class, observation_term_class

N, K, DT = 6, 8, 0.02


class ModifierBase(ABC):
    """As Isaac Lab's: what a modifier must be to be accepted."""

    def __init__(self, cfg, data_dim, device):
        self._cfg, self._data_dim, self._device = cfg, data_dim, device

    @abstractmethod
    def reset(self, env_ids=None): ...

    @abstractmethod
    def __call__(self, data): ...


class NoiseModel:
    """As mjlab's: its configuration must hold some noise."""

    def __init__(self, noise_model_cfg, num_envs, device):
        self._noise_model_cfg, self._num_envs, self._device = noise_model_cfg, num_envs, device
        if getattr(noise_model_cfg, "noise_cfg", None) is None:
            raise ValueError("NoiseModelCfg must have a valid noise_cfg")

    def reset(self, env_ids=None): ...

    def __call__(self, data):
        raise AssertionError("the hook must read the sensors in place of adding noise")


class ManagerTermBase:
    """As Isaac Lab's."""

    def __init__(self, cfg, env):
        self.cfg, self._env = cfg, env

    def reset(self, env_ids=None): ...


class Manager:
    """Calls one term as the observation managers do: term, modifier, noise, then clip and scale in place."""

    def __init__(self, env, func, modifier=None, noise=None):
        term = SimpleNamespace(func=func, modifier=modifier, noise=noise)
        self.env, self.term = env, copy.deepcopy(term)
        if inspect.isclass(self.term.func):
            self.term.func = self.term.func(cfg=self.term, env=env)
        shape = tuple(self.term.func(env).shape)
        if modifier is not None:
            self.term.modifier = self.term.modifier(cfg=self.term, data_dim=shape, device=env.device)
            assert isinstance(self.term.modifier, ModifierBase)
            assert list(inspect.signature(self.term.modifier).parameters) == ["data"]
        if noise is not None:
            assert issubclass(self.term.noise, NoiseModel)
            cfg = SimpleNamespace(noise_cfg="some", class_type=self.term.noise)
            self.term.noise = self.term.noise(cfg, num_envs=env.num_envs, device=env.device)
        if hasattr(self.term.func, "reset"):
            self.term.func.reset()

    def reset(self, env_ids=None):
        for part in (self.term.func, self.term.modifier, self.term.noise):
            if hasattr(part, "reset"):
                part.reset(env_ids=env_ids)

    def compute(self):
        value = self.term.func(self.env).clone()
        if self.term.modifier is not None:
            value = self.term.modifier(value)
        if self.term.noise is not None:
            value = self.term.noise(value)
        return value.clip_(min=-5.0, max=15.0).mul_(0.1)


class Env:
    """Steps as the environments of both do: count, record, reset, observe."""

    num_envs, device, step_dt = N, "cpu", DT

    def __init__(self, build, groups=1):
        self.common_step_counter = 0
        self.force = torch.full((N, K), 10.0)
        self.managers = [build(self) for _ in range(groups)]
        for manager in self.managers:
            manager.reset(slice(None))

    def step(self, ended=(), record=False):
        self.common_step_counter += 1
        self.force = torch.full((N, K), 10.0) + 0.01 * self.common_step_counter
        recorded = [manager.compute() for manager in self.managers] if record else None
        if len(ended):
            for manager in self.managers:
                manager.reset(torch.tensor(ended))
            self.force[list(ended)] = 0.0
        return recorded, [manager.compute() for manager in self.managers]


def true_force(env):
    return env.force


def feet(**options):
    return FootSensorsModule("hx711-load-cells", N, dt=DT, seed=1, **options)


def modified(sensors, **options):
    return lambda env: Manager(env, true_force, modifier=modifier_class(sensors, ModifierBase, **options))


def noisy(sensors, **options):
    return lambda env: Manager(env, true_force, noise=noise_model_class(sensors, NoiseModel, **options))


def observed(sensors, **options):
    def read(env):
        return sensors.newtons(sensors(env.force, step=env.common_step_counter))

    term = observation_term_class(read, sensors, base=ManagerTermBase, **options)
    return lambda env: Manager(env, term)


HOOKS = {"modifier": modified, "noise model": noisy, "observation term": observed}


def environment(hook, groups=1, **options):
    sensors = feet()
    env = Env(HOOKS[hook](sensors, **options), groups)
    sensors.counter = lambda: env.common_step_counter
    return env, sensors


@pytest.mark.parametrize("hook", HOOKS)
def test_recording_and_further_groups_do_not_age_the_sensors(hook):
    plain, ours = environment(hook)
    busy, theirs = environment(hook, groups=3)
    # While managers are built there is no counter yet.
    theirs.load_state_dict(ours.state_dict())
    for k in range(6):
        ended = [1, 4] if k == 3 else []
        _, (expected,) = plain.step(ended)
        recorded, seen = busy.step(ended, record=not ended)
        for values in seen + (recorded or []):
            assert torch.equal(values, expected)


@pytest.mark.parametrize("hook", HOOKS)
def test_what_ends_within_a_step_is_read_again(hook):
    env, _ = environment(hook, groups=2)
    for _ in range(3):
        env.step()
    recorded, seen = env.step(ended=[1, 4], record=True)
    stay, ended = [0, 2, 3, 5], [1, 4]
    for before, after in zip(recorded, seen, strict=True):
        assert torch.equal(after[stay], before[stay])
        # Zeros are off by some newtons, but the load of the episode before is gone.
        assert float((before - after)[ended].mean()) == pytest.approx(1.0, abs=0.4)


@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("hook", HOOKS)
def test_a_reset_keeps_the_sensors_unless_fresh(hook, fresh):
    env, sensors = environment(hook, fresh=fresh)
    env.step()
    before = sensors.true_parameters().scale
    env.step(ended=[2])
    moved = (sensors.true_parameters().scale / before - 1.0).abs().amax(dim=1) > 0.02
    assert bool(moved[2]) == fresh
    assert not moved[[0, 1, 3, 4, 5]].any()


@pytest.mark.parametrize("hook", HOOKS)
def test_forces_of_the_simulator_are_not_written_to(hook):
    env, _ = environment(hook)
    force = env.force.clone()
    env.managers[0].compute()
    assert torch.equal(env.force, force)


@pytest.mark.parametrize("hook", ["modifier", "noise model"])
def test_sensors_are_made_when_the_manager_asks(hook):
    made = []

    def make(num_envs, device):
        made.append(FootSensorsModule("hx711-load-cells", num_envs, device, dt=DT))
        return made[-1]

    Env(HOOKS[hook](make), groups=2)
    assert len(made) == 2
    assert made[0] is not made[1]


def test_counts_come_out_if_asked_for():
    for make in (modified, noisy):
        env = Env(make(feet(), unit="count"))
        # The double clips at 15 and scales by 0.1: codes are in the millions.
        assert torch.equal(env.managers[0].compute(), torch.full((N, K), 1.5))
    for make in (modifier_class, noise_model_class):
        with pytest.raises(ValueError, match="'unit' must be one of"):
            make(feet(), unit="newton")


def test_another_number_of_robots_or_channels_is_refused():
    few = FootSensorsModule("hx711-load-cells", N - 1, dt=DT)
    for hook in HOOKS.values():
        with pytest.raises(ValueError, match="was made for 5 robots, but the environment has 6"):
            Env(hook(few))
    with pytest.raises(ValueError, match=r"read forces of shape \(6, 12\), but the observation has \(6, 8\)"):
        Env(modified(FootSensorsModule("icub-force-torque", N, dt=DT)))
    env = Env(noisy(feet()))
    env.force = env.force[:4]
    with pytest.raises(ValueError, match="for another number of robots make another module"):
        env.managers[0].compute()


def test_no_base_class_is_needed_where_none_is_asked_for():
    sensors = feet()
    force = torch.full((N, K), 10.0)
    modifier = modifier_class(sensors)(None, (N, K), "cpu")
    noise = noise_model_class(sensors)(None, N, "cpu")
    assert torch.isfinite(modifier(force)).all()
    modifier.reset()
    noise.reset(env_ids=torch.tensor([0]))
    assert torch.isfinite(noise(force)).all()
