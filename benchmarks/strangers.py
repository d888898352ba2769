"""A Unitree G1 by published policies on other ground: it dances, walks on a soft mat and climbs stairs.

Robot, policies and ``g1_policy.py`` come from the folder that the variable ``SUREFOOT_STRANGERS`` names.
"""

import os
import re
import sys
from importlib import import_module
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from unittest.mock import patch

import gymnasium as gym
import mujoco
import numpy as np

from surefoot.arrays import Floats

MAT = {"solref": [0.06, 1.0], "solimp": [0.05, 0.95, 0.04, 0.5, 2.0]}
"""Contact of a mat on which a foot of a G1 sinks by 15 to 25 mm."""

STEP, RISE = 0.3, 0.05  # length and height of a stair in m


def make_g1(policy: str, ground: str = "") -> gym.Env[Any, Any]:
    """Make a G1 that walks by a policy, or dances by ``"ppo_g1_29dof_dancing"``.

    Args:
        policy: Name of the policy.
        ground: ``"mat"``, ``"stairs"``, or an empty string for a hard plane.
    """
    sys.path.append(os.environ["SUREFOOT_STRANGERS"])
    walker: Any = import_module("g1_policy")
    scene = _scene(walker.description(), ground)
    with patch.object(walker, "description", lambda: scene):
        if not policy.endswith("dancing"):
            env: gym.Env[Any, Any] = walker.G1Walk(policy)
            return env
        env = walker.G1Walk("ppo_g1_29dof")
    return Dance(env, policy)


def _scene(path: str, ground: str) -> str:
    """Return the path of a scene on other ground, made of the one on a plane."""
    if not ground:
        return path
    spec = mujoco.MjSpec.from_file(path)
    if ground == "mat":
        for pair in spec.pairs:
            pair.solref, pair.solimp = MAT["solref"], MAT["solimp"]
    else:
        for i in range(27):  # up and down again
            height = 0.5 * RISE * min(i + 1, 27 - i)
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5 * STEP, 3.0, height],
                pos=[0.6 + STEP * i, 0.0, height], condim=3, friction=[1.0, 0.005, 0.0001],
            )  # fmt: skip
    spec.compile()
    made = Path(mkdtemp()) / f"{ground}.xml"
    made.write_text(spec.to_xml())
    return str(made)


class Dance(gym.Wrapper[Any, Any, Any, Any]):
    """The G1 under a whole-body policy that follows a recorded dance; :meth:`act` returns its actions."""

    def __init__(self, env: gym.Env[Any, Any], policy: str) -> None:
        super().__init__(env)
        onnxruntime: Any = import_module("onnxruntime")  # of that folder

        root = Path(os.environ["SUREFOOT_STRANGERS"]) / "holosoma_inference"
        text = (root / "config/config_values/robot.py").read_text()
        scales = re.search(r"G1_29DOF_PER_JOINT_ACTION_SCALE = \(([^)]*)\)", text)
        assert scales is not None
        self._scale = np.array([float(part) for part in scales[1].split(",") if part.strip()])
        path = root / f"models/wbt/{policy}.onnx"
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        walker: Any = env.unwrapped
        self._walker = walker
        self._net = onnxruntime.InferenceSession(str(path), options)
        notes = self._net.get_modelmeta().custom_metadata_map
        for gain in ("kp", "kd"):
            setattr(walker.policy, gain, np.array([float(k) for k in notes[gain].strip("[]").split(",")]))
        self._home: Floats = import_module("g1_policy").HOME

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Put the robot into the first posture of the dance."""
        seen, info = self.env.reset(**options)
        self._time, self._last = 0, np.zeros(29)
        self._aim()
        model, data = self._walker.model, self._walker.data
        q = np.r_[0.0, 0.0, 0.8, 1.0, 0.0, 0.0, 0.0, self._home]
        q[self._walker.at] = self._command[:29]
        self._walker.set_state(q, np.zeros(model.nv))
        self._first = _heading(self._torso()), _heading(self._target)
        upright = _about_z(-self._first[1]) @ self._target @ self._torso().T
        mujoco.mju_mat2Quat(q[3:7], upright.ravel())
        self._walker.set_state(q, np.zeros(model.nv))
        self._first = _heading(self._torso()), self._first[1]
        floor = model.geom("floor").id
        parts = set(model.pair_geom1.tolist() + model.pair_geom2.tolist()) - {floor}
        q[2] -= min(data.geom_xpos[part][2] - model.geom_size[part][0] for part in parts)
        self._walker.set_state(q, np.zeros(model.nv))
        return seen, info

    def _aim(self) -> None:
        feed = {"obs": np.zeros((1, 154), np.float32), "time_step": np.array([[self._time]], np.float32)}
        place, speed, (quat,) = self._net.run(["joint_pos", "joint_vel", "ref_quat_xyzw"], feed)
        self._command = np.r_[place[0], speed[0]].astype(float)
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, quat[[3, 0, 1, 2]].astype(float))
        self._target = R.reshape(3, 3)

    def _torso(self) -> Floats:
        found: Floats = self._walker.data.body("torso_link").xmat.reshape(3, 3).copy()
        return found

    def act(self) -> Floats:
        """Return the policy's action, in units of the walker's own."""
        q, speed, spin, _ = self._walker.state()
        R, M = (
            _about_z(-first) @ one
            for first, one in zip(self._first, (self._torso(), self._target), strict=True)
        )
        seen = np.concatenate(
            [self._last, spin, q - self._home, speed, self._command, (R.T @ M)[:, :2].ravel()]
        )
        feed = {"obs": seen.astype(np.float32)[None], "time_step": np.array([[self._time]], np.float32)}
        self._last = np.clip(self._net.run(["actions"], feed)[0][0], -100.0, 100.0).astype(float)
        self._time += 1
        self._aim()
        targets: Floats = self._last * self._scale / 0.25
        return targets


def _heading(R: Floats) -> float:
    return float(np.arctan2(R[1, 0], R[0, 0]))


def _about_z(angle: float) -> Floats:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
