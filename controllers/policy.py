r"""A trained policy in NumPy: a small network behind an integrator, from a file that holds numbers only.

Opening a Stable-Baselines3 zip unpickles it, which runs code from the file. The files of this module are
NumPy archives of plain arrays, read with ``allow_pickle=False``;
:func:`surefoot.experiments.policy.view.export_zip` writes them.

The network is the mean of a Gaussian policy. Scaling and selection of the inputs are folded into its first
layer, so that it takes unscaled observations:

.. math:: y = W_L \phi(\dots \phi(W_1 z + b_1) \dots) + b_L,
    \qquad z = (\text{state}, \text{cop}, \text{cop\_valid})

Its outputs are speeds of postures, see :mod:`surefoot.controllers.posture`.
"""

import json
from collections.abc import Mapping
from operator import index
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.controllers.posture import PostureDrive
from surefoot.controllers.stabiliser import check_parts
from surefoot.files import AnyPath, atomic_path, names_in_archive, parse_json, read_arrays

FORMAT = "surefoot-policy-1"  # identifier of the file format
LARGEST_UNPACKED = 2**23  # largest unpacked size of a policy file in bytes

_REQUIRED = (
    "format",
    "parts",
    "sizes",
    "posture_matrix",
    "posture_speed",
    "posture_memory",
    "hold",
    "dt",
    "notes",
)


class PolicyFileError(ValueError):
    """A file is not a policy, or a policy for another robot."""


