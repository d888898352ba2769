"""The centre of pressure: of cells, of a foot, and of both feet together.

The centre of pressure of forces F_i at places p_i is (CoP paper, Eq. 8)

    p = sum p_i F_i / sum F_i.

It exists only where something presses: below a threshold of 5 N (a tenth of a NAO's weight, the paper's
epsilon) it is NaN here. Holding the last value for an observation is the business of whoever observes.

For a wrench (fx, fy, fz, tx, ty, tz) at and in a sole frame the same point on the sole is (-ty, tx) / fz.
Both feet are brought together as *moments*, (Fz, Fz px, Fz py), which add and are linear in the cells'
forces; the one division comes last. A force plate is one foot alone: shapes given with a 2 for the feet
have a 1 then. A series of samples has them first, written as ``...``.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_floating, check_tail
from surefoot.calibration.layout import FeetLayout

FORCE_THRESHOLD = 5.0
"""Vertical force in N at or below which there is no centre of pressure (CoP paper, section 3.2)."""


def cop_of_cells(force: Array, position: Array, threshold: float = FORCE_THRESHOLD) -> Array:
    """Find the centre of pressure of vertical forces at known places (CoP paper, Eq. 8), shape (..., 2) in m.

    Forces in N, (..., k), are at places in m, (..., k, 2) or (..., k, 3), whose heights are not used. The
    result is in the frame of the places: sole positions give the foot's centre of pressure, world positions
    that in the world. Cells of several feet may be given at once. It is NaN where the sum of forces does not
    exceed the threshold in N, or one is not finite. ValueError if the shapes do not belong together or the
    dtypes are not floating.

    >>> import numpy as np
    >>> corners = np.array([(0.1, 0.05), (0.1, -0.05), (-0.1, 0.05), (-0.1, -0.05)])
    >>> cop_of_cells(np.array([[6.0, 6.0, 2.0, 2.0], [1.0, 1.0, 1.0, 1.0]]), corners)
    array([[0.05, 0.  ],
           [ nan,  nan]])
    """
    check_floating(force, "force")
    check_floating(position, "position")
    if force.ndim < 1 or position.ndim < 2 or position.shape[-1] not in (2, 3):
        raise ValueError(
            "'force' must have shape (..., cells) and 'position' (..., cells, 2) or (..., cells, 3), "
            f"got {force.shape} and {position.shape}."
        )
    if force.shape[-1] != position.shape[-2]:
        raise ValueError(
            f"'force' holds {force.shape[-1]} cells on its last axis but 'position' places "
            f"{position.shape[-2]}: got shapes {force.shape} and {position.shape}."
        )
    known = np.isfinite(force).all(axis=-1)
    known_force = np.where(known[..., None], force, 0.0)
    moment = (position[..., :2] * known_force[..., None]).sum(axis=-2)
    total = np.where(known, known_force.sum(axis=-1), np.nan)
    return cop_of_moments(total, moment, threshold)


def cop_of_moments(fz: Array, moment: Array, threshold: float = FORCE_THRESHOLD) -> Array:
    """Divide first moments (Fz px, Fz py) in N m, shape (..., 2), by the vertical force in N, shape (...).

    The centre of pressure in m, shape (..., 2), is NaN where the force does not exceed the threshold in N.
    """
    valid = cop_is_valid(fz, threshold)[..., None]
    safe_fz = np.where(valid, fz[..., None], 1.0)
    return np.where(valid, moment / safe_fz, np.nan)


def cop_is_valid(fz: Array, threshold: float = FORCE_THRESHOLD) -> Array:
    """Return where a vertical force in N is large enough, and finite, for a centre of pressure, shape (...).

    A negative threshold is refused with a ValueError: forces that pull have no centre of pressure.
    """
    if not threshold >= 0:
        raise ValueError(f"'threshold' must not be negative, got {threshold} N.")
    return (fz > threshold) & np.isfinite(fz)


def _finite_or_nan(array: Array) -> Array:
    """Return NaN for infinities, which passes through products with zero without a warning."""
    return np.where(np.isfinite(array), array, np.nan)


def sole_wrenches(force: Array, layout: FeetLayout) -> Array:
    """Add the calibrated channels of each foot, shape (..., K), up to the wrench on its sole.

    Wrenches (fx, fy, fz, tx, ty, tz) at and in the sole frames in N and N m, shape (..., 2, 6). What is not
    finite in one foot leaves the other alone. ValueError says that there is not one force a channel.
    """
    check_floating(force, "force")
    layout.check_raw(force, "force")
    finite = _finite_or_nan(force)
    wrenches = [
        (finite[..., None, where] @ foot.wrench_map.T)[..., 0, :]
        for foot, where in zip(layout.feet, layout.slices, strict=True)
    ]
    return np.stack(wrenches, axis=-2)


def cop_of_wrench(wrench: Array, threshold: float = FORCE_THRESHOLD) -> Array:
    """Find the centre of pressure on the plane z = 0 of a wrench's own frame, (-ty, tx) / fz in m, (..., 2).

    Wrenches have the shape (..., 6), or are refused with a ValueError; NaN up to a threshold of fz in N.
    """
    check_tail(wrench, (6,), "wrench")
    finite = _finite_or_nan(wrench)
    moment = np.stack([-finite[..., 4], finite[..., 3]], axis=-1)
    return cop_of_moments(finite[..., 2], moment, threshold)


def level_moments(wrench_sole: Array, position_sole: Array, R_level_sole: Array) -> tuple[Array, Array]:
    """Take the feet's wrenches to a level frame as vertical forces and their first moments.

    Each foot's centre of pressure is taken at the height of its own sole's origin, so that for a flat foot

        Fz p = Fz p_sole + (-t_y, t_x),    t the torque about the sole's origin in level axes.

    Wrenches are at and in the sole frames, (..., 2, 6); origins of the soles in m, (..., 2, 3); rotations
    from sole to level frame, (..., 2, 3, 3). Returns Fz in N, (..., 2), and (Fz px, Fz py) in N m, (..., 2,
    2); ValueError if a shape is not as here.
    """
    check_tail(wrench_sole, ("feet", 6), "wrench_sole")
    feet = wrench_sole.shape[-2]
    check_tail(position_sole, (feet, 3), "position_sole")
    check_tail(R_level_sole, (feet, 3, 3), "R_level_sole")
    finite = _finite_or_nan(wrench_sole)
    force_level = (R_level_sole @ finite[..., :3, None])[..., 0]
    torque_level = (R_level_sole @ finite[..., 3:, None])[..., 0]
    fz = force_level[..., 2]
    lever = np.stack([-torque_level[..., 1], torque_level[..., 0]], axis=-1)
    return fz, position_sole[..., :2] * fz[..., None] + lever


def cop_of_feet(
    wrench_sole: Array, position_sole: Array, R_level_sole: Array, threshold: float = FORCE_THRESHOLD
) -> Array:
    """Find the centre of pressure of both feet together in a level frame or in the world in m, (..., 2).

    It is NaN up to a threshold of the total vertical force in N; arguments are those of
    :func:`level_moments`.
    """
    fz, moment = level_moments(wrench_sole, position_sole, R_level_sole)
    return cop_of_moments(fz.sum(axis=-1), moment.sum(axis=-2), threshold)


def moment_rows(layout: FeetLayout, position_sole: Array, R_level_sole: Array) -> Array:
    """Write the feet's vertical forces and first moments as linear maps of all channels.

    ``sum(moment_rows(...) @ force, feet)`` is (Fz, Fz px, Fz py) of :func:`level_moments`, whose arguments
    they take: the rows of every estimator that fits channels to a reference, shape (..., 2, 3, K), zero for
    the channels of the other foot.
    """
    feet = len(layout.feet)
    check_tail(position_sole, (feet, 3), "position_sole")
    check_tail(R_level_sole, (feet, 3, 3), "R_level_sole")
    return level_rows(layout.wrench_map, position_sole, R_level_sole)


def level_rows(wrench_map: Array, position_sole: Array, R_level_sole: Array) -> Array:
    """Return :func:`moment_rows` without its checks, of feet whose channels make up wrenches by (F, 6, K)."""
    force_level = R_level_sole @ wrench_map[..., :3, :]
    torque_level = R_level_sole @ wrench_map[..., 3:, :]
    fz = force_level[..., 2:3, :]
    lever = np.stack([-torque_level[..., 1, :], torque_level[..., 0, :]], axis=-2)
    return np.concatenate([fz, position_sole[..., :2, None] * fz + lever], axis=-2)
