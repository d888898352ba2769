"""Two lines around any biped: its episodes stay its own, bit for bit, and its feet are felt."""

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import SyncVectorEnv

from surefoot.envs import InstrumentedEnv
from surefoot.robot.beliefs.errors import NO_ERRORS
from surefoot.sensors import preset, sized
from surefoot.sensors.presets import PERFECT_FORCE_TORQUE
from surefoot.wrappers import (
    FootSensors,
    SelfCalibration,
    TruthRow,
    VectorFootSensors,
    VectorSelfCalibration,
)

ANKLES = "icub-force-torque"
NAO = {"speed": 0.04, "duration": 12.0}
BLIND = {"include_cfrc_ext_in_observation": False}
OPTIONS = {"surefoot/NaoWalk-v0": NAO, "Humanoid-v5": BLIND}


class AsItWas(gym.ObservationWrapper):
    """Shows what the environment itself showed, after it went through sensors."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.observation_space = env.observation_space["state"]

    def observation(self, observation: dict[str, Any]) -> Any:
        return observation["state"]


def humanoid() -> gym.Env[Any, Any]:
    return gym.make("Humanoid-v5", **BLIND)


def bare(name: str) -> gym.Env[Any, Any]:
    env = gym.make(name, **OPTIONS.get(name, {}))
    return AsItWas(env) if name.startswith("surefoot/") else env


@pytest.mark.parametrize("count", [120, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("Humanoid-v5", PERFECT_FORCE_TORQUE),
        ("Walker2d-v5", PERFECT_FORCE_TORQUE),
        ("surefoot/NaoWalk-v0", "perfect"),
        pytest.param("surefoot/NaoStand-v0", "perfect", marks=pytest.mark.slow),
    ],
)
def test_a_null_sensor_changes_nothing(name: str, config: Any, count: int) -> None:
    env = gym.make(name, **OPTIONS.get(name, {}))
    sensed = AsItWas(FootSensors(env, config, measure_state=False))
    comparison = "skip" if name.startswith("surefoot/") else "superset"
    check_environments_match(bare(name), sensed, num_steps=count, seed=3, info_comparison=comparison)


def test_null_cells_read_the_truth_that_info_has() -> None:
    """Means over the control step, in which motors' commands make steps."""
    env = FootSensors(gym.make("surefoot/NaoWalk-v0", **NAO), "perfect")
    env.reset(seed=1)
    for _ in range(40):
        seen, _, _, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
        true = info["surefoot"]["truth"]["force_cell"].ravel()
        np.testing.assert_allclose(seen["foot_raw"], true, atol=1e-4)


def test_a_null_sensor_reads_the_truth_about_the_ankles() -> None:
    env = FootSensors(humanoid(), PERFECT_FORCE_TORQUE)
    observation, _ = env.reset(seed=0)
    for _ in range(20):
        truth = env.source.truth.wrench_ankle.mean(axis=0).ravel()
        np.testing.assert_allclose(observation["foot_raw"], truth, rtol=1e-6, atol=1e-5)
        observation, *_ = env.step(env.action_space.sample())


STACKS = {
    "ankles": lambda: FootSensors(humanoid(), ANKLES),
    "planar": lambda: SelfCalibration(FootSensors(gym.make("Walker2d-v5"), ANKLES)),
    "calibrated": lambda: SelfCalibration(FootSensors(humanoid(), ANKLES), show=("cop", "foot_raw")),
    "soles": lambda: SelfCalibration(FootSensors(humanoid(), soles=True)),
}


def steps(env: gym.Env[Any, Any], count: int = 10) -> list[dict[str, Any]]:
    seen = [env.reset(seed=3)[0]]
    rng = np.random.default_rng(0)
    for _ in range(count):
        action = rng.uniform(-0.1, 0.1, env.action_space.shape).astype(np.float32)
        seen.append(env.step(action)[0])
    return seen


