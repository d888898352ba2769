"""Calibrators of many robots on torch tensors, on the example's toy, by kernels on a CPU or a GPU."""

import copy
import pickle

import numpy as np
import pytest
import torch
from _gpu import DEVICE, warp

from surefoot.calibration import (
    FeetLayout,
    FootCalibrator,
    FootLayout,
    MomentumReference,
    Parameters,
    Reference,
    nao_shoe_layout,
)
from surefoot.calibration.weights.curves import Curves
from surefoot.wrappers.gpu.batch import views
from surefoot.wrappers.gpu.foot_sensors import FootSensorsModule
from surefoot.wrappers.gpu.kernels import kernel
from surefoot.wrappers.gpu.self_calibration import SelfCalibrationModule

LAYOUT, MASS, DT, N = nao_shoe_layout(), 5.305, 1 / 80, 4


@pytest.fixture(scope="module")
def toy(load_script):
    return load_script("examples/gpu_stack.py")


@pytest.fixture(autouse=True)
def device():
    with DEVICE:
        yield


KERNELS = "moment", "tare", "none"  # methods that run on a GPU


@pytest.fixture(scope="module")
def log(toy):
    """Readings (T, N, 8), true forces and references of robots in different phases, in newtons."""
    force, _, *motion = toy.march()
    generator = torch.Generator().manual_seed(2)
    gain = 1.0 + 0.1 * torch.randn((N, 8), generator=generator, dtype=torch.float64)
    zero = torch.randn((N, 8), generator=generator, dtype=torch.float64)
    clock = (torch.arange(700)[:, None] + torch.tensor([0, 20, 50, 90])) % toy.CYCLE
    noise = 0.05 * torch.randn((len(clock), N, 8), generator=generator, dtype=torch.float64)
    raw = gain * force[clock] + zero + noise
    return raw.float().to(DEVICE), force[clock].to(DEVICE), [part[clock].to(DEVICE) for part in motion]


def make(method="moment", robots=N, **options):
    options = {"mass": MASS, "dt": DT, "lag": 0, "device": DEVICE} | options
    return SelfCalibrationModule(LAYOUT, method, robots, **options)


def row(log, k):
    return log[0][k], Reference(*(part[k] for part in log[2]))


def momentum_row(log, k):
    """The same of robots that measure velocities, to rounding."""
    counts, reference = row(log, k)
    before = log[2][0][max(k - 1, 0)]
    fields = reference._asdict() | {
        "com_velocity": (reference.com - before) / DT,
        "angular_momentum": torch.zeros_like(reference.com),
    }
    return counts, MomentumReference(*(fields[name] for name in MomentumReference._fields))


def run(module, log, samples, start=0):
    return [module(*row(log, k), step=k) for k in range(start, start + samples)]


def assert_same(one, other, robots=slice(None)):
    for name in one._fields:
        left, right = getattr(one, name), getattr(other, name)
        if left is not None:
            torch.testing.assert_close(
                left[robots],
                right[robots],
                rtol=0.0,
                atol=0.0,
                equal_nan=True,
                msg=lambda text, n=name: n + text,
            )


LAGS = [pytest.param(0, marks=pytest.mark.slow), 2]


@pytest.mark.parametrize("method", KERNELS)
@pytest.mark.parametrize("lag", LAGS)
def test_robots_are_calibrators_side_by_side(method, lag, log):
    compare_with_alone(method, lag, log, row)


@pytest.mark.parametrize("lag", LAGS)
def test_robots_that_measure_velocities_are_calibrators_side_by_side(lag, log):
    compare_with_alone("moment", lag, log, momentum_row)


