r"""A block's effect on the momentum, and its measurement: linear in the unknowns.

With C_n the components of a unit force of each channel about o, g_n those of gravity, and f = a F0 + b + u,

    end of the block:   p + sum_n dt_n ((1 + m) C_n f_n + g_n + w)
    mean over it:       p + sum_n s_n dt_n ((1 + m) C_n f_n + g_n + w)

where s_n is the share of the block that comes after sample n, its own end included. A robot that is heavier
than it believes (m < 0) weighs more, and moves less by the same forces. A delay tau shifts the
measurement by the force that acted, and the centre of mass by its velocity.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array, skew
from surefoot.calibration.cop import level_rows
from surefoot.calibration.moment.blocks import Block
from surefoot.calibration.moment.columns import SHEAR, Columns, find_talks
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.state import Belief, TiltState
from surefoot.calibration.setup import OnlineSetup

LEAST_LOAD = 0.2
"""Load in body weights that a centre of pressure is divided by at least: o is any point, and less of the
weight is on the feet in the air only."""

LEAST_COSINE = 0.5
"""Smallest cosine of a sole's lean by which the normal force is divided. A foot that leans by more than 60
degrees does not stand on its sole."""

TILT_MEMORY = 5.0  # time in s over which the tilt of the loaded soles is averaged, several steps
TILT_MEAN, TILT_STD = 0.5, 0.7
"""Expectation and standard deviation of the error of the centre of mass, as shares of the mean tilt times its
height. A wrong attitude moves it by that distance and a slope of the ground does not, and both are equally
likely. A standard deviation of 0.5 to 1 was best on walking and standing robots with IMUs biased by 0.5
m/s^2."""

TILT_NOISE = 0.008
"""Sine of a mean tilt that has no effect: half a degree, twice the attitude error that the mode ``FREE``
allows for."""

_ORDER = ([2, 3, 4], [2, 3, 4, 0, 1, 5])
"""Components of (force, torque) in the order of the momentum: (P_z, H_x, H_y), then (P_x, P_y, H_z)."""


class Rows(NamedTuple):
    """A block's effect on the momentum, and its measurement; C components, N unknowns."""

    mean: Array  # the block's mean momentum by the unknowns at its start, shape (C, N)
    mean_rest: Array  # its constant part, shape (C,)
    end: Array  # the momentum at its end, shape (C, N)
    end_rest: Array  # as above
    measured: Array  # measurement of the mean, shape (C,)
    at_end: Array  # measurement at the block's end, shape (C,)
    variance: Array  # of the measurement, as stated, shape (C, C)
    walk: Array  # variance that the block adds to the momentum at its end, shape (C, C)
    crossed: Array  # the block's mean momentum by each channel's place and each channel's F0, shape (C, K, K)
    lasting: Array  # variance of errors that last longer than a block, as an outside wrench does, shape (C,)
    point: Array  # o in m, shape (3,)
    height: float  # of the centre of mass over o in m
    tilt: Array
    """Sine of the tilt of the loaded soles times the height in m, in axes that head as feet do; NaN while no
    foot bears load, and of round feet, shape (2,)."""


