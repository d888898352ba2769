"""MuJoCo environments of a biped, and sensors for any other one: they know the truth and nothing else."""

from surefoot.envs.command import Command
from surefoot.envs.drawing import RobotDrawing
from surefoot.envs.exercise import ExerciseEnv
from surefoot.envs.feet_reader import FeetReader
from surefoot.envs.feet_truth import FeetTruth
from surefoot.envs.foot_geometry import FootGeometry
from surefoot.envs.gait_pattern import Pattern, plan_route, plan_walk
from surefoot.envs.gait_route import Leg, checked_route
from surefoot.envs.icub_leg import load_icub_leg_spec
from surefoot.envs.instrument import Instrumentation, instrument
from surefoot.envs.instrumented import InstrumentedEnv
from surefoot.envs.leg_rig import ADDED_MASSES, AddedMass, load_leg_rig_spec
from surefoot.envs.leg_rig_env import LegRigEnv
from surefoot.envs.nao import NaoEnv
from surefoot.envs.nao_balance import NaoBalanceEnv
from surefoot.envs.nao_carry import NaoCarryEnv
from surefoot.envs.nao_stand import NaoStandEnv
from surefoot.envs.nao_walk import NaoWalkEnv
from surefoot.envs.plate import SolePlate
from surefoot.envs.robot import BelowSensor, below_ankle, below_cells, load_nao_spec
from surefoot.envs.robots import load_robot_spec
from surefoot.envs.truth import Truth

__all__ = [
    "ADDED_MASSES",
    "AddedMass",
    "BelowSensor",
    "Command",
    "ExerciseEnv",
    "FeetReader",
    "FeetTruth",
    "FootGeometry",
    "Instrumentation",
    "InstrumentedEnv",
    "Leg",
    "LegRigEnv",
    "NaoBalanceEnv",
    "NaoCarryEnv",
    "NaoEnv",
    "NaoStandEnv",
    "NaoWalkEnv",
    "Pattern",
    "RobotDrawing",
    "SolePlate",
    "Truth",
    "below_ankle",
    "below_cells",
    "checked_route",
    "instrument",
    "load_icub_leg_spec",
    "load_leg_rig_spec",
    "load_nao_spec",
    "load_robot_spec",
    "plan_route",
    "plan_walk",
]
