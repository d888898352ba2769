"""A biped of the tests' own: ten lines of MJCF, an environment without any sensors, and policies."""

import os
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv

LEG = """<body name="{side}_leg" pos="0 {y} -.15"><joint name="{side}_hip" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="1"/>
<body name="{side}_foot" pos="0 0 -.4"><joint name="{side}_ankle" axis="0 1 0"/>
<geom type="box" size=".1 .04 .02" pos=".02 0 -.04" mass=".4"/></body></body>"""
XML = f"""<mujoco><option timestep="0.005" integrator="implicitfast"/>
<default><joint armature=".02" damping=".5"/></default>
<worldbody><geom name="floor" type="plane" size="5 5 .1"/><body name="torso" pos="0 0 .611"><freejoint/>
<geom type="box" size=".06 .12 .15" mass="8"/>{LEG.format(side="left", y=0.08)}{
    LEG.format(side="right", y=-0.08)
}
</body></worldbody><actuator>{
    "".join(
        f'<position joint="{s}_{j}" kp="150" kv="5"/>' for s in ("left", "right") for j in ("hip", "ankle")
    )
}</actuator></mujoco>"""
STEPS = 40


class Biped(MujocoEnv):
    """A biped that stands; nothing in it knows of foot sensors."""

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"]}  # noqa: RUF012

    def __init__(self, **options: Any) -> None:
        path = Path(gettempdir()) / f"surefoot_biped_{os.getpid()}.xml"
        path.write_text(XML)
        space = gym.spaces.Box(-np.inf, np.inf, (21,), np.float64)
        super().__init__(str(path), 4, space, **options)

    def _seen(self) -> Any:
        return np.concatenate([self.data.qpos, self.data.qvel])

    def reset_model(self) -> Any:
        self.set_state(self.init_qpos + 0.002 * self.np_random.standard_normal(self.model.nq), self.init_qvel)
        return self._seen()

    def step(self, action: Any) -> Any:
        self.do_simulation(action, self.frame_skip)
        height = float(self.data.qpos[2])
        return self._seen(), 1.0 - float(np.square(action).sum()), height < 0.4, False, {"height": height}


def make(**options: Any) -> Any:
    return gym.wrappers.TimeLimit(Biped(**options), STEPS)


def make_forgetful(**options: Any) -> Any:
    """A biped whose start no seed decides."""

    class Forgetful(gym.Wrapper):
        def reset(self, **given: Any) -> Any:
            return self.env.reset()

    return Forgetful(make(**options))


def swing(state: Any) -> Any:
    """Act on the environment's own observation."""
    return 0.1 * np.sin(state[7:11])


def cop_of(seen: Any) -> Any:
    return seen["cop"]


def lean(cop: Any) -> Any:
    """Act on the centre of pressure."""
    return np.clip(0.03 - cop[0], -0.1, 0.1) * np.array([0.0, 1.0, 0.0, 1.0])


def raises(state: Any) -> Any:
    """Fail in some episodes, after their first steps."""
    if state[19] > 0.0 and abs(state[13]) > 1e-2:
        raise RuntimeError("the gains are <gone>")
    return np.zeros(4)


def dies(state: Any) -> Any:
    """Kill its process, but not at the first observation, which is tried before anything is run."""
    if np.abs(state[11:]).max() > 0.0:
        os._exit(9)
    return np.zeros(4)
