"""The calibrator in the loop: what it is given, what it shows, and what it never sees."""

import re
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from surefoot.calibration import Curves, FootCalibrator, Moment, Parameters
from surefoot.robot.beliefs.contacts import CONTACT_MARGIN, Plan
from surefoot.robot.foot_view import DEFAULT
from surefoot.sensors import ForceTorque, LoadCells, Wire, scaled
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers import FootSensors, SelfCalibration

STILL = np.zeros(11, dtype=np.float32)


class Blindfold(gym.Wrapper):
    """Takes the truth away from whoever stands above."""

    def reset(self, **options: Any) -> Any:
        observation, info = self.env.reset(**options)
        return observation, self._blind(info)

    def step(self, action: Any) -> Any:
        *rest, info = self.env.step(action)
        return (*rest, self._blind(info))

    def _blind(self, info: dict[str, Any]) -> dict[str, Any]:
        del self.unwrapped.truth
        del info["surefoot"]["truth"]
        return info


def walk(env: gym.Env, steps: int, seed: int = 0) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    seen = [env.reset(seed=seed)]
    for _ in range(steps):
        observation, _, _, _, info = env.step(STILL)
        seen.append((observation, info))
    return seen


@pytest.mark.parametrize("method", ["moment", "window"])
def test_truth_is_never_looked_at(method: str, make_bare) -> None:
    seeing = walk(SelfCalibration(FootSensors(make_bare()), method), 80)
    blind = walk(SelfCalibration(Blindfold(FootSensors(make_bare())), method), 80)
    for (one, _), (other, _) in zip(seeing, blind, strict=True):
        for key in one:
            np.testing.assert_array_equal(one[key], other[key], err_msg=key)


def test_the_chance_of_contact_is_shown_by_the_method_that_weighs_it(make_bare) -> None:
    env = SelfCalibration(FootSensors(make_bare()), "moment", show=("contact_probability", "undetermined"))
    for observation, info in walk(env, 60)[1:]:
        assert env.observation_space.contains(observation)
        for name in ("contact_probability", "undetermined"):
            np.testing.assert_array_equal(observation[name], np.float32(info["surefoot"][name]), err_msg=name)
    np.testing.assert_array_equal(info["surefoot"]["undetermined"], env.estimate.undetermined)
    # Both feet stand at first; eight cells of a robot that stands are not known.
    assert observation["contact_probability"].min() > 0.5
    assert observation["undetermined"].mean() > 0.2
    with pytest.raises(
        ValueError,
        match=r"Method 'tare' reports no chance of contact, .*\['undetermined'\] .* \('moment',\)",
    ):
        SelfCalibration(FootSensors(make_bare()), "tare", show=("undetermined",))


def test_what_is_shown_is_the_calibrated_count(make_bare) -> None:
    # Cells that are read at an instant, as older readings are carried on to now.
    cells = FootSensors(make_bare(), {"rate": None})
    env = SelfCalibration(cells, "window", show=(*DEFAULT, "foot_raw", "foot_load"))
    weight = 9.81 * env.robot.model.mass
    for observation, info in walk(env, 150):
        scale, offset = info["surefoot"]["parameters"].values()
        force = scale * observation["foot_raw"] + offset
        np.testing.assert_allclose(observation["foot_force"], force, atol=1e-3)
        np.testing.assert_allclose(weight * observation["foot_load"], force, atol=0.2)
        assert info["surefoot"]["covariance"] is None
        assert info["surefoot"]["flags"].shape == (8,)
        np.testing.assert_allclose(info["surefoot"]["vgrf"].sum(), force.sum(), rtol=0.02, atol=0.2)
        total, left, right = observation["cop_valid"]
        assert total == (info["surefoot"]["vgrf"].sum() > 5.0)
        assert (left, right) == tuple(force.reshape(2, 4).sum(axis=1) > 5.0)


def test_another_calibrator_given_the_same_reports_the_same(make_bare) -> None:
    """All that reaches the calibrator are the counts and the reference: a recorded stream replays."""
    env = SelfCalibration(FootSensors(make_bare()), "window")
    env.reset(seed=1)
    setup = env.calibrator.setup
    known = {"mass": setup.mass, "initial": setup.initial, "dt": setup.dt, "lag": setup.lag, "age": setup.age}
    again = FootCalibrator(env.layout, "window", **known)
    again.update(env.env.raw, env.reference)
    for _ in range(160):
        env.step(STILL)
        estimate = again.update(env.env.raw, env.reference)
        np.testing.assert_array_equal(estimate.force, env.estimate.force)
        np.testing.assert_array_equal(estimate.scale, env.estimate.scale)


def test_the_same_seed_under_every_method_is_the_same_stream(make_bare) -> None:
    streams = []
    for method, initial in (("none", "nominal"), ("window", "nominal"), ("tare", "calibrated")):
        env = SelfCalibration(FootSensors(make_bare()), method, initial=initial, show=("cop", "foot_raw"))
        streams.append([(o["foot_raw"], i["surefoot"]["reference"]["com"]) for o, i in walk(env, 40)])
    for other in streams[1:]:
        for (raw, com), (same_raw, same_com) in zip(streams[0], other, strict=True):
            np.testing.assert_array_equal(raw, same_raw)
            np.testing.assert_array_equal(com, same_com)


