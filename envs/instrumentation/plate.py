r"""How a rigid plate shares a load among the cells that it rests on.

Springs :math:`k_i` at :math:`(x_i, y_i)` under a rigid plate that sinks by :math:`z` and turns by
:math:`(\theta_x, \theta_y)` give :math:`F_i = k_i (z + \theta_x y_i - \theta_y x_i)`, that is
:math:`F = K W^T u` with :math:`W` the map from cell forces to the load :math:`w = (f_z, t_x, t_y) = W F`.
Hence

.. math:: F = K W^T (W K W^T)^{-1} w.

Three numbers go in and four come out, so one combination of the four forces is always zero. With equal
stiffness on a rectangle it is the warp (+, -, +, -) around the corners. Horizontally all cells are taken to
be equally stiff.
"""

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats


class SolePlate:
    """The statics of one sole: a rigid plate on four springs, which are its load cells.

    Cells have places in the sole frame in m, (4, 2) or (4, 3), and stiffnesses in any one unit, (4,).
    ``load_of_cells`` is the load (fz, tx, ty) per force of each cell, (3, 4), 1 and m; ``share`` the forces
    of the cells per load at the sole's origin, (4, 3), 1 and 1/m; ``constraint`` the unit combination of the
    four forces that is zero under any load, (4,); ``across`` the horizontal forces, along x, then y, per load
    (fx, fy, tz) at the origin, (8, 3). ValueError if a shape is wrong, a stiffness is not positive or the
    cells lie on one line.

    >>> plate = SolePlate([(0.1, 0.05), (0.1, -0.05), (-0.1, 0.05), (-0.1, -0.05)], [1.0, 1.0, 1.0, 1.0])
    >>> plate.share @ (40.0, 0.0, 0.0)
    array([10., 10., 10., 10.])
    """

    def __init__(self, position_cell_sole: ArrayLike, stiffness: ArrayLike) -> None:
        position = np.asarray(position_cell_sole, dtype=np.float64)
        k = np.asarray(stiffness, dtype=np.float64)
        if position.shape not in ((4, 2), (4, 3)) or not np.isfinite(position).all():
            raise ValueError(
                "A sole plate rests on four cells: give finite positions in the sole frame in m, of shape "
                f"(4, 2) or (4, 3); got shape {position.shape}: {position.tolist()}."
            )
        if k.shape != (4,) or not np.isfinite(k).all() or not (k > 0.0).all():
            raise ValueError(
                "A sole plate needs four positive finite stiffnesses, one a cell (four ones for equals); "
                f"got {k.tolist()}."
            )
        x, y = position[:, 0], position[:, 1]
        if np.linalg.svd(position[:, :2] - position[:, :2].mean(axis=0), compute_uv=False)[1] < 1e-6:
            raise ValueError(
                f"The cells of a sole plate lie on one line, so that it would tip over: {position.tolist()}."
            )
        self.load_of_cells: Floats = np.stack([np.ones(4), y, -x])
        spread = k[:, None] * self.load_of_cells.T
        self.share: Floats = spread @ np.linalg.inv(self.load_of_cells @ spread)
        null = np.linalg.svd(self.load_of_cells)[2][3]
        constraint = np.sign(null[0]) * null / k
        self.constraint: Floats = constraint / np.linalg.norm(constraint)
        turn = np.concatenate([y.mean() - y, x - x.mean()]) / (4.0 * (x.var() + y.var()))
        even = np.repeat(np.eye(2), 4, axis=0) / 4.0
        self.across: Floats = np.column_stack([even + np.outer(turn, [y.mean(), -x.mean()]), turn])