def test_curves_stand_in_front(log):
    knots = np.array([[-20.0, 4.0, 9.0, 40.0], [-20.0, 0.0, 12.0, 40.0]])
    curves = Curves([None, knots, *[None] * 6])
    module = make("none", lag=0, dtype=torch.float64, curves=curves)
    alone = [FootCalibrator(LAYOUT, "none", mass=MASS, dt=DT, lag=0, curves=curves) for _ in range(N)]
    for k in range(10):
        raw, reference = row(log, k)
        raw[:, 1] *= 1.0 + k  # beyond both ends as well
        found = module(raw.double(), reference).force.cpu().numpy()
        for i, calibrator in enumerate(alone):
            own = type(reference)(*(part[i].cpu().numpy() for part in reference))
            np.testing.assert_allclose(found[i], calibrator.update(raw[i].double().cpu().numpy(), own).force)
    with pytest.raises(ValueError, match=r"'curves' are of 1 channels, and the layout has 8\."):
        make("none", curves=Curves([knots]))


def compare_with_alone(method, lag, log, given):
    """To rounding in double precision, with all that they do at a reset, and closely in single."""
    module, single = make(method, lag=lag, dtype=torch.float64), make(method, lag=lag)
    alone = [FootCalibrator(LAYOUT, method, mass=MASS, dt=DT, lag=lag) for _ in range(N)]
    for k in range(110):
        raw, reference = given(log, k)
        raw = raw.clone()
        raw[2, 5] = torch.nan if k % 9 == 8 else raw[2, 5]
        raw[3, 2] = 0.3 if k > 60 else raw[3, 2]  # one cell dies
        if k == 70:
            module.reset([1])
            single.reset([1])
        ours, theirs = module(raw.double(), reference), single(raw, reference)
        for i, calibrator in enumerate(alone):
            own = type(reference)(*(part[i].cpu().numpy() for part in reference))
            if i == 1 and 70 <= k <= 70 + lag:
                nowhere = np.zeros(2, dtype=bool)
                own = own._replace(com=own.com * np.nan, stance=nowhere, swing=nowhere)
            expected = calibrator.update(raw[i].double().cpu().numpy(), own)
            for name, part in expected._asdict().items():
                if part is None:
                    assert getattr(ours, name) is None
                    continue
                found = getattr(ours, name)[i].cpu().numpy()
                np.testing.assert_allclose(found, part, rtol=1e-9, atol=1e-9, err_msg=f"{name} {k}")
        torch.testing.assert_close(theirs.scale, ours.scale.float(), rtol=0.0, atol=1e-6)
        assert {part.dtype for part in (theirs.force, theirs.cop_foot)} == {torch.float32}
    if method == "moment":
        assert (ours.scale - 1.0).abs().amax() > 0.01
        assert ours.undetermined.amin() < 0.9


def test_robots_learn_and_keep_it_over_a_reset(log):
    module = make()
    estimates = run(module, log, 399)
    force = log[1].float()
    before, after = ((estimates[k].force - force[k]).abs().mean() for k in (0, 398))
    assert after < 0.4 * before
    module.reset(torch.tensor([1, 2]))
    again = module(*row(log, 399), step=399)
    assert torch.equal(again.scale, estimates[-1].scale)
    module.reset(torch.tensor([1, 2]), fresh=True)
    fresh = module(*row(log, 399), step=399)
    assert torch.equal(fresh.scale[[1, 2]], torch.ones(2, 8))
    assert torch.equal(fresh.scale[[0, 3]], again.scale[[0, 3]])


@pytest.mark.parametrize("method", KERNELS)
def test_a_step_is_one_step_however_often_it_is_asked_for(method, log):
    often, once = make(method), make(method)
    for k in range(18):
        several = [often(*row(log, k), step=k) for _ in range(3)]
        expected = once(*row(log, k), step=k)
        for estimate in several:
            assert_same(estimate, expected)
    count = 18
    often.counter = lambda: count
    expected = once(*row(log, 18), step=18)
    assert_same(often(*row(log, 18)), expected)
    assert_same(often(*row(log, 19)), expected)


def test_a_fall_takes_back_what_was_learnt(log):
    module = make()
    run(module, log, 150)
    learnt = module(*row(log, 149), step=149)
    module.retract(torch.tensor([True, False, False, True]))
    after = module(*row(log, 149), step=150)
    assert (after.scale != learnt.scale).any(dim=1).tolist() == [True, False, False, True]