def test_vector_environments_are_made_of_specs() -> None:
    env = gym.make_vec("Humanoid-v5", 2, "sync", **BLIND, wrappers=[lambda env: FootSensors(env, ANKLES)])
    observation, _ = env.reset(seed=0)
    assert observation["foot_raw"].shape == (2, 12)
    assert not np.array_equal(*observation["foot_raw"])
    env.close()


def test_listening_shifts_nothing_that_feet_draw() -> None:
    alone = steps(STACKS["ankles"]())
    listened = steps(STACKS["calibrated"]())
    for one, other in zip(alone, listened, strict=True):
        np.testing.assert_array_equal(one["foot_raw"], other["foot_raw"])


def test_feet_without_soles_have_forces_and_one_centre_of_pressure_together() -> None:
    env = SelfCalibration(
        FootSensors(humanoid(), PERFECT_FORCE_TORQUE),
        "none",
        errors=NO_ERRORS,
        show=("vgrf", "cop_valid"),
    )
    env.reset(seed=0)
    loads = []
    for _ in range(30):
        observation, _, _, _, info = env.step(np.zeros(17, dtype=np.float32))
        assert not observation["cop_valid"][1:].any()
        loads.append((observation["vgrf"].sum(), info["surefoot"]["truth"]["vgrf"].sum()))
    told, true = np.array(loads).T
    assert true.max() > 100.0
    # The feet's own inertia is felt as well, which a reference a few samples late cannot take off.
    assert np.corrcoef(told, true)[0, 1] > 0.99
    with pytest.raises(ValueError, match=r"The foot 'left_foot' has no area.*six-axis sensors in the ankles"):
        FootSensors(humanoid())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_episodes_are_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("moviepy", reason="moviepy is not installed")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    drawn = gym.make("surefoot/NaoStand-v0", render_mode="rgb_array")
    env = gym.wrappers.RecordVideo(FootSensors(drawn), str(tmp_path), disable_logger=True)
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.zeros(env.action_space.shape or ()))
    env.close()
    (film,) = tmp_path.glob("*.mp4")
    assert film.stat().st_size > 1000


def test_cells_are_of_the_robots_size() -> None:
    nao, large = (
        FootSensors(gym.make("surefoot/NaoStand-v0")),
        FootSensors(humanoid(), soles=True),
    )
    usual = preset("hx711-load-cells")
    assert nao.instruments.parts[0].config == usual
    (cells,) = (part.config for part in large.instruments.parts)
    weight = 9.81 * large.unwrapped.model.body_subtreemass[1]
    assert cells == sized(usual, large.source.drawing.weight)
    assert 4.0 * cells.capacity > 1.5 * weight
    hopper = FootSensors(gym.make("Hopper-v5"), feet=("foot",), soles=True)
    assert hopper.instruments.channels == 4


@pytest.mark.parametrize(
    ("config", "match"),
    [
        ("hx711-load-cells", r"Four load cells of 98.1 N are rated for 392 N .* robot of 413 N bears 620 N"),
        ("ati-mini45", r"Six-axis sensors are rated for 580 N .* give a larger ForceTorque.full_scale_force"),
    ],
)
def test_sensors_that_are_too_small_are_told_of(config: str, match: str) -> None:
    with pytest.warns(UserWarning, match=match):
        FootSensors(humanoid(), config, soles=True)


def test_many_robots_get_cells_of_their_size() -> None:
    envs = gym.make_vec(
        "Humanoid-v5", 2, "sync", **BLIND, wrappers=[lambda env: TruthRow(InstrumentedEnv(env, soles=True))]
    )
    sensed = VectorFootSensors(envs)
    cells = sensed.sensors.equipment.instruments.parts[0].config
    assert cells == sized(preset("hx711-load-cells"), sensed.sensors.drawing.weight)
    with pytest.warns(UserWarning, match=r"98.1 N are rated for 392 N a foot"):
        VectorFootSensors(envs, "hx711-load-cells")
    envs.close()


