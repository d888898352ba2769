"""MuJoCo environments of bipeds, and sensors for any other one: they know the truth and nothing else.

Modules are loaded when one of their names is asked for: a robot that reads its own model needs MuJoCo and no
Gymnasium.
"""

from typing import TYPE_CHECKING

from surefoot.extras import names_of

if TYPE_CHECKING:
    from surefoot.envs.command import Command as Command
    from surefoot.envs.exercise.env import ExerciseEnv as ExerciseEnv
    from surefoot.envs.g1.lean import LeanEnv as LeanEnv
    from surefoot.envs.gait.pattern import plan_walk as plan_walk
    from surefoot.envs.instrumentation.drawing import RobotDrawing as RobotDrawing
    from surefoot.envs.instrumentation.env import InstrumentedEnv as InstrumentedEnv
    from surefoot.envs.instrumentation.picture import FeetDrawing as FeetDrawing
    from surefoot.envs.instrumentation.reader import FeetReader as FeetReader
    from surefoot.envs.instrumentation.spec import instrument as instrument
    from surefoot.envs.instrumentation.truth import FeetTruth as FeetTruth
    from surefoot.envs.nao.env import NaoEnv as NaoEnv
    from surefoot.envs.nao.stand import NaoStandEnv as NaoStandEnv
    from surefoot.envs.nao.walk import NaoWalkEnv as NaoWalkEnv
    from surefoot.envs.prelude import Prelude as Prelude
    from surefoot.envs.robots.library import load_robot_spec as load_robot_spec
    from surefoot.envs.robots.nao import load_nao_spec as load_nao_spec

_MODULES = {
    "Command": "surefoot.envs.command",
    "ExerciseEnv": "surefoot.envs.exercise.env",
    "FeetDrawing": "surefoot.envs.instrumentation.picture",
    "FeetReader": "surefoot.envs.instrumentation.reader",
    "FeetTruth": "surefoot.envs.instrumentation.truth",
    "InstrumentedEnv": "surefoot.envs.instrumentation.env",
    "LeanEnv": "surefoot.envs.g1.lean",
    "NaoEnv": "surefoot.envs.nao.env",
    "NaoStandEnv": "surefoot.envs.nao.stand",
    "NaoWalkEnv": "surefoot.envs.nao.walk",
    "Prelude": "surefoot.envs.prelude",
    "RobotDrawing": "surefoot.envs.instrumentation.drawing",
    "instrument": "surefoot.envs.instrumentation.spec",
    "load_nao_spec": "surefoot.envs.robots.nao",
    "load_robot_spec": "surefoot.envs.robots.library",
    "plan_walk": "surefoot.envs.gait.pattern",
}

__all__ = [*_MODULES]
__getattr__, __dir__ = names_of(__name__, _MODULES, "sim")
