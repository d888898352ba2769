"""The environments' names, registered with Gymnasium.

``import surefoot`` imports no Gymnasium, so that a robot's program and ``surefoot --help`` start fast.
MuJoCo is imported when an environment is made.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

_STAND, _WALK = "surefoot.envs.nao.stand:NaoStandEnv", "surefoot.envs.nao.walk:NaoWalkEnv"

_BALANCE: dict[str, Any] = {
    "duration": 21.5,
    "stand_time": 3.5,
    "quiet_start": True,
    "sway": (0.025, 0.03),
    "sway_share": (0.5, 1.0),
    "payload_mass": (0.5, 1.0),
    "payload_boxes": (((-0.08, -0.12, 0.0), (0.10, 0.12, 0.10)),),
    "push_impulse": (0.3, 2.4),
    "push_interval": 4.0,
    "cop_scale": 0.015,
    "cop_weight": 2.0,
}

_BALANCE_HARD = _BALANCE | {
    "duration": 30.0,
    "sway": (0.065, 0.045),
    "sway_share": (0.8, 1.0),
    "payload_mass": (1.0, 1.4),
    "payload_boxes": (((-0.2, -0.15, 0.0), (0.2, 0.15, 0.1)),),
    "push_impulse": (0.1, 0.6),
}

# A payload reaches far before and behind, and not to the side: where one leg carries, its hip takes 2.8 of
# the 3.35 N m of its motor without any load, and a load at the side would exceed that torque.
_CARRY: dict[str, Any] = {
    "duration": 26.0,
    "stand_time": 3.5,
    "quiet_start": True,
    "speeds": (0.02, 0.04, 0.06),
    "payload_mass": (0.5, 0.7),
    "payload_boxes": (((-0.18, -0.02, 0.0), (0.22, 0.02, 0.10)),),
    "push_impulse": (0.4, 2.0),
    "push_interval": 5.0,
    "cop_scale": 0.012,
    "cop_weight": 3.0,
}

_CARRY_HARD = _CARRY | {
    "payload_mass": (0.75, 0.8),
    "payload_boxes": (
        ((-0.245, -0.02, 0.0), (-0.22, 0.02, 0.1)),
        ((0.38, -0.02, 0.0), (0.41, 0.02, 0.1)),
    ),
    "push_impulse": (0.1, 0.6),
}

ENVIRONMENTS: dict[str, tuple[str, str | None, dict[str, Any]]] = {
    "surefoot/Exercise-v0": ("surefoot.envs.exercise.env:ExerciseEnv", "exercise", {}),
    "surefoot/G1Lean-v0": ("surefoot.envs.g1.lean:LeanEnv", None, {}),
    "surefoot/NaoBalance-v0": (_STAND, "stand", _BALANCE),
    "surefoot/NaoBalanceHard-v0": (_STAND, "stand", _BALANCE_HARD),
    "surefoot/NaoCarry-v0": (_WALK, "walk", _CARRY),
    "surefoot/NaoCarryHard-v0": (_WALK, "walk", _CARRY_HARD),
    "surefoot/NaoStand-v0": (_STAND, "stand", {}),
    "surefoot/NaoWalk-v0": (_WALK, "walk", {}),
}
"""Environments: the class, the launcher of many in :mod:`surefoot.envs.batch`, and the options. Many robots
fall in the hard versions with a zero action."""


def register_environments() -> None:
    """Register ``surefoot/...``; doing so again changes nothing."""
    from gymnasium.envs.registration import register, registry

    for name, (entry_point, many, options) in ENVIRONMENTS.items():
        if name not in registry:
            vector = many and f"surefoot.envs.batch:{many}"
            register(id=name, entry_point=entry_point, vector_entry_point=vector, kwargs={**options})


def register_with_gymnasium() -> None:
    """Register now if Gymnasium is imported already, otherwise as soon as it is."""
    if "gymnasium.envs.registration" in sys.modules:
        register_environments()
    else:
        sys.meta_path.insert(0, _AfterGymnasium())


class _AfterGymnasium(MetaPathFinder):
    """Finds ``gymnasium`` as the other finders do, and registers once it has been executed."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        others = [finder for finder in sys.meta_path if finder is not self]
        spec = next(filter(None, (finder.find_spec(fullname, path, target) for finder in others)), None)
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def execute_and_register(module: ModuleType) -> None:
            execute(module)
            sys.meta_path.remove(self)
            register_environments()

        spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec
