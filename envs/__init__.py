"""MuJoCo environments of a NAO-class biped: they know the truth and nothing else."""

from surefoot.envs.command import Command
from surefoot.envs.feet_truth import FeetTruth
from surefoot.envs.foot_geometry import FootGeometry
from surefoot.envs.gait_pattern import Pattern, plan_route, plan_walk
from surefoot.envs.gait_route import Leg, checked_route
from surefoot.envs.icub_leg import load_icub_leg_spec
from surefoot.envs.instrument import Instrumentation, instrument
from surefoot.envs.leg_rig import ADDED_MASSES, AddedMass, load_leg_rig_spec
from surefoot.envs.leg_rig_env import LegRigEnv
from surefoot.envs.nao import NaoEnv
from surefoot.envs.nao_stand import NaoStandEnv
from surefoot.envs.nao_walk import NaoWalkEnv
from surefoot.envs.plate import SolePlate
from surefoot.envs.robot import BelowSensor, below_ankle, below_cells, load_nao_spec
from surefoot.envs.truth import Truth

__all__ = [
    "ADDED_MASSES",
    "AddedMass",
    "BelowSensor",
    "Command",
    "FeetTruth",
    "FootGeometry",
    "Instrumentation",
    "Leg",
    "LegRigEnv",
    "NaoEnv",
    "NaoStandEnv",
    "NaoWalkEnv",
    "Pattern",
    "SolePlate",
    "Truth",
    "below_ankle",
    "below_cells",
    "checked_route",
    "instrument",
    "load_icub_leg_spec",
    "load_leg_rig_spec",
    "load_nao_spec",
    "plan_route",
    "plan_walk",
]
