"""Walk on miscalibrated feet, and on feet that calibrate themselves, in two lines each.

Run with ``python examples/two_lines.py``.
"""

import gymnasium as gym
import numpy as np

import surefoot


def cop_error(method: str, seconds: float = 20.0, seed: int = 0) -> float:
    """Walk for a while; return the error of the feet's centres of pressure in mm rms over its second half."""
    env = gym.make("surefoot/NaoWalk-v0", speed=0.04, duration=seconds)
    env = surefoot.wrappers.FootSensors(env, "hx711-load-cells")
    env = surefoot.wrappers.SelfCalibration(env, method)

    env.reset(seed=seed)
    stay = np.zeros(env.action_space.shape, dtype=np.float32)
    errors, done = [], False
    while not done:
        observation, _, terminated, truncated, info = env.step(stay)
        done = terminated or truncated
        truth = info["surefoot"]["truth"]
        standing = truth["vgrf"][:, None] > 20.0  # N: where the centre of pressure of a foot is well defined
        errors.append(np.where(standing, observation["cop_foot"] - truth["cop_foot"], np.nan))
    late = np.array(errors[len(errors) // 2 :])
    return 1e3 * float(np.sqrt(np.nanmean(np.sum(late**2, axis=-1))))


if __name__ == "__main__":
    for name in ("none", "tare", "quasi-static", "window", "moment"):
        print(f"{name:>12}: {cop_error(name):5.1f} mm")
