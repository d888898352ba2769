"""Policies of any kind as functions of an observation, and a hash of each.

================================  ==========================================================================
given                             used as
================================  ==========================================================================
a name or a file                  see :mod:`surefoot.experiments.policy.controllers`; ``"model.zip"`` of
                                  Stable-Baselines3 needs ``trusted``, since opening it runs pickled code
a Stable-Baselines3 model         its deterministic action; recurrent ones keep their state over an episode,
                                  and statistics of ``VecNormalize`` are taken along
a torch module                    its output for one observation, clipped to the action space
``"model.onnx"``                  its first output for a batch of one observation (needs onnxruntime); inputs
                                  get the parts of the observation with their names
a callable                        its answer; one with a ``reset`` is reset before every episode
================================  ==========================================================================
"""

import inspect
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from surefoot.controllers.policy import PolicyFileError
from surefoot.experiments.policy.controllers import check_fits, controller_hash, load_controller

_DIGITS = 16  # of a hash: enough for any number of policies


class Normalization(NamedTuple):
    """What ``VecNormalize`` did to observations while training: (mean, variance) of each part, and limits."""

    moments: Mapping[str, tuple[Any, Any]]  # of a single observation under ""
    epsilon: float
    clip: float

    def __call__(self, observation: Any) -> Any:
        """Return the observation as the policy saw it."""
        if not isinstance(observation, Mapping):
            return self._scale("", observation)
        return {part: self._scale(part, value) for part, value in observation.items()}

    def _scale(self, part: str, value: Any) -> Any:
        if part not in self.moments:
            return value
        mean, variance = self.moments[part]
        scaled = (np.asarray(value) - mean) / np.sqrt(variance + self.epsilon)
        return np.clip(scaled, -self.clip, self.clip).astype(np.float32)


@dataclass(eq=False)
class Sb3Policy:
    """A policy of Stable-Baselines3 without its environment, so that it can be sent to other processes."""

    policy: Any
    normalization: Normalization | None = None

    def __post_init__(self) -> None:
        """Start an episode."""
        self.reset()

    @property
    def observation_space(self) -> spaces.Space[Any]:
        """The space that it was trained in."""
        space: spaces.Space[Any] = self.policy.observation_space
        return space

    def reset(self) -> None:
        """Start an episode: recurrent policies forget the last one."""
        self._state: Any = None
        self._begins = np.ones(1, dtype=bool)

    def __call__(self, observation: Any) -> Any:
        """Return the deterministic action."""
        if self.normalization is not None:
            observation = self.normalization(observation)
        action, self._state = self.policy.predict(
            observation, state=self._state, episode_start=self._begins, deterministic=True
        )
        self._begins = np.zeros(1, dtype=bool)
        return action


@dataclass(eq=False)
class TorchPolicy:
    """A torch module that answers a batch of observations with a batch of actions."""

    module: Any

    def __call__(self, observation: Any) -> Any:
        """Return the action for one observation."""
        import torch

        def batch(part: Any) -> Any:
            return torch.as_tensor(np.asarray(part), dtype=torch.float32)[None]

        with torch.no_grad():
            if isinstance(observation, Mapping):
                answer = self.module({name: batch(part) for name, part in observation.items()})
            else:
                answer = self.module(batch(observation))
        answer = answer[0] if isinstance(answer, tuple) else answer
        return answer[0].numpy()


@dataclass(eq=False)
class OnnxPolicy:
    """A network in an ONNX file, which holds numbers and operations and no code.

    Raises:
        ValueError: If the file is missing, is no ONNX, or onnxruntime is not installed.
    """

    path: str

    def __post_init__(self) -> None:
        """Open the file."""
        if not Path(self.path).is_file():
            raise ValueError(f"There is no policy file '{self.path}'; give its path.")
        try:
            import onnxruntime
            from onnxruntime.capi import onnxruntime_pybind11_state as errors
        except ImportError as error:
            raise ValueError(
                f"The policy '{self.path}' needs onnxruntime ({error}): pip install onnxruntime."
            ) from None
        try:
            self._session = onnxruntime.InferenceSession(self.path, providers=["CPUExecutionProvider"])
        except (errors.Fail, errors.InvalidGraph, errors.InvalidProtobuf, errors.NotImplemented) as error:
            raise ValueError(f"'{self.path}' cannot be opened as an ONNX network: {error}") from error
        self._shapes = {one.name: list(one.shape) for one in self._session.get_inputs()}

    def __reduce__(self) -> Any:
        """Send the path to other processes, which open the file themselves."""
        return OnnxPolicy, (self.path,)

    def __call__(self, observation: Any) -> Any:
        """Return the action for one observation; ValueError if the network takes another one."""
        parts = observation if isinstance(observation, Mapping) else {next(iter(self._shapes)): observation}
        batch = {}
        for name, shape in self._shapes.items():
            if name not in parts:
                raise ValueError(
                    f"The network '{self.path}' takes {list(self._shapes)}, and the observation has no "
                    f"'{name}'; give its parts these names, or one vector with 'observe'."
                )
            batch[name] = np.asarray(parts[name], dtype=np.float32)[None]
            own, asked = batch[name].shape[1:], shape[1:]
            # A dimension that is not a number may have any size.
            fits = all(not isinstance(size, int) or size == n for size, n in zip(asked, own, strict=False))
            if len(own) != len(asked) or not fits:
                raise ValueError(
                    f"The network '{self.path}' takes '{name}' of shape {asked}, and the observation has "
                    f"shape {list(own)}; choose its parts with 'observe'."
                )
        return self._session.run(None, batch)[0][0]


