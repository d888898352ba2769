"""The worth of each part of the moment filter: each switched off in turn, on the same scenes.

    python benchmarks/ablation.py --out FOLDER --seeds 4

Scenes are those of ``momentum.py``, recorded where they are missing: several robots, by policies and
patterns, walking, standing, held. Of each the error of a foot's centre of pressure in mm, as the root mean
square over seeds, and the NEES a parameter.
"""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from joblib import Parallel, delayed
from momentum import score, stream

from surefoot.calibration.moment.columns import Columns
from surefoot.calibration.moment.filter import MomentFilter
from surefoot.calibration.moment.modes import FIRST_CHANCE, HELD, LOADED, MODES, RATES

SCENES = (
    "g1/walk", "g1/stop-and-go", "g1/held-20", "g1/stand", "g1-fastsac/walk", "nao/walk", "nao/sway",
    "nao/balance", "exercise/op3", "exercise/t1",
)  # fmt: skip

Change = Callable[[MomentFilter, Mapping[str, Any]], dict[str, Any]]
"""Makes other values of some constants, by their names in C."""


def set_to(**values: Any) -> Change:
    """Set constants to values."""
    return lambda filter_, now: values


def take_for_right(part: str) -> Change:
    """Begin sure of some unknowns."""

    def change(filter_: MomentFilter, now: Mapping[str, Any]) -> dict[str, Any]:
        variance = now["first_variance"].copy()
        variance[getattr(Columns.of(filter_.setup.layout), part)] = 0.0
        return {"first_variance": variance}

    return change


def leave_out(*modes: int) -> Change:
    """Leave out modes."""
    rates, chance = RATES.copy(), FIRST_CHANCE.copy()
    rates[:, modes] = 0.0
    chance[list(modes)] = 1e-12
    return set_to(rates=rates, first_chance=chance / chance.sum(), least_chance=1e-12)


VARIANTS: dict[str, Change] = {
    "as it is": set_to(),
    "nobody holds it": leave_out(MODES.index(HELD)),
    "no loads": leave_out(MODES.index(LOADED)),
    "the start is believed as stated": set_to(severities=np.ones(4)),
    "noise is as stated": set_to(noise_share=0.0),
    "drift is as stated": set_to(rate_share=0.0, stated_rate=1e12),
    "readings are means": set_to(ripple=0.0),
    "a zero's drift is soon forgotten": set_to(product_time=0.0),
    "centre of mass taken for right": take_for_right("com"),
    "delay taken for right": take_for_right("delay"),
    "no tare": set_to(tare_share=2.0),
    "no gate": set_to(gate=1e6),
    "nobody is suspected": set_to(sure=1e12, contrast=1e12),
}


class Run(NamedTuple):
    """One scene of one seed, and the filter without one of its parts."""

    scene: str
    seed: int
    variant: str


def constants(change: Change, usual: Any, filter_: MomentFilter) -> tuple[NamedTuple, ...]:
    """Return the filter's constants, some of them changed."""
    records = usual.fget(filter_)
    now = {name: value for record in records for name, value in record._asdict().items()}
    values = change(filter_, now)
    return tuple(
        record._replace(**{name: values[name] for name in record._fields if name in values})
        for record in records
    )


def measure(folder: Path, run: Run) -> dict[str, float]:
    """Score one run."""
    usual = MomentFilter.constants
    changed = property(partial(constants, VARIANTS[run.variant], usual))
    with patch.object(MomentFilter, "constants", changed):
        return score(stream(folder, run.scene, run.seed, "usual"), "moment")


def main() -> None:
    """Print a table of the variants by scenes."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--out", type=Path, required=True, help="folder of the recorded scenes")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--scenes", nargs="+", default=SCENES)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    runs = [Run(scene, seed, variant) for scene in given.scenes for seed in seeds for variant in VARIANTS]
    rows = Parallel(given.jobs)(delayed(measure)(given.out, run) for run in runs)
    found = dict(zip(runs, rows, strict=True))
    print("| without | " + " | ".join(given.scenes) + " |")
    print("|---" * (1 + len(given.scenes)) + "|")
    for variant in VARIANTS:
        cells = []
        for scene in given.scenes:
            some = [found[Run(scene, seed, variant)] for seed in seeds]
            foot = np.sqrt(np.mean([row["foot"] ** 2 for row in some]))
            cells.append(f"{foot:.2f} ({np.mean([row['nees'] for row in some]):.1f})")
        print(f"| {variant} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
