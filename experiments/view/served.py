"""A page that is served: a loop that serves browsers' requests, and draws feet with their numbers."""

from queue import Empty, SimpleQueue
from time import perf_counter, sleep
from typing import Any

import viser

from surefoot.calibration.layout import FeetLayout
from surefoot.experiments.view.board import FeetBoard, colours
from surefoot.experiments.view.meters import Meters
from surefoot.experiments.view.server import FRAMES_PER_SECOND, set_scene

_REFUSALS = (ValueError, TypeError, IndexError, KeyError, OverflowError, OSError)


class Served:
    """The common part of pages: subclasses define the actions, the clock and the drawing.

    Browsers' requests come from other threads and wait in a queue: whoever calls :meth:`run` does it all. An
    empty page is given, the feet that are drawn, the robot's weight in N, and ``size`` and ``aside`` of
    :func:`~surefoot.experiments.view.server.view_of`.
    """

    def __init__(
        self, server: viser.ViserServer, *, layout: FeetLayout, weight: float, size: float, aside: float = 1.0
    ) -> None:
        self.server = server
        server.gui.reset()
        self._asked: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._stopped, self._told = False, ""
        self._ground = set_scene(server, size, aside)
        self._board = FeetBoard(server, layout, weight, size)
        self._meters = Meters(server, tuple(foot.name for foot in layout.feet), layout.channel_names)

    def run(self, seconds: float = float("inf")) -> None:
        """Go on and draw for some time in s, until interrupted or stopped."""
        last = due = perf_counter()
        until, self._stopped = last + seconds, False
        while last < until and not self._stopped:
            for what, value in self._waiting():
                self._try(what, value)
            now = perf_counter()
            self._advance(now - last)
            last = now
            self.draw()
            # A sleep that was a little too long makes the next one shorter.
            due = max(due + 1.0 / FRAMES_PER_SECOND, perf_counter())
            sleep(max(due - perf_counter(), 0.0))

    def stop(self) -> None:
        """Let :meth:`run` come back; any thread may call this."""
        self._stopped = True

    def draw(self) -> None:
        """Draw the present state."""
        raise NotImplementedError

    def _advance(self, passed: float) -> None:
        """Go on after a time in s has passed."""
        raise NotImplementedError

    def _do(self, what: str, value: Any) -> str:
        """Do one thing, and return the message about it."""
        raise NotImplementedError

    def _try(self, what: str, value: Any) -> None:
        try:
            self._told = self._do(what, value)
        except _REFUSALS as error:
            self._told = str(error)

    def _ask(self, what: str, value: Any) -> None:
        """Ask for one thing; any thread may call this."""
        self._asked.put((what, value))

    def _waiting(self) -> list[tuple[str, Any]]:
        asked: list[tuple[str, Any]] = []
        while True:
            try:
                asked.append(self._asked.get_nowait())
            except Empty:
                return asked

    def _paint(self, method: str) -> None:
        chosen = colours(method)
        self._board.paint(chosen)
        self._meters.paint(chosen)

    def _forget(self) -> None:
        """Drop trails and curves, where time jumps."""
        self._board.forget()
        self._meters.forget()
