"""What a user adds from a module of his own, as the tutorials tell: a sensor, a calibrator, a robot."""

import contextlib
import importlib
import io
import os
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
from _logs import run
from gymnasium.envs.registration import EnvSpec

from surefoot.arrays import take_rows
from surefoot.calibration import (
    GRAVITY,
    METHODS,
    FootCalibrator,
    OnlineMethod,
    nao_shoe_layout,
    online,
    register_method,
)
from surefoot.experiments.evaluate.grid import Plan
from surefoot.experiments.logs.format import Log, write_log
from surefoot.experiments.view.session import check_method
from surefoot.robot.foot_view import check_certainty
from surefoot.sensors import PRESETS, Fault, ForceTorque, Imu, LoadCells, preset, presets, register_preset
from surefoot.wrappers import FootSensors, SelfCalibration, VectorFootSensors, VectorSelfCalibration

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
PRESET = """
from surefoot.sensors import Imu, LoadCells, register_preset

register_preset("heavy-cells", LoadCells(capacity=200.0))
register_preset("quiet-imu", Imu(accelerometer_noise=0.0))
"""

pytestmark = pytest.mark.skipif(not TUTORIALS.is_dir(), reason="the tutorials are not part of the wheel")


def cells_of(page: str) -> list[str]:
    return re.findall(
        r"^```\{code-cell\} python\n(.*?)^```", (TUTORIALS / page).read_text(), re.MULTILINE | re.DOTALL
    )


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A user's module that nobody has imported yet: its path. What it registers is forgotten afterwards."""
    path = tmp_path / "my_feet.py"
    path.write_text(cells_of("6-method.md")[0] + PRESET)
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    yield path
    sys.modules.pop("my_feet", None)
    for table in (online._METHODS, *PRESETS.values()):
        for name in set(table) - online.SHIPPED - presets.SHIPPED:
            del table[name]


def walk(feet, method="none"):
    """Return the observations of a few steps, and the wrapped environment."""
    bare = gym.make("surefoot/NaoWalk-v0", speed=0.04, duration=12.0, disable_env_checker=True)
    env = SelfCalibration(FootSensors(bare, feet), method)
    env.reset(seed=0)
    for _ in range(8):
        observation, *_ = env.step(np.zeros(11))
    return observation["foot_force"], env


def test_a_users_sensor_goes_by_its_name_where_presets_do(own):
    by_name, env = walk("my_feet:heavy-cells")
    np.testing.assert_array_equal(by_name, walk(LoadCells(capacity=200.0))[0])
    assert not np.array_equal(by_name, walk("hx711-load-cells")[0])
    # Imported once, it needs no module; in a new program its specification does.
    np.testing.assert_array_equal(by_name, walk("heavy-cells")[0])
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    again.reset(seed=0)
    assert again.env.instruments.parts[0].config == LoadCells(capacity=200.0)
    pytest.importorskip("mujoco.batch", reason="BatchVectorEnv needs MuJoCo 3.17")
    many = gym.make_vec("surefoot/NaoWalk-v0", 2, "vector_entry_point", duration=12.0)
    many = VectorFootSensors(many, "heavy-cells", imu="quiet-imu")
    assert many.reset(seed=0)[0]["foot_raw"].shape == (2, 8)
    assert preset("my_feet:quiet-imu", Imu).accelerometer_noise == 0.0
    plan = Plan.of(
        "surefoot/NaoWalk-v0", "stabiliser", cells="my_feet:heavy-cells", feeds=("raw",), seeds=(0,)
    )
    key = plan.cases()[0].key
    register_preset("heavy-cells", LoadCells(capacity=300.0), replace=True)
    assert plan.cases()[0].key != key, "what other cells brought would be taken for theirs"


def test_a_sensors_name_must_be_free(own):
    register_preset("mine", LoadCells(capacity=200.0))
    register_preset("mine", LoadCells(capacity=200.0))
    for config in (LoadCells(), ForceTorque()):
        with pytest.raises(ValueError, match="There is a preset 'mine' already; choose another name"):
            register_preset("mine", config)
    for name in ("perfect", "icub-ftsens"):
        with pytest.raises(ValueError, match=f"There is a preset '{name}' already"):
            register_preset(name, LoadCells(capacity=200.0), replace=True)
    with pytest.raises(ValueError, match=r"must not be empty and must hold no ':', got 'a:b'"):
        register_preset("a:b", LoadCells())
    with pytest.raises(TypeError, match=r"A preset must be one of LoadCells, ForceTorque, .* got dict"):
        register_preset("other", {"capacity": 200.0})
    with pytest.raises(ValueError, match=r"There is no LoadCells preset 'mien'; there are .*'mine'"):
        preset("mien")
    with pytest.raises(ValueError, match=r"There is no foot sensor preset 'mien'; there are .*'mine'"):
        FootSensors(gym.make("surefoot/NaoStand-v0"), "mien")
    with pytest.raises(ValueError, match=r"The module of 'gone:mine' cannot be imported .* Python path"):
        preset("gone:mine")


