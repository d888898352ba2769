"""What each ingredient of the moment filter is worth: each switched off in turn, on the same walks.

    python benchmarks/ablation.py --seeds 10 --strangers FOLDER

Walks of 34 s, cells read when the host reads, errors from 14 s on against MuJoCo's truth: the package's own
walker at the bad start (scales off by 12 %, offsets by 1.5 N, drift of 2 % and 1 N per square root of a
minute), at three times that, and with a perfect map that drifts by a tenth; and, from the logs of
``second_walker.py``, the bad start and the perfect map on a walker that the filter was not made on. Of each
the error of the centre of pressure in mm, as the root mean square over walks, and the NEES a parameter.
"""

import argparse
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

import numpy as np
import second_walker

from surefoot.calibration.moment import drift, noise, product, severity, stream
from surefoot.experiments.arena.replay import play
from surefoot.experiments.arena.score import score_run
from surefoot.experiments.arena.streams import Stream
from surefoot.experiments.walks.record import Condition, record_walk
from surefoot.experiments.walks.walkers import STAND_TIME
from surefoot.sensors import LoadCells, scaled


@dataclass(frozen=True)
class Variant:
    """The filter without one of its ingredients.

    Attributes:
        options: Of the method.
        constants: (module or class, name, value) of what no option reaches.
    """

    options: dict[str, Any] = field(default_factory=dict)
    constants: tuple[tuple[ModuleType | type, str, Any], ...] = ()


VARIANTS = {
    "as it is": Variant(),
    "the start is believed as stated": Variant(
        constants=(
            (severity, "SEVERITIES", (1.0,)),
            (severity, "LIKELY", (1.0,)),
            (severity, "FIRST_WIDTH", 1.0),
            (stream, "FIRST_WIDTH", 1.0),
        )
    ),
    "noise is as assumed": Variant(
        constants=((stream, "FIRST_NOISE", 1.0), (noise, "_NOISE_MEMORY", 0.0)),
    ),
    "misfit is not counted": Variant(
        constants=((stream, "FIRST_MISFIT", 1.0), (noise, "_MISFIT_MEMORY", 0.0)),
    ),
    "product of errors not allowed for": Variant(
        constants=(
            (product, "_SHARED", 0.0),
            (product, "_WRONG", np.inf),
            (product, "_LONGEST_STANCE", 0.0),
        )
    ),
    "drift since a swing not shared": Variant(constants=((product, "_LONGEST_STANCE", 0.0),)),
    "nothing forgotten at a first swing": Variant(constants=((product, "_WRONG", np.inf),)),
    "no swing tare": Variant({"swing_noise": 1e3}),
    "centre of mass taken for right": Variant({"com_std": 0.0, "com_change": 0.0}),
    "mass taken for right": Variant({"mass_std": 0.0, "mass_change": 0.0}),
    "delay taken for right": Variant({"delay_std": 0.0}),
    "a reference that averages nothing": Variant({"blur": 0.0}),
    "drift is as stated": Variant(constants=((drift, "_MEMORY", 0.0),)),
    "no drift": Variant({"scale_drift": 0.0, "offset_drift": 0.0}),
    "channels read at one moment": Variant({"timing_noise": 0.0}),
    "averages over 8 samples": Variant({"average": 8}),
    "no averages": Variant({"average": 1}),
}


def own_walks(speed: float, seeds: range) -> dict[str, list[Stream]]:
    """Record walks of the package's own walker, the same ones at every start."""
    starts = {
        "bad start": LoadCells(rate=None),
        "three times": scaled(LoadCells(rate=None), 3.0),
        "perfect map": second_walker.STARTS["bench"].cells,
    }
    conditions = [Condition(name, name, cells, "nominal") for name, cells in starts.items()]
    streams: dict[str, list[Stream]] = {name: [] for name in starts}
    for seed in seeds:
        for name, log in record_walk(speed, seed, second_walker.DURATION, conditions).items():
            judged = log.time >= second_walker.SETTLE
            streams[name].append(Stream(replace(log, calibrated=None), seed, judged, STAND_TIME))
    return streams


def strangers(folder: Path, speed: float, seeds: range) -> dict[str, list[Stream]]:
    """Read walks of the second walker, recorded first where they are missing."""
    starts = {"second walker, bad start": "bad", "second walker, perfect map": "bench"}
    for seed in seeds:
        second_walker.record_missing(folder, speed, seed, second_walker.DURATION, tuple(starts.values()))
    return {
        name: [second_walker.stream(second_walker.log_path(folder, start, speed, seed)) for seed in seeds]
        for name, start in starts.items()
    }


def scores(streams: list[Stream], variant: Variant) -> str:
    """Play a variant on walks: the CoP in mm, and the NEES a parameter."""
    with ExitStack() as stack:
        # Constants are Python's; the library has its own.
        stack.enter_context(patch("surefoot.calibration.foot_calibrator.installed", lambda: None))
        for module, name, value in variant.constants:
            stack.enter_context(patch.object(module, name, value))
        played = play(streams, "moment", **variant.options)
    rows = [score_run(one, run) for one, run in zip(streams, played, strict=True)]
    cop = 1e3 * np.sqrt(np.mean([row["cop"] ** 2 for row in rows]))
    return f"{cop:.2f} ({np.mean([row['nees'] for row in rows]):.1f})"


def main() -> None:
    """Print a table of the variants by walks."""
    layout = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=layout)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=200)
    parser.add_argument("--speed", type=float, default=0.04, help="m/s")
    parser.add_argument("--strangers", type=Path, help="folder of the second walker's logs, of four seeds")
    given = parser.parse_args()
    walks = own_walks(given.speed, range(given.first_seed, given.first_seed + given.seeds))
    if given.strangers is not None:
        walks |= strangers(given.strangers, given.speed, range(4))
    print("|", " | ".join(["without", *walks]), "|")
    print("|---" * (1 + len(walks)) + "|")
    for name, variant in VARIANTS.items():
        print(
            "|",
            " | ".join([name, *(scores(streams, variant) for streams in walks.values())]),
            "|",
            flush=True,
        )


if __name__ == "__main__":
    main()
