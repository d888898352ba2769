"""The common part of modules over many robots: who is meant, which step it is, and their records."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from surefoot.checks import check_count
from surefoot.wrappers.gpu.kernels import Kernel

RobotIds = Tensor | slice | Sequence[int] | int | None
"""Robots as managers name them: their numbers or one, a mask (bool), a slice, or ``None`` for all."""

DTYPES = {torch.float32: True, torch.float64: False}
"""Dtypes of readings, and whether the kernels' numbers are floats rather than doubles then."""

Counter = Callable[[], int]
"""Returns the number of the simulation step, such as ``lambda: env.common_step_counter``."""


def mask_of(env_ids: RobotIds, num_envs: int, device: torch.device) -> Tensor:
    """Mark which of N robots are meant, shape (N,), on a device.

    Raises:
        TypeError: If numbers are not whole.
        ValueError: If a number is not one of a robot, or a mask is not of all robots.
    """
    mask = torch.zeros(num_envs, dtype=torch.bool, device=device)
    if env_ids is None:
        return ~mask
    if not isinstance(env_ids, slice):
        env_ids = torch.as_tensor(env_ids, device=device)
        if env_ids.ndim == 0:
            env_ids = env_ids[None]
        if not len(env_ids):
            # An empty list becomes a tensor of floats.
            env_ids = env_ids.to(torch.long)
        if env_ids.is_floating_point():
            raise TypeError(
                f"'env_ids' must be whole numbers of robots, a mask (bool), a slice or None, got {env_ids}."
            )
        if env_ids.dtype == torch.bool and env_ids.shape != mask.shape:
            raise ValueError(
                f"A mask of robots must have shape ({num_envs},), got {tuple(env_ids.shape)}; give their "
                "numbers to name only some."
            )
        # Beyond the last robot a GPU would end all of the process; a step that is captured cannot wait.
        capturing = device.type == "cuda" and torch.cuda.is_current_stream_capturing()
        if env_ids.dtype != torch.bool and len(env_ids) and not capturing:
            low, high = torch.stack(torch.aminmax(env_ids)).tolist()
            if low < -num_envs or high >= num_envs:
                raise ValueError(
                    f"'env_ids' must name robots from 0 to {num_envs - 1}, got {low if low < 0 else high}; "
                    "the number of robots is set when the module is made."
                )
    mask[env_ids] = True
    return mask


