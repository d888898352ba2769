"""What tests of environments share."""

import mujoco
import pytest

from surefoot.envs.robots.nao import load_nao_spec


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return load_nao_spec().compile()


@pytest.fixture
def path(tmp_path):
    """A place for a toy's description."""
    return tmp_path / "toy.xml"
