"""The result of in-situ calibration, and where its unknowns stand in its covariance."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.arrays import in_a_row
from surefoot.calibration.in_situ.data import Matrix
from surefoot.calibration.in_situ.model import AXES, MASS, RELATIVE_ERRORS, STATIC, limb_parameters
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats


class FitColumns(NamedTuple):
    """Places in a fit's covariance: C row by row, the last set's offset, the limb's m and m c."""

    matrix: slice
    offset: slice
    limb: slice

    @classmethod
    def of(cls, channels: int) -> "FitColumns":
        """Return the places for a sensor of k channels."""
        return cls(*in_a_row(AXES * channels, channels, STATIC))

    def row(self, axis: int) -> slice:
        """Return the places of one row of C."""
        channels = self.limb.start - self.offset.start
        return slice(axis * channels, (axis + 1) * channels)


class ErrorColumns(NamedTuple):
    """Places of a calibration's errors: the offset's, D row by row, and the limb's."""

    offset: slice
    response: slice
    limb: slice

    @classmethod
    def of(cls, channels: int) -> "ErrorColumns":
        """Return the places for a sensor of k channels."""
        return cls(*in_a_row(channels, RELATIVE_ERRORS, STATIC))


@dataclass(frozen=True, eq=False)
class Limb:
    """The rigid body beyond the sensor, such as a leg or a tool, without added masses.

    Attributes:
        mass: m in kg.
        mass_com: First moment m c in the sensor's frame in kg m, shape (3,).
        inertia: About the sensor's origin in its frame in kg m^2, shape (3, 3); None where the motion did not
            show it.
    """

    mass: float
    mass_com: NDArray[np.float64]
    inertia: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        if np.shape(self.mass_com) != (3,):
            raise ValueError(f"mass_com must have shape (3,), in kg m, got {np.shape(self.mass_com)}.")

    @property
    def com(self) -> NDArray[np.float64]:
        """Centre of mass in the sensor's frame in m, shape (3,)."""
        return np.asarray(self.mass_com / self.mass)

    @property
    def parameters(self) -> NDArray[np.float64]:
        """Inertial parameters phi: (m, m c) and, if it is known, I, shape (4,) or (10,)."""
        return limb_parameters(self.mass, self.mass_com, self.inertia)

    def weight(self, gravity: ArrayLike) -> NDArray[np.float64]:
        """Return the wrench by which the limb at rest loads the sensor, (m g, m c x g), shape (..., 6).

        ``gravity`` is in the sensor's frame in m/s^2 and points down, shape (..., 3).
        """
        g = _vectors("gravity", gravity, 3)
        return np.concatenate([self.mass * g, np.cross(self.mass_com, g)], axis=-1)

    def compensate(self, wrench: ArrayLike, gravity: ArrayLike) -> NDArray[np.float64]:
        """Return wrenches without the limb's own weight: what touches the limb, as the sensor feels it.

        For single readings of a running stream or many at once. The limb must be at rest or move slowly.

        Args:
            wrench: Of the limb on the robot in N and N m, as by :meth:`InSituFit.wrench`, shape (..., 6).
            gravity: In the sensor's frame in m/s^2, pointing down, shape (..., 3).

        >>> gripper = Limb(mass=1.2, mass_com=1.2 * np.array([0.0, 0.0, 0.05]))
        >>> level = np.array([0.0, 9.81, 0.0])
        >>> gripper.compensate(gripper.weight(level) + [0.0, 0.0, 5.0, 0.0, 0.0, 0.0], level)
        array([0., 0., 5., 0., 0., 0.])
        """
        return np.asarray(_vectors("wrench", wrench, 6) - self.weight(gravity))


