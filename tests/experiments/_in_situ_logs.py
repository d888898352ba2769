"""A made log of an in-situ calibration."""

from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.calibration import GRAVITY

RAW = [f"raw_{i}_count" for i in range(6)]
FORCE = [f"specific_force_{axis}_m_s2" for axis in "xyz"]
SPIN = [f"angular_velocity_{axis}_rad_s" for axis in "xyz"]
ROWS = 40
RESPONSE = np.diag([20.0, 20.0, 10.0, 900.0, 900.0, 800.0])
SETS = {"1": (0.0, (0.0, 0.0, 0.0)), "2": (0.5, (0.1, 0.0, 0.3)), "3": (0.7, (-0.1, 0.1, 0.3))}


def table() -> pd.DataFrame:
    """Three sets of a leg of 4 kg that turns slowly, whose counts are exact, at 10 Hz."""
    parts = []
    for begun, (name, (mass, com)) in enumerate(SETS.items()):
        time = np.arange(ROWS) / 10.0
        pitch, roll = 0.6 * np.sin(0.5 * time), 0.5 * np.sin(0.9 * time)
        up = GRAVITY * np.stack(
            [np.sin(pitch), -np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch)], axis=1
        )
        first = 4.0 * np.array([0.01, 0.0, 0.2]) + mass * np.asarray(com)
        wrench = np.concatenate([-(4.0 + mass) * up, -np.cross(first, up)], axis=1)
        frame = pd.DataFrame({"time_s": time + 100.0 * begun, "set": int(name)})
        frame[RAW] = wrench @ RESPONSE.T + 300.0
        frame[FORCE] = up
        parts.append(frame)
    return pd.concat(parts, ignore_index=True)


def toml(extra: str = "", sets: bool = True) -> str:
    """Name the added masses."""
    listed = [
        f'[[sets]]\nname = "{name}"\nadded_mass_kg = {mass}\nadded_com_m = {list(com)}\n'
        for name, (mass, com) in SETS.items()
    ]
    return extra + "\n" + "".join(listed if sets else [])


def write(folder: Path, frame: pd.DataFrame, told: str | None = None) -> Path:
    path = folder / "leg.csv"
    frame.to_csv(path, index=False)
    path.with_suffix(".toml").write_text(toml() if told is None else told)
    return path


def spinning(frame: pd.DataFrame) -> pd.DataFrame:
    """Add the gyroscope that belongs to the turning of gravity (its part about gravity left at zero)."""
    frame = frame.copy()
    frame[SPIN] = 0.0
    for _, part in frame.groupby("set"):
        up = part[FORCE].to_numpy() / GRAVITY
        rate = np.gradient(up, 0.1, axis=0)
        # d up/dt = -w x up; the w without a part along up is up x d up/dt turned round.
        frame.loc[part.index, SPIN] = np.cross(rate, up)
    return frame
