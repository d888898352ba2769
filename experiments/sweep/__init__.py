"""Sweeps: controllers on feeds, scenarios, severities and seeds, one seeded episode a job."""

from surefoot.experiments.sweep.episode import Cell, run_cell
from surefoot.experiments.sweep.plan import SweepPlan, plan_from_toml
from surefoot.experiments.sweep.replay import Replayed, replay_cell
from surefoot.experiments.sweep.run import SweepResults, run_sweep
from surefoot.experiments.sweep.scenarios import SCENARIOS, SweepScenario
from surefoot.experiments.sweep.store import SweepError

__all__ = [
    "SCENARIOS",
    "Cell",
    "Replayed",
    "SweepError",
    "SweepPlan",
    "SweepResults",
    "SweepScenario",
    "plan_from_toml",
    "replay_cell",
    "run_cell",
    "run_sweep",
]
