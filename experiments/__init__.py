"""What the ``surefoot`` command runs: logs, the virtual bench, replays, scores, closed loops and reports.

* :func:`read_log` and :func:`write_log` for logs of simulated and real robots (docs/log-format.md).
* :func:`record_walk`, :func:`replay_logs` and :func:`score_forces`: a walk, the same stream through every
  calibrator, and how far each is from the truth.
* :func:`run_bench` and :func:`run_loop` for the virtual bench and the walker on calibrated feet.
"""

from surefoot.experiments.logs.format import Log, LogError, LogTruth, read_log, write_log
from surefoot.experiments.walks.closed_loop import LoopRun, run_loop
from surefoot.experiments.walks.record import CONDITIONS, Condition, record_walk
from surefoot.experiments.walks.replay import Replayed, replay_logs
from surefoot.experiments.walks.score import Score, mean_interval, score_forces
from surefoot.experiments.weights.bench import BenchReport, BenchSetup, run_bench

__all__ = [
    "CONDITIONS",
    "BenchReport",
    "BenchSetup",
    "Condition",
    "Log",
    "LogError",
    "LogTruth",
    "LoopRun",
    "Replayed",
    "Score",
    "mean_interval",
    "read_log",
    "record_walk",
    "replay_logs",
    "run_bench",
    "run_loop",
    "score_forces",
    "write_log",
]