@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("method", KERNELS)
def test_a_partial_reset_leaves_the_others_alone(method, fresh, log):
    module, other = make(method), make(method)
    run(module, log, 47)
    run(other, log, 47)
    estimate = module(*row(log, 46), step=46)
    module.reset(torch.tensor([True, False, False, True]), fresh=fresh)
    # Asked again within the same step, and with another load: news only of those who were put back.
    raw, reference = row(log, 46)
    again = module(raw + 1.0, reference, step=46)
    assert_same(again, estimate, [1, 2])
    moved = again.force[[0, 3]] - estimate.force[[0, 3]]
    assert (moved != 0.0).any(dim=1).all()
    for ours, theirs in zip(run(module, log, 20, 47), run(other, log, 20, 47), strict=True):
        assert torch.equal(ours.force[[1, 2]], theirs.force[[1, 2]])


@pytest.mark.parametrize("method", ["moment", "tare"])
def test_who_is_frozen_learns_nothing(method, log):
    module = make(method)
    before = run(module, log, 120)[-1]
    module.freeze()
    before = run(module, log, 160, 120)[-1]
    for estimate in run(module, log, 24, 280):
        assert torch.equal(estimate.scale, before.scale)
        assert torch.equal(estimate.offset, before.offset)
    module.reset([0])
    assert torch.equal(module(*row(log, 304), step=304).offset, before.offset)
    module.freeze(False)
    after = run(module, log, 300, 305)[-1]
    assert not torch.equal(after.offset, before.offset)


@pytest.mark.parametrize("method", KERNELS)
def test_a_saved_state_goes_on_bit_for_bit(method, log, tmp_path):
    module = make(method)
    run(module, log, 50)
    module.reset([2])
    torch.save(module.state_dict(), tmp_path / "feet.pt")
    other = make(method)
    other.load_state_dict(torch.load(tmp_path / "feet.pt", weights_only=True))
    for ours, theirs in zip(run(module, log, 20, 49), run(other, log, 20, 49), strict=True):
        assert_same(ours, theirs)
    frozen = make(method)
    frozen.freeze()
    other.load_state_dict(frozen.state_dict())
    assert other.frozen


def test_a_saved_state_with_impossible_numbers_is_refused_and_nothing_changes(log):
    module, other = make(), make()
    run(module, log, 50)
    saved = module.state_dict()
    before = other.state_dict()["_extra_state"]["state"]
    views(saved["_extra_state"]["state"], module._layouts[0])["belief_mean"][1, 2, 3] = 1e30
    with pytest.raises(ValueError, match=r"go on with: 'belief_mean' is 1e\+30 at \(1, 2, 3\), outside"):
        other.load_state_dict(saved)
    assert torch.equal(other.state_dict()["_extra_state"]["state"], before)


def test_a_saved_state_of_another_calibrator_is_refused():
    state = make().state_dict()
    for name, other in (
        ("method", make("tare")),
        ("mass", make(mass=6.0)),
        ("lag", make(lag=1)),
        ("num_envs", make(robots=5)),
        ("options", make(com_std=0.01)),
        ("initial", make(initial=Parameters(2.0 * np.ones(8), np.zeros(8)))),
    ):
        with pytest.raises(ValueError, match=f"another SelfCalibrationModule: its {name} is"):
            other.load_state_dict(state)


def test_bad_input_is_refused_with_the_reason(log):
    module = make()
    raw, reference = row(log, 0)
    with pytest.raises(ValueError, match=r"'counts' must have shape \(4, 8\), got \(3, 8\)"):
        module(raw[:3], reference)
    with pytest.raises(ValueError, match=r"'reference.com' must have shape"):
        module(raw, reference._replace(com=reference.com[:3]))
    with pytest.raises(TypeError, match=r"'reference\.com' must be a torch tensor"):
        module(raw, reference._replace(com=reference.com.cpu().numpy()))
    with pytest.raises(ValueError, match=rf"'reference\.com' is on meta, but the module on {DEVICE}"):
        module(raw, reference._replace(com=reference.com.to("meta")))
    with pytest.raises(TypeError, match="'reference' must be a Reference or a MomentumReference, got tuple"):
        module(raw, tuple(reference))
    with pytest.raises(TypeError, match="'reference' must be a Reference, got MomentumReference"):
        make("tare")(*momentum_row(log, 0))
    with pytest.raises(ValueError, match="Method 'windows' does not exist"):
        make("windows")
    with pytest.raises(ValueError, match=r"Method 'window' has no kernel; methods that have one: moment, "):
        make("window")


