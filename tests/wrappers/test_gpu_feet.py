"""Foot sensors of many robots on torch tensors, by kernels on Warp's CPU device or a GPU."""

import copy
import pickle
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from _gpu import DEVICE

from surefoot.sensors import Fault, ForceTorque, LoadCells, Wire, parse_fault
from surefoot.sensors.presets import HX711_LOAD_CELLS, ICUB_FORCE_TORQUE
from surefoot.wrappers import FootEquipment, FootSensors
from surefoot.wrappers.gpu.batch import mask_of, views
from surefoot.wrappers.gpu.foot_sensors import FootSensorsModule

N, DT = 5, 0.02
CONFIGS = {
    "load cells": HX711_LOAD_CELLS,
    "warming": replace(HX711_LOAD_CELLS, offset_tempco=0.01, temperature_ramp=0.02),
    "six-axis": ICUB_FORCE_TORQUE,
}


@pytest.fixture(autouse=True)
def device():
    with DEVICE:
        yield


def make(config="hx711-load-cells", robots=N, **options):
    return FootSensorsModule(config, robots, **({"device": DEVICE, "dt": DT} | options))


def forces(feet, seed=0, substeps=None):
    generator = torch.Generator().manual_seed(seed)
    shape = (feet.num_envs, *(() if substeps is None else (substeps,)), feet.channels)
    return 20.0 * torch.rand(shape, generator=generator, device="cpu").to(DEVICE)


@pytest.mark.parametrize("substeps", [None, 1, 4])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_readings_are_counts_of_the_batch(dtype, substeps):
    feet = make(dtype=dtype)
    force = forces(feet, substeps=substeps)
    for _ in range(3):
        counts = feet(force)
        assert counts.shape == (N, 8)
        assert counts.dtype is dtype
        assert (counts == counts.round()).all()
    assert counts.min() > 0
    assert counts.max() < 2**24


ALONE = {
    "usual": {},
    "warming": {"config": CONFIGS["warming"]},
    "bars": {"config": "hx711-bar-cells"},
    "late": {"config": replace(HX711_LOAD_CELLS, settling=4, wire=Wire(delay=0.03, jitter=0.004))},
    "shear": {"config": replace(HX711_LOAD_CELLS, shear_std=0.05)},
    "ankles": {"config": "icub-force-torque"},
    "own severity": {"severity": (0.5, 2.0)},
    "by chance": {"faults": {"dies": 0.1, "within 0.1 s drops 50 %": 0.3}, "severity": (0.0, 1.0)},
    "broken": {"faults": ["from t=0.05 s to t=0.1 s cell left/2 drops 50 %", "at t=0 s cell right/1 spikes"]},
}


@pytest.mark.parametrize("case", ALONE)
def test_a_robot_reads_what_it_reads_alone(case):
    """In FootSensors with a seed of its own: drawn, kept and fresh sensors, number for number."""
    options = {"config": "hx711-load-cells"} | ALONE[case]
    alone = [
        FootSensors(gym.make("surefoot/NaoBalance-v0", disable_env_checker=True), **options) for _ in "ab"
    ]
    for i, env in enumerate(alone):
        env.reset(seed=3 + i)
    dt = alone[0].source.dt
    feet = make(FootEquipment(**options), 2, dtype=torch.float64, seed=3, dt=dt)

    def same():
        loads = [env.robot.equipment.instruments.parts[0].load(env.source.truth) for env in alone]
        read = feet(torch.as_tensor(np.stack(loads)))
        expected = np.stack([env.robot.raw for env in alone])
        np.testing.assert_allclose(read.cpu(), expected, rtol=1e-9, atol=1e-9)

    same()
    for ends, fresh in ((None, False), (0, False), (1, True)):
        for _ in range(6):
            for env in alone:
                env.step(env.action_space.sample() * 0.0)
            same()
        if ends is not None:
            alone[ends].reset(options={"surefoot": {"sensors": "fresh" if fresh else "keep"}})
            for env in alone[:ends] + alone[ends + 1 :]:
                env.step(env.action_space.sample() * 0.0)
            feet.reset(ends, fresh)
            same()


