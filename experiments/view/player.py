"""A log in the browser: its feet, played back or searched by time."""

from functools import partial
from typing import Any

import numpy as np
import viser

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import GRAVITY, METHODS
from surefoot.calibration.estimate import Estimate
from surefoot.experiments.logs.checks import check_load_cells
from surefoot.experiments.logs.clock import origin_of
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.view.served import Served
from surefoot.experiments.view.server import when_changed
from surefoot.experiments.view.session import check_method
from surefoot.experiments.view.shown import NEED_NO_ROBOT, Reading, Shown, place_apart, show_feet
from surefoot.experiments.walks.replay import replay_log, starting_map

SIZE = 1.0  # length in m by which the scene of a log is scaled: its robot is not known


class LogFeet:
    """A log, read by its sensors' data sheet and by a method, sample by sample, from its beginning.

    ``time`` holds the times of the samples in s, since the first one if the log's are since 1970. Raises
    LogError if the log is not of a plate or two feet on load cells or never gives their places, ValueError if
    the method does not exist.
    """

    def __init__(self, log: Log, method: str) -> None:
        check_load_cells(log.layout, "log")
        self.log, self.layout = log, log.layout
        self.time = log.time - origin_of(float(log.time[0]))
        if log.about.get("feet_alone"):
            feet = len(log.layout.feet)
            self._position = np.broadcast_to(place_apart(feet), (len(log), feet, 3))
            self._R = np.broadcast_to(np.eye(3), (len(log), feet, 3, 3))
        elif log.truth is None:
            # A reference is late; the last one that was known stands for those that were not.
            soles = log.reference.position_sole, log.reference.R_level_sole
            position, R = (np.asarray(part)[log.reference_rows] for part in soles)
            known = np.isfinite(position).all(axis=(1, 2)) & np.isfinite(R).all(axis=(1, 2, 3))
            if not known.any():
                raise LogError("This log never says where the soles are.")
            held = np.maximum.accumulate(np.where(known, np.arange(len(log)), np.argmax(known)))
            self._position, self._R = position[held], R[held]
        else:
            self._position, self._R = log.truth.position_sole, log.truth.R_world_sole
        self._raw = self._replay("none")
        self.choose(method)

    def choose(self, method: str) -> None:
        """Calibrate by another method; ValueError if there is none of that name."""
        self.method = check_method(method)
        if self.log.about.get("feet_alone") and self.method not in NEED_NO_ROBOT:
            raise LogError(f"Method '{self.method}' needs a robot's motion, and this log is of feet alone.")
        self._estimate = self._raw if self.method == "none" else self._replay(self.method)

    def state_to_draw(self, i: int) -> Shown:
        """State to draw of sample ``i``."""
        true = {} if self.log.truth is None else {"true": self._truth(self.log.truth.force[i], i)}
        raw, calibrated = (take_rows(one, i) for one in (self._raw, self._estimate))
        return show_feet(float(self.time[i]), self._position[i], self._R[i], raw, calibrated, **true)

    def _truth(self, force: Floats, i: int) -> Reading:
        """Return the truth of a sample, its centre of pressure by the places of the cells."""
        feet = len(self.layout.feet)
        cells = np.array([foot.position_cell_sole for foot in self.layout.feet])
        places = self._position[i][:, None] + cells @ self._R[i].swapaxes(1, 2)
        vgrf = force.reshape(feet, -1).sum(axis=1)
        total = float(vgrf.sum())
        cop = np.full(2, np.nan)
        if total > 0.05 * self.log.mass * GRAVITY:
            cop = force @ places.reshape(-1, 3)[:, :2] / total
        return Reading(force, vgrf, cop)

    def _replay(self, method: str) -> Estimate:
        return replay_log(self.log, method, starting_map(self.log, "nominal"))


class LogPage(Served):
    """A log in the browser, on an empty page, with a slider for its time."""

    def __init__(self, server: viser.ViserServer, feet: LogFeet) -> None:
        self.feet, log, time = feet, feet.log, feet.time
        weight = log.mass * GRAVITY
        super().__init__(server, layout=log.layout, weight=weight, size=SIZE, aside=0.0)
        gui = self.server.gui
        start, end = float(time[0]), float(time[-1])
        self._time = gui.add_slider("time, s", start, end, log.dt, start)
        self._method = gui.add_dropdown("calibrator", tuple(METHODS), initial_value=feet.method)
        self._play = gui.add_checkbox("play", initial_value=True)
        self._pace = gui.add_slider("pace", 0.1, 10.0, 0.1, 1.0, hint="1 is real time.")
        for what, handle in (("time", self._time), ("method", self._method)):
            when_changed(handle, partial(self._ask, what))
        self._now, self._drawn = start, -1
        self._paint(feet.method)

    def _advance(self, passed: float) -> None:
        if self._play.value:
            self._now = min(self._now + float(self._pace.value) * passed, float(self.feet.time[-1]))

    def draw(self) -> None:
        """Draw the sample of now, unless it is drawn already."""
        time = self.feet.time
        i = int(np.clip(np.searchsorted(time, self._now, side="right") - 1, 0, len(time) - 1))
        if i == self._drawn:
            return
        if i < self._drawn:
            self._forget()
        self._drawn = i
        shown = self.feet.state_to_draw(i)
        with self.server.atomic():
            self._board.draw(shown)
            self._meters.draw(shown, f"{shown.time:.2f} s of {time[-1]:.2f} s", self._told)
            if self._play.value:
                self._time.value = shown.time

    def _do(self, what: str, value: Any) -> str:
        if what == "time":
            self._now = float(value)
        else:
            self.feet.choose(str(value))
            self._drawn = -1
            self._paint(self.feet.method)
        return ""