@pytest.mark.slow
def test_the_example_calibrates(toy):
    before, after = toy.main(robots=8, device=str(DEVICE), seconds=6.0)
    assert before > 8.0
    assert after < 0.4 * before


def test_a_calibrator_starts_where_the_sensors_data_sheet_does(log):
    feet = FootSensorsModule("hx711-load-cells", N, DEVICE, dt=DT, severity=0.0)
    module = make("none", initial=feet.nominal)
    counts = feet(log[1][0])
    torch.testing.assert_close(module(counts, row(log, 0)[1]).force, log[1][0].float(), atol=1e-3, rtol=0.0)


def test_a_calibrator_can_be_copied(log):
    module = make()
    run(module, log, 40)
    copies = copy.deepcopy(module), pickle.loads(pickle.dumps(module))
    for k in range(40, 90):
        estimate = module(*row(log, k))
        for other in copies:
            assert_same(other(*row(log, k)), estimate)


@pytest.mark.slow  # a kernel of its own
def test_ankle_sensors_are_those_of_a_calibrator_alone(log):
    ankles = FeetLayout(
        tuple(
            FootLayout.force_torque(
                name,
                position_sensor_sole=np.array([0.0, 0.0, 0.05]),
                R_sole_sensor=np.eye(3),
                mass_below=0.1,
                com_below_sole=np.zeros(3),
            )
            for name in ("left", "right")
        )
    )
    known = {"mass": MASS, "dt": DT, "lag": 0, "foot_length": 0.16}
    module = SelfCalibrationModule(ankles, "moment", device=DEVICE, dtype=torch.float64, **known)
    alone = FootCalibrator(ankles, "moment", **known)
    for k in range(200):
        force, rng = log[1][k][0].cpu().numpy(), np.random.default_rng(k)
        raw = 0.2 * rng.normal(size=(2, 6))
        raw[:, 2] += 1.1 * force.reshape(2, 4).sum(axis=1)
        reference = Reference(*(part[k, :1] for part in log[2]))
        found = module(torch.as_tensor(raw.reshape(1, 12), device=DEVICE), reference)
        expected = alone.update(raw.ravel(), Reference(*(part[0].cpu().numpy() for part in reference)))
        np.testing.assert_allclose(found.force[0].cpu(), expected.force, rtol=1e-9, atol=1e-9)
    assert np.abs(expected.scale - 1.0).max() > 1e-3


@pytest.mark.slow
def test_four_feet_are_those_of_a_calibrator_alone():
    four = FeetLayout(tuple(FootLayout.point(name) for name in ("fl", "fr", "rl", "rr")))
    known = {"mass": 12.0, "dt": DT, "lag": 0, "foot_length": 0.4}
    module = SelfCalibrationModule(four, device=DEVICE, dtype=torch.float64, **known)
    alone, rng, none = FootCalibrator(four, **known), np.random.default_rng(5), np.zeros(3)
    soles = np.array([(0.2, 0.13, 0.0), (0.2, -0.13, 0.0), (-0.2, 0.13, 0.0), (-0.2, -0.13, 0.0)])
    for k in range(120):
        swing = np.arange(4) == k // 30
        load = 120.0 * ~swing / 3.0 + 1.0 + 0.1 * rng.normal(size=4)
        reference = Reference(
            np.array([0.0, 0.0, 0.3]), none, none, soles, np.tile(np.eye(3), (4, 1, 1)), ~swing, swing,
            np.array([0.0, 0.0, 9.81]), none,
        )  # fmt: skip
        expected = alone.update(load, reference)
        rows = Reference(*(torch.as_tensor(part[None], device=DEVICE) for part in reference))
        found = module(torch.as_tensor(load[None], device=DEVICE), rows)
        np.testing.assert_allclose(found.force[0].cpu(), expected.force, rtol=1e-9, atol=1e-9)
    assert np.abs(expected.offset).max() > 0.1


