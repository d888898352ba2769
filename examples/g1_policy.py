"""A Unitree G1 that walks by a published policy, on drifting feet and on calibrated ones.

Robot (29 joints, 33 kg) and policies come with holosoma and holosoma-inference (Apache-2.0, 50 MB):

    pip install --no-deps holosoma==0.0.3 holosoma-inference==0.1.3
    pip install onnxruntime
    python examples/g1_policy.py

``G1Walk`` is how an owner would put it into Gymnasium: it knows nothing of surefoot.
"""

import argparse
import atexit
import json
import shutil
import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib.pyplot as plt
import mujoco
import numpy as np
import onnxruntime
from gymnasium.envs.mujoco import MujocoEnv
from numpy.typing import NDArray

from surefoot.wrappers import FootSensors, SelfCalibration

Floats = NDArray[np.float64]
JOINTS = 29
ARMS = [0.2, 0.2, 0, 0.6, 0, 0, 0, 0.2, -0.2, 0, 0.6, 0, 0, 0]
HOME = np.array([-0.312, 0, 0, 0.669, -0.363, 0] * 2 + [0] * 3 + ARMS)
"""Angles of the posture that the policies were trained about, in rad."""


def folder_of(package: str) -> Path:
    """Folder of an installed package, which is not imported."""
    if (spec := find_spec(package)) is None:
        raise SystemExit(f"'{package}' is not installed; the first lines of {Path(__file__).name} say how.")
    return Path(next(iter(spec.submodule_search_locations or ())))


class Policy:
    """Targets of the joints, less ``HOME`` and over 0.25 rad, from a state and a command: m/s, m/s, rad/s."""

    def __init__(self, name: str) -> None:
        path = folder_of("holosoma_inference") / f"models/loco/g1_29dof/{name}.onnx"
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.net = onnxruntime.InferenceSession(str(path), options)
        notes = self.net.get_modelmeta().custom_metadata_map
        self.kp, self.kd, self.names = (json.loads(notes[key]) for key in ("kp", "kd", "dof_names"))
        self.reset()

    def reset(self) -> None:
        """Begin with both legs at the start of their cycles."""
        self.phase, self.last, self.stands = np.array([0.0, np.pi]), np.zeros(JOINTS), False

    def __call__(self, state: Floats, command: Floats) -> Floats:
        """Action of the policy, shape (29,)."""
        self.phase = np.fmod(self.phase + 2 * np.pi / 50 + np.pi, 2 * np.pi) - np.pi
        if np.abs(command).max() < 0.01:
            self.phase, self.stands = np.full(2, np.pi), True
        elif self.stands:
            self.phase, self.stands = np.array([0.0, np.pi]), False
        q, v, gyroscope, gravity = np.split(state, (JOINTS, 2 * JOINTS, 2 * JOINTS + 3))
        body = [0.25 * gyroscope, command[2:], command[:2], np.cos(self.phase), q - HOME, 0.05 * v, gravity]
        seen = np.concatenate([self.last, *body, np.sin(self.phase)]).astype(np.float32)
        self.last = np.clip(self.net.run(None, {"actor_obs": seen[None]})[0][0], -100, 100).astype(float)
        return self.last.copy()


