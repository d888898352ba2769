"""The headers in C in kernels for GPUs, by Warp: the library's numbers on its CPU device, and PTX of all."""

from pathlib import Path

import numpy as np
import pytest
from _native import library_of

from surefoot.calibration import OnlineSetup, Parameters, Reference, nao_shoe_layout
from surefoot.calibration.native import native_filter
from surefoot.native import CALIBRATION, FOLDER, SENSORS, compiler
from surefoot.sensors import preset
from surefoot.sensors.devices.native_cells import CELLS
from surefoot.sensors.devices.native_device import native_device
from surefoot.sensors.devices.native_force_torque import FORCE_TORQUE, STRAIN_GAUGES
from surefoot.sensors.presets import PRESETS
from surefoot.sensors.randomness import Stream

wp = pytest.importorskip("warp", "1.19", reason="kernels for GPUs need Warp: pip install 'warp-lang>=1.19'")

ROBOTS, SAMPLES, SUBSTEPS, DT, CLOSE = 3, 200, 4, 1 / 80, 1e-9
LAYOUT, MASS = nao_shoe_layout(), 5.3
KINDS = (CELLS, FORCE_TORQUE, STRAIN_GAUGES)
INSTRUMENTS = {"hx711-bar-cells": CELLS, "icub-force-torque": FORCE_TORQUE, "icub-ftsens-leg": STRAIN_GAUGES}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(compiler() is None, reason="there is no C compiler")]

# As calibration.c and sensors.c have them, so that records are laid out alike.
HEADERS = "".join(
    f'#include "{name}.h"\n'
    for name in (
        "device", "surefoot_moment", "surefoot_strapdown", "surefoot_view",
        "surefoot_window", "surefoot_feet", "surefoot_telemetry",
    )
)  # fmt: skip

# One robot a thread: its own record of each array, but for the constants, which all share.
STEP = """
    const void *c = config.data;
    const double *in = (const double *)given.data;
    double *out = (double *)found.data;
    sf_random *own = (sf_random *)stream.data + robot;
    if (what == 0) {
        /* The constants of the method lie behind those of the robot; `rows` is its number. */
        const sf_config *of = (const sf_config *)c;
        const sf_belief *belief = (const sf_belief *)beliefs.data + robot;
        const sf_reference *now = &belief->reference;
        const sf_real *imu[] = {belief->accelerometer, belief->gyroscope}, *raw = in + robot * of->channels;
        sf_estimate *told = (sf_estimate *)found.data + robot;
        if (rows == 0)
            sf_moment_step(of, (const sf_moment_config *)(of + 1),
                             (sf_moment_state *)state.data + robot,
                             (sf_moment_work *)stream.data + robot, raw, now, dt, told);
        else if (rows == 1)
            sf_window_step(of, (const sf_window_config *)(of + 1), (sf_window_state *)state.data + robot,
                           (sf_window_work *)stream.data + robot, raw, now, imu, dt, told);
        else if (rows == 2)
            sf_tare_step(of, (const sf_tare_config *)(of + 1), (sf_tare_state *)state.data + robot, raw, now,
                         dt, told);
        else sf_uncorrected_step(of, (sf_front *)state.data + robot, raw, now, dt, told);
    } else if (what == 1) {
        const int K = ((const sf_cells_config *)c)->channels;
        sf_cells_step((const sf_cells_config *)c, (sf_cells *)state.data + robot, own, in + robot * rows * K,
                      rows, dt, out + robot * K);
    } else if (what == 2) {
        const int K = SF_AXES * ((const sf_force_torque_config *)c)->sensors;
        sf_force_torque_step((const sf_force_torque_config *)c, (sf_force_torque *)state.data + robot, own,
                             in + robot * K, dt, out + robot * K);
    } else if (what == 3) {
        const int K = ((const sf_strain_gauges_config *)c)->channels;
        sf_strain_gauges_step((const sf_strain_gauges_config *)c, (sf_strain_gauges *)state.data + robot, own,
                              in + robot * SF_AXES, dt, out + robot * K);
    } else if (what == 4) {
        sf_telemetry_advance((const sf_telemetry_config *)c, (sf_telemetry *)state.data + robot, in, in, dt,
                             own, out);
    } else {
        const sf_timing *timing = (const sf_timing *)((const sf_model *)c + 1);
        sf_beliefs *s = (sf_beliefs *)state.data + robot;
        double soles[4 * SF_FEET];
        sf_beliefs_packet((const sf_model *)c, timing, s, (sf_whole)in[0], in[1], in + 2, in + 2, in + 2);
        sf_beliefs_sample(timing, s, in[0], nullptr, 0, (sf_belief *)beliefs.data + robot);
        sf_beliefs_soles(timing, s, in[0], soles);
        sf_view_show((const sf_config *)c, (const sf_view *)c, (sf_held *)stream.data + robot,
                     (const sf_estimate *)in + robot, soles, (sf_shown *)found.data + robot);
    }
"""

