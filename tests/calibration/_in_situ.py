"""Made-up in-situ sets: published matrices, masses and places, and a limb that turns."""

from dataclasses import replace

import numpy as np
from _in_situ_stacked import wrench_of_gravity
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ import InSituSet, estimate_offset

NOISE = np.array([0.1, 0.1, 0.1, 0.0025, 0.0025, 0.0025])  # white noise in N and N m

# Factory matrices of two FTSens sensors, N and N m per count.
LEG_MATRIX = np.array(
    [
        [0.0005779, -0.000490904, -0.023418914, -0.000315359, -0.001963616, 0.02412886],
        [0.001296632, 0.027701899, -0.013808145, -0.001016616, 0.001016616, -0.013581635],
        [-0.021660896, 0.000138864, 0.0002347, 0.020536289, 0.020821842, 0.000678675],
        [4.9002e-05, 0.00022237, -0.000117233, -0.000336812, 0.000276541, -0.000100864],
        [0.000376392, -1.2406e-05, -0.000178406, 0.000174617, 0.000158322, 0.00019735],
        [1.482e-05, 0.00023669, 0.000215254, 8.762e-06, -1.102e-05, 0.000225245],
    ]
)
FOOT_MATRIX = np.array(
    [
        [-3.512e-06, -0.000289165, -0.018467922, 0.000592378, 0.00014868, 0.01884489],
        [0.000141029, 0.021867615, -0.010802271, -2.0341e-05, 0.000729553, -0.010863293],
        [0.016491286, -0.000622283, -0.000247659, 0.016731108, 0.01716216, -0.00010502],
        [-8.354e-06, 0.000208576, -0.000102765, -0.000231934, 0.000255572, -0.000101284],
        [-0.000280548, 7.391e-06, -0.000166908, 0.000155331, 0.000147651, 0.000160499],
        [-1.026e-06, 0.000194068, 0.000187981, -3.185e-06, 1.097e-06, 0.000184212],
    ]
)
# Added masses of the paper's sets 1-4 in kg, and their places in the foot's and the leg's frame in m.
ADDED_MASS = (0.0, 0.703, 0.703, 0.703)
ADDED_COM_FOOT = np.array(
    [
        [0.0, 0.0, 0.0],
        [-0.018, 0.108341707, 0.003776111],
        [0.222, 0.108341707, 0.003776111],
        [0.262, 0.025223889, -0.093879972],
    ]
)
ADDED_COM_LEG = ADDED_COM_FOOT + np.array([-0.0035, 0.0, 0.3636])
# matrix, limb's mass in kg, its centre of mass in m, places of the added masses
SENSORS = {
    "leg": (LEG_MATRIX, 4.9, np.array([0.01, -0.02, 0.22]), ADDED_COM_LEG),
    "foot": (FOOT_MATRIX, 0.6, np.array([0.03, 0.004, 0.04]), ADDED_COM_FOOT),
}
OFFSET_WRENCH = np.array([200.0, -150.0, 145.0, 3.0, -4.0, 2.0])  # an offset of 289 N and 5.4 N m


def random_gravity(rng, n, size=9.81):
    direction = rng.standard_normal((n, 3))
    return size * direction / np.linalg.norm(direction, axis=1, keepdims=True)


def hip_gravity(front, side):
    """Gravity in a frame that points down, by the angles of two hips in degrees."""
    a, b = np.radians(front), np.radians(side)
    return 9.81 * np.stack([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)], axis=-1)


def swept_gravity(n, front=35.0, side=45.0, turns=(5.0, 1.1), begin=0.3):
    """Gravity while two hips sweep, degrees to either side, each so many times."""
    phase = 2.0 * np.pi * np.linspace(0.0, 1.0, n)
    return hip_gravity(front * np.sin(turns[0] * phase), side * np.sin(turns[1] * phase + begin))


def make_set(matrix, offset, limb, added, gravity, *, noise=0.0, rng=None, name="set"):
    """Read r = C^-1 (M_b + M_a) g + o; ``noise`` is a share of each channel's spread."""
    response = np.linalg.pinv(matrix)
    wrench = gravity @ (wrench_of_gravity(*limb) + wrench_of_gravity(*added)).T
    raw = wrench @ response.T
    if noise:
        raw = raw + noise * raw.std(axis=0) * rng.standard_normal(raw.shape)
    return InSituSet(raw + offset, gravity, added_mass=added[0], added_com=added[1], name=name)


