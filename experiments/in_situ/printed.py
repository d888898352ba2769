"""What the in-situ paper (Traversaro, Pucci and Nori, ICRA 2015) printed in its Tables I to III."""

from typing import NamedTuple

Triple = tuple[float, float, float]


class PrintedRow(NamedTuple):
    """What a sensor showed of a validation set, by this and the maker's matrix; minus signs are lost."""

    axes: Triple  # semi-axes in N (Table I)
    axes_maker: Triple
    mass: float  # added, in kg (Table II)
    mass_maker: float
    place: Triple | None  # its centre of mass in cm (Table III); None where nothing was added
    place_maker: Triple | None

    @property
    def ratio(self) -> float:
        """Longest over shortest semi-axis, proposed."""
        return self.axes[0] / self.axes[2]


PRINTED = {
    ("foot", 5): PrintedRow((13.6, 13.1, 12.9), (13.5, 10.2, 4.6), 0.53, 0.06, (31, 8.8, 8.3), (273, 83, 81)),
    ("foot", 6): PrintedRow((13.5, 12.9, 12.7), (13.6, 10.5, 9.4), 0.52, 0.27, (19, 9.9, 5), (30, 18, 18)),
    ("foot", 7): PrintedRow((8.4, 7.9, 7.4), (8.5, 6.9, 6.2), -0.03, -0.13, None, None),
    ("foot", 8): PrintedRow((13.7, 12.5, 12.0), (15.7, 13.6, 10.4), 0.46, 0.45, (5.5, 9, 3.2), (8.6, 12, 10)),
    ("leg", 5): PrintedRow((34.4, 33.3, 32.5), (76.5, 49.4, 45.6), 0.51, 2.77, (28, 11, 29), (16, 6.5, 29)),
    ("leg", 6): PrintedRow((34.8, 33.5, 32.8), (82.4, 49.3, 47.3), 0.54, 3.04, (17, 9.7, 30), (12, 5.1, 27)),
    ("leg", 7): PrintedRow((30.9, 28.2, 26.9), (77.0, 44.5, 40.0), -0.04, 2.39, None, None),
    ("leg", 8): PrintedRow(
        (35.52, 33.3, 32.2), (88.9, 49.5, 48.3), 0.51, 3.25, (3.8, 8.8, 32), (7.5, 4.9, 26)
    ),
}
"""Rows by sensor and data set; the paper's limb is unknown, and so is the truth of its forces."""
