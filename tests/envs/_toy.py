"""A toy on two feet, as an environment of a user's."""

import re
from contextlib import nullcontext

import gymnasium as gym
import mujoco
import numpy as np
import pytest

LEGS = "".join(
    f'<body name="foot_{side}" pos="0 {y} -0.5"><joint name="{side}" axis="0 1 0" pos="0 0 0.1" '
    'stiffness="300" damping="20" armature="0.02"/>'
    '<geom type="box" size="0.1 0.04 0.02" pos="0.03 0 0"/></body>'
    for side, y in (("l", 0.1), ("r", -0.1))
)
TOY = (
    '<mujoco><worldbody><geom type="plane" size="5 5 1"/><body name="trunk" pos="0 0 0.52"><freejoint/>'
    '<geom size="0.1" mass="5"/>{site}{legs}</body></worldbody>{end}</mujoco>'
)


class Toy(gym.Env):
    """Two rigid legs, which keep whatever a test wants kept."""

    observation_space = gym.spaces.Box(-np.inf, np.inf, (9,))
    action_space = gym.spaces.Box(-1.0, 1.0, (1,))
    frame_skip = 5

    def __init__(self, site="", end="", fullpath=None):
        self.xml = TOY.format(site=site, legs=LEGS, end=end)
        if fullpath is not None:
            self.fullpath = fullpath
            self.fullpath.write_text(self.xml)
        self.make()

    def make(self):
        self.model = mujoco.MjModel.from_xml_string(self.xml)
        self.data = mujoco.MjData(self.model)

    def reset(self, *, seed=None, options=None):
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        return self.data.qpos.copy(), {}

    def step(self, action):
        mujoco.mj_step(self.model, self.data, self.frame_skip)
        return self.data.qpos.copy(), 0.0, False, False, {}


def warned(reason):
    """Expect the warning that feet are read once a step, with its reason, or none."""
    match = (
        rf"read once a control step, at its end, and not in each of its \d+ substeps \({re.escape(reason)}"
    )
    return pytest.warns(UserWarning, match=match) if reason else nullcontext()
