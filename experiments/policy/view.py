"""A task as a policy sees it: which numbers go in and out, and which feet it stands on.

Encoders and IMU are the robot's own whatever is fed back, so that feeds differ by nothing but the feet. A
trained Stable-Baselines3 model becomes a policy file that holds numbers only.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.controllers.policy import PolicyFileError, PolicyNetwork
from surefoot.controllers.posture import PostureDrive, posture_matrix
from surefoot.envs.robots.nao import motor_of_joint
from surefoot.experiments.evaluate.feet import FedFeet, put_on
from surefoot.experiments.policy.tasks import Task, find_task

PARTS = ("state", "cop", "cop_valid")  # parts of an observation that a policy sees, in this order
TRACES = "traces"  # part that :class:`Traces` adds after them
MEMORY = (0.4, 4.0, 16.0)  # time constants of the traces in s: of a reach, of the load, and of a march
_LEGS = 12  # hinge joints of both legs, which come first
_COP_PARTS = 6  # numbers beside the state: CoP (2), whether it is valid (3), a constant one
_JOINT_UNIT = 0.1  # unit in which a policy sees joint angles, in rad
_COP_UNIT, _ERROR_UNIT = 0.03, 0.01  # m, of the CoP and of its difference to the commanded one


def make_task(feed: str, *, severity: float = 1.0, task: str = "balance", **env_options: Any) -> FedFeet:
    """Return the environment of a task on the feet of a feed; each reset draws fresh sensors."""
    bare = gym.make(find_task(task).env_id, disable_env_checker=True, **env_options)
    return put_on(bare, feed, severity, sensors={"fresh": True})


def _input_matrix(
    layout: Mapping[str, slice], standing: Floats | None, task: Task, *, traces: int, blind: bool
) -> Floats:
    """Return the matrix that picks and scales the inputs, shape (N, S + 6 + T).

    Its columns are the S numbers of the state, ``cop``, ``cop_valid``, T traces, and a constant one. Of the
    joints only the angles of the legs are used, if there is a standing posture, because encoders measure
    velocities badly. A blind policy has no inputs from the feet.
    """
    size = max(where.stop for where in layout.values())
    all_parts = np.eye(size + _COP_PARTS + traces)
    state, (cop, valid, past, one) = all_parts[:size], np.split(all_parts[size:], [2, 5, 5 + traces])
    rows = []
    if standing is not None:
        rows.append((state[layout["joint_position"]][:_LEGS] - standing[:_LEGS, None] * one) / _JOINT_UNIT)
    rows += [state[layout[name]] / scale for name, scale in task.scales.items()]
    if blind:
        return np.concatenate(rows)
    error = (cop - state[layout["goal" if task.imitates else "cop_reference"]]) / _ERROR_UNIT
    if standing is None:
        return np.concatenate([*rows, error, past / _ERROR_UNIT])
    for felt, off in zip(cop, error, strict=True):
        rows += [felt[None] / _COP_UNIT, off[None]]
    return np.concatenate([*rows, valid - one])


def input_names(task: Task, *, blind: bool = False) -> list[str]:
    """Return a task's inputs in words, in their order."""
    if task.imitates:
        return [*task.scales, *([] if blind else ["cop less goal"])]
    feet = ["cop, and cop less cop_reference", "cop_valid"]
    return [f"joint_position of the {_LEGS} leg joints", *task.scales, *feet]