MODEL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 1"/>
    <body name="trunk" pos="0 0 0.5">
      <freejoint/>
      <geom type="box" size="0.08 0.1 0.1" pos="0 0 0.1" mass="4"/>
      {legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""
LEG = """
<body name="{side}_leg" pos="0 {y} 0">
  <joint name="{side}_hip" axis="0 1 0" damping="2" armature="0.05"/>
  <geom type="capsule" fromto="0 0 -0.05 0 0 -0.35" size="0.03" mass="0.8" contype="0" conaffinity="0"/>
  <body name="{side}_foot" pos="0 0 -0.45">
    <joint name="{side}_ankle" axis="0 1 0" pos="0 0 0.05" damping="2" armature="0.05"/>
    <geom type="box" size="0.1 0.05 0.02" pos="0.02 0 -0.025" mass="0.4"/>
  </body>
</body>
"""


class Stilts(MujocoEnv):
    """A home-made biped, as a user would write it."""

    metadata = {  # noqa: RUF012
        "render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"],
        "render_fps": 50,
    }

    def __init__(self, path: str) -> None:
        space = gym.spaces.Box(-np.inf, np.inf, (10,), np.float64)
        super().__init__(path, 10, space)

    def step(self, action):
        self.do_simulation(action, self.frame_skip)
        return self.data.qpos[7:].repeat(3)[:10].copy(), 0.0, False, False, {}

    def reset_model(self):
        self.set_state(self.init_qpos, self.init_qvel)
        return self.data.qpos[7:].repeat(3)[:10].copy()


@pytest.fixture
def stilts(tmp_path):
    names = [f"{side}_{joint}" for side in ("left", "right") for joint in ("hip", "ankle")]
    motors = "".join(f'<position name="{name}" joint="{name}" kp="200" kv="10"/>' for name in names)
    legs = "".join(LEG.format(side=side, y=y) for side, y in (("left", 0.09), ("right", -0.09)))
    path = tmp_path / "stilts.xml"
    path.write_text(MODEL.format(legs=legs, motors=motors))
    return str(path)


def test_a_home_made_biped_needs_two_lines(stilts: str) -> None:
    env = FootSensors(Stilts(stilts), {"initial_scale_std": 0.1, "initial_offset_std": 2.0, "capacity": 60.0})
    env = SelfCalibration(env)
    env.reset(seed=0)
    start = np.abs(np.array(env.estimate.force) - env.env.source.truth.force_cell[-1]).max()
    for step in range(700):
        sway = 0.03 * np.sin(0.15 * step)
        env.step(np.array([-sway, sway, -sway, sway]))
    truth = env.env.source.truth
    assert isinstance(env.env.source, InstrumentedEnv)
    assert abs(env.estimate.vgrf.sum() - truth.vgrf().sum()) < 1.5
    cop = np.array(env.estimate.cop_foot)
    # It never lifts a foot: offsets stay as unsure as they began. Twelve such robots were 3 to 22 mm off.
    np.testing.assert_allclose(cop[:, 0], truth.cop_sole[-1][:, 0], atol=0.025)
    assert start > 2.0


def test_a_robot_that_is_dropped_learns_when_it_stands(stilts: str) -> None:
    class Dropped(Stilts):
        def reset_model(self):
            qpos = self.init_qpos.copy()
            qpos[2] += 0.15
            self.set_state(qpos, self.init_qvel)
            return self.data.qpos[7:].repeat(3)[:10].copy()

    env = SelfCalibration(FootSensors(Dropped(stilts), {"capacity": 60.0}))
    env.reset(seed=0)
    known = []
    for _ in range(200):
        env.step(np.zeros(4))
        known.append(np.isfinite(env.reference.com).all())
    assert not all(known)
    assert all(known[100:])


