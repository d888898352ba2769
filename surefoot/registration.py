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

HARD: dict[str, dict[str, Any]] = {
    "surefoot/NaoBalance": {
        "duration": 30.0,
        "sway": (0.065, 0.045),
        "sway_share": (0.8, 1.0),
        "payload_mass": (1.0, 1.4),
        "payload_boxes": (((-0.2, -0.15, 0.0), (0.2, 0.15, 0.1)),),
        "push_impulse": (0.1, 0.6),
    },
    "surefoot/NaoCarry": {
        "payload_mass": (0.75, 0.8),
        "payload_boxes": (
            ((-0.245, -0.02, 0.0), (-0.22, 0.02, 0.1)),
            ((0.38, -0.02, 0.0), (0.41, 0.02, 0.1)),
        ),
        "push_impulse": (0.1, 0.6),
    },
}
"""Options of tasks in which many robots fall if nobody acts; their names end in ``Hard-v0``."""


def register_environments() -> None:
    """Register ``surefoot/...``; doing so again changes nothing."""
    from gymnasium.envs.registration import register, registry

    many = "surefoot.envs.batch:"
    for name, (entry_point, vector) in {
        "surefoot/Exercise-v0": ("surefoot.envs.exercise.env:ExerciseEnv", f"{many}exercise"),
        "surefoot/NaoBalance-v0": ("surefoot.envs.nao.balance:NaoBalanceEnv", f"{many}balance"),
        "surefoot/NaoCarry-v0": ("surefoot.envs.nao.carry:NaoCarryEnv", f"{many}carry"),
        "surefoot/NaoStand-v0": ("surefoot.envs.nao.stand:NaoStandEnv", f"{many}stand"),
        "surefoot/NaoWalk-v0": ("surefoot.envs.nao.walk:NaoWalkEnv", f"{many}walk"),
    }.items():
        task, _, version = name.rpartition("-")
        made: dict[str, Any] = {"entry_point": entry_point, "vector_entry_point": vector}
        if name not in registry:
            register(id=name, **made)
        if task in HARD and f"{task}Hard-{version}" not in registry:
            register(id=f"{task}Hard-{version}", **made, kwargs={**HARD[task]})


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
