"""The preset of ``surefoot evaluate``: policies at the task that they were trained for, paired by seed."""

from dataclasses import replace
from typing import Any

from surefoot.experiments.episodes.episode import COP_INPUTS, episode_row
from surefoot.experiments.episodes.plan import EpisodePlan
from surefoot.experiments.episodes.scenarios import scenario_of_task
from surefoot.experiments.policy.controllers import Controller
from surefoot.experiments.policy.tasks import TASKS
from surefoot.experiments.walks.walkers import FEEDS, feed_named

EVALUATED = ("true", "none", "weights", "quasi-static", "window", "moment")  # feeds of an evaluation


def evaluation_plan(
    controllers: tuple[str, ...] = ("shipped",),
    feeds: tuple[str, ...] = EVALUATED,
    severities: tuple[float, ...] = (1.0,),
    *,
    seeds: int = 50,
    first_seed: int = 20_000,
    cop_inputs: tuple[str, ...] = COP_INPUTS[:1],
    task: str = next(iter(TASKS)),
) -> EpisodePlan:
    """Return the plan of an evaluation, whatever order things are named in; ValueError at a wrong one."""
    for name, value, least in (("seeds", seeds, 1), ("first_seed", first_seed, 0)):
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            raise ValueError(f"'{name}' must be a whole number from {least} on, got {value!r}.")
    return EpisodePlan(
        tuple(sorted(controllers)),
        tuple(sorted(map(feed_named, feeds), key=list(FEEDS).index)),
        (task,),
        tuple(sorted(severities, key=str)),
        tuple(range(first_seed, first_seed + seeds)),
        duration=None,
        settle=None,
        cop_inputs=cop_inputs,
        own={task: scenario_of_task(task)},
    )


def run_episode(
    controller: Controller | str,
    feed: str,
    seed: int,
    severity: float = 1.0,
    *,
    cop_input: str = COP_INPUTS[0],
    task: str = next(iter(TASKS)),
    **env_options: Any,
) -> dict[str, Any]:
    """Run one episode of a task and return its row.

    The row is that of :func:`~surefoot.experiments.episodes.episode.episode_row`.

    Args:
        controller: A name, a :class:`~surefoot.controllers.PolicyNetwork`, a stabiliser, or any function of
            observations; if it has a ``reset``, it is called when the quiet stand is over.
        feed: One of :data:`~surefoot.experiments.walks.walkers.FEEDS`.
        seed: Of the episode and its sensors, none of training's.
        severity: Factor of all errors of the feet's sensors.
        cop_input: One of :data:`~surefoot.experiments.episodes.episode.COP_INPUTS`.
        task: One of :data:`surefoot.experiments.policy.tasks.TASKS`.
        **env_options: Of the task's environment.

    Raises:
        ValueError: If a name does not exist, a seed is one of training's, or the controller does not fit or
            was made for another task.
    """
    name = controller if isinstance(controller, str) else "zero"
    plan = evaluation_plan(
        (name,), (feed,), (severity,), seeds=1, first_seed=seed, cop_inputs=(cop_input,), task=task
    )
    (episode,) = plan.episodes
    episode = replace(episode, cop_input=cop_input, options={**episode.options, **env_options})
    if isinstance(controller, str):
        return episode_row(episode)
    return episode_row(replace(episode, controller=""), controller)
