"""MuJoCo environments of a NAO-class biped: they know the truth and nothing else."""

from surefoot.envs.command import Command
from surefoot.envs.nao import NaoEnv
from surefoot.envs.nao_stand import NaoStandEnv
from surefoot.envs.plate import SolePlate
from surefoot.envs.robot import load_nao_spec
from surefoot.envs.truth import Truth

__all__ = ["Command", "NaoEnv", "NaoStandEnv", "SolePlate", "Truth", "load_nao_spec"]
