"""The experiment of the in-situ paper (Traversaro, Pucci and Nori, 2015), simulated for many sensors.

    python benchmarks/in_situ_paper.py --seeds 12 --jobs 2          # a quarter of an hour
    python benchmarks/in_situ_paper.py --quick
    python docs/study_tables.py out/results

A leg with six-axis sensors at foot and hip is swept about while known masses hang on it. Sets 1 to 4 are
fitted, sets 5 to 8 validate. The sensors have hysteresis, noise, creep, offsets that drift and jump between
sets, a 16-bit converter and matrices that are no longer the manufacturer's. The accelerometer has noise and a
bias, which is calibrated from its own readings. Calibration methods see counts, the IMU and the added masses;
the truth is only used for scores: the error of the limb's weight, and the rms of (C A - I) w over that of w,
under the loads w of the sets that were not fitted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import bench
import numpy as np
from rig import (
    SENSORS,
    SensorTruth,
    accelerometer_bias,
    read_imu,
    read_sensor,
    sensor_config,
    static_sets,
)
from scipy.stats import chi2

from surefoot.arrays import Floats
from surefoot.calibration.imu import savitzky_golay
from surefoot.calibration.in_situ import (
    InSituFit,
    InSituOptions,
    InSituSet,
    Limb,
    calibrate_in_situ,
    estimate_matrix,
    estimate_offset,
)
from surefoot.envs.leg_rig.recording import record_rig
from surefoot.experiments.force_torque.validation import (
    added_mass,
    cramer_rao,
    force_ellipsoid,
    normalise_error,
    offset_bounds,
    offset_of_set,
)
from surefoot.experiments.study.tables import (
    Frame,
    Table,
    Verdict,
    decimal,
    number,
    table_of,
    with_interval,
)

RATE, WHITE_RATE, EXACT_RATE = 100.0, 4.0, 10.0  # samples per s; of sets with white noise, and without errors
FITTED = 4  # number of fitted sets, the first ones (in-situ paper, IV)
FILTER = 3.0  # length of the paper's filter in s: 301 samples at 100 Hz
FORCE, TORQUE = slice(0, 3), slice(3, 6)  # parts of a wrench
PUBLISHED = "measurement"  # the method whose numbers are compared with the targets
METHODS = {
    PUBLISHED: "measurement-space fit",
    "no-loop": "the same without hysteresis",
    "paper": "paper (III-B, III-C)",
    "manufacturer": "manufacturer's matrix",
}


@dataclass(frozen=True, eq=False)
class Calibrated:
    """The result of one method for one sensor."""

    matrix: Floats  # C for contact loads in N and N m per count, shape (6, 6)
    in_air: Floats  # C at the swings of the sets, which weighs what hangs on the sensor
    offsets: Floats  # o of each set in counts, shape (J, 6)
    limb: Limb  # beyond the sensor


def calibrate(
    sets: Sequence[InSituSet], nominal: Floats, options: InSituOptions
) -> dict[str, Calibrated | str]:
    """Calibrate with the first :data:`FITTED` sets by every method; a refusal is returned as text."""
    found: dict[str, Calibrated | str] = {}
    for name, loops in ((PUBLISHED, True), ("no-loop", False)):
        fit = calibrate_in_situ(sets[:FITTED], options=replace(options, hysteresis=loops), refuse=False)
        found[name] = add_offsets(fit, sets)
    try:
        paper = calibrate_as_paper(sets)
    except ValueError as refusal:
        return found | dict.fromkeys(("paper", "manufacturer"), str(refusal))
    # The paper also weighs with the manufacturer's matrix, and subtracts the limb that its own method found.
    return found | {"paper": paper, "manufacturer": replace(paper, matrix=nominal, in_air=nominal)}


def add_offsets(fit: InSituFit, sets: Sequence[InSituSet]) -> Calibrated | str:
    """Return a fit with the offsets of the sets that were not fitted, or its first refusal."""
    if fit.refusals:
        return str(fit.refusals[0])
    unseen = sets[len(fit.offsets) :]
    others = [offset_of_set(one.raw, one.gravity, fit.response_in_air, fit.noise) for one in unseen]
    return Calibrated(fit.matrix, fit.matrix_in_air, np.array([*fit.offsets, *others]), fit.limb)


def calibrate_as_paper(sets: Sequence[InSituSet]) -> Calibrated:
    """Filter by cubics over 3 s, then find the offset of each set (III-B) and the matrix (III-C)."""
    smooth = []
    for one in sets:
        assert one.time is not None
        window = 2 * round(FILTER / float(one.time[1] - one.time[0]) / 2.0) + 1
        raw, gravity = (savitzky_golay(part, window) for part in (one.raw, one.gravity))
        smooth.append(replace(one, raw=raw, gravity=gravity))
    offsets = np.array([estimate_offset(one.raw, one.gravity).offset for one in smooth])
    fit = estimate_matrix(smooth[:FITTED], offsets[:FITTED], noise_margin=0.0)
    return Calibrated(fit.matrix, fit.matrix, offsets, fit.limb)


def wrench_error(matrix: Floats, response: Floats, wrench: Floats) -> tuple[float, float]:
    """Return the rms of (C A - I) w over the rms of w for forces and torques, with the true A and w."""
    off = wrench @ (matrix @ response - np.eye(6)).T
    shares = [np.linalg.norm(off[:, part]) / np.linalg.norm(wrench[:, part]) for part in (FORCE, TORQUE)]
    return float(shares[0]), float(shares[1])


def fit_row(found: Calibrated | str, truth: SensorTruth, wrench: Floats) -> dict[str, Any]:
    """Score a calibration under true wrenches that were not fitted, (n, 6)."""
    if isinstance(found, str):
        return {**dict.fromkeys(("limb_error", "force_error", "torque_error"), np.nan), "refusal": found}
    force, torque = wrench_error(found.matrix, truth.response, wrench)
    limb = found.limb.mass / truth.limb.mass - 1.0
    return {"limb_error": limb, "force_error": force, "torque_error": torque, "refusal": ""}


def set_rows(found: Calibrated | str, sets: Sequence[InSituSet]) -> list[dict[str, Any]]:
    """Score the sets that were not fitted as the paper does (its Tables I to III)."""
    if isinstance(found, str):
        return []
    rows = []
    for j, data in enumerate(sets[FITTED:], FITTED):
        wrench = (data.raw - found.offsets[j]) @ found.in_air.T
        axes = force_ellipsoid(wrench[:, FORCE], data.gravity).semi_axes
        weighed = added_mass(wrench, data.gravity, found.limb)
        place = weighed.position if data.added_mass > 0.0 else np.full(3, np.nan)
        errors = {
            "ratio": float(axes[0] / axes[2]),
            "mass_error": abs(weighed.mass - data.added_mass),
            "place_error": float(np.max(np.abs(place - data.added_com))),
        }
        rows.append({"set": j + 1, **errors})
    return rows


def sweep(seed: int, rate: float) -> bench.Rows:
    """Run the experiment with the sensors and the IMU of a seed: a row per method, and per method and set."""
    run = record_rig(rate=rate, seed=seed)
    force = read_imu(run, seed)[..., FORCE]
    bias = accelerometer_bias(force[:FITTED])
    fits, scored = [], []
    for sensor in SENSORS:
        config = sensor_config(sensor)
        counts, truth = read_sensor(config, sensor, run, seed)
        sets = static_sets(sensor, run, counts, force - bias)
        wrench = np.concatenate([getattr(one, f"wrench_{sensor}") for one in run[FITTED:]])
        # Readings at the end of the converter in more than a trace of some set: such a sensor is refused
        # rightly.
        ended = np.abs(counts[:FITTED]) >= config.code_range[1]
        clipped = bool(np.any(ended.mean(axis=1) > 1e-3))
        found = calibrate(sets, config.nominal_matrix, InSituOptions(code_range=config.code_range))
        for method in METHODS:
            key = {"sensor": sensor, "seed": seed, "method": method}
            fits.append({**key, "clipped": clipped, **fit_row(found[method], truth, wrench)})
            scored += [{**key, **row} for row in set_rows(found[method], sets)]
    return {"fits": fits, "sets": scored}


def exact(sensor: str, rate: float) -> bench.Rows:
    """Return relative errors of the paper's method; the sensor's only errors are its matrix and offsets."""
    run = record_rig(rate=rate, at_rest=True)
    counts, truth = read_sensor(sensor_config(sensor, exact=True), sensor, run, 0)
    sets = static_sets(sensor, run, counts, np.stack([one.specific_force for one in run]))
    offsets = np.array([estimate_offset(one.raw, one.gravity).offset for one in sets])
    fit = estimate_matrix(sets[:FITTED], offsets[:FITTED], noise_margin=0.0)
    pairs = [*zip(offsets, truth.offsets, strict=True), (fit.limb.mass_com, truth.limb.mass_com)]
    C = np.linalg.inv(truth.response)
    pairs += [(fit.matrix[part], C[part]) for part in (FORCE, TORQUE)]
    errors = [float(np.linalg.norm(ours - true) / np.linalg.norm(true)) for ours, true in pairs]
    return {"exact": [{"sensor": sensor, "error": max(*errors, abs(fit.limb.mass / truth.limb.mass - 1.0))}]}


def bound(seed: int, rate: float) -> bench.Rows:
    """Compare errors with the Cramer-Rao bound and the fit's covariance, for white noise and exact gravity.

    Squared errors of the offsets are in N^2 and (N m)^2, means over sets and axes.
    """
    run = record_rig(range(1, FITTED + 1), rate=rate, at_rest=True, seed=seed)
    rows = []
    for sensor in SENSORS:
        config = sensor_config(sensor, white=True)
        deviation = np.repeat([config.noise_force, config.noise_torque], 3)
        noise = (config.nominal_response * deviation**2) @ config.nominal_response.T
        counts, truth = read_sensor(config, sensor, run, seed)
        sets = static_sets(sensor, run, counts, np.stack([one.specific_force for one in run]))
        # Each posture was held: with times, a fit would count the turns from one to the next.
        sets = tuple(replace(one, time=None) for one in sets)
        fit = calibrate_in_situ(sets, options=InSituOptions(drift=False), refuse=False)
        least = offset_bounds(cramer_rao(sets, truth.response, truth.limb, noise), truth.response, len(sets))
        variance = np.array([np.diag(one) for one in least])
        off = (fit.offsets - truth.offsets) @ np.linalg.inv(truth.response).T
        nees = np.nan if fit.refusals else normalise_error(fit, truth.response, truth.offset, truth.limb)
        row: dict[str, Any] = {"sensor": sensor, "seed": seed, "nees": nees, "unknowns": len(fit.covariance)}
        for name, part in (("force", FORCE), ("torque", TORQUE)):
            row[f"{name}_square"] = float(np.mean(off[:, part] ** 2))
            row[f"{name}_bound"] = float(np.mean(variance[:, part]))
        rows.append(row)
    return {"bound": rows}


class Target(NamedTuple):
    """A limit that every number has to keep."""

    name: str
    most: float
    values: Floats  # one number per sensor, seed and set
    refused: int = 0  # numbers that are missing because a sound fit was refused
    printed: str = "–"  # in the paper

    @property
    def share(self) -> float:
        """Share of the numbers that keep the limit; a refused fit counts as a miss."""
        count = len(self.values) + self.refused
        return float(np.sum(self.values <= self.most)) / count if count else float("nan")


def consistency(rows: Frame) -> tuple[float, float, float]:
    """Return the mean NEES of rows of ``bound`` over its degrees of freedom, and its 95 % interval."""
    nees = rows["nees"].dropna()
    freedom = int(rows["unknowns"].iloc[0]) * len(nees)
    low, high = chi2.ppf([0.025, 0.975], freedom) / freedom
    return float(nees.sum() / freedom), float(low), float(high)


def targets(found: dict[str, Frame]) -> list[Target]:
    """Compare the results with the targets."""
    fits, sets = (part[part["method"] == PUBLISHED] for part in (found["fits"], found["sets"]))
    # A refused fit leaves all its sets without a number, three of four of which have an added mass in a
    # place.
    refused = int(((fits["refusal"] != "") & ~fits["clipped"]).sum())
    ratio, mass, place = (sets[name].dropna().to_numpy() for name in ("ratio", "mass_error", "place_error"))
    bounds = [part for _, part in found["bound"].groupby("sensor")]
    over = [
        float(np.sqrt(part[f"{what}_square"].sum() / part[f"{what}_bound"].sum()))
        for part in bounds
        for what in ("force", "torque")
    ]
    spread = [abs(2.0 * mean - low - high) / (high - low) for mean, low, high in map(consistency, bounds)]
    limb = fits["limb_error"].dropna().abs().to_numpy()
    table_3 = "its position, error in m along the worst axis (Table III)"
    nees = "covariance, NEES off the middle of its 95 % interval, in half widths"
    return [
        Target("III-B and III-C without noise, relative error", 1e-9, found["exact"]["error"].to_numpy()),
        Target("longest / shortest semi-axis (Table I)", 1.03, ratio, 4 * refused, "1.04 to 1.15"),
        Target("added mass, error in kg (Table II)", 0.01, mass, 4 * refused, "0.05"),
        Target(table_3, 0.01, place, 3 * refused, "up to 0.11"),
        Target("weight of the limb, relative error", 0.01, limb, refused, "about -0.38 (leg)"),
        Target("offset, rmse over the Cramér-Rao bound", 1.3, np.array(over)),
        Target(nees, 1.0, np.array(spread)),
    ]


def target_table(found: dict[str, Frame]) -> Table:
    """Return the table of the targets."""

    def short(reduce: Callable[[Floats], Any]) -> Callable[[Target], str]:
        def cell(one: Target) -> str:
            value = float(reduce(one.values)) if len(one.values) else float("nan")
            return decimal(value, ".1e") if 0.0 < abs(value) < 1e-4 else number(value, 4)

        return cell

    columns: dict[str, Callable[[Target], str]] = {
        "what": lambda one: one.name,
        "at most": lambda one: decimal(one.most, "g"),
        "median": short(np.median),
        "worst": short(np.max),
        "within it (%)": lambda one: decimal(100.0 * one.share, ".1f"),
        "refused": lambda one: decimal(one.refused, "d"),
        "the paper printed": lambda one: one.printed,
        "met by all": lambda one: Verdict.of(one.share == 1.0),
    }
    return table_of(
        "page_targets",
        "Targets, of all seeds, sensors and sets that were not fitted",
        columns,
        targets(found),
    )


def limb_table(fits: Frame) -> Table:
    """Return the errors of the limb's weight, forces and torques, with one row per sensor and method."""

    def error(show: Callable[[Frame], str]) -> Callable[[Frame], str]:
        return lambda part: show(100.0 * part["limb_error"].dropna())

    def within(errors: Frame) -> str:
        return decimal(100.0 * float(np.mean(errors.abs() <= 1.0)) if len(errors) else float("nan"), ".0f")

    columns: dict[str, Callable[[Frame], str]] = {
        "sensor, method": lambda part: f"{part['sensor'].iloc[0]}, {METHODS[part['method'].iloc[0]]}",
        "limb's weight, error (%)": error(with_interval),
        "spread (%)": error(lambda errors: number(errors.std())),
        "worst (%)": error(lambda errors: number(errors.abs().max())),
        "within 1 % (% of seeds)": error(within),
        "forces (%)": lambda part: number(100.0 * part["force_error"].mean()),
        "torques (%)": lambda part: number(100.0 * part["torque_error"].mean()),
        "refused": lambda part: decimal(int((part["refusal"] != "").sum()), "d"),
    }
    parts = [part for _, part in fits.groupby(["sensor", "method"], sort=False)]
    note = "The manufacturer's matrix weighs no limb: its limb is the paper's."
    return table_of("page_limb", "Absolute weight of the limb, and the matrix", columns, parts, note)


def main() -> None:
    """Run the experiment, and write its tables."""
    given = bench.options(__doc__, "in-situ", 12).parse_args()
    rate, seeds = (10.0, range(min(given.seeds, 2))) if given.quick else (RATE, range(given.seeds))
    found = bench.run(given.out, "no errors", exact, [(one, min(rate, EXACT_RATE)) for one in SENSORS])
    found |= bench.run(given.out, "white noise", bound, [(s, WHITE_RATE) for s in seeds], jobs=given.jobs)
    found |= bench.run(given.out, "sweeps", sweep, [(seed, rate) for seed in seeds], jobs=given.jobs)
    text = f"{len(seeds)} seeds, each with its own sensors, IMU and sweep; sets of 300 s at {rate:g} Hz."
    bench.publish(
        given.out, "In-situ calibration, simulated", text, [target_table(found), limb_table(found["fits"])]
    )


if __name__ == "__main__":
    bench.start(__file__)
