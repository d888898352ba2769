"""Truth and observations by the library against the Python that specifies them: the same bits."""

from copy import deepcopy
from typing import Any

import numpy as np
import pytest
from _native import library_of

from surefoot.envs.exercise.env import ExerciseEnv
from surefoot.envs.instrumentation.means import MeanTruth, mean_truth
from surefoot.envs.instrumentation.robot import RowColumns, RowLayout
from surefoot.envs.instrumentation.truth import CONTACT_FORCE
from surefoot.envs.nao.walk import NaoWalkEnv
from surefoot.envs.observation import STATE, Look
from surefoot.native import ENVS, FOLDER, compiler

ROBOTS, SUBSTEPS, THREADS = 33, 5, 2

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


@pytest.fixture(autouse=True)
def library(tmp_path, monkeypatch):
    """Use the library, compiled if none is installed."""
    monkeypatch.setattr(ENVS, "_found", (library_of(ENVS, tmp_path),))


@pytest.fixture(scope="module", params=["NAO", "Exercise"])
def env(request):
    """One of the two kinds of rows."""
    env = NaoWalkEnv(duration=6.0) if request.param == "NAO" else ExerciseEnv("nao")
    env.reset(seed=0)
    return env


def same(one, other):
    """Compare to the last bit, signs of zeros among them."""
    assert one.keys() == other.keys()
    for name, part in one.items():
        assert part.dtype == other[name].dtype
        assert part.shape == other[name].shape
        assert part.tobytes() == other[name].tobytes(), name


def rows_of(env, rng, blown_up=False):
    """Return rows about the present one, in which robots stand, hang in the air, and perhaps blow up."""
    rows = env.data.sensordata + rng.normal(0.0, 0.1, (ROBOTS, SUBSTEPS, env.model.nsensordata))
    rows[::3] *= 1e-3
    rows[1::5] *= rng.uniform(0.0, 30.0, (len(rows[1::5]), 1, 1))
    if blown_up:
        rows[7, -1], rows[8, 2] = np.nan, 1e200
    return rows


def look_by_python(monkeypatch, env, *arguments) -> Look:
    with monkeypatch.context() as patch:
        patch.setattr(ENVS, "_found", (None,))
        return deepcopy(env.observer).look(*arguments)


@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_the_mean_truth_of_many_is_that_of_each(env):
    rows = rows_of(env, np.random.default_rng(0), blown_up=True)
    means = env.mean_truth
    many = means(rows, THREADS)
    assert 0 < many["cop_valid"].sum() < many["cop_valid"].size
    for i, own in enumerate(rows[:12]):
        python = mean_truth(own, means._layout)
        same(python, means(own))
        if np.isfinite(own).all():  # which number is none is nobody's business
            same(python, {name: np.ascontiguousarray(part[i]) for name, part in many.items()})


@pytest.mark.filterwarnings("ignore:.*encountered:RuntimeWarning")
def test_the_looks_of_many_are_those_of_each(env, monkeypatch):
    rng = np.random.default_rng(1)
    rows, qvel = rows_of(env, rng), rng.normal(0.0, 20.0, (ROBOTS, env.model.nv))
    state, held = env.state, rng.normal(0.0, 0.5, (ROBOTS, 3, 2))
    command = type(state.command)._make(np.array([part] * ROBOTS) for part in state.command)
    for part in (command.com, command.com_velocity, command.cop, command.yaw_sole, command.phase):
        part += rng.normal(0.0, 0.3, part.shape)
    many = env.observer.look(rows, qvel, command, held, THREADS)
    python = look_by_python(monkeypatch, env, rows, qvel, command, held)
    same(python.observation, many.observation)
    same(python._asdict() | {"observation": held}, many._asdict() | {"observation": held})
    for i in range(5):
        own = type(command)._make(part[i] for part in command)
        one = env.observer.look(rows[i], qvel[i], own, np.ascontiguousarray(held[i]))
        same(one.observation, {name: part[i] for name, part in many.observation.items()})
        assert one.seen.tobytes() == many.seen[i].tobytes()
        assert one.cop_held.tobytes() == many.cop_held[i].tobytes()


def test_any_number_of_feet_has_a_mean_truth():
    starts = tuple(range(0, 4 * 27, 27))
    first = np.array(starts)[:, None]
    ankle, ground, sole, axes = (first + at + np.arange(n) for at, n in ((0, 6), (6, 9), (15, 3), (18, 9)))
    nowhere: dict[str, Any] = dict.fromkeys(RowColumns._fields)
    there = {"ankle": ankle, "ground": ground, "position_sole": sole, "axes_sole": axes, "up": -1.0}
    columns = RowColumns(**(nowhere | there | {"com": slice(108, 111)}))
    none = np.zeros(0)
    layout = RowLayout(111, columns, (True, False, True, False), "feet without area", (none, none), none)
    rng = np.random.default_rng(2)
    rows = rng.normal(0.0, 1.0, (SUBSTEPS, 111))
    rows[:, [start + 8 for start in starts]] = -10.0 * CONTACT_FORCE
    rows[:, [start + 26 for start in starts]] = 3.0
    found = MeanTruth(layout)(rows)
    same(mean_truth(rows, layout), found)
    assert found["cop_valid"].tolist() == [True, True, False, True, False]
    assert found["vgrf"].tolist() == [10.0 * CONTACT_FORCE] * 4
    assert "force_cell" not in found


def test_constants_of_the_library_are_those_of_the_python():
    source = "".join(path.read_text() for path in FOLDER.glob("*.h"))
    assert f"#define SF_CONTACT_FORCE {CONTACT_FORCE} " in source
    assert f"#define SF_STATE {STATE} " in source