def test_floats_read_what_doubles_read():
    single, double = make(), make(dtype=torch.float64)
    for k in range(20):
        force = forces(single, k)
        off = single.newtons(single(force)).double() - double.newtons(double(force.double()))
        assert off.abs().max() < 1e-3


def test_a_perfect_instrument_reads_the_truth_and_severity_scales():
    perfect, none = make("perfect"), make(severity=0.0)
    force = forces(perfect)
    torch.testing.assert_close(perfect(force), force)
    torch.testing.assert_close(none.newtons(none(force)), force, atol=1e-4, rtol=0.0)
    mild, bad = (make(severity=severity, robots=400) for severity in (0.5, 1.0))
    spread = [float((1.0 / feet.true_parameters().scale.abs()).std()) for feet in (mild, bad)]
    assert spread[1] / spread[0] == pytest.approx(2.0, abs=1e-3)
    assert bad.severity == 1.0


@pytest.mark.parametrize("name", CONFIGS)
def test_the_map_by_the_data_sheet_is_one_map(name):
    feet = make(CONFIGS[name], dtype=torch.float64)
    counts = feet(forces(feet).double())
    nominal = torch.as_tensor(feet.nominal.scale) * counts + torch.as_tensor(feet.nominal.offset)
    torch.testing.assert_close(feet.newtons(counts), nominal, atol=1e-8, rtol=1e-12)


def test_the_true_map_undoes_the_errors():
    config = replace(HX711_LOAD_CELLS, rate=None, input_noise=0.0)
    feet = make(config, dtype=torch.float64)
    force = forces(feet).double()
    counts = feet(force)
    scale, offset = feet.true_parameters()
    torch.testing.assert_close(scale * counts + offset, force, atol=1e-4, rtol=0.0)
    assert (feet.newtons(counts) - force).abs().max() > 0.5
    with pytest.raises(TypeError, match="Only load cells"):
        make("icub-force-torque").true_parameters()


@pytest.mark.parametrize("name", CONFIGS)
def test_a_step_is_one_step_however_often_it_is_asked_for(name):
    often, once = make(CONFIGS[name]), make(CONFIGS[name])
    for step in range(4):
        force = forces(often, step)
        readings = [often(force, step=step) for _ in range(3)]
        expected = once(force, step=step)
        for reading in readings:
            assert torch.equal(reading, expected)
    # Without a step every call is one, and a counter is a step that nobody has to hand over.
    assert not torch.equal(often(force), often(force))
    count = 7
    once.counter = lambda: count
    first = once(force)
    assert torch.equal(once(force), first)
    count = 8
    assert not torch.equal(once(force), first)


def test_readings_are_the_callers_own():
    feet = make()
    force = forces(feet)
    before = force.clone()
    reading = feet(force, step=1)
    kept = reading.clone()
    reading.clip_(0, 1).mul_(0)
    assert torch.equal(feet(force, step=1), kept)
    assert torch.equal(force, before)


@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("name", CONFIGS)
def test_a_partial_reset_leaves_the_others_alone(name, fresh):
    feet = make(CONFIGS[name], faults=[Fault("dropped", 0, probability=0.5, burst=0.1)])
    force = forces(feet)
    for step in range(3):
        feet(force, step)
    before, reading = feet._sensors.clone(), feet(force, 2)
    feet.reset(torch.tensor([1, 3]), fresh=fresh)
    again = feet(2.0 * force, 2)
    others = torch.tensor([0, 2, 4])
    torch.testing.assert_close(again[others], reading[others], rtol=0.0, atol=0.0, equal_nan=True)
    # Those who were put back read the new load within the same step.
    assert (again[[1, 3], 1:] != reading[[1, 3], 1:]).any(dim=1).all()
    assert torch.equal(before[others], feet._sensors[others])


@pytest.mark.parametrize("fresh", [False, True])
def test_sensors_are_kept_or_fresh(fresh):
    feet = make()
    feet(forces(feet))
    before = feet.true_parameters().scale
    feet.reset([2], fresh=fresh)
    changed = (feet.true_parameters().scale != before).any(dim=-1)
    assert changed.tolist() == [False, False, fresh, False, False]


