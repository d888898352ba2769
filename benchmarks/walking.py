"""How well the robot walks, what feedback of the centre of pressure buys, and what a bias of it costs.

    python benchmarks/walking.py                  # everything, about 40 minutes on one core
    python benchmarks/walking.py walk bias        # some of the studies
    python benchmarks/walking.py --seeds 4 --duration 20

Every study is seeded. The centre of pressure is the true one, to which ``bias`` adds a constant.
"""

import argparse
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.controllers import Stabiliser, zero_action
from surefoot.envs.nao.walk import NaoWalkEnv

SPEEDS = (0.02, 0.04, 0.1)
DIRECTIONS = {"forward": (1, 0), "backward": (-1, 0), "left": (0, 1), "right": (0, -1)}
Controller = Callable[[dict[str, Any]], NDArray[np.float32]]


class Walk(NamedTuple):
    """One episode: its length in s, whether it fell, speed in m/s, errors of the CoP in m, shape (n, 2)."""

    time: float
    fell: bool
    speed: float
    planned: NDArray[np.float64]
    alone: NDArray[np.float64]


def walk(env: NaoWalkEnv, controller: Controller, seed: int, bias: tuple[float, float] = (0.0, 0.0)) -> Walk:
    """Walk once; errors count from the first step on, where one foot is planned to carry (and does alone)."""
    observation, _ = env.reset(seed=seed)
    if isinstance(controller, Stabiliser):
        controller.reset()
    reference, stance = env.state_layout["cop_reference"], env.state_layout["stance"]
    start, planned, alone = env.truth.com[-1, :2].copy(), [], []
    terminated = truncated = False
    steps = 0
    while not (terminated or truncated):
        seen = observation | {"cop": observation["cop"] + np.float32(bias)}
        observation, _, terminated, truncated, _ = env.step(controller(seen))
        steps += 1
        state = observation["state"]
        if state[stance].sum() == 1:
            planned.append(observation["cop"] - state[reference])
            if env.truth.vgrf().min() < 5.0:
                alone.append(planned[-1])
    # The first and the last of the moves are half as long, and the last step only closes the feet.
    speed = float(np.linalg.norm(env.truth.com[-1, :2] - start)) / (0.8 * (len(env.pattern.footsteps) - 2))
    return Walk(steps * env.dt, terminated, speed, _rows(planned), _rows(alone))


def _rows(values: list[NDArray[Any]]) -> NDArray[np.float64]:
    return np.array(values, dtype=np.float64).reshape(-1, 2)


def rms(walks: list[Walk], which: str) -> str:
    """Root mean square of x, of y, and of their distance in mm."""
    square = 1e6 * (np.concatenate([getattr(walk, which) for walk in walks]) ** 2).mean(axis=0)
    return f"{square[0] ** 0.5:4.1f} {square[1] ** 0.5:4.1f} {square.sum() ** 0.5:4.1f}"


def controllers(env: NaoWalkEnv) -> Iterator[tuple[str, Controller]]:
    """Name those compared: the stabiliser and the open-loop walker."""
    yield "stabiliser", Stabiliser(env.state_layout)
    yield "zero action", zero_action


def study_walk(seeds: int, duration: float) -> None:
    """Walk straight on the true centre of pressure, with the environment's own disturbances."""
    print("\n## Walks\n\nrms of the true CoP about its reference in mm: x, y, both")
    print("speed    controller    falls    one foot planned   one foot alone    m/s")
    for speed in SPEEDS:
        env = NaoWalkEnv(speed=speed, duration=duration)
        for name, controller in controllers(env):
            walks = [walk(env, controller, seed) for seed in range(seeds)]
            mean_speed = np.mean([one.speed for one in walks])
            print(
                f"{speed:5.2f}    {name:11s}   {_falls(walks)}    {rms(walks, 'planned')}"
                f"     {rms(walks, 'alone')}    {mean_speed:.4f}",
                flush=True,
            )


