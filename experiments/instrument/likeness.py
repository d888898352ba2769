"""Whether a preset behaves as a recording does: both under the same loads, by independent numbers."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.stats import ks_2samp

from surefoot.arrays import Floats
from surefoot.experiments.instrument.noise import FEWEST, Stretch, conversions, find_settled, rests, step_of
from surefoot.experiments.instrument.recording import Recording
from surefoot.experiments.instrument.response import AFTER
from surefoot.sensors import LoadCells
from surefoot.sensors.devices.load_cells import load_cells

LONGEST = 12_000  # rows of a recording over which a preset is run
SUMMED = 16  # conversions of a sum that shows drift


def constant_stretches(
    recording: Recording, scale: Floats, values: Floats | None = None
) -> list[tuple[Stretch, float, float]]:
    """Return conversions under constant loads in N, with the load and the N of a step of the converter.

    ``values`` are readings in counts without some of their errors.
    """
    found: list[tuple[Stretch, float, float]] = []
    read = recording.raw if values is None else values
    for i, raw in enumerate(recording.raw.T):
        step = step_of(raw) * scale[i]
        if recording.has_loads and recording.load is None and not recording.unloaded[:, i].any():
            continue
        if recording.load is None:
            parts = find_settled(rests(recording.time, raw, recording.unloaded[:, i]))
            found += [(Stretch(one.time, one.value * scale[i]), 0.0, step) for one in parts]
            continue
        rows = conversions(raw).rows
        load = recording.load[:, i]
        edges = [0, *(np.flatnonzero(np.diff(load) != 0.0) + 1), len(load)]
        for start, end in pairwise(edges):
            wait = AFTER if start else 0.0
            inside = rows[(rows >= start) & (rows < end)]
            inside = inside[recording.time[inside] >= recording.time[start] + wait]
            if len(inside) >= FEWEST:
                part = Stretch(recording.time[inside], read[inside, i] * scale[i])
                found.append((part, abs(float(load[start])), step))
    return found


def simulate(recording: Recording, cells: LoadCells, periods: Floats) -> Recording:
    """Simulate readings of cells under the loads of a recording; chips of known periods in s keep them."""
    time, K = recording.time, len(recording.names)
    load = np.zeros((len(time), K)) if recording.load is None else recording.load
    signs = cells.polarity if len(cells.polarity) == K else (cells.polarity[0],)
    mechanics = replace(cells.mechanics, mounting_warp_std=0.0, mounting_common_std=0.0)
    device = load_cells(replace(cells, channels=K, polarity=signs, mechanics=mechanics, shear_std=0.0))
    rng = np.random.default_rng(0)
    state, read = device.init((K,), rng), np.empty((len(time), K))
    state = state._replace(period=np.where(np.isfinite(periods), periods, state.period))
    dt = float(np.median(np.diff(time)))
    for row, (now, step) in enumerate(zip(load, np.diff(time, prepend=time[0] - dt), strict=True)):
        read[row], state = device.apply(now[None], state, rng, float(step))
    return replace(recording, raw=read, read=None)


def compare(
    recording: Recording, cells: LoadCells, periods: Floats, size: Floats
) -> tuple[tuple[str, float], ...]:
    """Return the probability that twin and log are as different as they are by chance, of several sides."""
    log = recording.cut(slice(0, LONGEST))
    twin = simulate(log, cells, periods)
    step = 1.0 / cells.counts_per_newton
    seen = [_features(log, size, step), _features(twin, np.full(len(size), step), step)]
    found = []
    for name in seen[0]:
        a, b = (one[name] for one in seen)
        if min(len(a), len(b)) >= FEWEST:
            found.append((name, float(ks_2samp(a, b, method="asymp").pvalue)))
    return tuple(found)


def _features(recording: Recording, scale: Floats, step: float) -> dict[str, Floats]:
    """Return independent numbers that show noise, drift and clock; differences are whole steps in N."""
    noise: list[Floats] = []
    drift: list[Floats] = []
    runs: list[Floats] = []
    for one, _, own in constant_stretches(recording, scale):
        # Every second difference of neighbours shares no noise with the next.
        differences = np.diff(one.value)[::2]
        coarse = 2.0 * own > step  # readings of the preset may have no steps at all
        noise.append(np.rint(differences / own) * step if coarse else differences)
        if not recording.has_loads:
            continue  # an unknown load moves as well
        whole = len(one.value) // SUMMED * SUMMED
        means = one.value[:whole].reshape(-1, SUMMED).mean(axis=1)
        drift.append(np.diff(means)[::2])
    for raw in recording.raw.T:
        rows, _, slower = conversions(raw)
        if slower:
            # Lateness beats with the rows: runs of one length follow each other.
            runs.append(np.diff(rows[::8])[::2].astype(float))
    parts = {
        "noise: differences of conversions": noise,
        f"drift: differences of means of {SUMMED}": drift,
        "clock: rows of 8 conversions": runs,
    }
    return {name: np.concatenate([np.zeros(0), *part]) for name, part in parts.items()}
