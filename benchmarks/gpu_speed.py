"""Time the kernels of foot sensors and of their calibration for many robots, on the CPU or a GPU.

    python benchmarks/gpu_speed.py                         # 4,096 robots x 8 cells, one thread
    python benchmarks/gpu_speed.py --device cuda

A step is one of the control loop; the default calibrator learns at every eighth, so that its mean is more
than its median. On a GPU the same steps are replayed as a captured graph as well. No test asserts these
figures.
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from surefoot.calibration import GRAVITY, METHODS, Reference, nao_shoe_layout
from surefoot.sensors import Fault
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.wrappers.gpu.foot_sensors import FootSensorsModule
from surefoot.wrappers.gpu.self_calibration import SelfCalibrationModule

DT, MASS, STEPS, WARM = 1.0 / 80.0, 5.305, 96, 16
FAULTS = [Fault("spiking", 0), Fault("dropped", 5, probability=0.1, burst=0.1)]
WARMING = replace(HX711_LOAD_CELLS, offset_tempco=0.005, scale_tempco=5e-5, temperature_ramp=0.03)


def time_steps(name: str, call: Callable[[int], object], device: torch.device) -> None:
    """Print the median, mean and 95th percentile of a call in ms."""
    taken = []
    for step in range(WARM + STEPS):
        start = time.perf_counter()
        call(step)
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        taken.append(1e3 * (time.perf_counter() - start))
    used = np.array(taken[WARM:])
    print(f"{name:44s} {np.median(used):8.2f} {used.mean():8.2f} {np.percentile(used, 95):8.2f}")


def capture(call: Callable[[None], object], device: torch.device) -> Callable[[int], None]:
    """Capture a step in a graph, and give the function that replays it."""
    side = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
    side.wait_stream(torch.cuda.current_stream(device))
    with torch.cuda.stream(side):
        call(None)
    torch.cuda.current_stream(device).wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        call(None)
    return lambda step: graph.replay()


def stepping(robots: int, device: torch.device) -> tuple[torch.Tensor, Reference]:
    """Let each robot shift its weight: forces (N, 8) of one step, and its beliefs."""
    share = torch.linspace(0.0, 1.0, robots, device=device)
    force = MASS * GRAVITY / 4 * torch.stack([share, 1.0 - share], dim=1).repeat_interleave(4, dim=1)
    zero = torch.zeros(robots, 3, device=device)
    soles = torch.tensor([(0.0, 0.05, 0.0), (0.0, -0.05, 0.0)], device=device)
    on_ground = torch.stack([share > 0.0, share < 1.0], dim=1)
    return force, Reference(
        com=torch.stack([0.024 + 0 * share, 0.1 * share - 0.05, 0.26 + 0 * share], dim=1),
        com_acceleration=zero,
        angular_momentum_rate=zero,
        position_sole=soles.expand(robots, 2, 3),
        R_level_sole=torch.eye(3, device=device).expand(robots, 2, 3, 3),
        stance=on_ground,
        swing=~on_ground,
        accelerometer=zero + torch.tensor([0.0, 0.0, GRAVITY], device=device),
        gyroscope=zero,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=4096)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--methods", nargs="+", default=["moment"], choices=list(METHODS))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    device, robots = torch.device(arguments.device), arguments.robots
    force, reference = stepping(robots, device)
    ended = torch.arange(0, robots, 400, device=device)
    print(f"{robots} robots x 8 cells on {device}, float32, ms a step")
    print(f"{'':44s} {'median':>8s} {'mean':>8s} {'95 %':>8s}")

    plain = FootSensorsModule(HX711_LOAD_CELLS, robots, device, dt=DT)
    warming = FootSensorsModule(WARMING, robots, device, dt=DT, faults=FAULTS)
    block = force[:, None].expand(-1, 4, -1).contiguous()

    def read_after_reset(step: int) -> None:
        plain.reset(ended)
        plain(force, step)

    time_steps("load cells", lambda step: plain(force, step), device)
    time_steps("load cells, 4 substeps", lambda step: plain(block, step), device)
    time_steps("load cells, resets in every step", read_after_reset, device)
    time_steps("warming load cells with two faults", lambda step: warming(force, step), device)
    if device.type == "cuda":
        time_steps("load cells, captured", capture(lambda step: plain(force, step), device), device)
    counts = plain(force)
    for name in arguments.methods:
        calibrator = SelfCalibrationModule(
            nao_shoe_layout(), name, robots, device, mass=MASS, dt=DT, initial=plain.nominal
        )

        def estimate(step: int | None, each: SelfCalibrationModule = calibrator) -> object:
            return each(counts, reference, step)

        time_steps(f"calibrator '{name}'", estimate, device)
        if device.type == "cuda":
            time_steps(f"calibrator '{name}', captured", capture(estimate, device), device)


if __name__ == "__main__":
    main()