def test_a_module_is_where_it_was_asked_for_whatever_torchs_default_device_is(log):
    kernel.cache_clear()
    with torch.device("meta"):
        feet = FootSensorsModule("hx711-load-cells", N, DEVICE, dt=DT)
        module = make(initial=feet.nominal)
        module.reset([1])
        found = module(feet(log[1][0]), row(log, 0)[1])
    assert found.force.device == DEVICE
    assert torch.isfinite(found.force).all()


@pytest.mark.skipif(DEVICE.type != "cuda", reason="there is no GPU, or SUREFOOT_DEVICE does not name it")
@pytest.mark.parametrize("method", KERNELS)
def test_a_captured_step_is_a_step(method, log):
    """Sensors and calibrator in one graph, replayed with other loads and beliefs, and with resets between."""
    feet = [FootSensorsModule("hx711-load-cells", N, DEVICE, dt=DT) for _ in "ab"]
    modules = [make(method, initial=feet[0].nominal) for _ in "ab"]
    force, parts = log[1][0].clone(), [part[0].clone() for part in log[2]]
    for one, module in zip(feet, modules, strict=True):
        module(one(force), Reference(*parts))  # compiles
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        captured = modules[0](feet[0](force), Reference(*parts))
    for k in range(1, 120):
        force.copy_(log[1][k])
        for mine, now in zip(parts, log[2], strict=True):
            mine.copy_(now[k])
        if k == 60:
            for module in (*feet, *modules):
                module.reset([1])
        graph.replay()
        assert_same(captured, modules[1](feet[1](force), Reference(*parts)))


@pytest.mark.parametrize("workers", [1, 3])
def test_threads_take_turns_at_robots(workers, log):
    """As on a GPU with more robots than threads run at once, each thread with one place to work in."""
    module, expected = make(), make()
    module._workers, module._work = workers, module._work[:1].expand(workers, -1).clone()
    for ours, theirs in zip(run(module, log, 40), run(expected, log, 40), strict=True):
        assert_same(ours, theirs)


@pytest.mark.slow
@pytest.mark.parametrize("method", KERNELS)
@pytest.mark.filterwarnings("ignore:CUDA Toolkit:UserWarning")  # of optimization level 0
def test_kernels_compile_for_a_gpu(method, tmp_path):
    modules = [make(method, 1)] + [FootSensorsModule("hx711-load-cells", 1)] * (method == "none")
    for module in modules:
        found = warp.compile_aot_module(module._kernel.module, arch=90, module_dir=tmp_path, use_ptx=True)
        assert ".target sm_90" in found[0].read_text(errors="replace")


@pytest.mark.slow
def test_all_headers_compile_for_a_gpu(tmp_path):
    """Those that no module uses too, as docs/native.md says."""
    headers = "moment", "strapdown", "view", "tare", "feet", "telemetry"
    functions = (
        "sf_moment_step", "sf_tare_step", "sf_cells_step", "sf_strain_gauges_step", "sf_beliefs_packet",
        "sf_view_show", "sf_telemetry_advance",
    )  # fmt: skip
    body = "".join(f"((size_t *)found.data)[{i}] = (size_t){name};" for i, name in enumerate(functions))
    made = kernel("sensors", tuple(f"surefoot_{name}" for name in headers), body, (), (), False)
    made.module.options["optimization_level"] = 1  # a compiler warns of 0
    (path,) = warp.compile_aot_module(made.module, arch=90, module_dir=tmp_path, use_ptx=True)
    text = path.read_text(errors="replace")
    assert ".target sm_90" in text
    assert not [name for name in functions if name not in text]
