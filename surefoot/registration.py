"""The environments' names, registered with Gymnasium.

``import surefoot`` imports no Gymnasium, so that a robot's program and ``surefoot --help`` start fast.
MuJoCo is imported when an environment is made.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


def register_environments() -> None:
    """Register ``surefoot/...``; doing so again changes nothing."""
    from gymnasium.envs.registration import register, registry

    for name, (entry_point, max_episode_steps) in {
        "surefoot/Exercise-v0": ("surefoot.envs.exercise.env:ExerciseEnv", None),
        "surefoot/LegRig-v0": ("surefoot.envs.leg_rig.env:LegRigEnv", 3000),
        "surefoot/NaoBalance-v0": ("surefoot.envs.nao.balance:NaoBalanceEnv", None),
        "surefoot/NaoCarry-v0": ("surefoot.envs.nao.carry:NaoCarryEnv", None),
        "surefoot/NaoStand-v0": ("surefoot.envs.nao.stand:NaoStandEnv", None),
        "surefoot/NaoWalk-v0": ("surefoot.envs.nao.walk:NaoWalkEnv", None),
    }.items():
        if name not in registry:
            register(id=name, entry_point=entry_point, max_episode_steps=max_episode_steps)


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
