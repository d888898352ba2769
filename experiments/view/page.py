"""The page in the browser: a robot that walks, its feet, numbers, and controls."""

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import viser

from surefoot.experiments.logs.format import write_log
from surefoot.experiments.view.panel import Panel
from surefoot.experiments.view.robot import RobotMeshes
from surefoot.experiments.view.served import Served
from surefoot.experiments.view.session import Session

TORSO = 0.32  # height in m of the torso of a robot whose scene has size 1: the NAO's
LONGEST_FRAME = 0.1  # simulated s that one frame makes up for at most: a slower computer shows it more slowly
HURRY = 0.25  # s that a robot that stands is stepped between two frames: nobody wants to wait until it walks
LYING = 2.0  # s that a robot lies where it fell before it gets up again

LATEST = ("severity", "drift", "temperature", "scale", "offset", "payload", "slope", "speed", "pace")
"""What is asked for many times while a slider is drawn: only the last counts."""


class Page(Served):
    """A session in the browser, on an empty page.

    Recordings go into the folder, ``None`` for none. ``frames`` says how many were drawn.
    """

    def __init__(self, server: viser.ViserServer, session: Session, *, folder: Path | None = None) -> None:
        self.session, self._folder = session, folder
        size = float(session.source.data.body(session.drawing.torso).xpos[2]) / TORSO
        weight = session.drawing.weight
        super().__init__(server, layout=session.layout, weight=weight, size=size)
        self._paused, self._pace, self._due, self._lies = False, 1.0, 0.0, 0.0
        self.frames, self._simulated, self._rate = 0, 0.0, (0.0, 0.0)
        self._counted = perf_counter(), 0, 0.0
        self._robot = RobotMeshes(self.server, session.source.model)
        self._cell = size
        self._panel = Panel(self.server, session, self._ask, bool(folder))
        self._paint(str(session.settings["method"]))

    def draw(self) -> None:
        """Draw the session as it is now."""
        now, source = self.session.state_to_draw(), self.session.source
        torso = source.data.body(self.session.drawing.torso).xpos
        origin = np.array([torso[0], torso[1], 0.0])
        with self.server.atomic():
            self._robot.move(source.data, origin)
            # The grid repeats itself: so it lies still under a robot that stays in the middle.
            self._ground.position = *-np.fmod(origin[:2], self._cell), self._ground.position[2]
            self._board.draw(now)
            self._meters.draw(now, self._line(), self._told)
        self.frames += 1
        passed = perf_counter() - self._counted[0]
        if passed > 1.0:
            _, frames, simulated = self._counted
            self._rate = (self.frames - frames) / passed, (self._simulated - simulated) / passed
            self._counted = perf_counter(), self.frames, self._simulated

    def _line(self) -> str:
        session = self.session
        states = {"fallen": session.fell, "paused": self._paused, "stands": session.standing, "runs": True}
        state = next(word for word, holds in states.items() if holds)
        rate, real = self._rate
        return f"{state} at {session.time:.1f} s, {rate:.0f} frames a second, {real:.2f} of real time"

    def _advance(self, passed: float) -> None:
        """Step as far as time has gone on."""
        session = self.session
        if session.over:
            self._lies += passed
            if not session.fell or self._lies > LYING:
                self._ask("reset", None)
            return
        if self._paused:
            return
        if session.standing:
            end = perf_counter() + HURRY
            while session.standing and perf_counter() < end:
                self._step()
            return
        self._due = min(self._due + self._pace * passed, LONGEST_FRAME)
        while self._due >= session.dt and not session.over:
            self._step()
            self._due -= session.dt

    def _step(self) -> None:
        session = self.session
        session.step()
        self._simulated += session.dt
        if session.record_is_full:
            self._save()

    def _waiting(self) -> list[tuple[str, Any]]:
        """Requests of browsers since the last frame, of each slider the last value alone."""
        asked: list[tuple[str, Any]] = []
        for what, value in super()._waiting():
            if what in LATEST:
                same = what in ("scale", "offset")
                asked = [one for one in asked if one[0] != what or (same and one[1][0] != value[0])]
            asked.append((what, value))
        return asked

    def _do(self, what: str, value: Any) -> str:
        """Do one thing, and return the broken channels."""
        session = self.session
        match what:
            case "pause":
                self._paused = bool(value)
            case "step":
                if not session.over:
                    self._step()
            case "pace":
                self._pace = min(max(float(value), 0.1), 1.0)
            case "record":
                self._record()
            case "power_up":
                self._save()
                session.power_up(int(value))
                self._fresh()
                self._panel.show_settings()
            case "reset":
                self._save()
                session.change("reset")
                self._fresh()
            case _:
                session.change(what, value)
                if what == "method":
                    self._paint(str(session.settings["method"]))
        return f"Broken: {'; '.join(session.errors.faults)}" if session.errors.faults else ""

    def _fresh(self) -> None:
        self._lies = self._due = 0.0
        self._forget()

    def _record(self) -> None:
        if self._folder is None:
            raise ValueError("There is no folder for recordings; give one with --record FOLDER.")
        if self.session.recording is not None:
            self._save()
        else:
            self.session.record()
            self._panel.show_recording(True)

    def _save(self) -> None:
        """Write the recording, if there is one, into the folder that the command was given."""
        if self.session.recording is None or self._folder is None:
            return
        self._panel.show_recording(False)
        log = self.session.stop_recording()
        task = self.session.env_id.rpartition("/")[2].lower()
        number = 1
        while (path := self._folder / f"{task}-seed{self.session.seed}-{number}.parquet").exists():
            number += 1
        write_log(log, path)
        self._panel.show_recording(False, commands(path))


def commands(path: Path) -> Sequence[str]:
    """Return the commands that make something of a recording."""
    return f"surefoot calibrate walk {path}", f"surefoot view --log {path}"
