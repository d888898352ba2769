"""The centre of pressure: of cells, of a foot, and of both feet together.

The centre of pressure of forces F_i at places p_i is (CoP paper, Eq. 8)

    p = sum p_i F_i / sum F_i.

It is defined only under load: up to a threshold of 5 N (a tenth of a NAO's weight, the paper's epsilon) it is
NaN here. Observations that hold the last valid value do so themselves.

For a wrench (fx, fy, fz, tx, ty, tz) at and in a sole frame the same point on the sole is (-ty, tx) / fz.
Both feet are combined as *moments*, (Fz, Fz px, Fz py), which are linear in the cells' forces. They are added
first and divided last. A force plate counts as a single foot: axes of length 2 for the feet then have length
1. Leading axes of a series of samples are written as ``...``.
"""

import numpy as np

from surefoot.calibration.arrays import Array
from surefoot.calibration.checks import check_floating, check_tail
from surefoot.calibration.layout import FeetLayout

FORCE_THRESHOLD = 5.0
"""Vertical force in N at or below which the centre of pressure is not defined (CoP paper, section 3.2)."""


def cop_of_cells(force: Array, position: Array, threshold: float = FORCE_THRESHOLD) -> Array:
    """Return the centre of pressure of vertical forces at known positions (CoP paper, Eq. 8) in m, (..., 2).

    The result is in the frame of the positions, which may belong to cells of several feet. It is NaN if the
    sum of the forces does not exceed the threshold, or a force is not finite.

    Args:
        force: Forces in N, shape (..., k).
        position: Positions in m, shape (..., k, 2) or (..., k, 3). Heights are not used.
        threshold: Sum of forces in N at or below which the centre of pressure is not defined.

    Raises:
        ValueError: If the shapes do not match or the dtypes are not floating.

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
    valid = np.isfinite(force).all(axis=-1)
    valid_force = np.where(valid[..., None], force, 0.0)
    moment = (position[..., :2] * valid_force[..., None]).sum(axis=-2)
    total = np.where(valid, valid_force.sum(axis=-1), np.nan)
    return cop_of_moments(total, moment, threshold)


def cop_of_moments(fz: Array, moment: Array, threshold: float = FORCE_THRESHOLD) -> Array:
    """Divide first moments (Fz px, Fz py) in N m, shape (..., 2), by the vertical force in N, shape (...).

    The centre of pressure in m, shape (..., 2), is NaN if the force does not exceed the threshold in N.
    """
    valid = cop_is_valid(fz, threshold)[..., None]
    safe_fz = np.where(valid, fz[..., None], 1.0)
    return np.where(valid, moment / safe_fz, np.nan)


def cop_is_valid(fz: Array, threshold: float = FORCE_THRESHOLD) -> Array:
    """Return whether vertical forces in N are finite and large enough for a centre of pressure, shape (...).

    Raises:
        ValueError: If the threshold is negative.
    """
    if not threshold >= 0:
        raise ValueError(f"'threshold' must not be negative, got {threshold} N.")
    return (fz > threshold) & np.isfinite(fz)


def _finite_or_nan(array: Array) -> Array:
    """Replace infinities by NaN, which can be multiplied by zero without a warning."""
    return np.where(np.isfinite(array), array, np.nan)


def sole_wrenches(force: Array, layout: FeetLayout) -> Array:
    """Return the wrenches on the soles that the calibrated channels, shape (..., K), add up to.

    Wrenches (fx, fy, fz, tx, ty, tz) are at and in the sole frames in N and N m, shape (..., 2, 6). Values
    that are not finite affect their own foot only. ValueError unless there is one force per channel.
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
    """Return the centre of pressure on the plane z = 0 of a wrench's frame, (-ty, tx) / fz in m, (..., 2).

    It is NaN if fz does not exceed the threshold in N. ValueError unless wrenches have the shape (..., 6).
    """
    check_tail(wrench, (6,), "wrench")
    finite = _finite_or_nan(wrench)
    moment = np.stack([-finite[..., 4], finite[..., 3]], axis=-1)
    return cop_of_moments(finite[..., 2], moment, threshold)


def level_moments(wrench_sole: Array, position_sole: Array, R_level_sole: Array) -> tuple[Array, Array]:
    """Convert the feet's wrenches to vertical forces and first moments in a level frame.

    Each foot's centre of pressure is at the height of its sole's origin. For a flat foot

        Fz p = Fz p_sole + (-t_y, t_x),    t the torque about the sole's origin in level axes.

    Args:
        wrench_sole: Wrenches at and in the sole frames, shape (..., 2, 6).
        position_sole: Origins of the soles in m, shape (..., 2, 3).
        R_level_sole: Rotations from the sole frames to the level frame, shape (..., 2, 3, 3).

    Returns:
        Fz in N, shape (..., 2), and (Fz px, Fz py) in N m, shape (..., 2, 2).

    Raises:
        ValueError: If an argument has another shape.
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
    """Return the centre of pressure of both feet together in a level frame in m, shape (..., 2).

    It is NaN if the total vertical force does not exceed the threshold in N. The other arguments are those of
    :func:`level_moments`.
    """
    fz, moment = level_moments(wrench_sole, position_sole, R_level_sole)
    return cop_of_moments(fz.sum(axis=-1), moment.sum(axis=-2), threshold)


def moment_rows(layout: FeetLayout, position_sole: Array, R_level_sole: Array) -> Array:
    """Return the feet's vertical forces and first moments as linear maps of all channels, (..., 2, 3, K).

    The product with the channels' forces is (Fz, Fz px, Fz py) of each foot, as in :func:`level_moments`,
    which takes the same arguments. A foot's rows are zero for the channels of the other foot.
    """
    feet = len(layout.feet)
    check_tail(position_sole, (feet, 3), "position_sole")
    check_tail(R_level_sole, (feet, 3, 3), "R_level_sole")
    return level_rows(layout.wrench_map, position_sole, R_level_sole)


def level_rows(wrench_map: Array, position_sole: Array, R_level_sole: Array) -> Array:
    """Return :func:`moment_rows` without its checks, for wrench maps of shape (F, 6, K)."""
    force_level = R_level_sole @ wrench_map[..., :3, :]
    torque_level = R_level_sole @ wrench_map[..., 3:, :]
    fz = force_level[..., 2:3, :]
    lever = np.stack([-torque_level[..., 1, :], torque_level[..., 0, :]], axis=-2)
    return np.concatenate([fz, position_sole[..., :2, None] * fz + lever], axis=-2)
