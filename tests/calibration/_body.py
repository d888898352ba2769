"""A rigid body on two feet whose forces are known, what its sensors read, and what it believes."""

import numpy as np
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation
from surefoot.calibration.moment.rows import Block
from surefoot.calibration.moment.stream import MomentStream

from surefoot.calibration import GRAVITY, FeetLayout, FootLayout, OnlineSetup, Parameters, Reference
from surefoot.calibration.moment.config import MomentFilterConfig

MASS, DT, LENGTH = 5.3, 1.0 / 80.0, 0.17
CORNERS = [(0.1, 0.05), (0.1, -0.04), (-0.06, 0.05), (-0.07, -0.05)]
SENSOR = {
    "position_sensor_sole": (0.01, -0.005, 0.06),
    "R_sole_sensor": Rotation.from_rotvec([0.1, -0.4, 0.3]).as_matrix(),
}


def cells(name, **options):
    return FootLayout.load_cells(name, CORNERS, **options)


def ankle(name, **options):
    return FootLayout.force_torque(name, **SENSOR, **options)


def both(name):
    return FootLayout.combined(name, cells(name), ankle(name))


LAYOUTS = {
    "cells": FeetLayout((cells("left"), cells("right"))),
    "three and five cells": FeetLayout(
        (
            FootLayout.load_cells("left", CORNERS[:3]),
            FootLayout.load_cells("right", [*CORNERS, (0.02, 0.01)]),
        )
    ),
    "one plate": FeetLayout((cells("plate"),)),
    "ankles": FeetLayout((ankle("left"), ankle("right"))),
    "cells left, ankle right": FeetLayout((cells("left"), ankle("right"))),
    "both on each": FeetLayout((both("left"), both("right"))),
}
# Sizes of the reference's errors, each about ten times what is usual, so that second orders show.
SIZES = {"com": 0.02, "sole": 0.02, "mass": 0.05, "acceleration": 0.3, "delay": 0.02}


def block_of(force, motion, swing):
    """A block of samples that may all be learnt from, of a robot that stands."""
    ones = np.ones(len(force))
    return Block(force=force, motion=motion, swing=swing, stand=ones, use=ones)


def flat(stream, believed):
    """The flat references of beliefs of n samples, shape (n, R)."""
    samples = zip(*believed, strict=True)
    return np.stack([stream._front_end.motions.flatten(Reference(*sample)) for sample in samples])


