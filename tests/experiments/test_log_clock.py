"""Times of logs: coarse, shared, overflowing and of days."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from surefoot.experiments.instrument.check import check_log
from surefoot.experiments.instrument.recording import read_recording
from surefoot.experiments.logs.clock import read_clock

ROWS = 2000
TIME = np.arange(ROWS) / 80.0
COUNTS = np.rint(8e4 + np.random.default_rng(0).normal(0.0, 20.0, ROWS))

CLOCKS: dict[str, tuple[Any, Any]] = {
    "packets of five rows": (TIME[np.arange(ROWS) // 5 * 5], TIME),
    "seconds without fractions": (np.floor(TIME + 0.3), TIME + 0.3),
    "whole seconds since 1970": (1.7e9 + np.floor(TIME), 1.7e9 + TIME),
    "a counter of microseconds": ((TIME + 4290.0) % (2**32 * 1e-6), TIME + 4290.0),
    "a counter of milliseconds": ((TIME + 4294960.0) % (2**32 * 1e-3), TIME + 4294960.0),
}


@pytest.mark.parametrize(("stamps", "true"), CLOCKS.values(), ids=CLOCKS)
def test_coarse_and_overflowing_clocks_become_even(stamps: Any, true: Any) -> None:
    clock = read_clock(stamps)
    assert not clock.flaw
    assert clock.sessions == (0,)
    np.testing.assert_allclose(clock.time, true, rtol=0.0, atol=0.0126)
    np.testing.assert_allclose(np.diff(clock.time), 0.0125, atol=1e-6)


def test_a_few_equal_stamps_move_no_other_row() -> None:
    """A plate that sends a packet of two readings now and then, with times in whole milliseconds."""
    time = np.round(np.cumsum(np.random.default_rng(2).choice([0.009, 0.01, 0.011], ROWS)), 3)
    time[300::400] = time[299::400]
    found = read_clock(time).time
    assert (np.diff(found) > 0.0).all()
    moved = found != time
    assert moved.sum() == len(time[300::400])


DAYS: dict[str, str] = {
    "a time of day": "%H:%M:%S.%f",
    "a date and a time": "%Y-%m-%dT%H:%M:%S.%f",
    "a date as in Germany": "%d.%m.%Y %H:%M:%S.%f",
    "twelve hours": "%m/%d/%Y %I:%M:%S.%f %p",
    "minutes": "%M:%S.%f",
}


@pytest.mark.parametrize("form", DAYS.values(), ids=DAYS)
def test_times_of_day_go_on_at_midnight(form: str, tmp_path: Path) -> None:
    moments = pd.Timestamp("2025-03-09 23:59:50") + pd.to_timedelta(TIME, unit="s")
    table = {"time_s": moments.strftime(form), "raw_a_count": COUNTS}
    pd.DataFrame(table).to_csv(tmp_path / "rig.csv", index=False)
    found = read_recording(tmp_path / "rig.csv")
    np.testing.assert_allclose(found.time - found.time[0], TIME, atol=1e-6)
    assert check_log(tmp_path / "rig.csv").sound
