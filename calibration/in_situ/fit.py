"""The result of in-situ calibration, and where its unknowns stand in its covariance."""

import dataclasses
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.arrays import in_a_row
from surefoot.calibration.in_situ.data import Matrix
from surefoot.calibration.in_situ.model import AXES, MASS, RELATIVE_ERRORS, STATIC, limb_parameters
from surefoot.calibration.results import CalibrationRefused, FitResult, FitStats
from surefoot.calibration.state import LARGEST
from surefoot.files import read_json


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


def _name(in_file: str) -> dict[str, str]:
    """Name a field in files."""
    return {"name": in_file}


@dataclass(frozen=True, eq=False)
class InSituFit:
    """A calibrated six-axis sensor, w = C (r - o) (in-situ paper, Eq. 2), with J sets of k channels.

    Where the fit was refused all values are NaN and ``refusals`` says why.

    Attributes:
        matrix: C in N and N m per count, shape (6, k).
        offset: o of the last set (at its end, where it drifts) in counts, shape (k,).
        offsets: o of each set in counts, at the middle of its samples, shape (J, k).
        response: Counts per N and N m, shape (k, 6): r = response w + o; C is its inverse, for k > 6 the
            one of least variance.
        limb: The body beyond the sensor.
        covariance: Of (C row by row, the last set's offset, the limb's mass and first moment), shape
            (7 k + 4, 7 k + 4).
        noise: Covariance of a sample's noise in counts^2, shape (k, k).
        temperature_coefficient: Counts per K, shape (k,); None if no temperature was given, or it stayed.
        rotation: R_sensor_accelerometer, shape (3, 3); the identity unless it was estimated.
        result: How much the data determined.
        refusals: Why it was refused, or which refusals were accepted; empty if there was none.
        warnings: Limits of the numbers, to read before use.
        stats: Of all sets together; the residual is in counts.
        set_stats: One a set.
        affine_residual: Share of a set's spread that leaves the three-space of Lemma 1, shape (J,).
        set_names: Names of the sets in messages.
        temperature_reference: Temperature at which the offsets hold.
        temperature_gain: Change of each axis per K, as a share of its load, shape (6,); None if that was not
            seen.
        hysteresis: Width of the loop of each axis as a share of the load's swing, shape (6,); None if loads
            were not seen to lag.
        amplitude: Amplitudes of cycles of each axis in N and N m at whose ends the matrix holds, shape (6,):
            gains grow by ``hysteresis`` for each doubling of the amplitude. None without hysteresis.
        swing_gain: Gains of the axes at that amplitude over those at the swings of the sets, shape (6,); None
            without hysteresis.
        offset_doubt: Covariance in counts^2, shape (k, k), of the offset's error by hysteresis, part of
            ``covariance``; None without hysteresis.
        data_share: Of the information on each entry of ``covariance``, the share that the readings give by
            themselves, without a factory matrix or a known limb, shape (7 k + 4,).
        maker_known: Of each entry of D, A = A_0 (1 + D), the share that the readings know, 1 - posterior /
            prior variance, shape (6, 6); None without a factory matrix.
        accepted: The reason that was given to pass the refusals; empty if none was passed.
        bending: Share of a set's spread that goes with gravity's squares, where that is more than noise or
            hysteresis; the covariance counts it.
        scope: The quantities that were found, in words.
        maker_share: How far the maker's matrix is off by the readings, as a share of full scale; None without
            one.
        accelerometer_bias: In m/s^2, shape (3,), which was taken off.
        accelerometer_scale: By which its readings were multiplied: one number, or one an axis, shape (3,).
        delay: By which gravity was late against the readings in s, which was undone.
    """

    matrix: Matrix = field(metadata=_name("matrix_N_Nm_per_count"))
    offset: Matrix = field(metadata=_name("offset_count"))
    offsets: Matrix = field(metadata=_name("offset_of_each_set_count"))
    response: Matrix = field(metadata=_name("response_count_per_N_Nm"))
    limb: Limb
    covariance: Matrix = field(metadata=_name("covariance"))
    noise: Matrix = field(metadata=_name("noise_covariance_count2"))
    temperature_coefficient: Matrix | None = field(metadata=_name("temperature_coefficient_count_per_K"))
    rotation: Matrix = field(metadata=_name("R_sensor_accelerometer"))
    result: FitResult
    refusals: tuple[CalibrationRefused, ...]
    warnings: tuple[str, ...]
    stats: FitStats
    set_stats: tuple[FitStats, ...]
    affine_residual: Matrix = field(metadata=_name("affine_residual_of_each_set"))
    set_names: tuple[str, ...]
    temperature_reference: float = field(default=0.0, metadata=_name("temperature_reference_degC"))
    temperature_gain: Matrix | None = field(default=None, metadata=_name("temperature_gain_per_K"))
    hysteresis: Matrix | None = field(default=None, metadata=_name("hysteresis_share_of_swing"))
    amplitude: Matrix | None = field(default=None, metadata=_name("amplitude_of_matrix_N_Nm"))
    swing_gain: Matrix | None = field(default=None, metadata=_name("gain_at_swings_of_sets"))
    offset_doubt: Matrix | None = field(
        default=None, metadata=_name("offset_covariance_by_hysteresis_count2")
    )
    data_share: Matrix | None = field(default=None, metadata=_name("data_share_of_covariance"))
    maker_known: Matrix | None = field(default=None, metadata=_name("data_share_of_factory_errors"))
    accepted: str = field(default="", metadata=_name("accepted"))
    bending: float = field(default=0.0, metadata=_name("bending_share_of_spread"))
    scope: str = field(default="", metadata=_name("scope"))
    maker_share: float | None = field(default=None, metadata=_name("factory_share_of_full_scale"))
    accelerometer_bias: Matrix = field(
        default_factory=lambda: np.zeros(3), metadata=_name("accelerometer_bias_m_s2")
    )
    accelerometer_scale: Matrix | float = field(default=1.0, metadata=_name("accelerometer_scale"))
    delay: float = field(default=0.0, metadata=_name("accelerometer_delay_s"))

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
        return self.matrix if self.swing_gain is None else self.matrix * self.swing_gain[:, None]

    @property
    def response_in_air(self) -> NDArray[np.float64]:
        """The response at the swings of the sets in counts per N and N m, shape (k, 6)."""
        return self.response if self.swing_gain is None else self.response / self.swing_gain

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
        gain: NDArray[np.float64] | float = 1.0
        if temperature is not None and self.temperature_coefficient is not None:
            warmer = (np.asarray(temperature, dtype=np.float64) - self.temperature_reference)[..., None]
            o = o + warmer * self.temperature_coefficient
            if self.temperature_gain is not None:
                gain = 1.0 + warmer * self.temperature_gain
        return np.asarray((np.asarray(raw, dtype=np.float64) - o) @ self.matrix.T / gain)

    def at_reference(
        self, raw: NDArray[np.float64], temperature: float | NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Correct readings to the temperature of the offsets, in counts, shape (..., k).

        Args:
            raw: Counts, shape (..., k).
            temperature: At which they were read, shape (...).
        """
        warmer = (np.asarray(temperature, dtype=np.float64) - self.temperature_reference)[..., None]
        cool = raw if self.temperature_coefficient is None else raw - warmer * self.temperature_coefficient
        if self.temperature_gain is not None:
            load = self.wrench(raw, temperature=temperature)
            cool = cool - (warmer * self.temperature_gain * load) @ self.response.T
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


FORMAT = "surefoot-in-situ-calibration"
VERSION = 1

_CONVENTIONS = (
    "wrench = matrix (raw - offset), raw as it was read, in raw_unit, which stands for 'count' in all names",
    "wrench = (fx, fy, fz, tx, ty, tz) in N and N m, exerted by the limb on the robot through the sensor, "
    "at and in the sensor's frame: at rest f = m g with g pointing down",
    "response is counts per N and N m: raw = response wrench + offset",
    "offset is that of the last set at its end, offset_of_each_set_count those in the middle of each set; "
    "with a temperature coefficient, raw = response wrench + offset + coefficient (temperature_degC - "
    "temperature_reference_degC); with a temperature gain each axis of the wrench counts for 1 + gain times "
    "that difference",
    "gravity is (as read - accelerometer_bias) accelerometer_scale, and was read accelerometer_delay_s late",
    "covariance is of (matrix row by row, offset, limb mass, limb mass times centre of mass), in those units",
)
_USED = ("matrix", "offset", "response", "noise")


def _fields_of_files() -> dict[str, str]:
    """Return the names in files of the fields that stand there as they are, by the field's name."""
    return {one.name: one.metadata["name"] for one in dataclasses.fields(InSituFit) if one.metadata}


def facts_of(
    fit: InSituFit,
    channels: tuple[str, ...] = (),
    sensor: str = "",
    notices: tuple[str, ...] = (),
    raw_unit: str = "counts",
) -> Any:
    """Return a calibration as values that JSON can hold, with the sensor's name and notices of the log."""
    return _plain(
        {
            "format": FORMAT,
            "format_version": VERSION,
            "made_with": f"surefoot {version('surefoot')}",
            "sensor": sensor,
            "channels": channels,
            "raw_unit": raw_unit,
            "conventions": _CONVENTIONS,
            "result": fit.result.value,
            "refusals": [{"reason": no.reason, "cure": no.cure} for no in fit.refusals],
            "warnings": fit.warnings,
            "notices": notices,
            **{name: getattr(fit, field) for field, name in _fields_of_files().items()},
            "matrix_std_N_Nm_per_count": fit.matrix_std,
            "offset_std_count": fit.offset_std,
            "limb": {
                "mass_kg": fit.limb.mass,
                "mass_std_kg": fit.limb_mass_std,
                "mass_com_kg_m": fit.limb.mass_com,
                "inertia_kg_m2": fit.limb.inertia,
            },
            "sets": [
                {"name": name, **dataclasses.asdict(stats)}
                for name, stats in zip(fit.set_names, fit.set_stats, strict=True)
            ],
            "all_sets": dataclasses.asdict(fit.stats),
        }
    )


def _plain(value: Any) -> Any:
    """Turn arrays into lists and values that are not finite into null."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def read_calibration(path: Path) -> InSituFit:
    """Read a JSON file of ``surefoot calibrate ft``, to the last digit.

    Raises:
        ValueError: If the file is not there, is no calibration, one of another version, or holds numbers that
            no sensor has.
    """
    if not path.is_file():
        raise ValueError(f"{path}: no such file; 'surefoot calibrate ft' writes one.")
    try:
        given = read_json(path)
        if (given["format"], given["format_version"]) != (FORMAT, VERSION):
            raise ValueError(f"{given['format']} {given['format_version']}")
        fit = _fit_of(given)
        for field in _USED if fit.result is not FitResult.REFUSED else ():
            if not (np.abs(getattr(fit, field)) <= LARGEST).all():
                raise ValueError(f"'{_fields_of_files()[field]}' holds what no sensor has")
        return fit
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path.name}: is no {FORMAT} {VERSION}, which this surefoot reads ({error!r}); calibrate again."
        ) from None


def _fit_of(given: dict[str, Any]) -> InSituFit:
    if given.get("nonlinear") is not None:
        raise ValueError("a polynomial, which fits no longer have")
    values: dict[str, Any] = {}
    for one in dataclasses.fields(InSituFit):
        optional = one.default is not dataclasses.MISSING or one.default_factory is not dataclasses.MISSING
        name = one.metadata.get("name")
        # Files of the same version may lack what has a default.
        if name is not None and not (optional and given.get(name) is None):
            value = given[name]
            values[one.name] = _array(value) if isinstance(value, list) else value
    limb = given["limb"]
    return InSituFit(
        limb=Limb(_number(limb["mass_kg"]), _array(limb["mass_com_kg_m"]), _array(limb["inertia_kg_m2"])),
        result=FitResult(given["result"]),
        refusals=tuple(CalibrationRefused(no["reason"], no["cure"]) for no in given["refusals"]),
        warnings=tuple(given["warnings"]),
        stats=_stats_of(given["all_sets"]),
        set_stats=tuple(_stats_of(one) for one in given["sets"]),
        set_names=tuple(one["name"] for one in given["sets"]),
        **values,
    )


def _array(value: Any) -> Any:
    return None if value is None else np.array(value, dtype=object).astype(np.float64)


def _number(value: float | None, absent: float = np.nan) -> float:
    return absent if value is None else float(value)


def _stats_of(given: dict[str, Any]) -> FitStats:
    rms, condition = _number(given["residual_rms"]), _number(given["condition"], np.inf)
    rest = {key: value for key, value in given.items() if key != "name"}
    return FitStats(**rest | {"residual_rms": rms, "condition": condition})
