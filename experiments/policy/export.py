"""From a Stable-Baselines3 model to a policy file that holds numbers only."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.controllers.policy import PolicyFileError, PolicyNetwork
from surefoot.experiments.policy.view import PARTS, PolicyView, make_task


def network_of(model: Any, view: PolicyView, notes: Mapping[str, Any] | None = None) -> PolicyNetwork:
    """Return the mean of a PPO policy as numbers, inputs' scaling in its first layer; or ValueError."""
    policy = model.policy
    layers = [*policy.mlp_extractor.policy_net, policy.action_net]
    kinds = [type(layer).__name__ for layer in layers]
    if kinds != ["Linear", "Tanh"] * (len(kinds) // 2) + ["Linear"] or policy.squash_output:
        raise ValueError(f"A policy of tanh layers can be exported, this one has {kinds}.")
    weights, biases = [], []
    for layer in layers[::2]:
        weights.append(layer.weight.detach().cpu().numpy().astype(np.float64))
        biases.append(layer.bias.detach().cpu().numpy().astype(np.float64))
    if weights[0].shape[1] != len(view.inputs):
        raise ValueError(
            f"The model takes {weights[0].shape[1]} inputs, and PolicyView shows {len(view.inputs)}: it was "
            "trained on another task."
        )
    # The last column of the inputs' matrix stands for a constant one.
    scale, shift = view.inputs[:, :-1], view.inputs[:, -1]
    biases[0] = biases[0] + weights[0] @ shift
    weights[0] = weights[0] @ scale
    shown: Any = view.env.observation_space
    return PolicyNetwork(
        {part: int(np.prod(shown[part].shape)) for part in PARTS},
        weights,
        biases,
        posture_matrix=view.drive.matrix,
        posture_speed=view.drive.speed,
        posture_memory=view.drive.memory,
        hold=view.hold,
        dt=view.drive.dt,
        notes=notes,
    )


def export_zip(zip_path: Path, path: Path, *, task: str = "balance", trusted: bool = False) -> PolicyNetwork:
    """Turn what ``PPO.save`` wrote of a model that was trained on :class:`PolicyView` into a policy file.

    Opening such a zip runs pickled code, so its maker must be trusted: else, or if it is none,
    PolicyFileError.
    """
    if not zip_path.is_file():
        raise FileNotFoundError(f"There is no file '{zip_path}'.")
    if not trusted:
        raise PolicyFileError(
            f"'{zip_path}' was not opened: a Stable-Baselines3 zip holds pickled objects, which run whatever "
            "its maker put there. Say --trusted if you trust who made it."
        )
    from stable_baselines3 import PPO

    try:
        model = PPO.load(zip_path, device="cpu")
    except Exception as error:  # Whatever a damaged pickle raises.
        raise PolicyFileError(f"'{zip_path}' cannot be opened as a Stable-Baselines3 PPO: {error}") from error
    env, _ = make_task("true", task=task)
    try:
        network = network_of(model, PolicyView(env, task), {"from": zip_path.name})
    finally:
        env.close()
    network.save(path)
    return network