class BatchModule(nn.Module, ABC):
    """A module that holds a record of each of N robots and steps with a simulator.

    Records are bytes on the device, which kernels change in place. They are no buffers of torch's, as their
    layout is of one dtype: they go into ``state_dict()`` as extra state. Arguments are those of the modules;
    the counter may be set later.

    Raises:
        ValueError: If there is no robot, no time between steps, or no kernel of that dtype.
    """

    counter: Counter | None

    def __init__(
        self,
        num_envs: int,
        device: torch.device | str,
        dtype: torch.dtype,
        dt: float,
        counter: Counter | None,
    ) -> None:
        super().__init__()
        num_envs = check_count("num_envs", num_envs)
        if not 0.0 < dt < float("inf"):
            raise ValueError(f"'dt' must be a positive time between steps in s, got {dt}.")
        if dtype not in DTYPES:
            raise ValueError(f"'dtype' must be torch.float32 or torch.float64, got {dtype}.")
        self.num_envs, self.dt, self.dtype = num_envs, float(dt), dtype
        # A plain "cuda" is the current device, as tensors made on it have it.
        self.device = torch.empty(0, device=device).device
        self.counter = counter
        self._last: int | None = None
        self._records: dict[str, Tensor] = {}
        self._starting = self._register(
            "starting", torch.ones(num_envs, dtype=torch.bool, device=self.device)
        )
        self._asked = True  # whether an episode may have started since the last call

    @abstractmethod
    def reset(self, env_ids: RobotIds = None, fresh: bool = False) -> None:
        """Start new episodes of robots, of which nothing is kept if they are fresh; see the modules."""

    def extra_repr(self) -> str:
        """Return the module's size, device and dtype as text."""
        return f"num_envs={self.num_envs}, device={self.device}, dtype={self.dtype}, dt={self.dt:g}"

    def _begins(self, step: int | None) -> bool:
        """Return whether a call is the first one of its step, and remember the step."""
        if step is None and self.counter is not None:
            step = self.counter()
        again = step is not None and step == self._last
        self._last = step
        return not again

    def _register(self, name: str, values: Tensor) -> Tensor:
        """Move values to the device, and let them be saved and restored in place."""
        self._records[name] = values.to(self.device, copy=True).contiguous()
        return self._records[name]

    def _record(self, record: NDArray[Any], robots: int = 1) -> Tensor:
        """Return one record for each of some robots, or records as they are, on the device, in bytes."""
        rows = torch.from_numpy(np.atleast_1d(record).view(np.uint8).reshape(record.size, -1))
        return rows.to(self.device).expand(max(robots, record.size), -1).clone()

    def _note_starting(self, env_ids: RobotIds) -> Tensor:
        """Remember until the next call whose episodes start, and return the mask, shape (N,)."""
        mask = mask_of(env_ids, self.num_envs, self.device)
        self._starting |= mask
        self._asked = True
        return mask

    def _state_of(self, kernel: Kernel, identity: dict[str, Any]) -> dict[str, Any]:
        """Return all that is kept, for ``state_dict()``."""
        kept = {name: record.clone() for name, record in self._records.items()}
        return {"identity": identity | {"records": kernel.layout}, "last": self._last, **kept}

    def _restore(self, kernel: Kernel, saved: dict[str, Any], identity: dict[str, Any]) -> None:
        """Go on from a result of :meth:`_state_of`.

        Raises:
            ValueError: If it is of another module, with the first difference.
        """
        for name, ours in (identity | {"records": kernel.layout}).items():
            theirs = saved.get("identity", {}).get(name, "")
            if theirs != ours:
                raise ValueError(
                    f"The saved state is of another {type(self).__name__}: its {name} is {theirs!r}, this "
                    f"one's {ours!r}; make the module as it was when the state was saved."
                )
        lacking = sorted(self._records.keys() - saved.keys())
        if lacking:
            raise ValueError(
                f"The saved state has no {', '.join(lacking)}: its robots had one condition for all, "
                "and these have their own; make the module as it was when the state was saved."
            )
        for name, record in self._records.items():
            record.copy_(saved[name])
        self._last, self._asked = saved["last"], True

    def _bring(self, values: Tensor, name: str, tails: tuple[tuple[str, ...], ...], channels: int) -> Tensor:
        """Check a batch of values and bring it to the module's dtype, without its graph.

        Raises:
            TypeError: If they are no tensor.
            ValueError: If their shape or device is another than the module's.
        """
        if not isinstance(values, Tensor):
            raise TypeError(f"'{name}' must be a torch tensor, got {type(values).__name__}.")
        fits = values.ndim - 1 in map(len, tails) and values.shape[-1] == channels and values.shape[-2] > 0
        if not fits or values.shape[0] != self.num_envs:
            wanted = " or ".join(
                f"({', '.join([str(self.num_envs), *tail[:-1], str(channels)])})" for tail in tails
            )
            raise ValueError(
                f"'{name}' must have shape {wanted}, got {tuple(values.shape)}; for another number of robots "
                "make another module."
            )
        if values.device != self.device:
            raise ValueError(
                f"'{name}' is on {values.device}, but the module on {self.device}; make it with "
                f"device='{values.device}'."
            )
        return values.detach().to(self.dtype)

    def _apply(self, fn: Any, recurse: bool = True) -> Any:
        """Raise RuntimeError for another device or dtype: neither state nor random stream can follow."""
        probe = torch.empty(0, dtype=self.dtype, device=self.device)
        moved = fn(probe)
        if moved.dtype != self.dtype or moved.device != self.device:
            raise RuntimeError(
                f"{type(self).__name__} stays on {self.device} with {self.dtype}; make another one there "
                f"(device='{moved.device}', dtype={moved.dtype})."
            )
        return super()._apply(fn, recurse)  # type: ignore[no-untyped-call]


def views(records: Tensor, layout: np.dtype[Any]) -> dict[str, Tensor]:
    """Return the fields of N robots' records by name, which share their memory, bytes of shape (N, size)."""
    found = {}
    for name, (field, offset, *_) in (layout.fields or {}).items():
        kind, shape = field.subdtype or (field, ())
        part = records[:, offset : offset + field.itemsize].view(getattr(torch, kind.name))
        found[name] = part.view(len(part), *shape) if shape else part[:, 0]
    return found