def test_calibration_starts_from_the_map_that_was_asked_for(make_bare) -> None:
    nominal = Parameters(HX711_LOAD_CELLS.nominal_scale, HX711_LOAD_CELLS.nominal_offset)
    other = Parameters(1.1 * nominal.scale, 1.1 * nominal.offset + 0.3)
    found = {}
    for name, initial in {"nominal": "nominal", "calibrated": "calibrated", "given": other}.items():
        env = SelfCalibration(FootSensors(make_bare()), "none", initial=initial)
        _, info = env.reset(seed=2)
        found[name] = Parameters(**info["surefoot"]["parameters"])
        true = Parameters(*env.env.true_parameters())
    for name, expected in (("nominal", nominal), ("given", other)):
        np.testing.assert_allclose(found[name].scale, expected.scale)
        np.testing.assert_allclose(found[name].offset, expected.offset)
    left = found["calibrated"].relative_to(true)
    assert 0.0 < np.abs(left.scale - 1.0).max() < 0.006
    assert 0.0 < np.abs(left.offset).max() < 0.1
    assert np.abs(nominal.relative_to(true).scale - 1.0).max() > 0.05


def test_curves_of_weights_are_in_front_of_the_map(make_bare) -> None:
    """As the file of `surefoot calibrate weights` has them; the library knows of none."""
    nominal = Parameters(HX711_LOAD_CELLS.nominal_scale, HX711_LOAD_CELLS.nominal_offset)
    knots = HX711_LOAD_CELLS.zero_code + 8e6 * np.array(
        [[-1.0, -0.02, 0.0, 0.02, 1.0], [-1.0, -0.04, 0.0, 0.01, 1.0]]
    )
    curves = Curves([None] * 5 + [knots] + [None] * 2)
    initial = {**nominal._asdict(), "curves": curves.as_plain()}
    env = SelfCalibration(FootSensors(make_bare()), "none", initial=initial)
    env.reset(seed=2)
    for _ in range(5):
        env.step(STILL)
    expected = nominal.force(curves.straighten(env.env.raw))
    np.testing.assert_allclose(env.estimate.force, expected)
    assert np.abs(expected - nominal.force(env.env.raw))[5] > 0.1


def test_a_calibrated_start_is_as_good_as_its_errors(make_bare) -> None:
    env = SelfCalibration(
        FootSensors(make_bare()), "none", initial="calibrated", errors={"scale": 0.01, "offset": 0.2}
    )
    left = []
    for seed in range(40):
        env.reset(seed=seed)
        found, true = env.calibrator.setup.initial, Parameters(*env.env.true_parameters())
        left.append(np.concatenate(found.relative_to(true)))
    scale, offset = np.split(np.array(left), 2, axis=1)
    assert (scale - 1.0).std() == pytest.approx(0.01, rel=0.15)
    assert offset.std() == pytest.approx(0.2, rel=0.15)


def test_a_foot_in_the_air_keeps_its_last_centre_of_pressure(make_bare) -> None:
    perfect = FootSensors(make_bare(), "perfect")
    held, lifted = None, 0
    for observation, _ in walk(SelfCalibration(perfect, "none"), 400):
        if not observation["cop_valid"][1]:
            if held is not None:
                np.testing.assert_array_equal(observation["cop_foot"][0], held)
                lifted += 1
        else:
            held = observation["cop_foot"][0].copy()
    assert lifted > 20


def test_calibration_starts_fresh_at_a_reset_with_a_seed(make_bare) -> None:
    env = SelfCalibration(FootSensors(make_bare()), "window")
    first = walk(env, 100, seed=5)
    second = walk(env, 100, seed=5)
    for (one, _), (other, _) in zip(first, second, strict=True):
        for key in one:
            np.testing.assert_array_equal(one[key], other[key], err_msg=key)


@pytest.mark.parametrize("lag", [0, 2, CONTACT_MARGIN, 7])
def test_a_plan_is_sure_only_well_inside_a_phase(lag: int) -> None:
    plan = Plan(lag)
    planned = np.zeros((60, 2), dtype=bool)
    planned[20:45, 0] = True
    planned[:, 1] = True
    sure = [plan.at(row, ~row) for row in planned]
    ahead = min(CONTACT_MARGIN, lag)
    for now in range(60):
        then = now - lag
        before, after = then - CONTACT_MARGIN, then + ahead
        stance, swing = sure[now]
        assert stance[0] == (before >= 20 and after < 45)
        assert swing[0] == (before >= 0 and (after < 20 or before >= 45))
        assert stance[1] == (before >= 0)
        assert not swing[1]


