"""MuJoCo environments of a biped, and sensors for any other one: they know the truth and nothing else."""

from surefoot.envs.command import Command
from surefoot.envs.exercise.env import ExerciseEnv
from surefoot.envs.gait.pattern import Pattern, plan_route, plan_walk
from surefoot.envs.gait.route import Leg, checked_route
from surefoot.envs.instrumentation.drawing import BelowSensor, RobotDrawing, below_ankle, below_cells
from surefoot.envs.instrumentation.env import InstrumentedEnv
from surefoot.envs.instrumentation.geometry import FootGeometry
from surefoot.envs.instrumentation.plate import SolePlate
from surefoot.envs.instrumentation.reader import FeetReader
from surefoot.envs.instrumentation.spec import Instrumentation, instrument
from surefoot.envs.instrumentation.truth import FeetTruth
from surefoot.envs.leg_rig.env import LegRigEnv
from surefoot.envs.leg_rig.icub import load_icub_leg_spec
from surefoot.envs.leg_rig.spec import ADDED_MASSES, AddedMass, load_leg_rig_spec
from surefoot.envs.nao.balance import NaoBalanceEnv
from surefoot.envs.nao.carry import NaoCarryEnv
from surefoot.envs.nao.env import NaoEnv
from surefoot.envs.nao.stand import NaoStandEnv
from surefoot.envs.nao.truth import Truth
from surefoot.envs.nao.walk import NaoWalkEnv
from surefoot.envs.robots.library import load_robot_spec
from surefoot.envs.robots.nao import load_nao_spec

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