class Traces(gym.Wrapper[Any, Any, Any, Any]):
    """Add ``"traces"`` to the observation: means of the CoP less its goal over 0.4, 4 and 16 s, shape (6,).

    They let a policy learn from the robot's past motion how wrong its sensors are, without a calibrator. They
    are exponential means since the reset in m, the shortest first.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        shown: Any = env.observation_space
        self.observation_space = spaces.Dict(
            {**shown.spaces, TRACES: spaces.Box(-np.inf, np.inf, (2 * len(MEMORY),), np.float32)}
        )
        self._traces = np.zeros((len(MEMORY), 2))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Forget the past, and reset."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._traces[:] = 0.0
        return self._with_traces(observation), info

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step, and take in the reading."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._with_traces(observation), reward, terminated, truncated, info

    def _with_traces(self, observation: dict[str, Any]) -> dict[str, Any]:
        bare: Any = self.env.unwrapped
        error = observation["cop"] - observation["state"][bare.observation_parts["goal"]]
        self._traces += (error - self._traces) * bare.dt / np.array(MEMORY)[:, None]
        return {**observation, TRACES: self._traces.ravel().astype(np.float32)}


class PolicyView(gym.Wrapper[Any, Any, Any, Any]):
    """Show a policy its inputs as one vector, and let it command speeds of postures.

    The observation becomes ``Box(-inf, inf, (N,))`` of scaled numbers. The action has the speeds of
    :data:`surefoot.controllers.posture.POSTURES`, ``Box(-1, 1, (4,))``, or is that of the environment itself
    where the task has no postures. It holds for ``hold`` steps, and their rewards add up.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        task: str = "balance",
        *,
        reward_scale: float = 1.0,
        blind: bool = False,
    ) -> None:
        super().__init__(env)
        self.task = find_task(task)
        self.hold = self.task.hold
        bare, shown = cast(Any, env.unwrapped), cast(Any, env.observation_space)
        self.parts = [part for part in (*PARTS, TRACES) if part in shown.spaces]
        size = shown.spaces[TRACES].shape[0] if TRACES in self.parts else 0
        if self.task.imitates:
            # A drive that reaches its command within a step and forgets it with the next hands it on.
            standing, layout, drive = None, bare.observation_parts, (np.eye(2), 1.0 / bare.dt, bare.dt)
        else:
            standing = bare.model.key("stand").ctrl[motor_of_joint(bare.model)]
            layout, drive = bare.state_layout, (posture_matrix(), self.task.speed, self.task.memory)
        self.inputs = _input_matrix(layout, standing, self.task, traces=size, blind=blind)
        self.drive = PostureDrive(*drive, bare.dt)
        self._reward_scale = reward_scale
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(self.inputs),), dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (self.drive.size,), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Reset, with the pattern's posture, and let a robot march that marches before its task."""
        observation, info = self.env.reset(seed=seed, options=options)
        self.drive.reset()
        bare: Any = self.env.unwrapped
        for _ in range(round(bare.stand_time / bare.dt) if self.task.imitates else 0):
            observation, _, _, _, info = self.env.step(self.drive(np.zeros(self.drive.size)))
        return self.inputs_of(observation), info

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Move the posture for the steps that an action holds."""
        total = 0.0
        for _ in range(self.hold):
            observation, reward, terminated, truncated, info = self.env.step(self.drive(action))
            total += float(reward)
            if terminated or truncated:
                break
        return self.inputs_of(observation), self._reward_scale * total, terminated, truncated, info

    def inputs_of(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the inputs of an observation, shape (N,)."""
        flat = np.concatenate(
            [np.ravel(observation[part]).astype(np.float64) for part in self.parts] + [[1.0]]
        )
        seen: NDArray[np.float32] = (self.inputs @ flat).astype(np.float32)
        return seen


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
            "trained on another task (--task says which), or not on a PolicyView; evaluate such a model as "
            "'module:function'."
        )
    return export(weights, biases, view, notes)


def export(
    weights: list[Floats], biases: list[Floats], view: PolicyView, notes: Mapping[str, Any] | None
) -> PolicyNetwork:
    """Return layers that take the inputs of a view as a policy that takes observations."""
    # The last column of the inputs' matrix stands for a constant one.
    scale, shift = view.inputs[:, :-1], view.inputs[:, -1]
    weights, biases = [weights[0] @ scale, *weights[1:]], [biases[0] + weights[0] @ shift, *biases[1:]]
    shown: Any = view.env.observation_space
    return PolicyNetwork(
        {part: int(np.prod(shown[part].shape)) for part in view.parts},
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
    """Turn a file of ``PPO.save`` of a model that was trained on :class:`PolicyView` into a policy file.

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
    env = make_task("true", task=task)
    try:
        network = network_of(
            model, PolicyView(env, task), {"from": zip_path.name, "task": find_task(task).env_id}
        )
    finally:
        env.close()
    network.save(path)
    return network