@pytest.mark.parametrize(
    ("initial", "text"),
    [
        (
            None,
            "'initial' must be 'nominal', 'calibrated' or Parameters (scale, offset), also as a mapping, "
            "got None.",
        ),
        (
            {"scale": [1.0] * 8},
            "'initial' as a mapping must have exactly the keys ['scale', 'offset'], got ['scale'].",
        ),
        (
            {"scale": [1.0] * 8, "offset": [float("nan")] * 8},
            "'initial.offset' must hold one finite number for each of the 8 channels, "
            "got [nan, nan, nan, nan, nan, nan, nan, nan].",
        ),
        ({"scale": [0.0] * 8, "offset": [0.0] * 8}, "'initial.scale' must not be zero"),
    ],
)
def test_a_start_that_is_none_is_refused_at_construction(initial: Any, text: str, make_bare) -> None:
    with pytest.raises(ValueError, match=re.escape(text)):
        SelfCalibration(FootSensors(make_bare()), initial=initial)


def test_a_flat_observation_or_a_second_calibration_is_refused(make_bare) -> None:
    sensed = FootSensors(make_bare())
    with pytest.raises(
        TypeError, match=r"found Box; wrap in this order.*: SelfCalibration\(FootSensors\(env"
    ):
        SelfCalibration(gym.wrappers.FlattenObservation(sensed))
    with pytest.raises(TypeError, match="found another SelfCalibration below it; one is enough, wrap once"):
        SelfCalibration(SelfCalibration(sensed))


@pytest.mark.parametrize("link", [{"delay": 0.12}, {"delay": 0.3}, {"delay": 0.1, "jitter": 0.03}])
def test_a_late_link_has_brought_packets_when_an_episode_begins(link: dict[str, float], make_bare) -> None:
    env = SelfCalibration(FootSensors(make_bare(), link=link), "none")
    for observation, info in walk(env, 60):
        assert np.isfinite(observation["state"]).all()
        assert info["surefoot"]["reference"]["known"]


def test_a_reference_is_of_the_moment_at_which_late_ankle_sensors_were_read(make_bare) -> None:
    sensors = FootSensors(make_bare(), ForceTorque(wire=Wire(delay=0.03), averaged=False))
    env = SelfCalibration(sensors)
    env.reset(seed=0)
    env.step(STILL)
    np.testing.assert_array_equal(env.calibrator.setup.age, np.full(12, 0.03 - 0.5 * sensors.telemetry.dt))
    late = env.robot.late * sensors.telemetry.dt
    assert env.robot.reference_time == pytest.approx(sensors.time - late - 0.03)


def test_links_and_lags_that_nothing_is_kept_for_are_refused(make_bare) -> None:
    text = "Link.delay must be at most 0.3 s, which is as late as telemetry is of use here, got 0.31."
    with pytest.raises(ValueError, match=re.escape(text)):
        FootSensors(make_bare(), link={"delay": 0.31})
    env = SelfCalibration(FootSensors(make_bare()), lag=80)
    with pytest.raises(
        ValueError, match=r"A lag of 80 samples over Link\(.*\) needs \d+ packets, and at most 64"
    ):
        env.reset(seed=0)


@pytest.mark.parametrize("stream", [-1, 1.5, True])
def test_a_stream_is_a_whole_number(stream: Any, make_bare) -> None:
    text = f"'stream' must be a whole number from 0 on, got {stream}."
    with pytest.raises(ValueError, match=f"FootSensors: {re.escape(text)}"):
        FootSensors(make_bare(), stream=stream)
    with pytest.raises(ValueError, match=f"SelfCalibration: {re.escape(text)}"):
        SelfCalibration(FootSensors(make_bare()), stream=stream)


def test_options_may_be_a_value_that_a_spec_has_as_well(make_bare) -> None:
    env = SelfCalibration(FootSensors(make_bare()), Moment(scale_std=0.2))
    env.reset(seed=0)
    assert env.calibrator.method == "moment"
    assert env.calibrator._options["scale_std"] == 0.2
    kept = env.spec.additional_wrappers[-1].kwargs
    assert (kept["method"], kept["scale_std"]) == ("moment", 0.2)


def test_cells_that_report_when_they_converted_are_aligned():
    """Chips on clocks of their own read a moving robot at different moments, which they report."""
    steps, cells = 240, scaled(LoadCells(stamped=True), 0.0)
    env = SelfCalibration(FootSensors(gym.make("surefoot/NaoWalk-v0"), cells), "none")
    env.reset(seed=2)
    truth, read, aligned = [], [], []
    for _ in range(steps):
        *_, info = env.step(np.zeros(env.action_space.shape))
        truth.append(info["surefoot"]["truth"]["force_cell"])
        read.append(env.robot.estimate.force)
        aligned.append(env.robot.estimate.force_aligned)
    assert env.robot.calibrator.aligned_lag == 1
    off_read = np.array(read)[80:] - np.array(truth)[80:]
    off_aligned = np.array(aligned)[80:] - np.array(truth)[79:-1]
    assert np.sqrt((off_aligned**2).mean()) < 0.35 * np.sqrt((off_read**2).mean())


@pytest.mark.parametrize(
    ("cells", "named"),
    [({"rate": None}, "without a clock"), ({"wire": Wire(delay=0.01)}, "errors of the wire")],
)
def test_ages_of_readings_need_a_clock_and_a_clean_wire(cells, named):
    with pytest.raises(ValueError, match=named):
        LoadCells(stamped=True, **cells)
