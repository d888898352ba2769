"""Real recordings as streams of the arena, with gains and offsets put onto the recorded channels.

What the channels recorded is the truth, so that a plate's own errors are in both sides. The recordings are
found through the environment variable ``SUREFOOT_DATA``; without it their scenarios are skipped.
"""

from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType

import numpy as np

from surefoot.calibration import GRAVITY, FeetLayout, FootLayout, Parameters, Reference
from surefoot.experiments.arena.streams import Stream, held
from surefoot.experiments.logs.format import Log, LogTruth
from surefoot.experiments.real_recordings import (
    RATE,
    Recording,
    drifting_zeros,
    recordings_folder,
    rocked_pole,
    wii_board,
)

__all__ = ["RECORDINGS", "recording_hash", "recording_streams"]

GAIN_STD = 0.1
"""Standard deviation of the gains that are put in."""

OFFSET_SHARE = 0.03
"""Standard deviation of the offsets that are put in, in weights."""

_STREAM = 0x5EA2


def icub_feet(folder: Path) -> Recording:
    """Load the iCub that sways over both feet: two channels, the vertical force on each foot.

    Neither moments nor the soles' places were recorded, so that only the total is told, as a constant: both
    feet are put at one place, where no centre of pressure can be wrong.
    """
    with np.load(folder / "foot" / "icub_com-sinusoid.npz") as file:
        time, feet = file["t_s"], np.column_stack([file["left_fz_N"], file["right_fz_N"]])
    even = np.arange(time[0], time[-1], 1.0 / RATE)
    force = np.column_stack([np.interp(even, time, foot) for foot in feet.T])
    up = np.zeros((6, 1))
    up[2] = 1.0
    layout = FeetLayout(tuple(FootLayout(name, up, ("fz",)) for name in ("left", "right")))
    everywhere = np.ones(len(even), dtype=np.bool_)
    return Recording(
        name="iCub",
        layout=layout,
        force=force,
        vgrf=np.full(len(even), force.sum(axis=1).mean()),
        cop=np.zeros((len(even), 2)),
        loaded=everywhere,
        empty=~everywhere,
        still=False,
        judged=np.arange(len(even)) > 10 * RATE,
    )


RECORDINGS: Mapping[str, tuple[str, Callable[[Path], Recording]]] = MappingProxyType(
    {
        "board": ("wii_board_18min.npz", wii_board),
        "pole": ("caltester_FP1_600hz.npz", rocked_pole),
        "empty-plate": ("kistler2_600hz.npz", drifting_zeros),
        "icub": ("icub_com-sinusoid.npz", icub_feet),
    }
)
"""Recordings by name: a file below ``foot/``, and what loads it."""


def recording_hash(name: str) -> str:
    """Hash a recording's file; empty where there is none."""
    folder = recordings_folder()
    file = None if folder is None else folder / "foot" / RECORDINGS[name][0]
    return "" if file is None or not file.is_file() else sha256(file.read_bytes()).hexdigest()[:16]


def recording_streams(name: str, seeds: range) -> list[Stream]:
    """Put errors onto a recording, once a seed.

    Args:
        name: A key of :data:`RECORDINGS`.
        seeds: Of the draws.

    Returns:
        One stream a seed.

    Raises:
        FileNotFoundError: If ``SUREFOOT_DATA`` does not lead to the recording.
    """
    folder = recordings_folder()
    if folder is None:
        raise FileNotFoundError(
            f"Recording '{name}' needs SUREFOOT_DATA to name a folder with foot/{RECORDINGS[name][0]}."
        )
    recording = RECORDINGS[name][1](folder)
    return [_stream(recording, seed) for seed in seeds]


def _stream(recording: Recording, seed: int) -> Stream:
    rng = np.random.default_rng([_STREAM, seed])
    samples, channels = recording.force.shape
    gain = 1.0 + GAIN_STD * rng.standard_normal(channels)
    offset = OFFSET_SHARE * recording.weight * rng.standard_normal(channels)
    feet = len(recording.layout.feet)
    soles = np.zeros((samples, feet, 3))
    level = np.broadcast_to(np.eye(3), (samples, feet, 3, 3))
    time = np.arange(samples) / RATE
    empty = not recording.loaded.any()
    log = Log(
        time=time,
        raw=recording.force * gain + offset,
        reference=_told(recording),
        layout=recording.layout,
        mass=recording.weight / GRAVITY,
        nominal=Parameters(np.ones(channels), np.zeros(channels)),
        bench=None,
        dt=1.0 / RATE,
        lag=0,
        seed=seed,
        truth=LogTruth(
            force=np.zeros_like(recording.force) if empty else held(recording.force),
            position_sole=soles,
            R_world_sole=level,
            scale=np.broadcast_to(1.0 / gain, (samples, channels)),
            offset=np.broadcast_to(-offset / gain, (samples, channels)),
        ),
        about={"recording": recording.name},
    )
    there = recording.judged & np.isfinite(recording.force).all(axis=1)
    placed = all(foot.position_cell_sole is not None for foot in recording.layout.feet)
    return Stream(
        log=log,
        seed=seed,
        judged=there,
        began=float(time[np.argmax(recording.loaded)]) if not empty else 0.0,
        # Told and scored by one place; a layout without places has no centre of pressure to score.
        cop=recording.cop if placed else np.full((samples, 2), np.nan),
    )


def _told(recording: Recording) -> Reference:
    """Say what the methods are told, with as many feet as the layout has."""
    told = recording.reference()
    feet = len(recording.layout.feet)
    if feet == 1:
        return told
    each = {
        name: np.repeat(getattr(told, name), feet, axis=1)
        for name in ("position_sole", "R_level_sole", "stance", "swing")
    }
    return told._replace(**each)
