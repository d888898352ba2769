"""Plan the motion by which a robot calibrates its feet, play it once from start to end, and write it."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from surefoot.calibration.foot_excitation import FootExcitation, plan_foot_excitation
from surefoot.envs.prelude import Prelude
from surefoot.experiments.motion.rehearsal import Limits, Rehearsal, rehearse
from surefoot.experiments.study.tables import Table


class PlannedMotion(NamedTuple):
    """A motion, and what it will bring: tables of its parts, of single motions, and of those refused."""

    plan: FootExcitation
    prelude: Prelude
    tables: list[Table]


def plan_motion(
    robot: str | Path,
    budget: float = 40.0,
    *,
    goal: str = "cop",
    enough: float = 0.0,
    limits: Limits | None = None,
    **options: Any,
) -> PlannedMotion:
    """Plan a motion of at most a budget in s, which ends early at a standard deviation that is enough.

    Robots are those of :class:`~surefoot.envs.ExerciseEnv`, goals those of
    :func:`~surefoot.calibration.plan_foot_excitation`, options the moment filter's. Raises ValueError if
    something is refused, nothing fits, or motions that went well alone do not together.
    """
    limits = Limits() if limits is None else limits
    stage = Rehearsal(robot)
    able, refused = rehearse(stage, limits=limits)
    if not able.motions:
        raise ValueError(f"The robot can do none of the motions within {limits}: {refused}.")
    plan = plan_foot_excitation(stage.layout, able, budget, goal=goal, enough=enough, **options)
    prelude = stage.env.motion.prelude(plan.motions, stage.env.dt)
    played = stage.play(prelude)
    if reason := played.refusal(limits):
        raise ValueError(
            f"Played together, the motions do not keep to the limits: {reason}. Ask for more margin."
        )
    tables = [_segments(plan, prelude), _single(plan), _refused(refused)]
    return PlannedMotion(plan, prelude, tables)


def _segments(plan: FootExcitation, prelude: Prelude) -> Table:
    factor, unit = (1e3, "mm") if plan.goal == "cop" else (1.0, "N")
    start = np.concatenate([[0.0], plan.time[:-1]])
    before = np.concatenate([[plan.before], plan.std[:-1]])
    rows = tuple(
        (
            name,
            f"{a:.1f}",
            f"{b:.1f}",
            f"{factor * s:.2f}",
            f"{factor * e:.2f}",
            f"{np.log(s / e) / (b - a):.3f}",
        )
        for name, a, b, s, e in zip(plan.motions, start, plan.time, before, plan.std, strict=True)
    )
    what = "centre of pressure" if plan.goal == "cop" else "worst channel"
    columns = ("motion", "from (s)", "to (s)", f"before ({unit})", f"after ({unit})", "nats per second")
    return Table(
        "plan",
        f"{prelude.duration:.1f} s of motion: bound of the {what}'s standard deviation",
        columns,
        rows,
    )


def _single(plan: FootExcitation) -> Table:
    best = sorted(plan.rates.items(), key=lambda item: -item[1])
    rows = tuple((name, f"{rate:.3f}") for name, rate in best)
    return Table("rates", "What each motion would bring first", ("motion", "nats per second"), rows)


def _refused(refused: dict[str, str]) -> Table:
    rows = tuple(refused.items()) or (("none", ""),)
    return Table("refused", "What the robot must not do", ("motion", "because"), rows)