@pytest.mark.parametrize(
    "config",
    [
        HX711_LOAD_CELLS,
        replace(HX711_LOAD_CELLS, settling=4, wire=Wire(delay=0.03, under_way=40)),
    ],
)
def test_no_reading_is_of_the_episode_before(config):
    """Converters of 80 Hz under a loop of 1 kHz hold their last reading, but not across a reset."""
    quiet = replace(config, input_noise=0.0, initial_scale_std=0.0, initial_offset_std=0.0)
    quiet = replace(quiet, scale_drift=0.0, offset_drift=0.0)
    feet = make(quiet, dt=0.001)
    for _ in range(20):
        feet(torch.full((N, 8), 50.0))
    feet.reset([0, 4])
    read = feet.newtons(feet(torch.zeros(N, 8)))
    torch.testing.assert_close(read[[0, 4]], torch.zeros(2, 8), atol=1e-4, rtol=0.0)
    assert read[1:4].max() > 20.0


def test_nobody_reads_nothing_at_first():
    feet = make(robots=50, dt=0.001)
    assert torch.isfinite(feet(torch.zeros(50, 8))).all()
    feet.reset(slice(0, 10), fresh=True)
    assert torch.isfinite(feet(torch.zeros(50, 8))).all()


def test_robots_are_named_as_managers_name_them():
    for ids, expected in (
        (None, [1, 1, 1, 1]),
        (slice(None), [1, 1, 1, 1]),
        (slice(1, 3), [0, 1, 1, 0]),
        (torch.tensor([3, 0]), [1, 0, 0, 1]),
        (torch.tensor([True, False, True, False]), [1, 0, 1, 0]),
        ([2], [0, 0, 1, 0]),
        ([], [0, 0, 0, 0]),
        (torch.tensor([], dtype=torch.long), [0, 0, 0, 0]),
        (np.array([1, 2]), [0, 1, 1, 0]),
    ):
        assert mask_of(ids, 4, DEVICE).int().tolist() == expected
    with pytest.raises(ValueError, match="must name robots from 0 to 3, got 4"):
        mask_of([1, 4], 4, DEVICE)
    with pytest.raises(ValueError, match=r"A mask of robots must have shape \(4,\), got \(3,\)"):
        mask_of(torch.ones(3, dtype=torch.bool), 4, DEVICE)


def test_the_seed_decides():
    force = forces(make())
    one, same, other = (make(seed=seed) for seed in (1, 1, 2))
    assert torch.equal(one(force), same(force))
    assert not torch.equal(one(force), other(force))
    before = torch.random.get_rng_state()
    one(force)
    assert torch.equal(torch.random.get_rng_state(), before)


@pytest.mark.parametrize("name", CONFIGS)
def test_a_saved_state_goes_on_bit_for_bit(name, tmp_path):
    feet = make(CONFIGS[name], faults=[Fault("spiking", 2)], seed=4)
    for step in range(3):
        feet(forces(feet, step), step)
    feet.reset([1])
    torch.save(feet.state_dict(), tmp_path / "feet.pt")
    other = make(CONFIGS[name], faults=[Fault("spiking", 2)], seed=99)
    other.load_state_dict(torch.load(tmp_path / "feet.pt", weights_only=True))
    for step in range(2, 6):
        assert torch.equal(feet(forces(feet, step), step), other(forces(feet, step), step))
        feet.reset([0], fresh=True)
        other.reset([0], fresh=True)


def test_a_saved_state_of_other_sensors_is_refused():
    state = make().state_dict()
    for name, other in (
        ("num_envs", make(robots=6)),
        ("configuration", make(severity=0.5)),
        ("faults", make(faults=[Fault("dead", 0)])),
        ("dtype", make(dtype=torch.float64)),
        ("dt", make(dt=0.01)),
    ):
        with pytest.raises(ValueError, match=f"is of another FootSensorsModule: its {name} is"):
            other.load_state_dict(state)


