"""Which feet surely stand and which surely swing: no calibrator learns from one that is neither.

The log's own contacts come first, then the commands, then a guess from the soles' own motion.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, Reference
from surefoot.experiments.logs.checks import check_columns
from surefoot.experiments.logs.table import LogError, LogTable

SURE, SURE_ALOFT = 0.05, 0.025
"""Times in s by which a contact must hold before and after a moment to be sure of it, and by which a sole
must be seen in the air: there its height is a margin of its own."""

LIFTED = 0.007
"""Height in m of one sole above the other at which it surely does not stand on the same floor: angles of
joints and what gives under load make up some millimetres."""

TOGETHER = 0.003  # height in m up to which two soles may stand on the same floor
MOVING = 0.03  # speed in m/s of one sole against the other at which one of them surely does not stand
PAUSE = 0.1  # s before and after which a foot in the air must move: it turns round at the top
CARRIED = 0.5  # share of the weight that the ground must carry for any foot to be sure to stand

GUESSED = "guessed from the height and speed of the soles"
FELT = "guessed from the feet's own load"

SWINGS, LOADED = 0.5, 0.3
"""Range of a foot's load in weights from which it is thought to step at all, and the share of its range above
which it surely bears load."""

HARDEST = 3.0
"""Weights that the load of a foot changes by at most: those of runners do by two to three (Nilsson and
Thorstensson 1989, Acta Physiol. Scand. 136)."""

MOSTLY = 0.4  # share of rows with a reading that is enough: chips at half the rows' rate have about a half
FLAT = 0.01  # std of a foot's load in weights up to which it may hang in the air

Bools = NDArray[np.bool_]


def contacts(
    table: LogTable, names: tuple[str, str], reference: Reference, dt: float
) -> tuple[Bools, Bools, str]:
    """Return which feet surely stand and which surely swing, (N, 2) each, and how it is known."""
    phases = [f"reference_{name}_{phase}" for phase in ("stance", "swing") for name in names]
    commands = [f"command_{name}_contact" for name in names]
    for wanted, source in ((phases, "as the log says"), (commands, "as the log says was commanded")):
        there = [name for name in wanted if name in table]
        if not there:
            continue
        if len(there) < len(wanted):
            missing = ", ".join(name for name in wanted if name not in there)
            raise LogError(
                f"{table.file}: column {there[0]} is there without {missing}; give contacts of both feet or "
                "none."
            )
        values = check_columns(table, wanted)
        down = np.stack([values[name] for name in wanted], axis=-1) > 0.5
        if wanted is phases:
            return down[:, :2], down[:, 2:], source
        return _erode(down, dt), _erode(~down, dt), source
    return *guess_contacts(reference, dt), GUESSED


def guess_contacts(reference: Reference, dt: float) -> tuple[Bools, Bools]:
    """Guess stance and swing, (N, 2) each, from how high the soles are and how fast they move apart.

    A foot that is held up without moving may as well stand on a stair: it is neither.
    """
    apart = reference.position_sole[:, 0] - reference.position_sole[:, 1]
    known = np.isfinite(apart).all(axis=-1) & np.isfinite(reference.com_acceleration[:, 2])
    apart = np.where(known[:, None], apart, 0.0)
    # The level frame turns with the feet; lengths in it do not.
    speed = np.linalg.norm(np.gradient(apart, dt, axis=0), axis=-1)
    near = 2 * round(PAUSE / dt) + 1
    moving = maximum_filter1d((speed > MOVING).astype(np.int8), near, axis=0, mode="nearest") > 0
    height = np.stack([apart[:, 2], -apart[:, 2]], axis=-1)
    falling = ~(reference.com_acceleration[:, 2] > (CARRIED - 1.0) * GRAVITY)
    sure = (known & ~falling)[:, None]
    swing = (height > LIFTED) & moving[:, None] & sure
    together = (np.abs(height) < TOGETHER) & ~(speed > MOVING)[:, None]
    stance = (swing[:, ::-1] | together) & sure
    return _erode(stance, dt), _erode(swing, dt, SURE_ALOFT)


def feel_contacts(load: Floats, weight: float, dt: float) -> tuple[Bools, Bools]:
    """Guess stance and swing, (N, F) each, from the feet's vertical force in N by the starting map, (N, F).

    The map's offsets may be wrong: a foot swings where its load is flat at the low end of its range. A foot
    whose range is less than half the weight never leaves the ground; it is neither.
    """
    low, span = _range_of(load)
    steps = span > SWINGS * weight
    read, near = np.isfinite(load), 2 * round(SURE / dt) + 1
    load = np.where(read, load, 0.0)
    share, mean, square = (uniform_filter1d(read * load**p, near, axis=0, mode="nearest") for p in (0, 1, 2))
    mean, square = np.stack([mean, square]) / np.maximum(share, 1.0 / near)
    known = share > MOSTLY
    flat = np.sqrt(np.maximum(square - mean**2, 0.0)) < FLAT * weight
    low = np.where(flat & known, mean, np.inf).min(axis=0)
    swing = flat & (np.abs(mean - low) < 2.0 * FLAT * weight) & steps & known
    stance = (np.where(read, load, mean) > low + LOADED * span) & steps & known
    return _erode(stance, dt, SURE_ALOFT), _erode(swing, dt, SURE_ALOFT)


def check_steps(load: Floats, mass: float, file: str) -> None:
    """Raise LogError if by the starting map no foot's load in N, (N, F), changes as a robot's in kg does."""
    span, weight = float(_range_of(load)[1].max()), mass * GRAVITY
    if not SWINGS < span / weight < HARDEST:
        raise LogError(
            f"{file}: by the nominal map no foot's load changes by more than {span:.4g} N, and mass_kg = "
            f"{mass:.4g} weighs {weight:.4g} N: {span / weight:.3g} times as much, where a step makes "
            f"{SWINGS:g} to {HARDEST:g}. Give scale_N_per_count in newtons (9.81 for each kilogram) and "
            "mass_kg in kilograms; if they are, lift each foot, or give 'offset_N'."
        )


def _range_of(load: Floats) -> tuple[Floats, Floats]:
    """Return the least load in N and its range of each foot, (F,) each; 0 of a foot that was never read."""
    read = np.where(np.isfinite(load).any(axis=0), load, 0.0)
    low, high = np.nanpercentile(read, (2.0, 98.0), axis=0)
    return low, high - low


def refer_to_contacts(stance: Bools, swing: Bools, position_sole: Any) -> Reference:
    """Make the reference of feet alone: contacts, (..., F), and level soles in m, (..., F, 3)."""
    still = np.zeros((*stance.shape[:-1], 3))
    return Reference(
        com=still,
        com_acceleration=still,
        angular_momentum_rate=still,
        position_sole=position_sole,
        R_level_sole=np.tile(np.eye(3), (*stance.shape, 1, 1)),
        stance=stance,
        swing=swing,
        accelerometer=still + np.array([0.0, 0.0, GRAVITY]),
        gyroscope=still,
    )


def _erode(held: Bools, dt: float, margin: float = SURE) -> Bools:
    """Samples whose neighbours up to a margin in s hold as well."""
    kept = minimum_filter1d(held.astype(np.int8), 2 * round(margin / dt) + 1, axis=0, mode="nearest")
    return np.asarray(kept > 0)
