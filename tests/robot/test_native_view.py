"""A wrapped robot, and what is shown of it: the library is the Python."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from _native_robots import (
    motion,
    python,
    robot,
    round_feet,
    same_info,
)

from surefoot.calibration import FeetLayout, nao_shoe_layout
from surefoot.calibration.estimate import Estimate
from surefoot.native import CALIBRATION, Library, Record, compiler
from surefoot.robot.beliefs.believed import nothing
from surefoot.robot.beliefs.native import NativeBeliefs
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.robot.foot_view import ALL, CERTAINTY, DETERMINED, EACH, PARTS, FootView
from surefoot.robot.native import NativeSample, view_dtype, view_record
from surefoot.wrappers import FootSensors, SelfCalibration

SHOWN = tuple(part for part in PARTS if part not in DETERMINED)
BARE = tuple(part for part in SHOWN if part not in CERTAINTY)

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")


@pytest.fixture(scope="module")
def model() -> NominalModel:
    return robot("tree 2")


@pytest.mark.parametrize(("method", "show"), [("tare", BARE), ("moment", PARTS)])
def test_a_wrapped_robot_calibrates_alike(make_bare, library, monkeypatch, method, show):
    """With the library and without, whole episodes are the same; a held reference is NaN."""
    said, estimates = [], []
    for found in (library, None):
        rooms = () if found is None else (found,)
        monkeypatch.setattr(CALIBRATION, "rooms", lambda rooms=rooms: rooms)
        monkeypatch.setattr(CALIBRATION, "installed", lambda found=found: found)
        env = SelfCalibration(FootSensors(make_bare()), method, show=show)
        env.reset(seed=4)
        assert isinstance(env.beliefs, NativeBeliefs) == (found is not None)
        action, rows = np.zeros(env.action_space.shape, np.float32), []
        for step in range(121):
            if step == 60:
                env = copy.deepcopy(env)
            if step == 120:
                before, as_it_was = rows[-1], copy.deepcopy(rows[-1])
                env.freeze()
            rows.append(env.step(action))
            assert isinstance(env.robot.backend, NativeSample) == (found is not None)
        np.testing.assert_array_equal(env.reference.com, nothing(2).com)
        np.testing.assert_equal(before, as_it_was, "what was handed out stays as it is")
        said.append(rows)
        estimates.append(copy.deepcopy(env).estimate)
        env.close()
    for name, one, two in zip(Estimate._fields, *estimates, strict=True):
        one, two = np.array(one, np.float64), np.array(two, np.float64)  # of nothing NaN
        np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-6, err_msg=name)
    for one, two in zip(*said, strict=True):
        assert list(one[0]) == list(two[0])
        for name, part in one[0].items():
            assert (part.shape, part.dtype) == (two[0][name].shape, two[0][name].dtype), name
            np.testing.assert_allclose(part, two[0][name], rtol=1e-6, atol=1e-6, err_msg=name)
        same_info(one[4]["surefoot"]["reference"], two[4]["surefoot"]["reference"])
        assert list(one[4]["surefoot"]) == list(two[4]["surefoot"])
    assert said[0][-1][0]["cop_valid"].any()
    assert said[0][-1][0]["cop"] is not said[0][-2][0]["cop"]


@pytest.mark.skipif(len(CALIBRATION.rooms()) < 2, reason="needs both libraries")
def test_a_copy_goes_on_in_the_library_of_its_calibrator(make_bare):
    one = SelfCalibration(FootSensors(make_bare()))
    one.reset(seed=4)
    two = copy.deepcopy(one)
    for _ in range(20):
        seen = [env.step(np.zeros(env.action_space.shape, np.float32))[0] for env in (one, two)]
        np.testing.assert_equal(*seen)
    assert two.beliefs.library is two.calibrator.library is CALIBRATION.rooms()[0]
    assert isinstance(two.robot.backend, NativeSample)


class Estimates:
    """Estimates of a filter that is none, at random: with no load, with too much of it, and with flags."""

    def __init__(self, library: Library, feet: FootView, seed: int) -> None:
        self.rng, K = np.random.default_rng([74, seed]), feet.every["foot_force"].shape[0]
        F = feet.every["vgrf"].shape[0]
        shapes = {
            "force": (K,), "wrench": (F, 6), "vgrf": (F,), "cop": (2,), "cop_foot": (F, 2), "flags": (K,),
            "cop_measured": (2,), "cop_aligned": (2,), "cop_foot_aligned": (F, 2), "force_aligned": (K,),
            "force_std": (K,), "cop_covariance": (2, 2), "cop_valid": (), "cop_foot_valid": (F,),
        }  # fmt: skip
        self.estimate = Record(library.record("estimate", shapes))
        self.config = library.record_of("config", {"channels": K, "feet": F})

    def draw(self) -> Estimate:
        now, rng = self.estimate.now, self.rng
        for name in ("cop", "cop_measured", "cop_aligned", "cop_foot_aligned"):
            now[name] = rng.normal(size=now[name].shape)
        if rng.random() < 0.3:
            now["cop_aligned"] = now["cop_foot_aligned"][0] = np.nan
        for name in ("force", "force_aligned", "wrench", "vgrf"):
            now[name] = 10.0 ** rng.uniform(-1.0, 4.0) * rng.normal(size=now[name].shape)
        now["wrench"][:, 2] = np.abs(now["wrench"][:, 2]) + 1.0
        now["force_std"] = rng.random(now["force_std"].shape)
        now["cop_foot"], now["cop_covariance"] = (
            rng.normal(size=now["cop_foot"].shape),
            rng.normal(size=(2, 2)),
        )
        now["flags"] = rng.integers(0, 2**15, now["flags"].shape)
        now["cop_valid"], now["cop_foot_valid"] = rng.random() < 0.7, rng.random(now["vgrf"].size) < 0.7
        parts = {name: now[name].copy() for name in now.dtype.names}
        empty = dict.fromkeys(("scale", "offset", "covariance"))
        return Estimate(**parts, **empty)


@pytest.mark.parametrize(("feet", "flaw"), [(2, ""), (2, "no area"), (4, "round"), (1, "")])
def test_what_is_shown_is_the_python_s(library, feet, flaw):
    model, rolls = robot("tree 2" if feet == 2 else f"{feet} feet"), flaw == "round"
    native = NativeBeliefs(library, python(model, places=round_feet(feet), rolls=rolls))
    native.update(motion(len(model.joint_names))[:60])
    parts = tuple(part for part in SHOWN if not (flaw and part.startswith("cop_foot")))
    shoe = nao_shoe_layout().feet[0]
    layout = FeetLayout(tuple(replace(shoe, name=f"foot {i}") for i in range(feet)))
    one, two = (FootView(parts, layout, 5.3, flaw, rolls=rolls) for _ in range(2))
    source, config = Estimates(library, one, 1), view_record(library, one)
    shown, soles = Record(view_dtype(library, one)), np.zeros((feet, 4))
    for step in range(300):
        estimate, time = source.draw(), 0.5 + 0.001 * step
        places, (found, held) = native.soles(time), (shown.now, two.held)
        expected, soles[...] = one.show(estimate, places), places
        library.functions.surefoot_view_show(
            source.config.ctypes.data, config.ctypes.data, held.ctypes.data, source.estimate.address,
            soles.ctypes.data, shown.address,
        )  # fmt: skip
        for name, part in expected.items():
            assert (part.shape, part.dtype) == (found[name].shape, found[name].dtype), name
            np.testing.assert_allclose(found[name], part, rtol=2e-7, err_msg=name)
        # The one goes on with what the other holds.
        np.testing.assert_allclose(one.held, two.held, rtol=1e-12, atol=1e-12)
        if step == 150:
            two = copy.deepcopy(two)
    assert np.any(one.held[EACH]) == (not flaw)
    assert np.any(one.held[ALL]), "all feet together have a centre of pressure in any case"
