"""Robots and their motion for tests of beliefs in C."""

import gymnasium as gym
import mujoco
import numpy as np

from surefoot.envs import InstrumentedEnv
from surefoot.envs.instrumentation.drawing import draw_nao
from surefoot.robot.beliefs.errors import BeliefErrors
from surefoot.robot.beliefs.nominal import NominalModel
from surefoot.robot.beliefs.references import Beliefs
from surefoot.sensors.telemetry.computer import TelemetryLayout
from surefoot.sensors.transport.link import Packet

PACKETS, PERIOD, DT, LATE = 2000, 0.01, 0.0125, 0.03
ERRORS = BeliefErrors(mass=0.01, com=0.005)
CLOSE = 1e-9


def random_tree(
    seed: int, places: tuple[tuple[float, float], ...] = ((0.0, 0.1), (0.0, -0.1))
) -> mujoco.MjSpec:
    """A robot of bodies that hang anywhere on each other, by no hinge, one or three; it has legs."""
    rng = np.random.default_rng([71, seed])

    def vector(size):
        return rng.normal(scale=size, size=3)

    def massive(body):
        body.mass, body.ipos = rng.uniform(0.05, 2.0), vector(0.05)
        body.inertia = 1e-3 * (1.0 + rng.random(3))
        body.iquat, body.explicitinertial = rng.normal(size=4), True
        bodies.append(body)
        return body

    spec, bodies = mujoco.MjSpec(), []
    spec.compiler.degree = False
    torso = massive(spec.worldbody.add_body(name="torso"))
    torso.add_freejoint()
    torso.add_site(name="imu", pos=vector(0.1))
    for number in range(12):
        body = massive(
            bodies[int(rng.integers(len(bodies)))].add_body(pos=vector(0.2), quat=rng.normal(size=4))
        )
        for i in range(rng.choice([0, 1, 1, 3])):
            body.add_joint(name=f"{number} {i}", axis=vector(1.0), pos=vector(0.05), ref=rng.normal())
    for side, place in zip(soles_of(len(places)), places, strict=True):
        leg = massive(torso.add_body(pos=(*place, -0.3)))
        leg.add_joint(name=f"{side} hip", axis=(0.0, 1.0, 0.0), pos=vector(0.05))
        foot = massive(leg.add_body(pos=(0.0, 0.0, -0.3)))
        foot.add_joint(name=f"{side} ankle", axis=(1.0, 0.0, 0.0))
        foot.add_site(name=side, pos=vector(0.02), quat=(1.0, *vector(0.01)))
    return spec


def soles_of(feet: int) -> tuple[str, ...]:
    return ("left_sole", "right_sole") if feet == 2 else tuple(f"sole {foot}" for foot in range(feet))


def on_feet(feet: int) -> NominalModel:
    angle = 2.0 * np.pi * np.arange(feet) / feet
    places = tuple(zip(0.2 * np.cos(angle), 0.15 * np.sin(angle), strict=True))
    return NominalModel(random_tree(2, places), ERRORS, sites=("imu", *soles_of(feet)))


def humanoid() -> NominalModel:
    env = InstrumentedEnv(gym.make("Humanoid-v5"))
    env.close()
    return NominalModel.of_drawing(env.drawing, ERRORS)


ROBOTS = {
    "nao": lambda: NominalModel.of_drawing(draw_nao(), ERRORS),
    "humanoid": humanoid,
    **{f"{feet} feet": lambda feet=feet: on_feet(feet) for feet in (1, 3, 4, 8)},
    **{f"tree {seed}": lambda seed=seed: NominalModel(random_tree(seed), ERRORS) for seed in (1, 2, 3)},
}


def robot(name: str) -> NominalModel:
    model = ROBOTS[name]()
    model.draw(np.random.default_rng(3))
    return model


def python(model: NominalModel, averaged: bool = True, lag: int = 5, places=None, rolls=False) -> Beliefs:
    layout = TelemetryLayout(len(model.joint_names))
    return Beliefs(model, layout, PERIOD, LATE, averaged, lag=lag, dt=DT, touching=places, rolls=rolls)


def round_feet(feet: int) -> np.ndarray:
    """Centres and radii of the balls of each foot."""
    rng = np.random.default_rng(9)
    return np.concatenate(
        [0.02 * rng.normal(size=(feet, 2, 3)), rng.uniform(0.01, 0.03, (feet, 2, 1))], axis=2
    )


def motion(joints: int, seed: int = 0) -> list[Packet]:
    """Smooth motions of all joints, odd postures, falls, flights; packets late, lost, repeated, spoilt."""
    rng, where = np.random.default_rng([72, seed]), TelemetryLayout(joints)
    time = PERIOD * np.arange(PACKETS)[:, None]
    values = 0.2 * rng.normal(size=where.size) * np.sin(rng.uniform(1.0, 9.0, where.size) * time)
    # Now and then it stands still, so that feet are found to stand.
    values *= (np.sin(0.7 * time) > -0.3) * 1.0
    values += 1e-4 * rng.normal(size=values.shape)
    values[:, where.accelerometer] += (0.0, 0.0, 9.81)
    for start in range(1500, 1900, 50):
        values[start : start + 40, where.joint_position] = rng.normal(size=joints)
    values[700:720, where.accelerometer] *= 0.1
    values[1200:1290, where.accelerometer] = (9.0, 1.0, 0.5)
    late = LATE + 0.004 * rng.standard_normal(PACKETS)
    packets = [Packet(n, PERIOD * n + late[n], row) for n, row in enumerate(values)]
    for n, spoilt in ((300, np.nan), (500, np.inf), (501, 1e7)):
        packets[n].values[rng.integers(where.size)] = spoilt
    lost = rng.random(PACKETS) < 0.002
    packets = [packet for packet in packets if not lost[packet.number]]
    packets.insert(900, packets[899])
    return packets


def same(expected, found, name: str = "") -> None:
    expected, found = np.asarray(expected), np.asarray(found)
    assert (expected.shape, expected.dtype) == (found.shape, found.dtype), name
    if expected.dtype.kind != "f":
        np.testing.assert_array_equal(found, expected, err_msg=name)
        return
    largest = np.abs(expected).max(axis=0, initial=0.0, where=np.isfinite(expected))
    off = np.abs(found - expected) <= CLOSE * np.maximum(largest, 1e-3)
    assert (off | (np.isnan(expected) & np.isnan(found))).all(), name


def same_info(expected: dict, found: dict) -> None:
    assert list(expected) == list(found)
    for name, part in expected.items():
        assert type(part) is type(found[name])
        same(part, found[name], name)
