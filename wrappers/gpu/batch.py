"""What torch modules over batches of robots have in common: who is meant, which step it is, what is kept."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from surefoot.calibration.setup import OLD_NAMES

RobotIds = Tensor | slice | Sequence[int] | int | None
"""Robots as managers name them: their numbers or one, a mask (bool), a slice, or ``None`` for all."""

Counter = Callable[[], int]
"""Returns the number of the simulation step, such as ``lambda: env.common_step_counter``."""


def mask_of(env_ids: RobotIds, num_envs: int, device: torch.device) -> Tensor:
    """Mark robots.

    Args:
        env_ids: Who is meant.
        num_envs: Number N of robots.
        device: Where the mask is to be.

    Returns:
        True for those who are meant, shape (N,).

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
        if env_ids.dtype != torch.bool and device.type == "cpu" and len(env_ids):
            low, high = int(env_ids.min()), int(env_ids.max())
            if low < -num_envs or high >= num_envs:
                raise ValueError(
                    f"'env_ids' must name robots from 0 to {num_envs - 1}, got {low if low < 0 else high}; "
                    "the number of robots is set when the module is made."
                )
    mask[env_ids] = True
    return mask


class BatchModule(nn.Module, ABC):
    """A module that holds the state of N robots and steps with a simulator.

    Its state is a value that each step replaces, so that it is no buffer of the module's: it goes into
    ``state_dict()`` as extra state, and stays on the device and in the dtype that it was made for.

    Args:
        num_envs: Number N of robots.
        device: Where everything is; readings must be there as well.
        dtype: A floating dtype; readings are brought to it.
        dt: Time between steps in s.
        counter: Returns the number of the simulation step; ``None`` if it is given at the calls, or every
            call is a step. May be set later.

    Raises:
        ValueError: If there is no robot, no time between steps, or the dtype cannot hold NaN.
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
        if not isinstance(num_envs, int) or isinstance(num_envs, bool) or num_envs < 1:
            raise ValueError(f"'num_envs' must be a positive whole number, got {num_envs!r}.")
        if not 0.0 < dt < float("inf"):
            raise ValueError(f"'dt' must be a positive time between steps in s, got {dt}.")
        if not dtype.is_floating_point:
            raise ValueError(f"'dtype' must be a floating one, got {dtype}.")
        self.num_envs, self.dt, self.dtype = num_envs, float(dt), dtype
        # A plain "cuda" is the current device, as tensors made on it have it.
        self.device = torch.empty(0, device=device).device
        self.counter = counter
        self._last: int | None = None
        self._starting: Tensor | None = None

    @abstractmethod
    def reset(self, env_ids: RobotIds = None, fresh: bool = False) -> None:
        """Start new episodes of robots; see the modules.

        Args:
            env_ids: Robots that begin one; all by default.
            fresh: Whether nothing of theirs is kept.
        """

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

    def _note_starting(self, env_ids: RobotIds) -> Tensor:
        """Remember until the next call whose episodes start, and return the mask, shape (N,)."""
        mask = mask_of(env_ids, self.num_envs, self.device)
        self._starting = mask if self._starting is None else self._starting | mask
        return mask

    def _saved_steps(self) -> dict[str, Any]:
        """Return which step it is and whose episodes start."""
        return {"returned": self._starting, "last": self._last}

    def _restore_steps(self, saved: dict[str, Any]) -> None:
        """Go on from what :meth:`_saved_steps` returned."""
        returned = saved["returned"]
        self._starting = None if returned is None else returned.to(self.device, copy=True)
        self._last = saved["last"]

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

    def _check_saved(self, saved: dict[str, Any], identity: dict[str, Any]) -> None:
        """Raise ValueError if a saved state is of another module, with the first difference."""
        for name, ours in identity.items():
            theirs = saved.get("identity", {}).get(name)
            if name == "method":
                theirs = OLD_NAMES.get(theirs, theirs)
            if theirs != ours:
                raise ValueError(
                    f"The saved state is of another {type(self).__name__}: its {name} is {theirs!r}, this "
                    f"one's {ours!r}; make the module as it was when the state was saved."
                )


def flat(tree: Any) -> list[Any]:
    """List the leaves of a state."""
    return [leaf for part in tree for leaf in flat(part)] if isinstance(tree, tuple) else [tree]


def saved_leaves(tree: Any) -> list[Any]:
    """Copy the leaves of a state, to be kept."""
    return [leaf.clone() if isinstance(leaf, Tensor) else leaf for leaf in flat(tree)]


def restored(like: Any, leaves: list[Any], device: torch.device) -> Any:
    """Put saved leaves back into a tree of the same form.

    Raises:
        ValueError: If they are not of such a tree.
    """
    wanted = flat(like)
    if [_kind(leaf) for leaf in wanted] != [_kind(leaf) for leaf in leaves]:
        raise ValueError(
            "The saved state does not fit: its arrays have other shapes or dtypes than this module's."
        )
    rest = iter(leaves)

    def rebuild(tree: Any) -> Any:
        if isinstance(tree, tuple):
            parts = [rebuild(part) for part in tree]
            return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
        leaf = next(rest)
        return leaf.to(device, copy=True) if isinstance(leaf, Tensor) else leaf

    return rebuild(like)


def _kind(leaf: Any) -> Any:
    return (tuple(leaf.shape), leaf.dtype) if isinstance(leaf, Tensor) else type(leaf)
