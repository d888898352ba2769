"""The in-situ paper as printed, from the raw samples to the matrix (Traversaro, Pucci and Nori, 2015).

1. :func:`savitzky_golay` and :func:`static_samples`: the samples at rest (II-B, IV).
2. :func:`estimate_offset`: the three-space that they lie in (III-A, Lemma 1) and the offset (III-B).
3. :func:`estimate_matrix`: the matrix and the limb from three or more added masses (III-C, Lemma 2).

All three are the paper's least squares without its Kronecker products, which for 240,000 samples would fill
460 MB and take more than fifty times as long.
"""

from surefoot.calibration.in_situ.paper_matrix import PaperMatrixFit, estimate_matrix
from surefoot.calibration.in_situ.paper_offset import OffsetFit, estimate_offset
from surefoot.calibration.in_situ.static import savitzky_golay, static_samples

__all__ = [
    "OffsetFit",
    "PaperMatrixFit",
    "estimate_matrix",
    "estimate_offset",
    "savitzky_golay",
    "static_samples",
]