Bytes = wp.array[wp.uint8]


@wp.func_native(STEP)
def step(
    what: int, rows: int, dt: wp.float64, config: Bytes, state: Bytes, stream: Bytes, given: Bytes,
    beliefs: Bytes, found: Bytes, robot: int,
): ...  # fmt: skip


@wp.kernel
def steps(
    what: int, rows: int, dt: wp.float64, config: Bytes, state: Bytes, stream: Bytes, given: Bytes,
    beliefs: Bytes, found: Bytes,
):  # fmt: skip
    step(what, rows, dt, config, state, stream, given, beliefs, found, wp.tid())


@pytest.fixture(scope="module")
def module(tmp_path_factory):
    wp.config.kernel_cache_dir = str(tmp_path_factory.mktemp("warp"))
    options = wp.ModuleBuildOptions(
        extra_cuda_include_dirs=[str(FOLDER)],
        extra_cpu_include_dirs=[str(FOLDER)],
        extra_cuda_preamble=HEADERS,
        extra_cpu_preamble=HEADERS,
    )
    # A product and a sum are rounded one after the other, as everywhere.
    chosen = {"extra_build_options": options, "enable_backward": False, "fuse_fp": False}
    chosen["optimization_level"] = 1  # no compiler warns of it, whatever other tests have set
    wp.set_module_options(chosen, module=__name__)
    return steps.module


def launch(what, rows, *arrays):
    """Run the kernel for all robots, in the memory of these arrays."""
    given = [np.zeros(1) if one is None else np.atleast_1d(one) for one in arrays]
    shared = [wp.array(one.view(np.uint8).ravel(), wp.uint8, device="cpu", copy=False) for one in given]
    wp.launch(steps, ROBOTS, [what, rows, DT, *shared], device="cpu")


def of_robots(records):
    """Return records side by side; np.stack would leave out the gaps between their fields."""
    return np.concatenate([record.reshape(1).view(np.uint8) for record in records]).view(records[0].dtype)


def same(one, other):
    """Compare records or arrays, number by number."""
    for name in one.dtype.names or [...]:
        np.testing.assert_allclose(one[name], other[name], rtol=CLOSE, atol=CLOSE, err_msg=str(name))


def walking(rng):
    """Readings in N and beliefs of robots that march, each with errors and timing of its own."""
    time = np.arange(SAMPLES)[:, None] * DT + rng.uniform(0.0, 1.0, ROBOTS)
    left = np.clip(0.5 + 0.9 * np.sin(2.0 * np.pi * time / 1.6), 0.0, 1.0)
    share = np.stack([left, 1.0 - left], axis=-1)
    force = np.repeat(share, 4, axis=-1) * MASS * 9.81 / 4.0
    raw = force * (1.0 + 0.1 * rng.normal(size=(ROBOTS, 8))) + rng.normal(size=(ROBOTS, 8))
    raw += 0.05 * rng.normal(size=raw.shape)
    raw[120:, 1, 2] = 0.3  # one cell dies
    raw[rng.random(raw.shape) < 0.002] = np.nan
    still, beside = np.zeros_like(left), 0.05 * (2.0 * left - 1.0)
    soles = np.array([(0.0, 0.05, 0.0), (0.0, -0.05, 0.0)])
    zero = np.stack([still, still, still], axis=-1)
    return raw, Reference(
        com=np.stack([still + 0.02, 0.5 * beside, still + 0.26], axis=-1),
        com_acceleration=np.stack([still, -20.0 * beside, still], axis=-1),
        angular_momentum_rate=zero,
        position_sole=np.broadcast_to(soles, (*left.shape, 2, 3)),
        R_level_sole=np.broadcast_to(np.eye(3), (*left.shape, 2, 3, 3)),
        stance=share > 0.02,
        swing=share == 0.0,
        accelerometer=zero,
        gyroscope=zero,
    )