def normalization_of(statistics: Any) -> Normalization | None:
    """Return the statistics of a ``VecNormalize`` or of its file, which is a pickle; ``None`` for none."""
    if isinstance(statistics, str | Path):
        import pickle

        if not Path(statistics).is_file():
            raise ValueError(
                f"There is no file of statistics '{statistics}'; give the path of VecNormalize.save()."
            )
        statistics = pickle.loads(Path(statistics).read_bytes())
    if statistics is None or not getattr(statistics, "norm_obs", True):
        return None
    running = statistics.obs_rms
    parts = running if isinstance(running, Mapping) else {"": running}
    moments = {name: (np.array(one.mean), np.array(one.var)) for name, one in parts.items()}
    return Normalization(moments, float(statistics.epsilon), float(statistics.clip_obs))


def portable(policy: Any, *, statistics: Any = None, trusted: bool = False) -> Any:
    """Return a policy that can be sent to other processes; names stay names, to be loaded where they act.

    Raises:
        ValueError: If it is no policy, or its file is not there.
        PolicyFileError: If a zip of Stable-Baselines3 is not trusted.
    """
    if isinstance(policy, Path) or (isinstance(policy, str) and policy.endswith((".zip", ".onnx"))):
        policy = str(policy)
        if policy.endswith(".zip"):
            policy = load_sb3(Path(policy), trusted=trusted)
        elif policy.endswith(".onnx"):
            policy = OnnxPolicy(policy)
    if hasattr(policy, "predict") and hasattr(policy, "policy"):
        found = statistics if statistics is not None else policy.get_vec_normalize_env()
        return Sb3Policy(policy.policy, normalization_of(found))
    if statistics is not None:
        raise ValueError("'statistics' are those of VecNormalize and need a Stable-Baselines3 model.")
    if hasattr(policy, "state_dict"):
        return policy if hasattr(policy, "predict") else TorchPolicy(policy.eval())
    if not (isinstance(policy, str) or callable(policy)):
        raise ValueError(
            f"'policy' must be a Stable-Baselines3 model, a torch module, a function of observations, a name "
            f"or a file, got {type(policy).__name__}."
        )
    return policy


def load_sb3(path: Path, *, trusted: bool) -> Any:
    """Open a zip of Stable-Baselines3 by its algorithm, if its maker is trusted."""
    if not path.is_file():
        raise ValueError(f"There is no policy file '{path}'; give its path.")
    if not trusted:
        raise PolicyFileError(
            f"'{path}' was not opened: a Stable-Baselines3 zip holds pickled objects, which run whatever its "
            "maker put there. If you trust who made it, say --trusted, or trusted=True."
        )
    import stable_baselines3 as sb3

    try:
        with zipfile.ZipFile(path) as archive:
            held = json.loads(archive.read("data"))
        return getattr(sb3, _algorithm_of(held)).load(path, device="cpu")
    except (zipfile.BadZipFile, KeyError, ValueError) as error:
        raise PolicyFileError(f"'{path}' cannot be opened as a Stable-Baselines3 model: {error}.") from error


def _algorithm_of(held: Mapping[str, Any]) -> str:
    """Return the algorithm whose own settings a model holds."""
    own = {"clip_range": "PPO", "target_entropy": "SAC", "policy_delay": "TD3", "exploration_rate": "DQN"}
    return next((name for setting, name in own.items() if setting in held), "A2C")


def ready(policy: Any, env: gym.Env[Any, Any], name: str) -> Callable[[Any], Any]:
    """Return a policy that answers observations of an environment; ValueError if it does not fit."""
    if isinstance(policy, str):
        return load_controller(policy, env, same_task=True)
    check_fits(policy, env, name)
    found: Callable[[Any], Any] = policy
    return found


def fingerprint(given: Any, env_id: str = "") -> str:
    """Return a hash of what decides how a policy, or a function of the user's, acts.

    It is that of a file's content, of a network's parameters, of a function's source, or else of the pickled
    object.
    """
    if isinstance(given, str):
        return controller_hash(given, env_id) or given
    if isinstance(given, OnnxPolicy):
        return sha256(Path(given.path).read_bytes()).hexdigest()[:_DIGITS]
    module = getattr(given, "policy", getattr(given, "module", given))
    if hasattr(module, "state_dict"):
        digest = sha256()
        for part, value in module.state_dict().items():
            digest.update(part.encode() + np.ascontiguousarray(value.detach().cpu().numpy()).tobytes())
        if (scaled := getattr(given, "normalization", None)) is not None:
            digest.update(repr(scaled).encode())
        return digest.hexdigest()[:_DIGITS]
    if inspect.isfunction(given) or inspect.isclass(given):
        return _hash_of_code(given)
    import joblib

    try:
        return str(joblib.hash(given))[:_DIGITS]
    except Exception:  # Whatever an object raises that cannot be pickled: loky's own pickler may do it.
        return _hash_of_code(type(given))


def _hash_of_code(given: Any) -> str:
    try:
        text = inspect.getsource(given)
    except (OSError, TypeError):
        code = getattr(given, "__code__", None)
        text = f"{given.__qualname__} {'' if code is None else (code.co_code, code.co_consts)}"
    cells = [cell.cell_contents for cell in getattr(given, "__closure__", None) or ()]
    held = [
        fingerprint(cell) if callable(cell) or hasattr(cell, "__dict__") else repr(cell) for cell in cells
    ]
    return sha256(repr((text, held)).encode()).hexdigest()[:_DIGITS]
