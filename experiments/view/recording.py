"""The recording of a robot that was shown, kept sample by sample to become a log."""

from typing import Any

import numpy as np

from surefoot.calibration import Parameters, Reference
from surefoot.experiments.arrays import Floats, stack_rows
from surefoot.experiments.logs.format import Log, LogTruth

LONGEST_RECORDING = 600.0  # time in s after which a recording ends by itself


class Recording:
    """Samples of one episode, ``dt`` s apart."""

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._rows: list[Any] = []

    @property
    def full(self) -> bool:
        """Whether it is as long as it may be."""
        return len(self._rows) * self._dt >= LONGEST_RECORDING

    def keep(self, time: float, raw: Floats, reference: Reference, truth: Any, undone: Parameters) -> None:
        """Keep one sample, unless the robot does not know yet where it is.

        Time is since the episode start in s, ``raw`` are counts, shape (K,), ``truth`` is the state that the
        simulator knows of the last step, and ``undone`` the map that undoes the errors of the readings.
        """
        if np.isfinite(reference.com).all():
            self._rows.append(
                (
                    time,
                    raw.copy(),
                    Reference(*(np.array(part) for part in reference)),
                    np.array(truth.force_cell[-1]),
                    truth.position_sole[-1].copy(),
                    truth.R_world_sole[-1].copy(),
                    *undone,
                )
            )

    def log(self, **known: Any) -> Log:
        """Return the log, with the facts of robot and recording; ValueError if nothing is recorded."""
        if len(self._rows) < 2:
            raise ValueError("Nothing was recorded yet: record, and let the robot go on for a while.")
        time, raw, reference, force, position, R, scale, offset = zip(*self._rows, strict=True)
        return Log(
            time=np.array(time),
            raw=np.array(raw),
            reference=stack_rows(reference),
            truth=LogTruth(*(np.array(part) for part in (force, position, R, scale, offset))),
            dt=self._dt,
            calibrated=None,
            **known,
        )