@pytest.mark.parametrize("method", ["moment", "window", "tare", "none"])
def test_a_calibrator_in_a_kernel_is_that_of_the_library(module, tmp_path, method):
    library = library_of(CALIBRATION, tmp_path)
    setup = OnlineSetup(layout=LAYOUT, mass=MASS, initial=Parameters(np.ones(8), np.zeros(8)))
    native = native_filter(library, method, setup, {})
    expected = of_robots([native.init().now] * ROBOTS)
    state, beliefs = expected.copy(), np.zeros(ROBOTS, native.references[Reference].dtype)
    beliefs["known"] = True
    own, number = native.constants.own, native.constants.number
    constants = [one.reshape(1).view(np.uint8) for one in (native.constants.config, own) if one is not None]
    size = library.places["moment_work" if method == "moment" else "window_work"][""][2]
    work = np.full(ROBOTS * size // 8, np.nan)  # nothing of it is remembered
    estimate, wanted = (np.zeros(ROBOTS, native.estimate.now.dtype) for _ in range(2))
    raw, motion = walking(np.random.default_rng(5))
    for k in range(SAMPLES):
        for name, part in motion._asdict().items():
            beliefs[name] = part[k]
        launch(0, number, np.concatenate(constants), state, work, raw[k], beliefs, estimate)
        for robot in range(ROBOTS):
            records = expected[robot : robot + 1], raw[k, robot], beliefs[robot : robot + 1]
            at, out = native.parts["filter"].address, wanted[robot : robot + 1].ctypes.data
            library.functions.surefoot_step(at, *(part.ctypes.data for part in records), DT, out)
        same(estimate, wanted)
    same(state, expected)
    if method == "moment":
        assert estimate["flags"][1, 2] != 0
    learnt = np.abs(estimate["scale"] - 1.0) > 0.01, np.abs(estimate["offset"]) > 0.1
    sound = [0, 2]  # what the others learn while a cell is lost may be taken back
    assert np.stack(learnt)[:, sound].any(axis=(0, 2)).all() == (method != "none")


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_a_device_in_a_kernel_is_that_of_the_library(module, tmp_path, name):
    kind, library, rng = INSTRUMENTS[name], library_of(SENSORS, tmp_path), np.random.default_rng(3)
    config = next(preset(name, family) for family in PRESETS if name in PRESETS[family])
    native = native_device(library, kind, config)
    rows, felt = (SUBSTEPS if kind.blocks else 1), kind.count_loads(config)
    streams = of_robots([Stream.of(9, robot).record for robot in range(ROBOTS)])
    states = [
        native.pack(kind.build(config).init((config.channels,), Stream.of(1, robot)))
        for robot in range(ROBOTS)
    ]
    state, drawn = of_robots([each.now for each in states]), streams.copy()
    counts, wanted = np.zeros((ROBOTS, config.channels)), np.zeros((ROBOTS, config.channels))
    advance = getattr(library.functions, f"surefoot_{kind.name}_step")
    for _ in range(SAMPLES):
        load = rng.normal(10.0, 20.0, (ROBOTS, rows, felt))
        launch(1 + KINDS.index(kind), rows, native.constants, state, drawn, load, None, counts)
        for robot, one in enumerate(states):
            places = (part.ctypes.data for part in (streams[robot : robot + 1], load[robot]))
            advance(native.constants.ctypes.data, one.address, *places, rows, DT, wanted[robot].ctypes.data)
        same(counts, wanted)
    same(state, of_robots([each.now for each in states]))
    assert (drawn == streams).all()
    assert len(np.unique(np.round(counts[:, 0]))) == ROBOTS


def test_all_headers_compile_for_a_gpu(module, tmp_path):
    (path,) = wp.compile_aot_module(module, arch=90, module_dir=str(tmp_path), use_ptx=True)
    text = Path(path).read_text(errors="replace")
    assert ".target sm_90" in text
    for function in (
        "sf_moment_step",
        "sf_window_step",
        "sf_cells_step",
        "sf_beliefs_packet",
        "sf_view_show",
        "sf_wire",
    ):
        assert function in text