def test_a_users_calibrator_goes_by_its_name_where_methods_do(own, log: Log, tmp_path, undrawn):
    name = "my_feet:slow-tare"
    calibrator = FootCalibrator(nao_shoe_layout(), name, mass=5.3, time_constant=0.5)
    assert METHODS["slow-tare"].build.__module__ == "my_feet"
    force, env = walk("hx711-load-cells", name)
    start, _ = walk("hx711-load-cells", "tare")
    np.testing.assert_array_equal(force, start)  # it stands yet, so that nothing is learnt
    env.calibrator.retract()
    env.save(tmp_path / "learnt.npz")
    env.load(tmp_path / "learnt.npz")
    pytest.importorskip("mujoco.batch", reason="BatchVectorEnv needs MuJoCo 3.17")
    many = gym.make_vec("surefoot/NaoWalk-v0", 2, "vector_entry_point", duration=12.0)
    many = VectorSelfCalibration(VectorFootSensors(many), name)
    many.reset(seed=0)
    assert np.isfinite(many.step(np.zeros((2, 11)))[0]["foot_force"]).all()
    # On a log from the command line: a foot in the air takes its reading away, with the time constant.
    log.reference.swing[:, 0], log.reference.stance[:, 0] = True, False
    path = write_log(log, tmp_path / "walk.parquet")
    run("calibrate", "walk", path, "--method", name)
    found = pd.read_parquet(tmp_path / "walk.slow-tare.parquet")
    for k in range(2, len(log)):
        calibrator.update(log.nominal.force(log.raw[k - 2]), take_rows(log.reference, k))
    assert found["force_left_front_left_N"].iloc[-1] < 0.2 * log.truth.force[-1, 0]
    np.testing.assert_allclose(found["force_right_front_left_N"], log.truth.force[:, 4], atol=1e-6)
    assert calibrator.state.offset[0] < 0.0


def test_a_users_calibrator_takes_part_in_studies(own):
    name = "my_feet:slow-tare"
    plan = Plan.of("surefoot/NaoWalk-v0", "stabiliser", feeds=("true", name), severities=(1.0,), seeds=(0,))
    assert [episode.feed for episode in plan.episodes] == ["true", name]
    key = plan.cases()[-1].key
    own.write_text(own.read_text() + "# changed\n")
    assert plan.cases()[-1].key != key, "results of the old code would be taken for its own"
    assert check_method("slow-tare") == "slow-tare"
    with pytest.raises(ValueError, match=r"Method 'json:tool' does not exist"):
        check_method("json:tool")
    with pytest.raises(ValueError, match=r"There is no feed 'mine'. Available: .*'moment', 'slow-tare'"):
        Plan.of("surefoot/NaoWalk-v0", "stabiliser", feeds=("mine",))


@pytest.mark.slow
def test_workers_import_a_users_module(own, tmp_path):
    """Processes of their own know of no name that was registered here."""
    words = "surefoot/NaoWalk-v0 stabiliser --feed raw --feed my_feet:slow-tare --severity 1 --seeds 1"
    more = ["--duration", "6", "--cells", "my_feet:heavy-cells", "--jobs", "2", "--out", tmp_path / "out"]
    path = os.pathsep.join([str(own.parent), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-m", "surefoot", "evaluate", *words.split(), *map(str, more)]
    subprocess.run(command, check=True, env=os.environ | {"PYTHONPATH": path}, capture_output=True)
    assert list(pd.read_parquet(tmp_path / "out" / "episodes.parquet")["error"]) == ["", ""]


def test_a_calibrators_name_must_be_free(own):
    def build(setup):
        raise AssertionError

    register_method("mine", build)
    register_method("mine", build)
    register_method("mine", lambda setup: None, replace=True)
    with pytest.raises(ValueError, match="There is a method 'mine' already; choose another name"):
        register_method("mine", build)
    with pytest.raises(ValueError, match="There is a method 'tare' already"):
        register_method("tare", build, replace=True)
    with pytest.raises(TypeError, match="'build' must be a function of an OnlineSetup, got str"):
        register_method("other", "mine")
    with pytest.raises(TypeError, match="'config' must be a dataclass of options, or None, got 3"):
        register_method("other", build, 3)
    with pytest.raises(ValueError, match=r"Fault.kind has no default: a method is built by its name"):
        register_method("other", build, Fault)
    with pytest.raises(ValueError, match=r"Method 'mien' does not exist. Available: .*'none', 'mine'"):
        FootCalibrator(nao_shoe_layout(), "mien", mass=5.3)
    with pytest.raises(ValueError, match=r"'mine' reports no covariance, .* \('moment',\) do"):
        check_certainty(["cop_std"], "mine")
    register_method("bare", lambda setup: OnlineMethod(lambda raw: raw, lambda *given: None))
    with pytest.raises(TypeError, match="'bare' has a state ndarray without a FrontState as 'front'"):
        FootCalibrator(nao_shoe_layout(), "bare", mass=5.3).update(np.zeros(8), None)


def test_a_drawing_is_enough_for_a_robot(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    drawing, words, _, task = cells_of("7-robot.md")
    exec(drawing, names)
    with contextlib.redirect_stdout(io.StringIO()) as said:
        exec(words, names)
    assert "feet 'left_foot', 'right_foot' (guessed, left first), torso 'torso'" in said.getvalue()
    assert "sole 180 x 80 mm" in said.getvalue()
    exercise = gym.make("surefoot/Exercise-v0", robot="my_biped.xml", disable_env_checker=True)
    exercise = SelfCalibration(FootSensors(exercise))
    assert exercise.env.source.drawing.weight == pytest.approx(10.2 * GRAVITY)
    assert exercise.reset(seed=0)[0]["foot_force"].shape == (8,)
    exec("import gymnasium as gym, numpy as np, surefoot", names)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Gymnasium has ideas about a Box without bounds
        exec(task, names)
    assert not names["fell"]
    assert np.abs(names["observation"]["cop"]).max() < 0.09
    del gym.registry["Squat-v0"]
