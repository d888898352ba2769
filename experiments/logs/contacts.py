"""Which feet surely stand and which surely swing: no calibrator learns from one that is neither.

The log's own contacts come first, then the commands, then a guess from the soles' own motion.
"""

import numpy as np
from scipy.ndimage import maximum_filter1d

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, Reference
from surefoot.calibration.contacts import SURE_ALOFT, SWINGS, Bools, erode, load_range
from surefoot.experiments.logs.checks import check_columns
from surefoot.experiments.logs.table import LogError, LogTable

LIFTED = 0.007
"""Height in m of one sole above the other at which it surely does not stand on the same floor: angles of
joints and what gives under load make up some millimetres."""

TOGETHER = 0.003  # height in m up to which two soles may stand on the same floor
MOVING = 0.03  # speed in m/s of one sole against the other at which one of them surely does not stand
PAUSE = 0.1  # s before and after which a foot in the air must move: it turns round at the top
CARRIED = 0.5  # share of the weight that the ground must carry for any foot to be sure to stand

GUESSED = "guessed from the height and speed of the soles"
FELT = "guessed from the feet's own load"

HARDEST = 3.0
"""Weights that the load of a foot changes by at most: those of runners do by two to three (Nilsson and
Thorstensson 1989, Acta Physiol. Scand. 136)."""


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
        return erode(down, dt), erode(~down, dt), source
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
    return erode(stance, dt), erode(swing, dt, SURE_ALOFT)


def check_steps(load: Floats, mass: float, file: str) -> None:
    """Raise LogError if by the starting map no foot's load in N, (N, F), changes as a robot's in kg does."""
    span, weight = float(load_range(load)[1].max()), mass * GRAVITY
    if not SWINGS < span / weight < HARDEST:
        raise LogError(
            f"{file}: by the nominal map no foot's load changes by more than {span:.4g} N, and mass_kg = "
            f"{mass:.4g} weighs {weight:.4g} N: {span / weight:.3g} times as much, where a step makes "
            f"{SWINGS:g} to {HARDEST:g}. Give scale_N_per_count in newtons (9.81 for each kilogram) and "
            "mass_kg in kilograms; if they are, lift each foot, or give 'offset_N'."
        )
