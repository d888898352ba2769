"""The demo and the CoP paper's full study: presets of the study of walks."""

from dataclasses import replace
from pathlib import Path

from surefoot.experiments.arena.options import ArenaOptions
from surefoot.experiments.arena.scenarios import PAPER_SCENARIOS, SPEEDS
from surefoot.experiments.walks.record import CONDITIONS
from surefoot.experiments.walks.walkers import FEEDS, STAND_TIME

# Without weights there is no calibration from them.
_LOOPED = tuple(feed for feed in FEEDS if feed != "weights")


def full_options(
    out: Path = Path("out/compare-walking-full"), seeds: int = 10, jobs: int = 2
) -> ArenaOptions:
    """Return the CoP paper's study in full: three speeds, closed loops, the window's weights, a film."""
    return ArenaOptions(
        out=out,
        seeds=seeds,
        jobs=jobs,
        scenarios=_scenarios(SPEEDS),
        loops={3.0: _LOOPED, 1.0: ("none", "window")},
        factors=(0.2, 0.5, 1.0, 2.0, 5.0),
        film_duration=STAND_TIME + 12.0,
    )


def demo_options(out: Path = Path("out/demo"), seeds: int = 4, jobs: int = 2) -> ArenaOptions:
    """Return the same at one speed, with fewer walks: less than two minutes on two cores."""
    return replace(
        full_options(out, seeds, jobs),
        scenarios=_scenarios((0.04,)),
        loops={3.0: _LOOPED},
        factors=(),
        film_duration=STAND_TIME + 10.0,
    )


def quick_options(options: ArenaOptions) -> ArenaOptions:
    """Return the same at one speed, with two seeds and short walks, to see whether all works."""
    return replace(
        options,
        seeds=min(options.seeds, 2),
        scenarios=_scenarios((0.04,)),
        duration=STAND_TIME + 8.0,
        settle=STAND_TIME + 4.0,
        loops={3.0: _LOOPED},
        loop_duration=STAND_TIME + 4.0,
        factors=(0.2, 1.0, 5.0) if options.factors else (),
        sensitivity_seeds=1,
        film_duration=min(options.film_duration, STAND_TIME + 2.0),
    )


def _scenarios(speeds: tuple[float, ...]) -> tuple[str, ...]:
    return tuple(PAPER_SCENARIOS[condition.name, speed].name for speed in speeds for condition in CONDITIONS)