def paper_sets(sensor, rng, n=300, noise=0.0):
    """Sets 1-4 of the paper for one of its sensors; returns them and the true offset."""
    matrix, mass, com, places = SENSORS[sensor]
    offset = np.linalg.solve(matrix, OFFSET_WRENCH)
    sets = [
        make_set(
            matrix,
            offset,
            (mass, com),
            (added, place),
            swept_gravity(n),
            noise=noise,
            rng=rng,
            name=f"data set {i + 1}",
        )
        for i, (added, place) in enumerate(zip(ADDED_MASS, places, strict=True))
    ]
    return sets, offset


def noisy_sets(sensor, rng, n=600, noise=1.0, count=4):
    """Sets of the paper with times and noise that is white in the wrench; and the true offset."""
    sets, offset = paper_sets(sensor, rng, n=n)
    response, time = np.linalg.inv(SENSORS[sensor][0]), np.arange(n) / 10.0
    return [
        replace(one, raw=one.raw + noise * (NOISE * rng.standard_normal((n, 6))) @ response.T, time=time)
        for one in sets[:count]
    ], offset


def offsets_of(sets):
    return np.array([estimate_offset(one.raw, one.gravity).offset for one in sets])


def with_arrays(one, raw, gravity, added_com=None):
    place = one.added_com if added_com is None else added_com
    return InSituSet(raw, gravity, added_mass=one.added_mass, added_com=place, name=one.name)


def moving_sets(rng, noise, slower=1.0, own=1.0):
    """A leg that swings at about 1 Hz, or so many times slower, its motion known.

    What is added has so many times the inertia of a cube of steel about its centre.
    """
    matrix, mass, com, places = SENSORS["leg"]
    inertia = np.diag([0.3, 0.28, 0.02]) + mass * (com @ com * np.eye(3) - np.outer(com, com))
    response, time = np.linalg.inv(matrix), slower * np.arange(1500) / 100.0
    sets = []
    for added, place in zip((0.0, 0.703, 0.703, 0.703), places, strict=True):
        phase = rng.uniform(0.0, 2.0 * np.pi, (2, 3))

        def turn(t, phase=phase):
            t = t / slower
            swing = 0.5 * np.sin(2.0 * np.pi * np.array([0.7, 0.9, 1.1]) * t[:, None] + phase[0])
            return Rotation.from_euler("xyz", swing + 0.2 * np.sin(2.0 * np.pi * 1.7 * t[:, None] + phase[1]))

        def rate(t, turn=turn):
            return (turn(t - 1e-4).inv() * turn(t + 1e-4)).as_rotvec() / 2e-4

        omega, alpha = rate(time), (rate(time + 1e-3) - rate(time - 1e-3)) / 2e-3
        gravity = turn(time).inv().apply([0.0, 0.0, 9.81])
        moment = mass * com + added * place
        cube = added * np.cbrt(added / 7850.0) ** 2 / 6.0
        total = (
            inertia + added * (place @ place * np.eye(3) - np.outer(place, place)) + own * cube * np.eye(3)
        )
        force = (mass + added) * gravity - np.cross(alpha, moment) - np.cross(omega, np.cross(omega, moment))
        torque = np.cross(moment, gravity) - alpha @ total - np.cross(omega, omega @ total)
        wrench = np.concatenate([force, torque], axis=1) + noise * NOISE * rng.standard_normal((1500, 6))
        sets.append(InSituSet(wrench @ response.T + 500.0, gravity, added, place, omega, alpha, time=time))
    return sets, inertia


def errors(fit, sensor, offset):
    """What a fit's matrix, offset and limb are off by, one after the other, shape (46,)."""
    matrix, mass, com, _ = SENSORS[sensor]
    return np.concatenate(
        [
            (fit.matrix - matrix).ravel(),
            fit.offset - offset,
            [fit.limb.mass - mass],
            fit.limb.mass_com - mass * com,
        ]
    )
