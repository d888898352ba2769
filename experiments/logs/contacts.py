"""Feet that certainly stand and feet that certainly swing. Calibrators do not learn from other feet.

Contacts come from the log, otherwise from commands, otherwise from the motion of the soles.
"""

import numpy as np
from scipy.ndimage import maximum_filter1d

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, Reference
from surefoot.calibration.contacts import SURE_ALOFT, SWINGS, Bools, erode, load_range
from surefoot.experiments.logs.checks import check_columns
from surefoot.experiments.logs.table import LogError, LogTable

LIFTED = 0.007
"""Height in m of one sole above the other from which it does not stand on the same floor. Errors of joint
angles and compliance amount to some millimetres."""

TOGETHER = 0.003  # largest height difference in m of two soles on the same floor
MOVING = 0.03  # relative speed in m/s of the soles above which one of them does not stand
PAUSE = 0.1  # time in s for which a foot in the air may rest, because it stops at the highest point
CARRIED = 0.5  # least share of the weight on the ground for any foot to count as standing

GUESSED = "guessed from the height and speed of the soles"
FELT = "guessed from the feet's own load"

HARDEST = 3.0
"""Largest range of a foot's load in body weights. For runners it is two to three (Nilsson and Thorstensson
1989, Acta Physiol. Scand. 136)."""


def contacts(
    table: LogTable, names: tuple[str, str], reference: Reference, dt: float
) -> tuple[Bools, Bools, str]:
    """Return which feet certainly stand and which swing, (N, 2) each, and the source of the contacts."""
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
    """Estimate stance and swing, (N, 2) each, from the height and relative speed of the soles.

    A raised foot that does not move may stand on a stair, so it is neither in stance nor in swing.
    """
    apart = reference.position_sole[:, 0] - reference.position_sole[:, 1]
    known = np.isfinite(apart).all(axis=-1) & np.isfinite(reference.com_acceleration[:, 2])
    apart = np.where(known[:, None], apart, 0.0)
    # The level frame rotates with the feet, which does not change lengths.
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
    """Raise LogError unless the load of a foot in N, (N, F), changes as in a step of a robot of this mass."""
    span, weight = float(load_range(load)[1].max()), mass * GRAVITY
    if not SWINGS < span / weight < HARDEST:
        raise LogError(
            f"{file}: by the nominal map no foot's load changes by more than {span:.4g} N, and mass_kg = "
            f"{mass:.4g} weighs {weight:.4g} N: {span / weight:.3g} times as much, where a step makes "
            f"{SWINGS:g} to {HARDEST:g}. Give scale_N_per_count in newtons (9.81 for each kilogram) and "
            "mass_kg in kilograms; if they are, lift each foot, or give 'offset_N'."
        )
