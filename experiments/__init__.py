"""What the ``surefoot`` command runs: logs, the virtual bench, replays, scores, closed loops and reports.

* :func:`read_log` and :func:`write_log` for logs of simulated and real robots (docs/log-format.md).
* :func:`record_walk`, :func:`replay_logs` and :func:`score_forces`: a walk, the same stream through every
  calibrator, and how far each is from the truth.
* :func:`run_weighing` and :func:`run_loop` for the virtual bench and the walker on calibrated feet.
"""

from surefoot.experiments.logs.format import Log, LogError, LogTruth, read_log, write_log
from surefoot.experiments.walks.closed_loop import LoopRun, run_loop
from surefoot.experiments.walks.record import CONDITIONS, Condition, record_walk
from surefoot.experiments.walks.replay import Replayed, replay_logs
from surefoot.experiments.walks.score import Score, mean_interval, score_forces
from surefoot.experiments.weights.weighing import WeighingReport, WeighingSetup, run_weighing

__all__ = [
    "CONDITIONS",
    "Condition",
    "Log",
    "LogError",
    "LogTruth",
    "LoopRun",
    "Replayed",
    "Score",
    "WeighingReport",
    "WeighingSetup",
    "mean_interval",
    "read_log",
    "record_walk",
    "replay_logs",
    "run_loop",
    "run_weighing",
    "score_forces",
    "write_log",
]
