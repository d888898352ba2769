"""What the CoP paper (PMC12899417) printed in Tables 2 to 6, to be set beside what comes out here."""

from typing import NamedTuple

import numpy as np


class WeightTable(NamedTuple):
    """Codes of eight cells under known loads and the lines through them, as in Table 2."""

    channel_names: tuple[str, ...]
    load: np.ndarray  # in kg, shape (n,)
    code: np.ndarray  # of the converters, shape (8, n)
    scale: np.ndarray  # in kg per count, shape (8,)
    offset: np.ndarray  # in kg, shape (8,)


class MethodErrors(NamedTuple):
    """Root-mean-square errors of the centre of pressure in m and of the vertical force in N."""

    cop: float
    vgrf: float


_CELLS = ("front-left", "front-right", "rear-left", "rear-right")

TABLE_2 = WeightTable(
    channel_names=tuple(f"{foot}/{cell}" for foot in ("left", "right") for cell in _CELLS),
    load=np.array([0.0, 0.01, 0.05, 0.2]),
    code=np.array(
        [
            [8347750, 8344582, 8326926, 8264253],
            [8347750, 8344582, 8301298, 8264254],
            [8322914, 8317325, 8301301, 8264263],
            [8322914, 8317325, 8301299, 8264278],
            [8322914, 8317426, 8301297, 8264254],
            [8322914, 8317356, 8301289, 8264261],
            [8322914, 8317320, 8301299, 8264262],
            [8321583, 8317321, 8301297, 8264267],
        ],
        dtype=np.float64,
    ),
    scale=np.array(
        [-2.38250654, -2.20853048, -3.47692594, -3.47779548, -3.4736872, -3.47589563, -3.47698378, -3.5299719]
    )
    * 1e-6,
    offset=np.array(
        [19.8895457, 18.4277626, 28.9285295, 28.9357592, 28.9017197, 28.9199912, 28.9290027, 29.3677097]
    ),
)
"""The paper's weighing. Six of the eight cells share one code for no load; two rows share three codes."""

TABLE_3 = {"initial": MethodErrors(0.1839, 5.298), "calibrated": MethodErrors(0.0005, 0.08)}
"""Before and after the paper's manual calibration from weights."""

WALKING_TABLES = {
    0.02: {"window": MethodErrors(0.0059, 0.4339), "quasi-static": MethodErrors(0.0108, 1.2949)},
    0.04: {"window": MethodErrors(0.0108, 0.5324), "quasi-static": MethodErrors(0.0166, 1.8646)},
    0.1: {"window": MethodErrors(0.0134, 1.0387), "quasi-static": MethodErrors(0.0199, 2.5220)},
}
"""Tables 4 to 6 by walking speed in m/s, against the paper's own offline-calibrated baseline."""
