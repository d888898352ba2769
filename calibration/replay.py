"""Run an online method over a log, causally or with the CoP paper's zero-phase filter.

A causal replay processes the log sample by sample, as the robot would. With ``zero_phase``, forces and
accelerations first pass the CoP paper's zero-phase filter of 10 Hz, which is not possible online, and the
method does not filter again. Use this to compare results with the paper, not to evaluate a controller.
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats, RowCollector, take_rows
from surefoot.calibration.checks import ONE_ROBOT
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.foot_calibrator import FootCalibrator
from surefoot.calibration.front_end.filters import zero_phase as filter_zero_phase
from surefoot.calibration.front_end.motion import LARGEST_REFERENCE
from surefoot.calibration.front_end.readings import FrontEnd
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.online import MethodOptions, method_entry, resolve_method
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import MomentumReference, Reference
from surefoot.checks import check_kind, check_value

PAPER_CUTOFF = 10.0  # cutoff of the CoP paper's zero-phase filter in Hz


def replay(
    layout: FeetLayout,
    method: str | MethodOptions,
    raw: Floats,
    reference: Reference | MomentumReference,
    dt: float | Floats = 1.0 / 80.0,
    *,
    mass: float,
    initial: Parameters | None = None,
    lag: int = 2,
    zero_phase: bool = False,
    watch: Callable[[range], Iterable[int]] = iter,
    **options: Any,
) -> Estimate:
    """Run a method over a log of one robot with a :class:`~surefoot.calibration.FootCalibrator`.

    Args:
        layout: How the channels make up the feet's wrenches.
        method: A key of :data:`~surefoot.calibration.online.METHODS`.
        raw: Readings, shape (N, K).
        reference: The robot's state estimate at each sample, with N rows in each field.
        dt: Time between samples in s, or the time since the previous sample, shape (N,).
        mass: Mass of the robot as the robot knows it, in kg.
        initial: The starting map. By default, readings are forces in newtons.
        lag: How many samples earlier than its row a reference describes the feet.
        zero_phase: Whether to filter readings and accelerations forwards and backwards before learning.
        watch: Iterates over the sample numbers, for example to show progress.
        options: Further fields of :class:`~surefoot.calibration.online.OnlineSetup` and options of the
            method. An ``age`` in s of shape (N, K) is that of each reading, where a device reports it.

    Returns:
        The estimates of all samples, with N rows in each field.

    Raises:
        ValueError: If a field does not have as many rows as the readings, or an array or option is invalid.
    """
    name, options = resolve_method(method, options)
    readings = np.asarray(raw, dtype=np.float64)
    log, steps = _check_log(layout, readings, reference, dt)
    nominal = float(np.median(steps))
    cutoff = None
    if zero_phase:
        cutoff = options.pop("cutoff", None) or PAPER_CUTOFF
        if "cutoff" in getattr(method_entry(name).config, "__dataclass_fields__", {}):
            options["cutoff"] = None
    ages = np.asarray(options.get("age", 0.0), dtype=np.float64)
    if each := ages.shape == readings.shape:
        options["age"] = np.nanmean(ages, axis=0)
    calibrator = FootCalibrator(layout, name, mass=mass, initial=initial, dt=nominal, lag=lag, **options)
    front_end = FrontEnd(calibrator.setup)
    learnt_from, learnt_with = readings, log
    if cutoff is not None:
        learnt_from = _filter_plausible(readings, *front_end.plausible, cutoff, nominal)
        learnt_with = _filter_accelerations(log, cutoff, nominal)
    rows = RowCollector(len(readings), held=("covariance",))
    for k in watch(range(len(readings))):
        sample = learnt_from[k], take_rows(learnt_with, k), float(steps[k])
        rows.put(k, calibrator.update(*sample, age=ages[k] if each else None))
    estimate: Estimate = rows.collect()
    return estimate if cutoff is None else _estimate_by_maps(front_end, readings, log, steps, estimate)


def _estimate_by_maps(
    front_end: FrontEnd, readings: Floats, log: Any, steps: Any, learnt: Estimate
) -> Estimate:
    """Return estimates for the unfiltered readings with maps that were learnt from filtered ones."""
    front, rows = front_end.init(readings[0]), RowCollector(len(readings), held=("covariance",))
    for k in range(len(readings)):
        filtered = take_rows(learnt, k)
        front, sample = front_end.observe(front, readings[k], take_rows(log, k), float(steps[k]))
        correction = Parameters(filtered.scale, filtered.offset).relative_to(front_end.setup.initial)
        estimate = front_end.estimate(sample, *correction, covariance=filtered.covariance)
        rows.put(k, estimate._replace(flags=filtered.flags | sample.flags))
    result: Estimate = rows.collect()
    return result


def _check_log(layout: FeetLayout, readings: Floats, reference: Any, dt: Any) -> tuple[Any, Floats]:
    """Return a log's reference in double precision and the times between samples, or raise ValueError."""
    check_kind("layout", layout, FeetLayout)
    if not isinstance(reference, MomentumReference):
        check_kind("reference", reference, Reference)
    layout.check_raw(readings)
    if readings.ndim != 2 or len(readings) == 0:
        remedy = f" {ONE_ROBOT}" if readings.ndim > 2 else ""
        raise ValueError(f"'raw' must have shape (samples, channels), got {readings.shape}.{remedy}")
    log = type(reference)(*(_in_float64(part) for part in reference))
    for field, part in zip(log._fields, log, strict=True):
        if part.shape[:1] != readings.shape[:1]:
            raise ValueError(
                f"'reference.{field}' must have one row for each of the {len(readings)} rows of 'raw', "
                f"got shape {part.shape}."
            )
    if np.shape(dt) not in ((), readings.shape[:1]):
        raise ValueError(
            f"'dt' must be one number or hold one for each of the {len(readings)} rows of 'raw', "
            f"got shape {np.shape(dt)}."
        )
    if np.ndim(dt) == 0:
        check_value("dt", dt, positive=True)
    return log, np.broadcast_to(np.asarray(dt, dtype=np.float64), len(readings))


def _in_float64(values: Any) -> NDArray[Any]:
    """Convert numbers to double precision, as the library requires, but not booleans."""
    array = np.asarray(values)
    return array.astype(np.float64, copy=False) if array.dtype.kind in "fiu" else array


def _filter_accelerations(log: Reference | MomentumReference, cutoff: float, dt: float) -> Reference:
    """Return a log with filtered accelerations, or raise ValueError if it does not contain accelerations."""
    if not isinstance(log, Reference):
        raise ValueError(
            "'zero_phase' filters accelerations, which a MomentumReference does not have; give a Reference."
        )
    limits = (-LARGEST_REFERENCE, LARGEST_REFERENCE)
    return log._replace(
        com_acceleration=_filter_plausible(log.com_acceleration, *limits, cutoff, dt),
        angular_momentum_rate=_filter_plausible(log.angular_momentum_rate, *limits, cutoff, dt),
    )


def _filter_plausible(values: NDArray[Any], low: Any, high: Any, cutoff: float, dt: float) -> NDArray[Any]:
    """Filter plausible readings only. Others do not affect their neighbours, and the method flags them."""
    plausible = (values >= low) & (values <= high)
    return np.where(plausible, filter_zero_phase(np.where(plausible, values, np.nan), cutoff, dt), values)
