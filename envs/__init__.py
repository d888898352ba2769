"""MuJoCo environments of a NAO-class biped: they know the truth and nothing else."""

from surefoot.envs.command import Command
from surefoot.envs.gait_pattern import Pattern, plan_route, plan_walk
from surefoot.envs.gait_route import Leg, checked_route
from surefoot.envs.nao import NaoEnv
from surefoot.envs.nao_stand import NaoStandEnv
from surefoot.envs.nao_walk import NaoWalkEnv
from surefoot.envs.plate import SolePlate
from surefoot.envs.robot import BelowSensor, below_ankle, below_cells, load_nao_spec
from surefoot.envs.truth import Truth

__all__ = [
    "BelowSensor",
    "Command",
    "Leg",
    "NaoEnv",
    "NaoStandEnv",
    "NaoWalkEnv",
    "Pattern",
    "SolePlate",
    "Truth",
    "below_ankle",
    "below_cells",
    "checked_route",
    "load_nao_spec",
    "plan_route",
    "plan_walk",
]
