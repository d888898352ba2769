"""Check a log before and after calibration: reject implausible loads, and collect notices about missing data.

A log is rejected only if it would mislead every calibrator. All other flaws become notices, which are shown
to the user and stored with the result.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from surefoot.calibration import GRAVITY, Estimate, Flag, Parameters
from surefoot.calibration.cop import sole_wrenches
from surefoot.calibration.results import Finding
from surefoot.experiments.instrument.channels import Wrong, facts_of, find_wrong_channels
from surefoot.experiments.instrument.recording import Recording
from surefoot.experiments.logs.clock import MAX_GAP, find_gaps, longest_step
from surefoot.experiments.logs.columns import raw_names_of
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.walking.agreement import ground_of_motion
from surefoot.experiments.walking.judge import explain_pull

MOST = 3.0  # maximum ratio between total foot force and weight, either way (beyond it, units are wrong)
STILL = 0.003  # maximum std in m of the CoP required by the motion, for a robot that stands still
ALIKE = 0.03  # relative difference between mass_kg and the mass of the robot model that is not reported

SPARSE = 0.5  # minimum share of missing, repeated or rejected readings for a notice
ROUNDING = 1e-9  # rounding error of a force that is exactly zero, in units of the body weight
COMMON = 1.5  # maximum median change factor of the scales, either way (beyond it, one cause affects all)

_UNITS = {
    1000.0: "millinewtons or a mass in tonnes",
    1.0 / 1000.0: "kilonewtons or a mass in grams",
    1000.0 / GRAVITY: "grams-force",
    1.0 / GRAVITY: "kilograms-force",
    0.2248: "pounds-force",
}


def check_weight(log: Log, start: str, initial: Parameters, file: str) -> None:
    """Raise LogError if the foot forces of the starting map are negative or far from the robot's weight."""
    if wrong := weigh_feet(log, start, initial):
        raise LogError(f"{file}: {wrong.reason} {wrong.cure}")


def weigh_feet(log: Log, start: str, initial: Parameters) -> Finding | None:
    """Return a finding if the starting map gives negative forces or an implausible weight, else ``None``."""
    read = np.isfinite(log.raw)
    # A reading that never changes comes from a dead channel and is unrelated to the load.
    lives = np.array([at.any() and np.ptp(raw[at]) > 0.0 for raw, at in zip(log.raw.T, read.T, strict=True)])
    if not lives.any():
        reason = f"columns 'raw_..._count' hold no reading that ever changes in the {len(log)} rows;"
        return Finding("no reading", reason, "write the converters' counts into them.")
    force = np.where(read & lives, initial.force(log.raw), 0.0)
    total = sole_wrenches(force, log.layout)[..., 2].sum(axis=-1)
    low, high, highest = np.percentile(total, (10, 90, 99))
    weight = log.mass * GRAVITY
    given = f"and mass_kg = {log.mass:.4g} weighs {weight:.4g} N"
    if low < -weight / MOST and high < weight / MOST:
        cause = explain_pull(log, initial)
        pull = f"by the {start} map the feet pull the ground with {-low:.4g} N, {given}."
        return replace(cause, reason=f"{pull} {cause.reason}")
    if high < weight / MOST:
        high = highest  # the robot may stand on the sensors for less than a tenth of the log
    ratio = float(high / weight)
    if 1.0 / MOST <= ratio <= MOST:
        return None
    near = [
        f" A map in {text} would look so." for factor, text in _UNITS.items() if 0.67 < ratio / factor < 1.5
    ]
    return Finding(
        "mass",
        f"by the {start} map the feet carry {high:.4g} N where they carry most, {given}: {ratio:.3g} times "
        f"as much.{near[0] if near else ''}",
        "Give scale_N_per_count and offset_N in newtons (without offset_N it is read while a foot swings), "
        "mass_kg in kilograms, and a log in which the robot stands on its feet.",
        ratio,
        MOST,
    )


def log_notices(log: Log, file: str) -> tuple[str, ...]:
    """Notices about a log. Each is one sentence with the observation, its effect and the remedy."""
    found = (*_clock_notices(log), *motion_notices(log))
    broken = (
        f"{file} ({one.since}): {one.finding.reason} {one.finding.cure}" for one in find_broken(log, file)
    )
    return (*log.about.get("notices", ()), *broken, *(f"{file}: {text}" for text in found))


def find_broken(log: Log, file: str) -> Iterator[Wrong]:
    """Yield the flaws of single channels that ``surefoot check`` reports as wrong.

    Calibration continues, because some methods can cope with them.
    """
    names, nowhere = tuple(raw_names_of(log.layout)), np.zeros(log.raw.shape, dtype=bool)
    recording = Recording(file, "walk", names, log.time, log.raw, nowhere)
    # Without times, noise and drift are not analysed, which saves time.
    timeless = replace(recording, time=np.full(len(log), np.nan))
    yield from (one for one in find_wrong_channels(recording, facts_of(timeless)) if one.finding.refuses)


def _clock_notices(log: Log) -> Iterator[str]:
    """Yield a notice about gaps in the times of the rows."""
    step = np.diff(log.time)
    gaps = find_gaps(step)
    if gaps.any():
        longest = longest_step(step, MAX_GAP)
        yield (
            f"column 'time_s' leaps {gaps.sum()} times by more than {longest:.3g} s, the longest "
            f"by {step.max():.3g} s; after each the filters start again, and what was learnt is kept."
        )


