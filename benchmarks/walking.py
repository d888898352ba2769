"""Who falls: the stabiliser by its gains, and nobody, under pushes and on a centre of pressure that is off.

    python benchmarks/walking.py                  # about half an hour on one core
    python benchmarks/walking.py --seeds 4 --duration 10

Every walk is seeded. The centre of pressure that the controller is shown is the true one, to which a
circumstance may add a constant. How walks go on sensors is ``surefoot sweep``'s.
"""

import argparse
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from surefoot.controllers import Stabiliser, zero_action
from surefoot.envs.nao.walk import NaoWalkEnv

SPEEDS = (0.02, 0.04, 0.1)


class Circumstance(NamedTuple):
    """Pushes of one size every 3 s in N s, and by how much the centre of pressure is off in m."""

    push: float = 0.0
    bias: tuple[float, float] = (0.0, 0.0)


CIRCUMSTANCES = {f"pushes of {size:g} N s": Circumstance(push=size) for size in (0.5, 1.0, 1.5, 2.0)} | {
    f"{size} mm off {towards}": Circumstance(bias=(1e-3 * size * x, 1e-3 * size * y))
    for size in (10, 20, 30)
    for towards, (x, y) in {"forward": (1, 0), "backward": (-1, 0), "left": (0, 1), "right": (0, -1)}.items()
}


def gains() -> dict[str, Mapping[str, float] | None]:
    """Gains by name: each of the stabiliser's changed alone, and ``None`` for the zero action."""
    changed = {"admittance": (0.75, 3.0), "position_gain": (1.1, 1.2, 1.6, 2.0), "velocity_gain": (0.0, 0.16)}
    single = {f"{name} {value:g}": {name: value} for name, values in changed.items() for value in values}
    return {"zero action": None, "stabiliser": {}, **single}


def falls(env: NaoWalkEnv, options: Mapping[str, float] | None, bias: tuple[float, float], seed: int) -> bool:
    """Walk once, and tell whether the robot fell."""
    controller: Callable[[dict[str, Any]], Any] = zero_action
    if options is not None:
        controller = Stabiliser(env.state_layout, **options)
        controller.reset()
    observation, _ = env.reset(seed=seed)
    fell = over = False
    while not (fell or over):
        seen = observation | {"cop": observation["cop"] + np.float32(bias)}
        observation, _, fell, over, _ = env.step(controller(seen))
    return fell


def main() -> None:
    """Print a table of gains by circumstances: falls at each of the speeds."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=5, help="walks of each kind and speed")
    parser.add_argument("--duration", type=float, default=30.0, help="length of a walk in s")
    arguments = parser.parse_args()
    print(f"falls of {arguments.seeds} walks at {', '.join(f'{speed:g}' for speed in SPEEDS)} m/s")
    print("|", " | ".join(["", *gains()]), "|")
    print("|---" * (1 + len(gains())) + "|")
    for name, (push, bias) in CIRCUMSTANCES.items():
        pushed = {"push_impulse": (push, push), "push_interval": 3.0} if push else {}
        envs = [NaoWalkEnv(speed=speed, duration=arguments.duration, **pushed) for speed in SPEEDS]
        row = [
            ", ".join(str(sum(falls(env, one, bias, s) for s in range(arguments.seeds))) for env in envs)
            for one in gains().values()
        ]
        print("|", " | ".join([name, *row]), "|", flush=True)


if __name__ == "__main__":
    main()