def test_faults_begin_when_they_should():
    feet = make(faults=[Fault("dead", 3, start=0.1)], severity=0.0)
    force = torch.full((N, 8), 10.0)
    read = torch.stack([feet.newtons(feet(force))[:, 3] for _ in range(8)])
    dead = (read.abs() < 0.1).all(dim=1).tolist()
    assert dead == [False] * 4 + [True] * 4


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_faults_begin_when_they_should_after_hours(dtype):
    late = [Fault("dead", 3, start=7201.0)]
    feet = make(robots=1, dtype=dtype, dt=0.005, faults=late, severity=0.0)
    _, faults = feet._parts(feet._usual[0])
    views(feet._faults, faults.layout)["time"].fill_(7200.0)
    force = torch.full((1, 8), 10.0)
    read = [abs(float(feet.newtons(feet(force))[0, 3])) < 0.1 for _ in range(203)]
    assert read.index(True) == pytest.approx(199, abs=1)


def test_a_mapping_of_either_kind_is_a_configuration():
    assert make({"input_noise": 0.0}).config == LoadCells(input_noise=0.0)
    assert make({"noise_force": 0.0}).config == ForceTorque(noise_force=0.0)


def test_bad_input_is_refused_with_the_reason():
    feet = make()
    with pytest.raises(ValueError, match=r"'force' must have shape \(5, 8\) or \(5, S, 8\), got \(6, 8\)"):
        feet(torch.zeros(6, 8))
    with pytest.raises(ValueError, match="for another number of robots make another module"):
        feet(torch.zeros(5, 7))
    with pytest.raises(ValueError, match=r"\(5, 0, 8\)"):
        feet(torch.zeros(5, 0, 8))
    with pytest.raises(ValueError, match=r"'force' must have shape \(5, 12\), got \(5, 3, 12\)"):
        make("icub-force-torque")(torch.zeros(5, 3, 12))
    with pytest.raises(TypeError, match="must be a torch tensor, got ndarray"):
        feet(np.zeros((5, 8)))
    with pytest.raises(ValueError, match=f"'force' is on meta, but the module on {DEVICE}"):
        feet(torch.zeros((5, 8), device="meta"))
    with pytest.raises(ValueError, match="There is no foot sensor preset 'hx712'"):
        make("hx712")
    with pytest.raises(ValueError, match="channel"):
        make(faults=[Fault("dead", 8)])
    with pytest.raises(ValueError, match="There is no kernel for such sensors"):
        make(replace(HX711_LOAD_CELLS, settling=4, rate=None))
    with pytest.raises(ValueError, match="takes no 'ankles': it reads one kind of instrument"):
        make(FootEquipment(ankles="icub-force-torque"))
    with pytest.raises(ValueError, match="'severity' is given twice"):
        make(FootEquipment(severity=0.5), severity=2.0)
    for options, message in (
        ({"num_envs": 0}, "'num_envs' must be a whole number from 1 on"),
        ({"dt": 0.0}, "'dt' must be a positive time"),
        ({"dtype": torch.int32}, "'dtype' must be torch.float32 or torch.float64"),
    ):
        with pytest.raises(ValueError, match=message):
            FootSensorsModule(**({"config": "perfect", "num_envs": 2} | options))


def test_a_module_stays_where_it_was_made():
    feet = make()
    policy = torch.nn.Sequential(torch.nn.Linear(8, 2), feet)
    policy.to(DEVICE).float()
    with pytest.raises(RuntimeError, match=rf"stays on {DEVICE} with torch\.float32; make another one"):
        policy.double()
    with pytest.raises(RuntimeError, match="device='meta'"):
        policy.to("meta")
    assert "num_envs=5" in repr(feet)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("name", ["hx711-load-cells", "hx711-bar-cells", "nao-fsr", "icub-force-torque"])
def test_a_robot_that_blew_up_reads_again(name, fresh, value):
    feet = make(replace(make(name).config, wire=Wire()))
    for _ in range(6):
        feet(forces(feet))
    blown = forces(feet)
    blown[2] = value
    read = [feet(blown), *(feet(forces(feet, k)) for k in range(12))]
    assert torch.isfinite(torch.stack(read)[:, [0, 1, 3, 4]]).all()
    # An infinite load drives cells without a memory to the rail.
    assert any(torch.isnan(one[2]).any() for one in read) or value > 0.0
    assert torch.isfinite(read[-1][2]).all()
    feet(blown)
    feet.reset([2], fresh=fresh)
    # A reset robot's first reading is of its own load alone.
    assert torch.isfinite(feet(forces(feet))).all()


