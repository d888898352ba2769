r"""The CoP paper's sliding window: Gauss-Newton on the last half second (Eq. 14).

.. math:: \min_\theta \sum_k w_F \left(\frac{F_{z,k} - F_{z,k}^{ref}}{M g}\right)^2
          + w_P \left|\frac{p_k - p_k^{ref}}{L}\right|^2 + |\theta - \theta_{last}|^2_{w_S}

over scales and offsets of all channels. It is solved every four samples by five iterations from the last
solution, after a standing start (Eqs. 12, 13, :mod:`surefoot.calibration.standing`).

Differences from the paper, where it does not specify something or an online stream requires it:

* Unknowns are a and b / (M g) of F = a F0 + b, both of order one, instead of c and d.
* The paper filters forces and accelerations at 10 Hz and then divides. The centre of pressure depends on the
  level frame, which may change from sample to sample. Here the filter is therefore applied to the *rows* of
  (Fz, Fz (p - p_ref)), which do not depend on the frame and are linear in the unknowns, and the division
  follows. Forces and reference pass the same filter, so that its delay cancels.
* "Outlier rejection around contact transitions" rejects samples shortly after a foot has gained or lost
  contact whose residual exceeds ``outlier_threshold`` standard deviations and the same multiple of the
  window's median.
* Samples that are off by half the weight or half a foot length are never used, because no calibration error
  is as large.
"""

from dataclasses import dataclass

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.centroidal import ground_reference
from surefoot.calibration.checks import check_counts, check_not_negative, check_positive
from surefoot.calibration.cop import cop_of_moments, moment_rows
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import Reference
from surefoot.calibration.setup import OnlineSetup


