"""Run an online method over a log: as the robot would have, or with hindsight.

Causal replay is the stream itself, sample by sample: it gives the robot's knowledge at each moment.
With ``zero_phase`` the forces and the accelerations pass the CoP paper's zero-phase filter of 10 Hz first,
which no robot could do, and the method then filters nothing; use that to compare with the paper, never to
judge a controller.
"""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats, RowCollector, take_rows
from surefoot.calibration.checks import ONE_ROBOT, check_kind, check_value
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.foot_calibrator import FootCalibrator
from surefoot.calibration.front_end.filters import zero_phase as filter_zero_phase
from surefoot.calibration.front_end.motion import LARGEST_REFERENCE
from surefoot.calibration.front_end.readings import FrontEnd
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.online import MethodOptions, method_entry, resolve_method
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import MomentumReference, Reference

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
    """Run a method over a whole log of one robot, by a :class:`~surefoot.calibration.FootCalibrator`.

    Args:
        layout: How the channels make up the feet's wrenches.
        method: A key of :data:`~surefoot.calibration.online.METHODS`.
        raw: Readings, shape (N, K).
        reference: The robot's beliefs as they were known at each sample, N first in each field.
        dt: Time between samples in s, or the times since the sample before, shape (N,).
        mass: Mass of the robot as it believes it, in kg.
        initial: The map to start from; by default readings are taken for newtons.
        lag: How many samples before its row a row's reference describes.
        zero_phase: Whether to filter readings and accelerations forwards and backwards before; the forces
            that come out are still those of the unfiltered readings.
        watch: Iterates over the samples' numbers, and may show how far it is.
        options: Further fields of :class:`~surefoot.calibration.online.OnlineSetup` and options of the
            method.

    Returns:
        The estimates of all samples, N first in each field.

    Raises:
        ValueError: If a field has another length than the readings, or an array or option does not fit.
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
    calibrator = FootCalibrator(layout, name, mass=mass, initial=initial, dt=nominal, lag=lag, **options)
    front_end = FrontEnd(calibrator.setup)
    learnt_from, learnt_with = readings, log
    if cutoff is not None:
        learnt_from = _filter_plausible(readings, *front_end.plausible, cutoff, nominal)
        learnt_with = _filter_accelerations(log, cutoff, nominal)
    found = RowCollector(len(readings), held=("covariance",))
    for k in watch(range(len(readings))):
        found.put(k, calibrator.update(learnt_from[k], take_rows(learnt_with, k), float(steps[k])))
    estimate: Estimate = found.collect()
    return estimate if cutoff is None else _estimate_by_maps(front_end, readings, log, steps, estimate)


def _estimate_by_maps(
    front_end: FrontEnd, readings: Floats, log: Any, steps: Any, learnt: Estimate
) -> Estimate:
    """Return the estimates of the unfiltered readings by maps that were learnt from filtered ones."""
    front, found = front_end.init(readings[0]), RowCollector(len(readings), held=("covariance",))
    for k in range(len(readings)):
        one = take_rows(learnt, k)
        front, sample = front_end.observe(front, readings[k], take_rows(log, k), float(steps[k]))
        own = Parameters(one.scale, one.offset).relative_to(front_end.setup.initial)
        estimate = front_end.estimate(sample, *own, covariance=one.covariance)
        found.put(k, estimate._replace(flags=one.flags | sample.flags))
    whole: Estimate = found.collect()
    return whole


def _check_log(layout: FeetLayout, readings: Floats, reference: Any, dt: Any) -> tuple[Any, Floats]:
    """Return a log's reference in double precision, and its times between samples, or refuse them."""
    check_kind("layout", layout, FeetLayout)
    if not isinstance(reference, MomentumReference):
        check_kind("reference", reference, Reference)
    layout.check_raw(readings)
    if readings.ndim != 2 or len(readings) == 0:
        way_out = f" {ONE_ROBOT}" if readings.ndim > 2 else ""
        raise ValueError(f"'raw' must have shape (samples, channels), got {readings.shape}.{way_out}")
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
    """Return numbers in double precision, which the library takes; booleans stay."""
    array = np.asarray(values)
    return array.astype(np.float64, copy=False) if array.dtype.kind in "fiu" else array


def _filter_accelerations(log: Reference | MomentumReference, cutoff: float, dt: float) -> Reference:
    """Return a log whose accelerations are filtered; raise ValueError if it has none."""
    if not isinstance(log, Reference):
        raise ValueError(
            "'zero_phase' filters accelerations, which a MomentumReference has none of: give a Reference."
        )
    limits = (-LARGEST_REFERENCE, LARGEST_REFERENCE)
    return log._replace(
        com_acceleration=_filter_plausible(log.com_acceleration, *limits, cutoff, dt),
        angular_momentum_rate=_filter_plausible(log.angular_momentum_rate, *limits, cutoff, dt),
    )


def _filter_plausible(values: NDArray[Any], low: Any, high: Any, cutoff: float, dt: float) -> NDArray[Any]:
    """Filter plausible readings; others stay as they are, for the method to flag, and change no neighbour."""
    plausible = (values >= low) & (values <= high)
    return np.where(plausible, filter_zero_phase(np.where(plausible, values, np.nan), cutoff, dt), values)
