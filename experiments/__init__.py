"""What the ``surefoot`` command runs: logs, simulated walks, studies, policies and pages.

* :func:`read_log` and :func:`write_log` for logs of simulated and real robots (docs/log-format.md).
* :func:`record_walk`, :func:`replay_logs` and :func:`score_forces`: a walk, the same stream through every
  calibrator, and how far each is from the truth; :func:`run_loop` for the walker on calibrated feet.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from surefoot.extras import not_installed

if TYPE_CHECKING:
    from surefoot.experiments.logs.format import Log, LogTruth, read_log, write_log
    from surefoot.experiments.logs.table import LogError
    from surefoot.experiments.walks.closed_loop import run_loop
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
    "run_loop",
    "score_forces",
    "write_log",
]

_HOMES = {
    "logs.format": ("Log", "LogTruth", "read_log", "write_log"),
    "logs.table": ("LogError",),
    "walks.closed_loop": ("run_loop",),
    "walks.record": ("record_walk",),
    "walks.replay": ("replay_logs",),
    "walks.score": ("score_forces",),
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for, so that the command starts fast."""
    for module, names in _HOMES.items():
        if name in names:
            try:
                home = import_module(f"surefoot.experiments.{module}")
            except ModuleNotFoundError as missing:
                raise not_installed(f"surefoot.experiments.{name}", missing, "experiments") from None
            return getattr(home, name)
    raise AttributeError(f"module 'surefoot.experiments' has no attribute '{name}'")