class Model:
    """The rows of one setup.

    Args:
        setup: The robot.
        config: Options.
        columns: The unknowns.

    Attributes:
        velocity_variance: Of a block's mean velocity in m^2/s^2, shape (3,).
        spin_variance: Of its mean angular momentum by the mass in m^4/s^2.
        talk_to: Channels that may show another one's load, shape (T,).
        talk_from: The channels of these loads, shape (T,).
    """

    def __init__(self, setup: OnlineSetup, config: Moment, columns: Columns) -> None:
        self._columns, self._wrench_map, self._gravity = columns, setup.layout.wrench_map, setup.gravity
        self._flat = all(foot.flat for foot in setup.layout.feet)
        self._shear = columns.components == SHEAR
        self._order = _ORDER[int(self._shear)]
        self.velocity_variance = (
            np.array([config.velocity_noise, config.velocity_noise, config.vertical_noise]) ** 2
        )
        self.spin_variance = config.momentum_noise**2
        self._ripple = config.ripple
        self.talk_to, self.talk_from = find_talks(setup.layout)

    def rows(self, block: Block, published: Array, lasting: Array, spare: Array | None = None) -> Rows:
        """Write the rows of a block.

        Args:
            block: The samples.
            published: Scales, offsets and drift, by which the point o is found, shape (M,).
            lasting: Variance of each channel's force in W^2 that lasts and that no unknown stands for,
                shape (K,).
            spare: Map of the forces of channels in use to all forces, shape (K, K), or ``None`` if all are.
        """
        columns, dt = self._columns, block.dt
        T, C = block.duration, columns.components
        a, b, u = (published[part] for part in (columns.scale, columns.offset, columns.drift))
        com, sole, rotation = block.com, block.sole, block.rotation
        force = a * block.force + b + u
        each_force = force if spare is None else force @ spare.T
        point = self._point(each_force, sole, rotation, dt)
        height = float((com[:, 2] - point[2]).mean())
        own = self._of_channels(sole - point, rotation)
        unit = own if spare is None else own @ spare
        (gravity, along), heading = self._weigh(com - point), _heading(rotation)
        summed = np.einsum("nck,nk->nc", unit, force)
        # Share of the block after the beginning of a sample's interval: all of it for the first.
        after = np.cumsum(dt[::-1])[::-1] / T

        def add_up(share: Array) -> tuple[Array, Array]:
            H = np.zeros((C, columns.size))
            weighted = unit * share[:, None, None]
            reach = weighted.sum(axis=0)
            H[:, columns.scale] = np.einsum("nck,nk->ck", weighted, block.force)
            H[:, columns.offset], H[:, columns.drift] = reach, reach
            shown = block.force[:, self.talk_from]
            H[:, columns.talk] = np.einsum("nck,nk->ck", weighted[:, :, self.talk_to], shown)
            H[:, columns.com] = share.sum() * along @ heading
            H[:, columns.mass] = (share @ summed)[:, None]
            H[:, columns.delay] = -share.sum() * (along @ block.velocity.mean(axis=0)[:2])[:, None]
            H[:, columns.momentum] = np.eye(C)
            H[:, columns.wrench] = share.sum() * np.eye(C)
            return H, share @ gravity

        mean, mean_rest = add_up(dt * after)
        mean[:, columns.delay] -= (dt @ (summed + gravity) / T)[:, None]
        end, end_rest = add_up(dt)
        each, variance = self._measure(block, point)
        read = block.read if spare is None else block.read[:, np.diagonal(spare) > 0.5]
        return Rows(
            mean=mean,
            mean_rest=mean_rest,
            end=end,
            end_rest=end_rest,
            measured=dt @ each / T,
            at_end=each[-1],
            variance=variance,
            walk=self._walk(force, unit, read, dt),
            crossed=np.einsum("n,nck,nl->ckl", dt * after, unit, block.force),
            lasting=np.einsum("nck,n->ck", own, dt / T) ** 2 @ lasting,
            point=point,
            height=height,
            tilt=height * self._tilt(each_force, rotation) @ heading,
        )

    def _walk(self, force: Array, unit: Array, read: Array, dt: Array) -> Array:
        """Return the variance of the momentum by forces between the readings, shape (C, C).

        Chips have clocks of their own: each channel's change is an error of its own, and the larger the more
        samples a reading stands for.
        """
        held = len(dt) / max(float(read.sum(axis=0).min()), 1.0)
        change = np.diff(force, axis=0, prepend=force[:1]) * (dt * self._ripple * held)[:, None]
        change = np.einsum("nck,nk->nkc", unit, change).reshape(-1, unit.shape[1])
        walk: Array = change.T @ change
        return walk

    def _tilt(self, force: Array, rotation: Array) -> Array:
        """Return the level components of the mean normal of the loaded soles, shape (2,)."""
        load = np.maximum(force @ self._wrench_map[:, 2].T, 0.0)
        total = float(load.sum())
        if not self._flat or total < LEAST_LOAD * len(force):
            return np.full(2, np.nan)
        normal: Array = np.einsum("nf,nfx->x", load, rotation[:, :, :2, 2]) / total
        return normal

    def allow_for_tilt(
        self, belief: Belief, state: TiltState, rows: Rows, duration: float
    ) -> tuple[Belief, TiltState]:
        """Let the centre of mass be as far off as the soles are tilted, and return the new mean tilt.

        Soles that stand are parallel to the ground. If they are not level by the believed attitude, either
        the ground slopes or the attitude is wrong, because of a mounting error or a bias of the IMU. In the
        second case the centre of mass is off by the tilt times its height. The tilt counts from the first
        block on, because what is learnt from a wrong centre of mass stays in the map. It counts once, and
        again only if a later mean tilt is larger.
        """
        if np.isnan(rows.tilt).any():
            return belief, state
        time = min(state.time + duration, TILT_MEMORY)
        shift = state.shift + duration / time * (rows.tilt - state.shift)
        square = np.maximum(shift**2 - (TILT_NOISE * rows.height) ** 2, 0.0)
        grows, at = square > belief.com_shift**2, np.arange(2) + self._columns.com.start
        possible = np.where(grows, np.copysign(np.sqrt(square), shift), belief.com_shift)
        mean, covariance = belief.mean.copy(), belief.covariance.copy()
        mean[:, at] += TILT_MEAN * (possible - belief.com_shift)
        covariance[:, at, at] += TILT_STD**2 * (possible**2 - belief.com_shift**2)
        belief = belief._replace(mean=mean, covariance=covariance, com_shift=possible)
        return belief, TiltState(shift, time)

    def move(self, step: Array, velocity: Array) -> tuple[Array, Array]:
        """Return the transition of the unknowns to a point o that has moved.

        Args:
            step: By how much o has moved in m, shape (3,).
            velocity: Of the centre of mass in m/s, whose level part cells do not see, shape (3,).

        Returns:
            A transition, shape (N, N), and a constant that it adds, shape (N,).
        """
        columns, at = self._columns, self._columns.momentum.start
        x, y, z = step.tolist()
        transition, added = np.eye(columns.size), np.zeros(columns.size)
        # H <- H - step x P
        transition[at + 1, at], transition[at + 2, at] = -y, x
        if self._shear:
            transition[at + 1, at + 4], transition[at + 2, at + 3] = z, -z
            transition[at + 5, at + 4], transition[at + 5, at + 3] = -x, y
        else:
            added[at + 1], added[at + 2] = z * velocity[1] / self._gravity, -z * velocity[0] / self._gravity
        return transition, added

    def _point(self, force: Array, sole: Array, rotation: Array, dt: Array) -> Array:
        """Return the mean centre of pressure on the ground in m, shape (3,)."""
        total, x, y = np.einsum("nfck,nk,n->c", level_rows(self._wrench_map, sole, rotation), force, dt)
        least = max(float(total), LEAST_LOAD * float(dt.sum()))
        return np.array([x / least, y / least, sole[:, :, 2].min(axis=1).mean()])

    def _of_channels(self, sole: Array, rotation: Array) -> Array:
        """Return the components of a unit of each channel, shape (n, C, K), of soles seen from o."""
        if not self._shear:
            return self._of_cells(sole, rotation)
        force = rotation @ self._wrench_map[:, :3]
        torque = rotation @ self._wrench_map[:, 3:]
        arm = np.broadcast_to(sole[..., None], force.shape)
        torque = torque + np.cross(arm, force, axis=-2)
        components: Array = np.concatenate([force, torque], axis=-2).sum(axis=1)[:, self._order]
        return components

    def _of_cells(self, sole: Array, rotation: Array) -> Array:
        """Return the same for cells, which measure only the force normal to the sole.

        The mean force of the ground is vertical, also under a leaning sole: friction supplies the component
        along the sole. A cell that measures n under a sole that leans by theta therefore carries n / cos
        theta.
        """
        normal, tx, ty = self._wrench_map[:, 2], self._wrench_map[:, 3, None], self._wrench_map[:, 4, None]
        cosine = np.maximum(rotation[..., 2, 2], LEAST_COSINE)[..., None]
        moment = (
            sole[..., :2, None] * normal[:, None] - rotation[..., :2, :1] * ty + rotation[..., :2, 1:2] * tx
        )
        vertical, moment = normal / cosine, moment / cosine[..., None]
        components: Array = np.stack([vertical, moment[:, :, 1], -moment[:, :, 0]], axis=2).sum(axis=1)
        return components

    def _weigh(self, arm: Array) -> tuple[Array, Array]:
        """Return the components of the weight, shape (n, C), and how they change with its error d (C, 2)."""
        components = np.zeros((len(arm), self._columns.components))
        components[:, 0], components[:, 1], components[:, 2] = -1.0, -arm[:, 1], arm[:, 0]
        along = np.zeros((self._columns.components, 2))
        along[1, 1], along[2, 0] = 1.0, -1.0
        return components, along

    def _measure(self, block: Block, point: Array) -> tuple[Array, Array]:
        """Return the momentum by the robot's motion, shape (n, C), and its stated variance, shape (C, C)."""
        arm, velocity = block.end - point, block.velocity
        components = np.concatenate([velocity, block.spin + np.cross(arm, velocity)], axis=1) / self._gravity
        turned = skew(arm.mean(axis=0))
        noise = np.zeros((6, 6))
        noise[:3, :3] = np.diag(self.velocity_variance)
        noise[3:, :3] = turned * self.velocity_variance
        noise[:3, 3:] = noise[3:, :3].T
        noise[3:, 3:] = (turned * self.velocity_variance) @ turned.T + self.spin_variance * np.eye(3)
        order = self._order
        return components[:, order], noise[np.ix_(order, order)] / self._gravity**2


def force_and_wrench(components: int) -> Array:
    """Return which components are forces (1), and which torques (0), shape (C,)."""
    return np.array([1.0, 0.0, 0.0, 1.0, 1.0, 0.0][:components])


def _heading(rotation: Array) -> Array:
    """Return the rotation from axes that head as the feet do, level, shape (2, 2)."""
    x, y = rotation[:, :, :2, 0].mean(axis=(0, 1)).tolist()
    norm = float(np.hypot(x, y)) or 1.0
    return np.array([[x, -y], [y, x]]) / norm
