"""Contact loads that no fit has seen: is a calibrated sensor better than its maker's matrix, or worse?

    python benchmarks/in_situ_contact.py                     # 20 seeds a row
    python benchmarks/in_situ_contact.py --seeds 5 --off 0.03

A six-axis sensor (12 bits of noise, or ten times as much) whose maker's matrix is off by a share of full
scale in every entry is calibrated with one to four loads: a bare tool, and masses on it. It is scored with
pushes of up to half of full scale at random, which no tool's weight resembles: the error of the wrench beside
the offset, as a share of full scale, of the maker's matrix and of the calibrated one, and the share of the
calibrated matrix's entries that its 95 % intervals hold.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from surefoot.calibration.in_situ import InSituSet, calibrate_in_situ

Floats = NDArray[np.float64]

FULL_SCALE = np.array([130.0, 130.0, 400.0, 10.0, 10.0, 10.0])
"""Of an ATI Gamma SI-130-10 in N and N m."""

QUIET, NOISY = 2.0**-12, 10.0 * 2.0**-12
"""White noise as a share of full scale."""

LOADS = (
    (0.0, (0.0, 0.0, 0.0)),
    (1.0, (0.12, 0.0, 0.08)),
    (1.0, (-0.05, 0.1, 0.1)),
    (1.5, (0.0, -0.08, 0.15)),
)
"""Masses in kg, and their places in m."""

TOOL = (1.2, np.array([0.01, 0.02, 0.06]))
ROWS, SPACING = 600, 0.1
GRAVITY_NOISE = 0.02
"""In m/s^2."""


@dataclass(frozen=True)
class Score:
    """One calibration.

    Attributes:
        maker: Error of forces and torques by the maker's matrix, as shares of full scale, rms.
        ours: The same by the calibrated one.
        held: Share of its entries within 1.96 deviations.
        refusal: Why there is none, or empty.
    """

    maker: tuple[float, float]
    ours: tuple[float, float]
    held: float
    refusal: str


def experiment(seed: int, loads: int, off: float, noise: float) -> tuple[list[InSituSet], Floats, Floats]:
    """Return sets, the maker's matrix (newtons of a driver) and the true response."""
    rng = np.random.default_rng([7, seed, loads, round(1e4 * off), round(1e6 * noise)])
    D = off * rng.standard_normal((6, 6)) * FULL_SCALE[:, None] / FULL_SCALE
    response = np.eye(6) + D
    time = SPACING * np.arange(ROWS)
    sets = []
    for mass, place in LOADS[:loads]:
        phase = rng.uniform(0.0, 2.0 * np.pi, 2)
        angles = [
            1.2 * np.sin(2.0 * np.pi * time / 37.0 + phase[0]),
            1.4 * np.sin(2.0 * np.pi * time / 23.0 + phase[1]),
        ]
        gravity = Rotation.from_euler("xy", np.stack(angles, axis=1)).inv().apply([0.0, 0.0, -9.80665])
        moment = TOOL[0] * TOOL[1] + mass * np.array(place)
        wrench = np.concatenate([(TOOL[0] + mass) * gravity, np.cross(moment, gravity)], axis=1)
        read = wrench @ response.T + rng.normal(0.0, 0.02, 6) * FULL_SCALE
        read = read + noise * FULL_SCALE * rng.standard_normal(read.shape)
        felt = gravity + GRAVITY_NOISE * rng.standard_normal(gravity.shape)
        sets.append(InSituSet(read, felt, mass, place, time=time, name=f"load {len(sets)}"))
    return sets, np.eye(6), response


def score(seed: int, loads: int, off: float, noise: float) -> Score:
    """Return how one sensor comes out."""
    sets, maker, response = experiment(seed, loads, off, noise)
    rng = np.random.default_rng([8, seed])
    pushes = 0.5 * FULL_SCALE * rng.uniform(-1.0, 1.0, (500, 6))
    fit = calibrate_in_situ(sets, factory_matrix=maker, refuse=False)
    by_maker = _error(maker, response, pushes)
    if fit.refusals:
        return Score(by_maker, (np.nan, np.nan), np.nan, str(fit.refusals[0]))
    off_by = np.abs(fit.matrix - np.linalg.inv(response)) / fit.matrix_std
    return Score(by_maker, _error(fit.matrix, response, pushes), float(np.mean(off_by < 1.96)), "")


def _error(matrix: Floats, response: Floats, pushes: Floats) -> tuple[float, float]:
    wrong = (pushes @ (matrix @ response - np.eye(6)).T) / FULL_SCALE
    return float(np.sqrt(np.mean(wrong[:, :3] ** 2))), float(np.sqrt(np.mean(wrong[:, 3:] ** 2)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--off", type=float, nargs="*", default=[0.0, 0.01, 0.03, 0.1])
    parser.add_argument("--loads", type=int, nargs="*", default=[1, 2, 3, 4])
    parser.add_argument("--quiet", action="store_true", help="without the noisy sensor")
    args = parser.parse_args()
    table = Table(title="Error of contact loads, % of full scale (rms), mean over seeds")
    for name in (
        "loads",
        "maker off",
        "noise",
        "maker f",
        "ours f",
        "maker t",
        "ours t",
        "worst - maker",
        "held",
        "refused",
    ):
        table.add_column(name, justify="right")
    for noise in (QUIET,) if args.quiet else (QUIET, NOISY):
        for off in args.off:
            for loads in args.loads:
                rows = [score(args.first + s, loads, off, noise) for s in range(args.seeds)]
                answered = [one for one in rows if not one.refusal]
                ours = np.array([one.ours for one in answered]).reshape(-1, 2)
                maker = np.array([one.maker for one in answered]).reshape(-1, 2)
                worst = np.max(ours - maker) if len(ours) else np.nan
                means = [
                    f"{100 * value:.3f}"
                    for pair in zip(maker.mean(0), ours.mean(0), strict=True)
                    for value in pair
                ]
                held = np.mean([one.held for one in answered])
                table.add_row(
                    str(loads), f"{100 * off:.0f} %", "quiet" if noise == QUIET else "noisy", *means,
                    f"{100 * worst:+.3f}", f"{held:.2f}", str(len(rows) - len(answered)),
                )  # fmt: skip
                for one in {one.refusal[:150] for one in rows if one.refusal}:
                    print(loads, off, one)
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