@dataclass(frozen=True, kw_only=True)
class Window:
    """Options of the sliding window, in body weights and foot lengths as in the paper."""

    window: float = 0.5
    """Length of the window in s."""

    every: int = 4
    """Samples between updates: 4 at 80 Hz are the paper's 20 Hz."""

    iterations: int = 5
    """Gauss-Newton iterations of one update."""

    cutoff: float | None = 10.0
    """Cutoff in Hz of the causal low-pass filter of forces and reference, or ``None`` for filtered logs."""

    delta_force: float = 0.01
    """Standard deviation of the vertical force against the model, in body weights (w_F = 1 / delta_F^2)."""

    delta_cop: float = 0.05
    """Standard deviation of the centre of pressure against the model, in foot lengths (w_P = 1 /
    delta_P^2)."""

    scale_step: float = 3e-3
    """Expected change of a scale from one update to the next (w_S = 1 / step^2).

    Cells that drift by 2 % per square root of a minute change by 6e-4 in 50 ms. A sample is in the window for
    ten updates, and each of them counts it. A factor of sqrt(10) compensates for this: 2e-3. The choice is
    not critical: on walks of a simulated NAO, errors of the centre of pressure change by a tenth between 2e-3
    and 2e-2 (with offsets in proportion). With much larger steps the window follows errors of its reference
    where half a second does not excite the parameters enough: at a hundred times the step the error doubles.
    At a tenth of the step, correcting a bad start takes minutes."""

    offset_step: float = 9e-4
    """Expected change of an offset from one update to the next, in body weights: 0.05 N for a NAO. Drift of
    1 N per square root of a minute gives 0.03 N in 50 ms, or 0.09 N with the factor above. The value is half
    of that, because a constant error of the believed centre of mass has the same effect as offsets and should
    not be learnt as fast."""

    scale_step_bound: float = 0.02
    """Largest change of a scale in one iteration."""

    offset_step_bound: float = 0.01
    """Largest change of an offset in one iteration, in body weights."""

    scale_rate: float = 0.2
    """Largest change of a scale per second."""

    offset_rate: float = 0.1
    """Largest change of an offset per second, in body weights."""

    scale_range: tuple[float, float] = (0.5, 2.0)
    """Smallest and largest scale relative to the starting map."""

    offset_range: float = 0.5
    """Largest offset from the starting map in body weights."""

    transition: float = 0.1
    """Time in s after a foot has gained or lost contact in which samples may be rejected. It covers the
    transition itself and the memory of the filter."""

    outlier_threshold: float = 3.0
    """Residual above which such a sample is rejected, in standard deviations and in multiples of the window's
    median."""

    gross_error: float = 0.5
    """Error of the vertical force in body weights, and of the centre of pressure in foot lengths, above which
    samples are never used, because no calibration error is as large."""

    settle: float = 0.05
    """Time in s after a bad sample before samples are used again, so that it has left the filter."""

    minimum_share: float = 0.25
    """Share of the window that must be usable and in contact for an update."""

    standing_start: bool = True
    """Whether to begin with quiet standing (Eqs. 12, 13)."""

    standing_warm_up: float = 0.5
    """Time before the standing start that is not used, T_warm, in s."""

    standing_duration: float = 2.0
    """Time of quiet standing after the warm-up in s."""

    standing_samples: int = 40
    """Minimum number of samples, in contact and still, of a standing start. A robot that lifts a foot earlier
    has no standing start. One that lifts it before ``standing_duration`` has a shorter one."""

    standing_patience: float = 15.0
    """Time in s after which a robot that never stood still continues without a standing start."""

    standing_scale_std: float = 0.02
    """Prior standard deviation of scales at the standing start. It is small because the paper calibrates with
    known weights first. Standing cannot distinguish an error of the sensors from one of the believed centre
    of mass, and this value decides which of them is corrected."""

    standing_offset_std: float = 0.005
    """Prior standard deviation of offsets at the standing start in body weights."""

    def __post_init__(self) -> None:
        """Raise an error if a value is out of range."""
        check_positive(
            self, "window", "delta_force", "delta_cop", "scale_step", "offset_step",
            "scale_step_bound", "offset_step_bound", "scale_rate", "offset_rate", "offset_range",
            "outlier_threshold", "gross_error", "minimum_share", "standing_scale_std", "standing_offset_std",
            "standing_patience",
        )  # fmt: skip
        check_not_negative(self, "transition", "settle", "standing_warm_up", "standing_duration")
        check_counts(self, "every", "iterations", "standing_samples")
        if self.cutoff is not None:
            check_positive(self, "cutoff")
        try:
            low, high = self.scale_range
        except (TypeError, ValueError):
            low = high = 0.0
        if not 0.0 < low < 1.0 < high < np.inf:
            raise ValueError(f"'scale_range' must enclose 1 and be positive, got {self.scale_range}.")
        if self.minimum_share > 1.0:
            raise ValueError(f"'minimum_share' must be a share from 0 to 1, got {self.minimum_share}.")


def confidence_from_standing(setup: OnlineSetup, raw: Floats, reference: Reference) -> tuple[float, float]:
    """Estimate delta_F in body weights and delta_P in foot lengths from quiet standing, as the paper does.

    Both are standard deviations of the feet's forces against those that the motion requires, over readings,
    (N, K), aligned with the beliefs, that have passed the initial calibration: the setup's map. Standing
    shows noise and sway but not the errors of walking (the errors of the centre of mass and of its
    acceleration), so that delta_P comes out as a lower bound. ValueError if fewer than ten samples are finite
    and in contact.
    """
    force = Parameters(*setup.initial).force(np.asarray(raw, dtype=np.float64))
    rows = moment_rows(setup.layout, reference.position_sole, reference.R_level_sole).sum(axis=1)
    moments = np.einsum("nik,nk->ni", rows, force)
    ground = ground_reference(reference, setup.mass, threshold=setup.force_threshold)
    cop = cop_of_moments(moments[:, 0], moments[:, 1:], setup.force_threshold)
    force_error = (moments[:, 0] - ground.vgrf) / setup.weight
    cop_error = (cop - ground.cop) / setup.length
    usable = np.isfinite(force_error) & np.isfinite(cop_error).all(axis=1)
    if usable.sum() < 10:
        raise ValueError(
            f"Only {usable.sum()} of {len(raw)} samples are finite and in contact; at least 10 are needed to "
            "estimate a standard deviation. Record the robot standing on its feet."
        )
    delta_cop = float(np.sqrt(np.var(cop_error[usable], axis=0).mean()))
    return float(np.std(force_error[usable])), delta_cop