def test_faults_may_be_words_and_mappings():
    words = make(faults=["at t=0.1 s cell left/2 dies"])
    mapping = make(faults=[{"kind": "dead", "channel": 1, "start": 0.1}])
    given = make(faults=[parse_fault("at t=0.1 s cell left/front-right dies")])
    for k in range(8):
        force = forces(words, k)
        read = words(force)
        assert torch.equal(read, mapping(force))
        assert torch.equal(read, given(force))
    assert (words.newtons(read)[:, 1].abs() < 1e-3).all()
    assert words.state_dict()["_extra_state"]["identity"] == given.state_dict()["_extra_state"]["identity"]
    ankles = make("icub-force-torque", faults=["at t=0 s cell right/fz dies"])
    assert (ankles(torch.full((N, 12), 9.0))[:, 8] == 0.0).all()
    with pytest.raises(ValueError, match="There is no cell 'middle/2'"):
        make(faults=["at t=1 s cell middle/2 dies"])
    with pytest.raises(ValueError, match="Fault has no field"):
        make(faults=[{"kind": "dead", "cell": 1}])


def test_one_robot_may_be_named_by_its_number():
    for number in (2, torch.tensor(2), np.int64(2), -3):
        assert mask_of(number, N, DEVICE).tolist() == [False, False, True, False, False]
    feet, other = make(), make()
    for module, ids in ((feet, 2), (other, [2])):
        module(forces(module))
        module.reset(ids, fresh=True)
    assert torch.equal(feet(forces(feet)), other(forces(other)))
    with pytest.raises(ValueError, match="'env_ids' must name robots from 0 to 4, got 5"):
        feet.reset(5)
    with pytest.raises(TypeError, match="'env_ids' must be whole numbers of robots"):
        feet.reset(1.5)


def test_no_graph_is_kept_and_a_module_can_be_copied():
    feet = make("hx711-bar-cells")
    force = forces(feet).requires_grad_()
    for _ in range(3):
        assert not feet(2.0 * force).requires_grad
    twin, other = copy.deepcopy(feet), pickle.loads(pickle.dumps(feet))
    for k in range(3):
        read = feet(forces(feet, k))
        for copied in (twin, other):
            torch.testing.assert_close(copied(forces(feet, k)), read, rtol=0, atol=0, equal_nan=True)


def test_a_wire_too_short_is_refused_when_the_module_is_made():
    with pytest.raises(ValueError, match=r"readings 0\.002 s apart .* Wire\.under_way = 4; give at least 12"):
        make("hx711-bar-cells", dt=0.002)


def test_severity_and_faults_may_be_set_for_some_robots():
    feet, alike = make(seed=3), make(seed=3)
    force = forces(feet)
    feet.set_severity([(0.5, 2.0), 0.0], [3, 1])
    feet.set_faults(["at t=0 s cell left/2 dies"], 4)
    for module in (feet, alike):
        module.reset([0, 1, 3])
        module.reset(4)
        module(force)
    assert (feet._severity == 1.0).all()  # of sensors that are kept
    counts, others = feet(force), alike(force)
    assert (counts != others).any(dim=1).tolist() == [False] * 4 + [True]
    assert (counts[4] != others[4]).nonzero()[:, 0].tolist() == [1]
    again = make(seed=3)
    again.load_state_dict(feet.state_dict())
    assert torch.equal(again(force), feet(force))
    with pytest.raises(ValueError, match=r"^The saved state has no config, .*: its robots had one condition"):
        again.load_state_dict(alike.state_dict())
    alike(force)
    for module in (feet, alike):
        module.reset([0, 1, 3], fresh=True)
    assert (feet(force) != alike(force)).any(dim=1).tolist() == [False, True, False, True, True]
    nominal = torch.as_tensor(feet.nominal.scale, dtype=torch.float32, device=DEVICE)
    assert torch.allclose(feet.true_parameters().scale[1], nominal)
    with pytest.raises(ValueError, match="one a robot: got 1 for 2 robots"):
        feet.set_severity([1.0], [0, 1])
    with pytest.raises(ValueError, match="must be finite and not negative"):
        feet.set_severity(-1.0)
    with pytest.raises(ValueError, match="9"):
        feet.set_faults((), 9)