class G1Walk(MujocoEnv):
    """The robot on a plane, 50 actions a second; it shows joints, speeds, gyroscope and gravity, (64,)."""

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"], "render_fps": 50}  # noqa: RUF012

    def __init__(self, policy: str = "ppo_g1_29dof", **options: Any) -> None:
        self.policy = Policy(policy)
        space = gym.spaces.Box(-np.inf, np.inf, (2 * JOINTS + 6,), np.float64)
        super().__init__(str(write_scene()), 10, space, **options)
        self.action_space = gym.spaces.Box(-100, 100, (JOINTS,), np.float32)
        joints = [self.model.joint(name).id for name in self.policy.names]
        self.at, self.moves = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]
        self.limit = self.model.jnt_actfrcrange[joints, 1]
        self.motors = [int(np.flatnonzero(self.model.actuator_trnid[:, 0] == joint)[0]) for joint in joints]

    def state(self) -> Floats:
        """State that the policy sees."""
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, self.data.qpos[3:7])
        speeds = self.data.qvel[self.moves], self.data.qvel[3:6]
        return np.concatenate([self.data.qpos[self.at], *speeds, -rotation.reshape(3, 3)[2]])

    def reset_model(self) -> Floats:
        """Stand at ``HOME``."""
        self.policy.reset()
        self.set_state(np.r_[0, 0, 0.76, 1, 0, 0, 0, HOME], np.zeros(self.model.nv))
        return self.state()

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Hold the targets for 20 ms; torques follow them 500 times a second."""
        target = HOME + 0.25 * np.asarray(action, float)
        for _ in range(self.frame_skip):
            lag, speed = target - self.data.qpos[self.at], self.data.qvel[self.moves]
            torque = self.policy.kp * lag - self.policy.kd * speed
            self.data.ctrl[self.motors] = np.clip(torque, -self.limit, self.limit)
            mujoco.mj_step(self.model, self.data)
        return self.state(), 1.0, bool(self.data.qpos[2] < 0.4), False, {}


@cache
def write_scene() -> Path:
    """Write the robot on a plane, 2 ms a step, into a folder that Python removes; return its path."""
    robot = folder_of("holosoma") / "data/robots/g1/g1_29dof.xml"
    spec = mujoco.MjSpec.from_file(str(robot))
    spec.meshdir = str(robot.parent / spec.meshdir)
    plane = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [20, 20, 0.1], "friction": [1, 0.005, 0.0001]}
    spec.worldbody.add_geom(
        name="floor", contype=1, conaffinity=1, condim=3, rgba=[0.6, 0.65, 0.7, 1], **plane
    )
    spec.worldbody.add_light(pos=[0, 0, 4])
    spec.option.timestep = 0.002
    spec.add_key(name="home", qpos=np.r_[0, 0, 0.76, 1, 0, 0, 0, HOME])
    spec.compile()
    folder = tempfile.mkdtemp()
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    path = Path(folder) / "g1_on_plane.xml"
    path.write_text(spec.to_xml())
    return path


def walk(sensors: str | None, method: str, seconds: float, seed: int) -> Floats:
    """Stand for 2 s, then walk at 0.4 m/s; errors of each foot's centre of pressure in mm, (N, 2)."""
    robot = G1Walk()
    env = FootSensors(robot, sensors)  # truth -> counts
    env = SelfCalibration(env, method)  # counts -> forces and centres of pressure
    observation, _ = env.reset(seed=seed)
    errors = []
    for k in range(round(50 * seconds)):
        command = np.array([0.4 if k > 100 else 0.0, 0.0, 0.0])
        observation, _, fell, _, info = env.step(robot.policy(observation["state"], command))
        if fell:
            raise SystemExit("the robot fell")
        truth = info["surefoot"]["truth"]
        # 16 N are a twentieth of the weight.
        stands = (truth["vgrf"] > 16.0) & (observation["cop_valid"][1:] > 0)
        error = 1e3 * np.linalg.norm(observation["cop_foot"] - truth["cop_foot"], axis=1)
        errors.append(np.where(stands, error, np.nan))
    return np.array(errors)


def main() -> None:
    """Walk on the same feet by each method; print errors, and draw them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sensors", help="a preset; load cells of the robot's size if none is given")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--figure", type=Path, help="file to draw the errors into")
    given = parser.parse_args()
    figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
    print("error of a foot's centre of pressure in mm, second half of the walk")
    for method, label in {"none": "raw", "tare": "tare", "moment": "moment"}.items():
        errors = walk(given.sensors, method, given.seconds, given.seed)
        late = errors[len(errors) // 2 :]
        half, most = np.nanpercentile(late, (50, 95))
        rms = np.sqrt(np.nanmean(late**2))
        print(f"{label:8s} median {half:4.1f}   95 % are below {most:4.1f}   rms {rms:4.1f}")
        seconds = np.nanmedian(errors[: len(errors) // 50 * 50].reshape(-1, 100), axis=1)
        axes.semilogy(np.arange(len(seconds)) + 0.5, seconds, label=label)
    axes.set(xlabel="time in s", ylabel="median error of a second in mm")
    axes.legend()
    if given.figure:
        figure.savefig(given.figure, transparent=True)


if __name__ == "__main__":
    main()
