"""Calibrate the F/T sensor in a leg with poses that a planner proposes, and with those of a raster sweep.

The planner starts from the maker's matrix, drives the hip of ``surefoot/LegRig-v0`` to the postures it
proposes, waits until the leg hangs still, reads, fits and plans again, also which mass to hang. Run with
``python examples/in_situ_planner.py``.
"""

import gymnasium as gym
import numpy as np

import surefoot  # noqa: F401 - registers the environment
from surefoot.calibration.in_situ import (
    InSituFit,
    InSituOptions,
    InSituSet,
    KnownLimb,
    MassCandidate,
    calibrate_in_situ,
    plan_excitation,
    prior_from_factory,
    prior_from_fit,
)
from surefoot.envs.leg_rig.spec import ADDED_MASSES
from surefoot.sensors import StrainGauges, preset

CONFIGURATIONS = (1, 2, 3, 4)
MASSES = [MassCandidate(ADDED_MASSES[j].mass, ADDED_MASSES[j].com_leg) for j in CONFIGURATIONS]
FACTORY = np.array(preset("icub-ftsens-leg", StrainGauges).matrix)
HIP = np.radians([(a, b) for a in np.linspace(-30, 30, 4) for b in np.linspace(-40, 40, 5)])
SAMPLES = 20


def gravity_at(hip: np.ndarray) -> np.ndarray:
    """Return gravity as the robot believes it, in the frame of the sensor: x ahead, z down."""
    a, b = hip[..., 0], hip[..., 1]
    return 9.81 * np.stack([-np.sin(a), -np.cos(a) * np.sin(b), np.cos(a) * np.cos(b)], axis=-1)


def drive(env: gym.Env, observation: np.ndarray, hip: np.ndarray) -> tuple[np.ndarray, dict]:
    """Turn the hip to these angles in rad and wait until it rests there."""
    hold, still = np.zeros(2, dtype=np.float32), 0
    while still < 15:
        far = np.abs(hip - observation[:2]).max() > 0.02
        still = 0 if far else still + 1
        action = np.clip(3.0 * (hip - observation[:2]), -1.0, 1.0).astype(np.float32) if far else hold
        observation, _, _, _, info = env.step(action)
    return observation, info


def read(env: gym.Env, poses: list, sensor: tuple, rng: np.random.Generator) -> list[InSituSet]:
    """Take poses (orientation, mass), mass by mass; each mass is a set, with an offset of its own."""
    response, offset = sensor
    noise, sets = np.linalg.inv(FACTORY) * np.repeat([0.1, 0.0025], 3), []
    for index in sorted({mass for _, mass in poses}):
        raw, gravity, (mass, com, _) = [], [], MASSES[index]
        off = offset + 30.0 * noise @ rng.standard_normal(6)
        observation, _ = env.reset(seed=0, options={"configuration": CONFIGURATIONS[index]})
        for orientation in sorted(o for o, mass in poses if mass == index):
            observation, info = drive(env, observation, HIP[orientation])
            counts = response @ info["surefoot"]["truth"]["wrench_leg"] + off
            raw.append(counts + rng.standard_normal((SAMPLES, 6)) @ noise.T)
            gravity.append(np.tile(-observation[4:7].astype(float), (SAMPLES, 1)))
        sets.append(InSituSet(np.concatenate(raw), np.concatenate(gravity), mass, com))
    return sets


def compare(rounds: int = 3, poses: int = 20, seed: int = 0) -> dict[str, list[tuple[float, float]]]:
    """Calibrate round by round; return for each way the reported and the true rms error of A in percent."""
    rng = np.random.default_rng([1, seed])
    response = np.linalg.inv(FACTORY) @ (np.eye(6) + np.diag(0.15 * rng.standard_normal(6)))
    sensor = response, response @ np.array([50.0, -30.0, 40.0, 0.5, 0.2, -0.3])
    limb = KnownLimb(mass=4.9, mass_std=0.3, com=np.array([0.0, 0.0, 0.2]), com_std=0.05)
    options = InSituOptions(factory_std=(0.2,) * 6)
    sweep = [(o, mass) for mass in range(len(MASSES)) for o in range(len(HIP))]
    env = gym.make("surefoot/LegRig-v0", speed_deg=40.0).unwrapped
    found: dict[str, list[tuple[float, float]]] = {}
    for way in ("planned", "raster"):
        prior, sets, found[way] = prior_from_factory(FACTORY, limb), [], []
        for round_ in range(rounds):
            if way == "planned":
                plan = plan_excitation(prior, gravity_at(HIP), MASSES, count=poses, samples=SAMPLES)
                chosen = [(pose.orientation, pose.mass) for pose in plan.poses]
            else:
                every = np.linspace(0, len(sweep) - 1, rounds * poses).astype(int)
                chosen = [sweep[i] for i in every[round_::rounds]]
            sets += read(env, chosen, sensor, rng)
            fit = prior = calibrate_in_situ(sets, factory_matrix=FACTORY, limb=limb, options=options)
            found[way].append(errors(fit, response))
    env.close()
    return found


def errors(fit: InSituFit, response: np.ndarray) -> tuple[float, float]:
    """Return the reported and the true rms error of the axes, in percent of a leg's weight and torque."""
    size = np.repeat([48.0, 10.0], 3)
    share = size / size[:, None]
    reported = np.diag(prior_from_fit(fit).covariance)[:36].reshape(6, 6) * share**2
    true = (fit.matrix @ response - np.eye(6)) * share
    return 100.0 * float(np.sqrt(reported.mean())), 100.0 * float(np.sqrt(np.mean(true**2)))


if __name__ == "__main__":
    for name, rows in compare().items():
        for number, (reported, true) in enumerate(rows, start=1):
            print(f"{name:>8}, {20 * number} poses: reported {reported:6.3f} %, true {true:6.3f} %")
