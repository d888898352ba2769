"""Experiments that must not be answered with a number: whether a fit refuses, and what that spares."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ import InSituOptions, InSituSet, calibrate_in_situ
from surefoot.calibration.results import CalibrationRefused
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.experiments.in_situ.instruments import (
    SensorTruth,
    accelerometer_bias,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)
from surefoot.experiments.in_situ.methods import paper_calibration, wrench_error

Sets = Sequence[InSituSet]

SENSOR = "leg"  # whose sensor they are tried on: the knee and the floor matter to it most

REASON = "the study looks at what is refused"
"""Why refusals are passed."""


@dataclass(frozen=True)
class SpoiltExperiment:
    """One experiment that went wrong."""

    name: str
    rig: dict[str, Any] = field(default_factory=dict)  # options of the rig
    configurations: tuple[int, ...] = (1, 2, 3, 4)
    spoil: Callable[[Sets], list[InSituSet]] = list  # what happens to the sets
    factory: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None
    harmless: bool = False  # a control, which must be answered
    clips: bool = False  # whether the range of the converter is given


def _two_orientations(sets: Sets) -> list[InSituSet]:
    """Return what each set showed within a degree of two orientations."""
    found = []
    for data in sets:
        unit = data.gravity / np.linalg.norm(data.gravity, axis=1, keepdims=True)
        other = unit[np.argmin(unit @ unit[0])]
        near = np.maximum(unit @ unit[0], unit @ other) > np.cos(np.radians(1.0))
        assert data.time is not None
        found.append(replace(data, raw=data.raw[near], gravity=data.gravity[near], time=data.time[near]))
    return found


def _mass_off(share: float) -> Callable[[Sets], list[InSituSet]]:
    def spoil(sets: Sets) -> list[InSituSet]:
        return [
            replace(data, added_mass=(1.0 + share) * data.added_mass) if j == 2 else data
            for j, data in enumerate(sets)
        ]

    return spoil


def _saturated(sets: Sets) -> list[InSituSet]:
    """Return sets where channel 0 of one ends, with a twentieth of its readings beyond."""
    low, high = sensor_config(SENSOR).code_range
    found = list(sets)
    raw = found[1].raw.copy()
    raw[:, 0] += high - np.quantile(raw[:, 0], 0.95)
    found[1] = replace(found[1], raw=np.clip(raw, low, high))
    return found


def _flipped(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a matrix that lost the sign of one entry."""
    spoilt = matrix.copy()
    spoilt[2, 0] *= -1.0
    return spoilt


SPOILT = (
    SpoiltExperiment("nothing wrong", harmless=True),
    SpoiltExperiment("nothing wrong, factory matrix given", factory=np.copy, harmless=True),
    SpoiltExperiment("front-back motion only", {"range_deg": (70.0, 0.0)}),
    SpoiltExperiment("two orientations", spoil=_two_orientations),
    SpoiltExperiment("two masses", configurations=(1, 2)),
    SpoiltExperiment("one mass at three places, no bare limb", configurations=(5, 6, 8)),
    SpoiltExperiment("knee gives by 0.005 rad per N m", {"knee_slack": 0.005}),
    SpoiltExperiment("knee gives by 0.02 rad per N m", {"knee_slack": 0.02}),
    SpoiltExperiment("knee gives by 0.06 rad per N m", {"knee_slack": 0.06}),
    SpoiltExperiment("foot touches the floor", {"floor": True}),
    SpoiltExperiment("channel 0 saturated", spoil=_saturated, clips=True),
    SpoiltExperiment("sign of one factory entry lost", factory=_flipped),
    SpoiltExperiment("one mass given 5 % too heavy", spoil=_mass_off(0.05)),
    SpoiltExperiment("one mass given 20 % too heavy", spoil=_mass_off(0.2)),
)
"""What is tried."""


def spoil_and_calibrate(index: int, seed: int, rate: float) -> dict[str, list[dict[str, Any]]]:
    """Try one experiment of :data:`SPOILT` with one seed's sensor, at a rate in Hz.

    ``refusals`` has errors of forces and torques of the answer, also where it is refused (NaN where there is
    none at all), and of III-C.
    """
    case = SPOILT[index]
    recordings = record_rig(case.configurations, rate=rate, seed=seed, **case.rig)
    config = sensor_config(SENSOR)
    counts, truth = read_sensor(config, SENSOR, recordings, seed)
    force = read_imu(recordings, seed)[..., :3]
    # A plane is refused by the accelerometer's calibration as well: the robot goes on with what it has.
    with suppress(CalibrationRefused):
        force = force - accelerometer_bias(force)
    sets = case.spoil(static_sets(SENSOR, recordings, counts, force))
    factory = None if case.factory is None else case.factory(config.nominal_matrix)
    options = InSituOptions(code_range=config.code_range if case.clips else None)
    fit = calibrate_in_situ(sets, factory_matrix=factory, options=options, refuse=False, accept=REASON)
    # A spoilt matrix of the maker's is what is left of a fit that does not look at it.
    matrix: NDArray[np.float64] | None = factory if fit.refusals and factory is not None else fit.matrix
    paper: NDArray[np.float64] | None = None
    with suppress(ValueError, AssertionError):
        paper = paper_calibration(sets).matrix
    row: dict[str, Any] = {"case": case.name, "harmless": case.harmless, "seed": seed}
    row["refused"] = bool(fit.refusals)
    row["refusal"] = fit.refusals[0].reason if fit.refusals else ""
    # True wrenches of a sound rig under the validation sets.
    loads = np.concatenate([one.wrench_leg for one in record_rig(range(5, 9), rate=min(rate, 10.0))])
    row["force_error"], row["torque_error"] = _errors(matrix, truth, loads)
    row["paper_force"], row["paper_torque"] = _errors(paper, truth, loads)
    return {"refusals": [row]}


def _errors(
    matrix: NDArray[np.float64] | None, truth: SensorTruth, wrench: NDArray[np.float64]
) -> tuple[float, float]:
    if matrix is None or not np.isfinite(matrix).all():
        return float("nan"), float("nan")
    return wrench_error(matrix, truth.response, wrench)
