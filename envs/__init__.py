"""MuJoCo environments of bipeds, and sensors for any other one: they know the truth and nothing else."""

from surefoot.extras import not_installed

try:
    from surefoot.envs.command import Command
    from surefoot.envs.exercise.env import ExerciseEnv
    from surefoot.envs.gait.pattern import plan_walk
    from surefoot.envs.instrumentation.drawing import RobotDrawing
    from surefoot.envs.instrumentation.env import InstrumentedEnv
    from surefoot.envs.instrumentation.picture import FeetDrawing
    from surefoot.envs.instrumentation.reader import FeetReader
    from surefoot.envs.instrumentation.spec import instrument
    from surefoot.envs.instrumentation.truth import FeetTruth
    from surefoot.envs.leg_rig.env import LegRigEnv
    from surefoot.envs.leg_rig.spec import ADDED_MASSES
    from surefoot.envs.nao.balance import NaoBalanceEnv
    from surefoot.envs.nao.carry import NaoCarryEnv
    from surefoot.envs.nao.env import NaoEnv
    from surefoot.envs.nao.stand import NaoStandEnv
    from surefoot.envs.nao.walk import NaoWalkEnv
    from surefoot.envs.prelude import Prelude
    from surefoot.envs.robots.library import load_robot_spec
    from surefoot.envs.robots.nao import load_nao_spec
except ModuleNotFoundError as missing:
    raise not_installed(__name__, missing, "sim") from None

__all__ = [
    "ADDED_MASSES",
    "Command",
    "ExerciseEnv",
    "FeetDrawing",
    "FeetReader",
    "FeetTruth",
    "InstrumentedEnv",
    "LegRigEnv",
    "NaoBalanceEnv",
    "NaoCarryEnv",
    "NaoEnv",
    "NaoStandEnv",
    "NaoWalkEnv",
    "Prelude",
    "RobotDrawing",
    "instrument",
    "load_nao_spec",
    "load_robot_spec",
    "plan_walk",
]
