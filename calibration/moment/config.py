r"""The moment filter: a Kalman filter on rows that are linear in what is unknown.

The CoP paper divides moments by forces before it compares (Eq. 14), and needs Gauss-Newton for that. Left
undivided, the six Newton-Euler equations (Eqs. 6, 7) are *linear* in scales a, in offsets and, to first
order, in the errors of the reference itself. About the point o below the believed centre of mass, on the
ground,

    sum_i f_i = M (c'' + g e_z) + errors of mass and acceleration
    sum_i [ (p_i - o) x f_i + t_i ] = L' + h e_z x M c'' + errors of the centre of mass and of the delay

with F = a (F0 + offset) in place of every f_i. Load cells see three of the six rows, (Fz, Mx, My), a six-axis
sensor all. Light loads weigh little by nature, nothing is divided by a small force, and drift is what it is:
process noise. See ``docs/estimator.md`` for the derivation and
:mod:`surefoot.calibration.moment.unknowns` for the state.

* **The moments are taken about the estimated centre of pressure.** About any other point the noise of the
  reference enters the regressors, and noisy regressors shrink what they estimate.
* **Swing tare.** A foot in the air reads what its own sole's inertia makes it read: every offset at once,
  and the only moment at which the warp (+, -, -, +) of four cells can be seen.
* **Errors of the reference are unknowns too** (centre of mass, acceleration, delay), or are considered
  without being estimated (mass, after Schmidt, until it leaps; vertical bias): what belongs to the reference
  does not flow into the cells.
* **Sums, not a filter.** A low-pass makes noise coloured, and a Kalman filter that takes coloured noise for
  white is too sure of itself. Here samples are averaged, ``average`` of them, the same on both sides.
* **Rows may be wrong**: see :mod:`surefoot.calibration.moment.kalman`. A foot that should swing and carries
  weight is left out; noise is taken as larger than assumed while the innovations are.
* **Level frames should turn with the feet**, as those of :class:`~surefoot.wrappers.SelfCalibration` do: the
  errors of the centre of mass and of the acceleration are taken for constant in them.
* **Channels may break**: see :mod:`surefoot.calibration.moment.faults`.
"""

from dataclasses import dataclass

from surefoot.calibration.checks import check_count, check_not_negative, check_positive


@dataclass(frozen=True, kw_only=True)
class MomentFilterConfig:
    """Options of the moment filter; the defaults are those of cheap cells under a small humanoid."""

    every: int = 16
    """Samples from one update to the next."""

    average: int = 2
    """Samples that are averaged into one set of rows; must divide ``every``."""

    scale_std: float = 0.12
    """How far scales are thought to be from the starting map: 12 % for cells that were never calibrated.
    Whether it is a twenty-fifth of that or five times as much is learnt."""

    offset_std: float = 0.03
    """How far offsets are thought to be from the starting map, in body weights (1.5 N for a NAO); as
    uncertain as `scale_std`."""

    cross_talk: float = 0.01
    """How much the vertical force of a six-axis sensor is thought to show in its other five channels,
    relative to their own scale (times the foot length in a torque); 0 takes its matrix for diagonal."""

    scale_drift: float = 0.02
    """Random walk of a scale per square root of a minute. How many times faster than stated scales and
    offsets drift is learnt."""

    offset_drift: float = 0.02
    """Random walk of an offset in body weights per square root of a minute (1 N for a NAO)."""

    force_noise: float = 0.016
    """Standard deviation of one sample of the reference's force, in body weights."""

    cop_noise: float = 2.5e-3
    """Standard deviation of one sample of the reference's centre of pressure in m."""

    timing_noise: float = 0.003
    """Standard deviation of the moments at which single channels are read, in s."""

    swing_noise: float = 0.001
    """Standard deviation of a channel's mean reading over 16 samples in the air, in body weights."""

    parity_noise: float = 0.02
    """Standard deviation of the difference of two instruments of one foot over half a block, in body weights
    and body weights times foot lengths."""

    com_std: float = 0.002
    """How far the believed centre of mass is thought to be off along each axis, in m."""

    com_known: float = 0.0012
    """Standard deviation in m down to which the centre of mass is estimated along an axis: errors of the
    reference repeat at every stride, so that many strides tell no more of it than the first did. Half of it
    while the robot does not walk."""

    sole_std: float = 0.0001
    """How much farther off the centre of mass is thought to be over one foot than over both, along each axis,
    in m: joints and masses of the two legs are not off alike, and at every stride in the same way."""

    mass_std: float = 0.005
    """How far the believed mass is thought to be off, relative."""

    learn_mass: bool = True
    """Whether to estimate the mass after it leapt. Else it is only considered that it may be off (Schmidt):
    what a robot weighs can be found on any kitchen scale, and drifting scales would carry it along."""

    mass_change: float = 0.05
    """How much the mass is thought to have changed, relative, when the vertical force of a whole block leaps
    away from what the motion asks for: a load was picked up."""

    com_change: float = 0.004
    """How much the centre of mass is thought to have moved along each axis then, in m."""

    acceleration_std: float = 0.02
    """How far the mean believed acceleration is thought to be off along each axis, in m/s^2."""

    delay_std: float = 0.004
    """How far the moments that references describe are thought to be off, in s."""

    blur: float = 0.009
    """Standard deviation of the window that the reference's rates are averaged over, in s: differences of
    telemetry at 100 Hz, or slopes of parabolas over 50 ms. Its square is learnt, and at the start as unsure
    as it is large; 0 for a reference that follows the forces at once."""

    gate: float = 3.0
    """Standard deviations beyond which an innovation pulls no harder."""

    reject: float = 0.25
    """Innovation of a force in body weights, and of a moment in body weights times foot lengths, that is no
    error of calibration if it is beyond eight standard deviations as well: the robot is held, or pushed."""

    settle: int = 4
    """Samples after a foot left the ground, and before it comes back, that are not used as swing."""

    swing_load: float = 0.1
    """Load of a foot in body weights above which it is not believed to swing, beyond four standard
    deviations of what the load is known to; and by which it may carry more than where it carries least before
    it is taken to be down again."""

    still: float = 0.005
    """Change of a reading in body weights (times foot lengths for a torque) below which a robot stands still:
    all blocks together then count as little more than one. 0 takes every block for itself."""

    leap: float = 0.25
    """Change of a channel's force from one sample to the next in body weights that no foot makes: such
    readings are held for up to three samples."""

    stand_in_memory: float = 20.0
    """Time in s over which is learnt how the cells of a foot share its load."""

    @property
    def span(self) -> int:
        """Samples of one block: those that are learnt from, and ``settle`` on either side."""
        return self.every + 2 * self.settle

    @property
    def middle(self) -> slice:
        """Those samples of a block that are learnt from."""
        return slice(self.settle, self.settle + self.every)

    def __post_init__(self) -> None:
        """Raise an error if a value has no meaning."""
        check_positive(
            self, "scale_std", "offset_std", "force_noise", "cop_noise", "swing_noise", "parity_noise",
            "gate", "reject", "leap", "stand_in_memory",
        )  # fmt: skip
        check_not_negative(
            self, "cross_talk", "scale_drift", "offset_drift", "timing_noise", "com_std", "com_known",
            "sole_std", "blur", "mass_std", "acceleration_std", "delay_std", "swing_load", "still",
            "mass_change", "com_change",
        )  # fmt: skip
        check_count(self, "every", "average", "settle")
        if self.every % self.average:
            raise ValueError(f"'average' must divide 'every', got {self.average} and {self.every}.")
