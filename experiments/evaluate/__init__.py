"""Evaluate any policy in any Gymnasium environment on true, drifting and calibrated feet.

:func:`evaluate` runs a grid of policies, feeds, severities and seeds and returns one row per episode;
``surefoot evaluate`` is the same from the shell. The engine puts
:class:`~surefoot.wrappers.FootSensors` and :class:`~surefoot.wrappers.SelfCalibration` around a bare
environment. The same seed is the same episode under every feed: the same start, the same disturbances, and
sensors whose errors differ by their severity alone. Differences between feeds are therefore paired.
"""

from surefoot.experiments.evaluate.episode import run_episode
from surefoot.experiments.evaluate.grid import Evaluation, evaluate
from surefoot.experiments.evaluate.setup import Setup

__all__ = ["Evaluation", "Setup", "evaluate", "run_episode"]