def _vectors(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """Return an array of vectors, shape (..., size), or raise ValueError."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape[-1:] != (size,):
        raise ValueError(f"'{name}' must have shape (..., {size}), got {array.shape}.")
    return array


@dataclass(frozen=True, eq=False)
class SetFit:
    """What a fit found for one set of readings."""

    name: str  # the set's
    offset: Matrix  # o in counts at the middle of its samples, shape (k,)
    stats: FitStats  # the residual is in counts
    affine_residual: float  # share of its spread that leaves the three-space of Lemma 1


@dataclass(frozen=True, eq=False)
class ImuErrors:
    """Errors of the accelerometer that were found and undone."""

    bias: Matrix = field(default_factory=lambda: np.zeros(3))  # in m/s^2, shape (3,), which was taken off
    scale: Matrix | float = 1.0  # by which its readings were multiplied: one number, or one an axis, (3,)
    rotation: Matrix = field(default_factory=lambda: np.eye(3))
    """R_sensor_accelerometer, shape (3, 3); the identity unless it was estimated."""
    delay: float = 0.0  # by which gravity was late against the readings in s


@dataclass(frozen=True, eq=False)
class TemperatureEffect:
    """How the sensor follows its temperature."""

    coefficient: Matrix  # of the offsets in counts per K, shape (k,)
    reference: float = 0.0  # temperature at which the offsets hold
    gain: Matrix | None = None
    """Change of each axis per K, as a share of its load, shape (6,); None if that was not seen."""


@dataclass(frozen=True, eq=False)
class Hysteresis:
    """How the sensor lags behind its load; shape (6,) each."""

    share: Matrix  # width of the loop of each axis as a share of the load's swing
    amplitude: Matrix
    """Amplitudes of cycles in N and N m at whose ends the matrix holds: gains grow by ``share`` for each
    doubling of the amplitude."""
    swing_gain: Matrix  # gains of the axes at that amplitude over those at the swings of the sets


@dataclass(frozen=True, eq=False)
class MakerErrors:
    """How far the maker's matrix is off, A = A_0 (1 + D)."""

    share: float  # size of D as a share of full scale
    known: Matrix  # share of each entry that the readings know, 1 - posterior / prior variance, shape (6, 6)


@dataclass(frozen=True, eq=False)
class InSituFit:
    """A calibrated six-axis sensor, w = C (r - o) (in-situ paper, Eq. 2), of k channels.

    Where the fit was refused all values are NaN and ``refusals`` says why.

    Attributes:
        matrix: C in N and N m per count, shape (6, k).
        offset: o of the last set (at its end, where it drifts) in counts, shape (k,).
        response: Counts per N and N m, shape (k, 6): r = response w + o; C is its inverse, for k > 6 the
            one of least variance.
        limb: The body beyond the sensor.
        covariance: Of (C row by row, the last set's offset, the limb's mass and first moment), shape
            (7 k + 4, 7 k + 4).
        noise: Covariance of a sample's noise in counts^2, shape (k, k).
        sets: One for each set of readings.
        stats: Of all sets together; the residual is in counts.
        result: How much the data determined.
        refusals: Why it was refused, or which refusals were accepted; empty if there was none.
        warnings: Limits of the numbers, to read before use.
        accepted: The reason that was given to pass the refusals; empty if none was passed.
        scope: The quantities that were found, in words.
        imu: Errors of the accelerometer.
        temperature: None if no temperature was given, or it stayed.
        hysteresis: None if loads were not seen to lag.
        offset_doubt: Covariance in counts^2, shape (k, k), of the offset's error by hysteresis, part of
            ``covariance``; None without hysteresis.
        maker: None without a factory matrix that may change.
        data_share: Of the information on each entry of ``covariance``, the share that the readings give by
            themselves, without a factory matrix or a known limb, shape (7 k + 4,).
    """

    matrix: Matrix
    offset: Matrix
    response: Matrix
    limb: Limb
    covariance: Matrix
    noise: Matrix
    sets: tuple[SetFit, ...]
    stats: FitStats
    result: FitResult
    refusals: tuple[CalibrationRefused, ...] = ()
    warnings: tuple[str, ...] = ()
    accepted: str = ""
    scope: str = ""
    imu: ImuErrors = field(default_factory=ImuErrors)
    temperature: TemperatureEffect | None = None
    hysteresis: Hysteresis | None = None
    offset_doubt: Matrix | None = None
    maker: MakerErrors | None = None
    data_share: Matrix | None = None

    @property
    def offsets(self) -> NDArray[np.float64]:
        """Offsets of each set in counts, at the middle of its samples, shape (J, k)."""
        return np.array([one.offset for one in self.sets])

    @property
    def columns(self) -> FitColumns:
        """Places of the unknowns in the covariance."""
        return FitColumns.of(len(self.offset))

    @property
    def matrix_std(self) -> NDArray[np.float64]:
        """Standard deviation of each entry of C in N and N m per count, shape (6, k)."""
        return np.asarray(self._std(self.columns.matrix).reshape(self.matrix.shape))

    @property
    def matrix_in_air(self) -> NDArray[np.float64]:
        """C at the swings of the sets, which weighs what hangs on the sensor as it turns, shape (6, k).

        With hysteresis it differs from :attr:`matrix`, which is for contact loads.
        """
        return self.matrix if self.hysteresis is None else self.matrix * self.hysteresis.swing_gain[:, None]

    @property
    def response_in_air(self) -> NDArray[np.float64]:
        """The response at the swings of the sets in counts per N and N m, shape (k, 6)."""
        return self.response if self.hysteresis is None else self.response / self.hysteresis.swing_gain

    @property
    def offset_std(self) -> NDArray[np.float64]:
        """Standard deviation of the last set's offset in counts, shape (k,)."""
        return self._std(self.columns.offset)

    @property
    def limb_mass_std(self) -> float:
        """Standard deviation of the limb's mass in kg."""
        return float(self._std(self.columns.limb)[MASS])

    def _std(self, place: slice) -> NDArray[np.float64]:
        return np.asarray(np.sqrt(np.diag(self.covariance)[place]))

    def wrench(
        self,
        raw: NDArray[np.float64],
        offset: NDArray[np.float64] | None = None,
        temperature: float | NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Return w = C (r - o) in N and N m (in-situ paper, Eq. 2).

        Args:
            raw: Counts, shape (..., k).
            offset: o in counts, shape (..., k); the last set's by default.
            temperature: Of the sensor, shape (...); where the fit knows its effect, that at which the offsets
                hold by default.

        Returns:
            Wrench of the limb on the robot, at and in the sensor's frame, shape (..., 6).
        """
        raw = _vectors("raw", raw, self.matrix.shape[1])
        o = self.offset if offset is None else np.asarray(offset)
        if temperature is None or self.temperature is None:
            return np.asarray((raw - o) @ self.matrix.T)
        matrix, change = self.at_temperature(temperature)
        return np.asarray((matrix @ (raw - o - change)[..., None])[..., 0])

    def at_temperature(self, temperature: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return C, (..., 6, k), and the change of the offset in counts, (..., k), at a temperature (...)."""
        effect = self.temperature
        if effect is None:
            return self.matrix, np.zeros(self.matrix.shape[1])
        warmer = np.asarray(temperature, dtype=np.float64)[..., None] - effect.reference
        gain = 1.0 + warmer * (np.zeros(AXES) if effect.gain is None else effect.gain)
        return self.matrix / gain[..., None], warmer * effect.coefficient

    def at_reference(
        self, raw: NDArray[np.float64], temperature: float | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Correct readings to the temperature of the offsets, in counts, shape (..., k).

        Args:
            raw: Counts, shape (..., k).
            temperature: At which they were read, shape (...).
        """
        effect = self.temperature
        if effect is None:
            return np.asarray(raw)
        warmer = np.asarray(temperature, dtype=np.float64)[..., None] - effect.reference
        cool = raw - warmer * effect.coefficient
        if effect.gain is not None:
            load = self.wrench(raw, temperature=temperature)
            cool = cool - (warmer * effect.gain * load) @ self.response.T
        return np.asarray(cool)


def error_covariance(fit: InSituFit) -> Matrix:
    r"""Return the covariance of (offset, D row by row, m, m c) by a fit, shape (k + 40, k + 40).

    From that of the matrix: :math:`C' = (1 + D)^{-1} C` gives :math:`D = -\delta C A`.
    """
    of, to = fit.columns, ErrorColumns.of(len(fit.offset))
    turn = np.zeros((to.limb.stop, of.limb.stop))
    turn[to.offset, of.offset] = np.eye(len(fit.offset))
    turn[to.response, of.matrix] = -np.kron(np.eye(AXES), fit.response.T)
    turn[to.limb, of.limb] = np.eye(STATIC)
    return np.asarray(turn @ fit.covariance @ turn.T)


def check_calibrated(fit: InSituFit, what: str) -> None:
    """Raise ValueError if a fit has no numbers since it was refused."""
    if fit.result is FitResult.REFUSED:
        reason = str(fit.refusals[0]) if fit.refusals else ""
        raise ValueError(f"{what} needs a calibration, and this fit was refused. {reason}".rstrip())