def motion_notices(log: Log) -> Iterator[str]:
    """Yield notices about incomplete motion, contacts and mass, and about rows that repeat readings."""
    held = (np.diff(log.raw, axis=0) == 0.0).all(axis=1).mean() if len(log) > 1 else 0.0
    if SPARSE < held < 1.0:
        yield (
            f"{100 * held:.0f} % of the rows repeat the readings of all channels of the row before, so that "
            "they come late; write rows at the converters' rate."
        )
    unknown = ~np.isfinite(log.reference.com).all(axis=-1)
    if unknown.any():
        yield (
            f"in {unknown.sum()} of {len(log)} rows joints and IMU do not reach around the sample of the "
            "feet; nothing is learnt there."
        )
    model = log.about.get("model_mass_kg")
    if model is not None and abs(model / log.mass - 1.0) > ALIKE:
        yield (
            f"mass_kg = {log.mass:.4g} is not the model's {model:.4g} kg; its centre of mass and angular "
            "momentum are the model's. Weigh the robot, and correct the model."
        )
    swing, source = np.asarray(log.reference.swing), log.about.get("contacts", "")
    for i, foot in enumerate(log.layout.feet if len(log.layout.feet) == 2 else ()):
        if not swing[:, i].any():
            seen = f"'reference_{foot.name}_swing' is 0 in all {len(log)} rows"
            yield (
                f"the {foot.name} foot is never surely in the air ({source or seen}), so that its offsets "
                "cannot be separated from its scales; let it swing, or lift it for a second."
            )
    alone = bool(log.about.get("feet_alone", False))
    spread = np.inf if alone else _spread(log)
    if not swing.any() and spread < STILL:
        yield (
            f"the robot never moves: the centre of pressure that its motion asks for stays within "
            f"{1e3 * spread:.1f} mm, so that only the weight and its place can be learnt and single channels "
            "cannot; walk, or shift the weight over each corner."
        )


def result_notices(
    log: Log, method: str, initial: Parameters, estimate: Estimate, file: str
) -> tuple[str, ...]:
    """Return notices about a result: an unchanged map, scales that change sign, or a common scale factor."""
    found, unread = [], float(1.0 - np.isfinite(log.raw).mean())
    still = all(np.ptp(part, axis=0).max() == 0.0 for part in (estimate.scale, estimate.offset))
    if still and method != "none":
        why = _why_nothing_was_learnt(log, method, initial, estimate)
        found.append(f"nothing was learnt: the {method} map is the one at the start. {why}")
    elif unread > SPARSE:
        found.append(
            f"{100 * unread:.0f} % of the readings are missing; the last ones are held in between, and less "
            "is learnt. If the converters are slower than the rows, write rows at their rate."
        )
    ratio = np.asarray(estimate.scale[-1]) / np.asarray(initial.scale)
    found += [
        f"the scale of column '{name}' changed its sign, which no cell's drift does: see whether cells or "
        "feet are exchanged before you use this map."
        for name, change in zip(raw_names_of(log.layout), ratio, strict=True)
        if change < 0.0
    ]
    common = float(np.median(ratio))
    if common > COMMON or 0.0 < common < 1.0 / COMMON:
        found.append(
            f"scales changed by a common factor of {common:.2f}: see whether mass_kg is in kilograms and the "
            "amplifiers' gain is the one of the starting map."
        )
    return tuple(f"{file}: {text}" for text in found)


def _why_nothing_was_learnt(log: Log, method: str, initial: Parameters, estimate: Estimate) -> str:
    """Return the likely reason why the map did not change, with a remedy."""
    read, flags = np.isfinite(log.raw), np.asarray(estimate.flags)
    unread, partly = float(1.0 - read.mean()), float(1.0 - read.all(axis=1).mean())
    lost = Flag.MISSING | Flag.OUT_OF_RANGE | Flag.DEAD | Flag.STUCK
    useless = ((flags & lost) != 0).mean(axis=0) > 1.0 - SPARSE / 10.0
    refused = ((flags & Flag.REJECTED) != 0).any(axis=1).mean()
    if unread > SPARSE:
        return (
            f"{100 * unread:.0f} % of the readings are missing, and a method learns from rows in which all "
            "channels were read; if the converters are slower than the rows, write rows at their rate."
        )
    if useless.any():
        name = raw_names_of(log.layout)[int(np.argmax(useless))]
        return f"Column '{name}' never holds a living channel's reading, and this method needs every one."
    if refused > SPARSE:
        return f"{100 * refused:.0f} % of the samples ask for what no sensor does."
    if partly > SPARSE / 10.0:
        fill = "fill single missing readings between their neighbours, or log all channels in every row."
        lack = f"{100 * partly:.0f} % of the rows lack a reading of a channel"
        return f"{lack}, of which little is learnt; {fill}"
    air = np.asarray(log.reference.swing)[log.reference_rows][:, log.layout.foot_of_channel]
    hanging = np.abs(np.where(air & read, initial.force(log.raw), 0.0))
    if method == "tare" and air.any(axis=0).all() and hanging.max() < ROUNDING * log.mass * GRAVITY:
        return "It was exact already: feet in the air read 0 N by it."
    return "The log may be too short, or no foot surely stands or swings: see the flags."


def _spread(log: Log) -> float:
    """Standard deviation in m of the CoP required by the motion, relative to the middle of the soles.

    It is infinite if the CoP is unknown in all rows.
    """
    cop = ground_of_motion(log).cop
    there = cop[np.isfinite(cop).all(axis=-1)]
    return float(there.std(axis=0).max()) if len(there) else np.inf