def study_pushes(seeds: int, duration: float) -> None:
    """Push harder and harder, every 3 s on the average."""
    print("\n## Falls under pushes of one size, every 3 s\n")
    print("speed    controller    " + "  ".join(f"{size:5.1f} N s" for size in (0.5, 1.0, 1.5, 2.0)))
    for speed in SPEEDS:
        rows: dict[str, list[str]] = {}
        for size in (0.5, 1.0, 1.5, 2.0):
            env = NaoWalkEnv(speed=speed, duration=duration / 2, push_impulse=(size, size), push_interval=3.0)
            for name, controller in controllers(env):
                walks = [walk(env, controller, 100 + seed) for seed in range(seeds)]
                rows.setdefault(name, []).append(_falls(walks))
        for name, row in rows.items():
            print(f"{speed:5.2f}    {name:11s}   " + "    ".join(f"{entry:>5s}" for entry in row), flush=True)


def study_bias(seeds: int, duration: float) -> None:
    """Add a constant to the centre of pressure that the stabiliser is shown."""
    sizes = (5, 10, 15, 20, 25, 30)
    seeds = max(seeds // 5, 1)
    print(f"\n## Falls on a biased CoP, of {seeds}, and median time to a fall\n")
    print("speed    towards     " + "   ".join(f"{size:3d} mm   " for size in sizes))
    for speed in SPEEDS:
        env = NaoWalkEnv(speed=speed, duration=duration)
        controller = Stabiliser(env.state_layout)
        for name, (x, y) in DIRECTIONS.items():
            row = []
            for size in sizes:
                bias = (1e-3 * size * x, 1e-3 * size * y)
                walks = [walk(env, controller, 200 + seed, bias) for seed in range(seeds)]
                times = [one.time for one in walks if one.fell]
                row.append(f"{len(times)} {np.median(times):4.1f} s" if times else "0       ")
            print(f"{speed:5.2f}    {name:9s}   " + "   ".join(f"{entry:8s}" for entry in row), flush=True)


def study_gains(seeds: int, duration: float) -> None:
    """Compare gains under pushes of 1.5 N s, and on a CoP that is off by 20 mm to either side and ahead."""
    print(
        "\n## Gains: falls under pushes of 1.5 N s at the three speeds, and on 20 mm of bias (of 9 walks)\n"
    )
    print("  A    k1     k2    pushes                 bias")
    gains = [
        {"admittance": admittance, "position_gain": position_gain, "velocity_gain": velocity_gain}
        for admittance in (0.75, 1.5, 3.0)
        for position_gain in (1.1, 1.2, 1.3, 1.6, 2.0)
        for velocity_gain in (0.065,)
    ]
    gains += [{"admittance": 1.5, "position_gain": 1.2, "velocity_gain": gain} for gain in (0.0, 0.16)]
    pushed = [
        NaoWalkEnv(speed=v, duration=duration / 2, push_impulse=(1.5, 1.5), push_interval=3.0) for v in SPEEDS
    ]
    quiet = [NaoWalkEnv(speed=v, duration=duration / 2) for v in SPEEDS]
    for one in gains:
        falls = [
            _falls([walk(env, Stabiliser(env.state_layout, **one), 300 + seed) for seed in range(seeds)])
            for env in pushed
        ]
        biased = sum(
            walk(env, Stabiliser(env.state_layout, **one), 400, bias).fell
            for env in quiet
            for bias in ((0.02, 0.0), (0.0, 0.02), (0.0, -0.02))
        )
        print(
            f"{one['admittance']:4.2f}  {one['position_gain']:4.2f}  {one['velocity_gain']:5.3f}   "
            + "  ".join(f"{fall:>5s}" for fall in falls)
            + f"      {biased}/9",
            flush=True,
        )


def _falls(walks: list[Walk]) -> str:
    return f"{sum(one.fell for one in walks)}/{len(walks)}"


STUDIES = {"walk": study_walk, "pushes": study_pushes, "bias": study_bias, "gains": study_gains}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "studies", nargs="*", choices=[[], *STUDIES], help="which studies; all when not given"
    )
    parser.add_argument("--seeds", type=int, default=20, help="walks of each kind")
    parser.add_argument("--duration", type=float, default=60.0, help="length of a walk in s")
    arguments = parser.parse_args()
    for name in arguments.studies or STUDIES:
        STUDIES[name](arguments.seeds, arguments.duration)


if __name__ == "__main__":
    main()