class Body:
    """A rigid-body state with known forces on the feet, what its sensors read, and its beliefs.

    Args:
        layout: The feet.
        seed: Of everything that is random.
        cross_talk: Share that six-axis sensors talk across.
    """

    def __init__(self, layout, seed, cross_talk=0.0):
        self.rng = rng = np.random.default_rng([17, seed])
        # One group a block: rows are then exact for an average, however the body moves.
        self.config = MomentFilterConfig(cross_talk=cross_talk, every=8, average=8, settle=3)
        setup = OnlineSetup(
            layout=layout,
            mass=MASS,
            initial=Parameters(np.ones(layout.channels), np.zeros(layout.channels)),
            dt=DT,
            foot_length=LENGTH,
        )
        self.stream = MomentStream(setup, self.config)
        self.layout, self.unknowns = layout, self.stream.unknowns
        self.feet, self.n = len(layout.feet), self.config.every + 2 * self.config.settle
        unknowns, K = self.unknowns, layout.channels

        x = unknowns.start.copy()
        x[unknowns.scale] += 0.1 * rng.normal(size=unknowns.scales) * (unknowns.std[unknowns.scale] > 0)
        x[unknowns.offset] = 0.03 * rng.normal(size=K)
        self.x = x
        self.A = np.zeros((K, K))
        self.A[unknowns.out, unknowns.inp] = x[unknowns.scale]

        self.position = rng.normal(size=(self.n, self.feet, 3)) * (0.1, 0.1, 0.03)
        self.R = Rotation.from_rotvec(rng.normal(size=(self.n * self.feet, 3)) * 0.2).as_matrix()
        self.R = self.R.reshape(self.n, self.feet, 3, 3)
        self.com = np.array([0.0, 0.0, 0.3]) + rng.normal(size=(self.n, 3)) * 0.03
        # The force of each channel changes evenly, so that its rate has no higher orders.
        self.at_rest, self.rate = self._forces(), self._forces()

    def _forces(self):
        """Draw the true channels of feet on the ground, shape (K,)."""
        parts = []
        for foot in self.layout.feet:
            wrench = self.rng.normal(size=6) * (5.0, 5.0, 10.0, 0.5, 0.5, 0.3) + (0, 0, 25.0, 0, 0, 0)
            if not all(sensor.six_axis for sensor in foot.sensors) and len(foot.sensors) == 1:
                wrench *= (0, 0, 1, 1, 1, 0)  # cells alone: neither shear nor twist
            for sensor in foot.sensors:
                share = np.linalg.pinv(sensor.wrench_map) @ wrench
                null = null_space(sensor.wrench_map)
                parts.append(share + null @ self.rng.normal(size=null.shape[1]) * 3.0)
        return np.concatenate(parts)

    def channels(self, late=0.0):
        """True channels at all samples, or a while later, shape (n, K)."""
        time = (np.arange(self.n) - self.n / 2) * DT + late
        return self.at_rest + time[:, None] * self.rate

    def block(self, com=(0.0, 0.0), mass=0.0, acceleration=(0.0, 0.0, 0.0), delay=0.0, sole=(0.0, 0.0)):
        """What the robot reads and believes when its reference is wrong by this much."""
        F = self.channels(delay)
        true_mass = MASS / (1.0 + mass)
        force, moment = np.zeros((self.n, 3)), np.zeros((self.n, 3))
        for foot, (side, where) in enumerate(zip(self.layout.feet, self.layout.slices, strict=True)):
            for k in range(self.n):
                wrench = side.wrench_map @ F[k, where]
                f, t = self.R[k, foot] @ wrench[:3], self.R[k, foot] @ wrench[3:]
                force[k] += f
                moment[k] += t + np.cross(self.position[k, foot] - self.com[k], f)
        believed = Reference(
            com=self.com + np.array([*com, 0.0]),
            com_acceleration=force / true_mass - [0.0, 0.0, GRAVITY] + acceleration,
            # A robot that thinks itself heavier thinks all its parts heavier.
            angular_momentum_rate=moment * (1.0 + mass),
            position_sole=self.position + np.array([[-1.0], [1.0]])[: self.feet] * np.array([*sole, 0.0]),
            R_level_sole=self.R,
            stance=np.ones((self.n, self.feet), bool),
            swing=np.zeros((self.n, self.feet), bool),
            accelerometer=np.zeros((self.n, 3)),
            gyroscope=np.zeros((self.n, 3)),
        )
        F0 = np.linalg.solve(self.A, (self.channels() - self.offset).T).T
        return block_of(F0, flat(self.stream, believed), np.zeros((self.n, self.feet)))

    @property
    def offset(self):
        """True offsets b of the channels in N or N m: F = A F0 + b."""
        return self.A @ (self.x[self.unknowns.offset] * self.unknowns.unit)

    def rows(self, mean, block):
        """The Newton-Euler rows of one block."""
        rows, places = self.stream.newton_euler.rows(mean, block, np.ones(self.stream.newton_euler.kinds))
        unknowns, matrix = self.unknowns, np.zeros(self.A.shape)
        matrix[unknowns.out, unknowns.inp] = mean[unknowns.scale]
        np.testing.assert_allclose(rows.H[:, unknowns.offset], places @ matrix * unknowns.unit, atol=1e-14)
        return rows

    def residual(self, told=1.0, **errors):
        """H x - y at the truth, the errors of the reference told ``told`` times."""
        unknowns, x = self.unknowns, self.x.copy()
        x[unknowns.com] = told * np.asarray(errors.get("com", (0.0, 0.0))) / LENGTH
        x[unknowns.mass] = told * errors.get("mass", 0.0)
        x[unknowns.acceleration] = told * np.asarray(errors.get("acceleration", np.zeros(3))) / GRAVITY
        x[unknowns.delay] = told * errors.get("delay", 0.0)
        x[unknowns.sole] = told * np.asarray(errors.get("sole", (0.0, 0.0))) / LENGTH
        rows = self.rows(x, self.block(**errors))
        assert (rows.variance > 0.0).all()
        return rows.H @ x - rows.y
