"""One study of controllers: episodes on feeds, in scenarios, at severities, over seeds.

``surefoot evaluate`` and ``surefoot sweep`` are two presets of it.
"""

from surefoot.experiments.episodes.episode import Episode
from surefoot.experiments.episodes.plan import EpisodePlan, evaluation_plan, plan_from_toml, run_episode
from surefoot.experiments.episodes.run import EpisodeResults, Replayed, replay_episode, run_plan
from surefoot.experiments.walks.scenarios import SCENARIOS, Scenario

__all__ = [
    "SCENARIOS",
    "Episode",
    "EpisodePlan",
    "EpisodeResults",
    "Replayed",
    "Scenario",
    "evaluation_plan",
    "plan_from_toml",
    "replay_episode",
    "run_episode",
    "run_plan",
]