@pytest.mark.parametrize("vector", [False, True])
@pytest.mark.slow
def test_robots_that_only_fall_hardly_move_their_map(vector: bool) -> None:
    """Until it falls, within a second, a robot stands for some blocks, which show the sum of its forces."""
    env: Any
    if vector:
        copies = [lambda: TruthRow(InstrumentedEnv(humanoid(), soles=True))] * 2
        env = VectorSelfCalibration(VectorFootSensors(SyncVectorEnv(copies)))
    else:
        env = SelfCalibration(FootSensors(humanoid(), soles=True))
    _, info = env.reset(seed=3)
    start, ended = np.array(info["surefoot"]["parameters"]["scale"]), 0
    for _ in range(240):
        _, _, terminated, _, info = env.step(0.0 * env.action_space.sample())
        np.testing.assert_allclose(info["surefoot"]["parameters"]["scale"], start, rtol=0.1)
        ended += int(np.sum(terminated))
        if terminated is True:
            env.reset()
    assert ended > 2


def test_feet_that_do_not_exist_are_refused_with_those_that_do(stilts: str) -> None:
    with pytest.raises(ValueError, match=r"got \['toes'\]; the model's bodies are .*'left_foot'"):
        FootSensors(Stilts(stilts), feet=("toes",))
    instrumented = InstrumentedEnv(Stilts(stilts))
    with pytest.raises(ValueError, match=r"\['feet'\] are about putting sensors into a robot, but"):
        FootSensors(instrumented, feet=("left_foot", "right_foot"))


def test_a_step_that_is_longer_than_dt_is_refused(stilts: str) -> None:
    class Repeat(gym.Wrapper):
        def step(self, action):
            self.env.step(action)
            return self.env.step(action)

    env = FootSensors(Repeat(Stilts(stilts)), "perfect")
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="took 20 physics steps, and 10 were expected"):
        env.step(np.zeros(4))
    with pytest.raises(
        RuntimeError, match=r"took 0.04 s of simulated time, but its dt is 0.02 s; put whatever"
    ):
        env.step(np.zeros(4))
    outside = Repeat(FootSensors(Stilts(stilts), "perfect"))
    outside.reset(seed=0)
    for _ in range(3):
        outside.step(np.zeros(4))


def test_true_forces_beside_the_sensors_are_told_of_once() -> None:
    cure = r"holds 'cfrc_ext', .* Leave it out with gym.make\(..., include_cfrc_ext_in_observation=False\)"
    with pytest.warns(UserWarning, match=cure) as told:
        FootSensors(gym.make("Humanoid-v5"), ANKLES)
    assert len(told) == 1
    assert told[0].filename == __file__
    with pytest.warns(UserWarning, match=cure) as told:
        VectorFootSensors(SyncVectorEnv([lambda: TruthRow(gym.make("Humanoid-v5"))] * 3), ANKLES)
    assert len(told) == 1
    assert told[0].filename == __file__
    # Whoever has left them out by a wrapper knows.
    space = gym.spaces.Box(-np.inf, np.inf, (270,), np.float64)
    cut = gym.wrappers.TransformObservation(gym.make("Humanoid-v5"), lambda seen: seen[:270], space)
    FootSensors(cut, ANKLES)


def test_an_environments_own_arrays_stay_its_own(stilts: str) -> None:
    class Careless(Stilts):
        def step(self, action):
            super().step(action)
            return self.data.qpos[:10], 0.0, False, False, {}

    env = FootSensors(Careless(stilts), "perfect")
    env.reset(seed=0)
    first, second = (env.step(np.zeros(4))[0]["state"] for _ in range(2))
    assert not np.shares_memory(first, second)
    assert not np.shares_memory(second, env.unwrapped.data.qpos)


@pytest.mark.parametrize(
    "mix",
    [
        gym.wrappers.FlattenObservation,
        lambda env: gym.wrappers.FilterObservation(env, ["cop"]),
        lambda env: gym.wrappers.FrameStackObservation(env, 3),
    ],
)
def test_truth_is_not_taken_out_of_a_mixture(mix: Any) -> None:
    with pytest.raises(TypeError, match=r"wrap in this order, .*: FootSensors\(env\)"):
        FootSensors(mix(gym.make("surefoot/NaoStand-v0")))
