"""Train a policy by Stable-Baselines3 on drifting feet that are calibrated as the robot moves.

    python examples/sb3_balance.py --out out/balance.zip

It takes five to six minutes of one core. docs/vector.md says why the policy sees and commands what it does.
"""

import argparse

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnvWrapper, VecMonitor

from surefoot.controllers.posture import posture_matrix
from surefoot.wrappers import TruthRow
from surefoot.wrappers.vector.sb3 import VecFootSensors, VecSelfCalibration


class Postures(VecEnvWrapper):
    """See numbers of the order of one; command the speeds of four postures, for four steps at a time."""

    def __init__(self, venv):
        super().__init__(venv, spaces.Box(-np.inf, np.inf, (15,)), spaces.Box(-1.0, 1.0, (4,)))
        self.layout, self.stand = venv.get_attr("state_layout", 0)[0], venv.get_attr("stand_time", 0)[0]

    def reset(self):
        """Begin with no posture commanded."""
        self.posture, self.age = np.zeros((self.num_envs, 4)), np.zeros(self.num_envs)
        return self.inputs_of(self.venv.reset(), self.posture)

    def step_async(self, actions):
        """Keep the speeds of the postures, shape (N, 4)."""
        self.speed = actions

    def step_wait(self):
        """Take four steps, and add up their rewards."""
        paid, done, last = np.zeros(self.num_envs), np.zeros(self.num_envs, bool), {}
        for _ in range(4):
            speed = 1.5 * self.speed * (self.age > 80 * self.stand)[:, None]  # nobody acts in the quiet stand
            self.posture = np.clip(self.posture + (speed - self.posture) / 80, -1.0, 1.0)  # leaks in 1 s
            residual = np.clip(self.posture @ posture_matrix().T, -1.0, 1.0)
            shown, rewards, ended, infos = self.venv.step(residual)
            paid, done, self.age = paid + rewards * ~done, done | ended, (self.age + 1) * ~ended
            for i in np.flatnonzero(ended):
                final = self.inputs_of(infos[i]["terminal_observation"], self.posture[i])
                last[i] = infos[i] | {"terminal_observation": final}
                self.posture[i] = 0.0
        infos = [last.get(i, info) for i, info in enumerate(infos)]
        return self.inputs_of(shown, self.posture), 0.05 * paid, done, infos

    def inputs_of(self, shown, posture):
        """Return errors, plan, motion and postures in numbers of the order of one, shape (N, 15)."""
        state = {name: shown["state"][..., where] for name, where in self.layout.items()}
        plan, speed = state["cop_reference"], state["com_reference_velocity"]
        units = [(shown["cop"] - plan) / 0.01, plan / 0.03, speed / 0.05]
        units += [state["tilt"] / 0.1, state["gyroscope"] / 0.5, posture / 0.3]
        return np.concatenate(units, axis=-1).astype(np.float32)


def robots(count, **task):
    """Make robots on fresh cells, calibrated as they move."""
    copies = DummyVecEnv([lambda: TruthRow(gym.make("surefoot/NaoBalanceHard-v0", **task))] * count)
    feet = VecFootSensors(copies, fresh=True)
    return Postures(VecSelfCalibration(feet, "moment", show=("cop",)))


def ppo(venv, seed=0):
    """Make the learner."""
    return PPO(
        "MlpPolicy",
        VecMonitor(venv),
        n_steps=256,
        batch_size=512,
        n_epochs=16,
        gamma=0.97,  # a decision is 1/20 s: rewards 1.6 s ahead count about a third
        learning_rate=lambda left: 2e-3 * left,
        use_sde=True,  # smooth exploration: feet that shake measure nothing
        sde_sample_freq=8,
        policy_kwargs={"log_std_init": -2.5, "net_arch": {"pi": [], "vf": [64, 64]}},  # a linear policy
        seed=seed,
        device="cpu",
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000, help="decisions of all robots together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", default="sb3_balance.zip")
    asked = parser.parse_args()
    model = ppo(robots(8), asked.seed)
    model.learn(asked.steps)
    model.save(asked.out)
