"""A batch of robots with foot sensors and calibrators of their own, as in a simulator on a GPU (docs/gpu.md).

    python examples/gpu_stack.py --robots 4096 --device cuda

The simulator is a toy: inverted pendulums that march on the spot and begin a new episode now and then.
"""

import argparse
import math

import torch

from surefoot.calibration import GRAVITY, Reference, nao_shoe_layout
from surefoot.wrappers.gpu.foot_sensors import FootSensorsModule
from surefoot.wrappers.gpu.self_calibration import SelfCalibrationModule

LAYOUT, MASS, HEIGHT, DT, CYCLE = nao_shoe_layout(), 5.305, 0.26, 1 / 80, 128


def march() -> tuple[torch.Tensor, ...]:
    """Return one cycle: true cell forces (T, 8), true centre of pressure (T, 2), fields of the motion."""
    phase = torch.arange(CYCLE, dtype=torch.float64) * (2 * math.pi / CYCLE)
    left = (0.5 + 0.9 * torch.sin(phase)).clip(0.0, 1.0)
    share = torch.stack([left, 1.0 - left], dim=1)
    roll = torch.stack([0.024 + 0.03 * torch.sin(2 * phase), 0.01 * torch.cos(2 * phase)], dim=1)
    sole = torch.tensor([(0, 0.05, 0), (0, -0.05, 0)], dtype=torch.float64)
    cop = roll + share @ sole[:, :2]
    # The pendulum above a periodic centre of pressure, frequency by frequency.
    turn = 2 * math.pi * torch.fft.fftfreq(CYCLE, DT, dtype=torch.float64)
    com = torch.fft.ifft(torch.fft.fft(cop, dim=0) / (1 + turn**2 * HEIGHT / GRAVITY)[:, None], dim=0).real
    cell = torch.stack([torch.as_tensor(foot.position_cell_sole)[:, :2] for foot in LAYOUT.feet])
    low = cell.amin(1, keepdim=True)
    near = (roll[:, None, None] - low) / (cell.amax(1, keepdim=True) - low)
    force = MASS * GRAVITY * share[:, :, None] * torch.where(cell > low, near, 1.0 - near).prod(-1)
    still, up = torch.zeros(CYCLE, 3, dtype=torch.float64), torch.tensor([0.0, 0.0, 1.0])
    acceleration = GRAVITY / HEIGHT * torch.cat([com - cop, still[:, :1]], dim=1)
    motion = Reference(
        com=torch.cat([com, still[:, :1] + HEIGHT], dim=1),
        com_acceleration=acceleration,
        angular_momentum_rate=still,
        position_sole=sole.expand(CYCLE, 2, 3),
        R_level_sole=torch.eye(3, dtype=torch.float64).expand(CYCLE, 2, 3, 3),
        stance=share > 0.02,
        swing=share == 0.0,
        accelerometer=acceleration + GRAVITY * up,
        gyroscope=still,
    )
    return force.reshape(CYCLE, 8), cop, *motion


def main(robots: int = 256, device: str = "cpu", seconds: float = 20.0) -> tuple[float, float]:
    """March; return the root mean square error of the centre of pressure in mm, before and after."""
    force, cop, *motion = (part.to(device) for part in march())
    chance = torch.Generator(device).manual_seed(1)
    feet = FootSensorsModule("hx711-load-cells", robots, device, dt=DT)
    options = {"mass": MASS, "dt": DT, "initial": feet.nominal}
    names = ("none", "moment")
    methods = [SelfCalibrationModule(LAYOUT, name, robots, device, **options) for name in names]
    clock = torch.randint(CYCLE, (robots,), generator=chance, device=device)
    for step in range(round(seconds / DT)):
        ended = torch.rand(robots, generator=chance, device=device) < 1 / 400
        clock = torch.where(ended, 0, (clock + 1) % CYCLE)
        for module in (feet, *methods):
            module.reset(ended)
        counts = feet(force[clock], step)
        belief = Reference(*(part[clock] for part in motion))
        noise = 0.1 * torch.randn((robots, 3), generator=chance, device=device)
        belief = belief._replace(com=belief.com + 0.002, com_acceleration=belief.com_acceleration + noise)
        found = [method(counts, belief, step).cop - cop[clock] for method in methods]
    before, after = (1e3 * float(error.square().sum(1).nanmean().sqrt()) for error in found)
    print(f"{robots} robots: CoP error {before:.1f} mm by the data sheet, {after:.1f} mm calibrated")
    return before, after


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=256)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--seconds", type=float, default=20.0)
    main(**vars(parser.parse_args()))
