"""The parts of the ``surefoot`` command: logs, simulated walks, studies, policies and pages.

* :func:`read_log` and :func:`write_log` for logs of simulated and real robots (docs/log-format.md).
* :func:`record_walk`, :func:`replay_logs` and :func:`score_forces`: a walk, the same stream through every
  calibrator, and how far each is from the truth.
* :func:`surefoot.evaluate`: any policy in any environment on true, drifting and calibrated feet.
"""

from typing import TYPE_CHECKING

from surefoot.extras import names_of

if TYPE_CHECKING:
    from surefoot.experiments.logs.format import Log, LogTruth, read_log, write_log
    from surefoot.experiments.logs.table import LogError
    from surefoot.experiments.walks.record import record_walk
    from surefoot.experiments.walks.replay import replay_logs
    from surefoot.experiments.walks.score import score_forces

__all__ = [
    "Log",
    "LogError",
    "LogTruth",
    "read_log",
    "record_walk",
    "replay_logs",
    "score_forces",
    "write_log",
]

_MODULES = {
    "Log": "surefoot.experiments.logs.format",
    "LogError": "surefoot.experiments.logs.table",
    "LogTruth": "surefoot.experiments.logs.format",
    "read_log": "surefoot.experiments.logs.format",
    "record_walk": "surefoot.experiments.walks.record",
    "replay_logs": "surefoot.experiments.walks.replay",
    "score_forces": "surefoot.experiments.walks.score",
    "write_log": "surefoot.experiments.logs.format",
}

# Loaded when first asked for, so that the command starts fast.
__getattr__, __dir__ = names_of(__name__, _MODULES, "experiments")