class PolicyNetwork:
    """Turns observations of ``surefoot/NaoBalance-v0``, or of wrappers around it, into actions.

    Args:
        parts: Parts of the observation that the network uses, in order, with their sizes.
        weights: Of the layers, shapes (n, S), ..., (A, n).
        biases: Of the layers.
        posture_matrix: Residuals of the motors per unit of posture, shape (M, A).
        posture_speed: Change of a posture per second at a full command.
        posture_memory: Time constant in s with which a posture returns.
        hold: Number of observations for which one output of the network is used.
        dt: Time from one observation to the next in s.
        engage_after: Time in s after a reset during which actions are zero, for example a quiet stand.
        notes: How it was trained: task, seed, versions.

    Attributes:
        drive: The integrator between the network's outputs and the action.

    Raises:
        PolicyFileError: If the shapes do not fit each other, or a number is not finite.
    """

    def __init__(
        self,
        parts: Mapping[str, int],
        weights: list[NDArray[np.float64]],
        biases: list[NDArray[np.float64]],
        *,
        posture_matrix: NDArray[np.float64],
        posture_speed: float,
        posture_memory: float,
        hold: int,
        dt: float,
        engage_after: float = 0.0,
        notes: Mapping[str, Any] | None = None,
    ) -> None:
        self.parts = dict(parts)
        self.weights = [np.array(weight, dtype=np.float64) for weight in weights]
        self.biases = [np.array(bias, dtype=np.float64) for bias in biases]
        self.notes = dict(notes or {})
        try:
            self.drive = PostureDrive(posture_matrix, posture_speed, posture_memory, dt)
        except ValueError as refused:
            raise PolicyFileError(f"The policy's postures are impossible: {refused}") from refused
        if not 1 <= hold <= 1000:
            raise PolicyFileError(f"'hold' must lie in 1 to 1000, got {hold}.")
        self.hold = int(hold)
        self._check()
        self._wait = round(engage_after / dt)
        self.reset()

    @property
    def action_size(self) -> int:
        """Number of motors that an action moves."""
        return int(self.drive.matrix.shape[0])

    def reset(self) -> None:
        """Start an episode with the posture of the pattern."""
        self.drive.reset()
        self._seen = 0
        self._held = np.zeros(self.drive.size)

    def speeds(self, observation: Mapping[str, Any]) -> NDArray[np.float64]:
        """Return the speeds of the postures in [-1, 1], shape (A,); ValueError if a part is missing."""
        signal = self._vector(observation)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            signal = np.tanh(weight @ signal + bias)
        speeds: NDArray[np.float64] = np.clip(self.weights[-1] @ signal + self.biases[-1], -1.0, 1.0)
        return speeds

    def __call__(self, observation: Mapping[str, Any]) -> NDArray[np.float32]:
        """Return the action for one observation: residuals on leg motors' targets within [-1, 1], shape (M,).

        Raises:
            ValueError: If a part of the observation is missing or has another size.
        """
        age = self._seen - self._wait
        self._seen += 1
        if age < 0:
            return np.zeros(self.action_size, dtype=np.float32)
        if age % self.hold == 0:
            self._held = self.speeds(observation)
        return self.drive(self._held)

    def fits(self, observation_space: Any, action_space: Any) -> None:
        """Raise ValueError if a part of the observation is missing or has another size, or motors differ."""
        shown = getattr(observation_space, "spaces", {})
        for part, size in self.parts.items():
            if part not in shown:
                raise ValueError(
                    f"The policy looks at {list(self.parts)}, and the environment shows {sorted(shown)}: no "
                    f"'{part}'. FootSensors takes the centre of pressure away and SelfCalibration brings it "
                    "back: SelfCalibration(FootSensors(env))."
                )
            there = int(np.prod(shown[part].shape))
            if there != size:
                raise ValueError(
                    f"The policy was trained on '{part}' of {size} numbers, and the environment shows "
                    f"{there}: it is a policy for another robot or another version of the task."
                )
        if action_space.shape != (self.action_size,):
            raise ValueError(
                f"The policy moves {self.action_size} motors, and the environment has actions of shape "
                f"{action_space.shape}: it is a policy for another robot."
            )

    @classmethod
    def load(cls, path: AnyPath, *, engage_after: float = 0.0) -> "PolicyNetwork":
        """Read a policy file without executing any code from it.

        Args:
            path: An ``.npz`` that :meth:`save` wrote.
            engage_after: As in the constructor.

        Raises:
            FileNotFoundError: If there is no such file.
            PolicyFileError: If it is not a policy, is damaged, or is a Stable-Baselines3 zip.
        """
        try:
            pickled = {"data", "policy.pth"} & set(names_in_archive(path))
            held = {} if pickled else read_arrays(path, LARGEST_UNPACKED)
        except FileNotFoundError:
            raise FileNotFoundError(f"There is no policy file '{path}'.") from None
        except ValueError as error:
            raise PolicyFileError(
                f"'{path}' cannot be read as a policy file, an archive of arrays (.npz): "
                f"{error.__cause__ or error}."
            ) from error
        if pickled:
            raise PolicyFileError(
                f"'{path}' is a Stable-Baselines3 zip, which holds pickled objects: opening it runs whatever "
                "its maker put there. If you trust who made it, turn it into a file of numbers once: "
                f"surefoot train --export {path} --trusted."
            )
        return cls._from(held, Path(path), engage_after)

    @classmethod
    def _from(cls, held: dict[str, NDArray[Any]], path: Path, engage_after: float) -> "PolicyNetwork":
        if missing := [name for name in _REQUIRED if name not in held]:
            raise PolicyFileError(f"'{path}' is no policy file: it lacks {missing} and has {sorted(held)}.")
        if str(held["format"]) != FORMAT:
            raise PolicyFileError(
                f"'{path}' says it is '{held['format']}', and this version of surefoot reads '{FORMAT}'."
            )
        count = sum(name.startswith("weight_") for name in held)
        layers = [(f"weight_{i}", f"bias_{i}") for i in range(count)]
        known = {*_REQUIRED, *(name for layer in layers for name in layer)}
        if count == 0 or set(held) != known:
            raise PolicyFileError(
                f"'{path}' holds {sorted(set(held) ^ known) or 'no layers'} that a policy file of {count} "
                "layers does not, or the other way round: it is damaged or of another program."
            )
        try:
            notes = parse_json(str(held["notes"]), "its notes")
            sizes = [index(size) for size in held["sizes"].tolist()]
            parts = dict(zip(held["parts"].tolist(), sizes, strict=True))
            numbers = {
                name: held[name].astype(np.float64, casting="same_kind")
                for name in known - {"format", "parts", "notes"}
            }
            speed, memory = float(held["posture_speed"]), float(held["posture_memory"])
            hold, dt = index(held["hold"].item()), float(held["dt"])
        except (ValueError, TypeError) as error:
            raise PolicyFileError(f"'{path}' is damaged: {str(error).rstrip('.')}.") from error
        try:
            return cls(
                parts,
                [numbers[weight] for weight, _ in layers],
                [numbers[bias] for _, bias in layers],
                posture_matrix=numbers["posture_matrix"],
                posture_speed=speed,
                posture_memory=memory,
                hold=hold,
                dt=dt,
                engage_after=engage_after,
                notes=notes if isinstance(notes, dict) else {},
            )
        except PolicyFileError as error:
            raise PolicyFileError(f"'{path}': {error}") from error

    def save(self, path: AnyPath) -> None:
        """Write the policy to an ``.npz`` of plain arrays in single precision, without changing the name.

        Raises:
            ValueError: If the path exists and is not a regular file.
        """
        layers: dict[str, Any] = {}
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            layers[f"weight_{i}"], layers[f"bias_{i}"] = weight.astype(np.float32), bias.astype(np.float32)
        with atomic_path(path) as part, part.open("wb") as file:
            np.savez_compressed(
                file,
                format=np.array(FORMAT),
                parts=np.array(list(self.parts)),
                sizes=np.array(list(self.parts.values())),
                posture_matrix=self.drive.matrix,
                posture_speed=np.array(self.drive.speed),
                posture_memory=np.array(self.drive.memory),
                hold=np.array(self.hold),
                dt=np.array(self.drive.dt),
                notes=np.array(json.dumps(self.notes, sort_keys=True)),
                **layers,
            )

    def _vector(self, observation: Mapping[str, Any]) -> NDArray[np.float64]:
        check_parts(observation, self.parts)
        pieces = [np.ravel(observation[part]).astype(np.float64) for part in self.parts]
        for piece, (part, size) in zip(pieces, self.parts.items(), strict=True):
            if piece.size != size:
                raise ValueError(
                    f"The policy was trained on '{part}' of {size} numbers, and the observation has "
                    f"{piece.size}."
                )
        return np.concatenate(pieces)

    def _check(self) -> None:
        if not self.weights or len(self.weights) != len(self.biases):
            raise PolicyFileError("A policy has at least one layer, and each layer a weight and a bias.")
        if not all(size > 0 for size in self.parts.values()):
            raise PolicyFileError(f"Parts of an observation have at least one number, got {self.parts}.")
        size = sum(self.parts.values())
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if weight.ndim != 2 or weight.shape[1] != size or bias.shape != weight.shape[:1]:
                raise PolicyFileError(
                    f"Layer {i} has a weight of shape {weight.shape} and a bias of shape {bias.shape}, and "
                    f"takes {size} numbers: the file is damaged."
                )
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise PolicyFileError(f"Layer {i} holds numbers that are not finite: its training diverged.")
            size = weight.shape[0]
        if size != self.drive.size:
            raise PolicyFileError(f"The last layer gives {size} numbers for {self.drive.size} postures.")
