"""Buttons and sliders: the requests of a browser."""

from collections.abc import Callable, Sequence
from typing import Any

import viser

from surefoot.calibration import GRAVITY, METHODS
from surefoot.experiments.view.server import when_changed
from surefoot.experiments.view.session import Session

Ask = Callable[[str, Any], None]
"""Takes what is asked for and its value; called from other threads than the one that steps the robot."""

FAULTS = ("dies", "sticks", "flips", "swaps with", "spikes", "drops", "saturates")
"""What a cell can do, in the words of faults."""

PUSHES = {"forward": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}
"""Directions (forward, left) of pushes."""


class Panel:
    """The controls of a session, at which it only looks; nothing else can be asked for.

    ``records`` says whether there is a folder for recordings.
    """

    def __init__(self, server: viser.ViserServer, session: Session, ask: Ask, records: bool) -> None:
        self._gui, self._session, self._ask = server.gui, session, ask
        self._chosen: dict[str, Any] = {}
        self._loop()
        tabs = self._gui.add_tab_group()
        parts = {"Run": self._run, "Sensors": self._cells, "Robot": self._robot}
        if records:
            parts["Record"] = self._recordings
        for name, add in parts.items():
            with tabs.add_tab(name):
                add()

    def show_settings(self) -> None:
        """Show the present choices, such as after a power-up."""
        for what, handle in self._chosen.items():
            handle.value = self._session.settings[what]
        self._seed.value = self._session.seed
        self.show_cell()

    def show_cell(self) -> None:
        """Show the errors of the cell that is chosen."""
        channel = self._channel()
        self._scale.value = round(100.0 * float(self._session.errors.scale[channel]), 3)
        self._offset.value = round(float(self._session.errors.offset[channel]), 3)

    def _channel(self) -> int:
        return list(self._session.layout.channel_names).index(str(self._cell.value))

    def _tell(self, handle: Any, what: str, value: Callable[[Any], Any] = lambda chosen: chosen) -> None:
        """Ask for a browser's choice at a control."""
        when_changed(handle, lambda chosen: self._ask(what, value(chosen)))

    def _button(self, label: str, what: str, value: Callable[[], Any] = lambda: None, **options: Any) -> Any:
        button = self._gui.add_button(label, **options)
        button.on_click(lambda event: self._ask(what, value()))
        return button

    def _slider(self, label: str, what: str, low: float, high: float, step: float, hint: str) -> None:
        handle = self._gui.add_slider(label, low, high, step, self._inside(what, low, high), hint=hint)
        self._chosen[what] = handle
        self._tell(handle, what)

    def _inside(self, what: str, low: float, high: float) -> float:
        return min(max(float(self._session.settings[what]), low), high)

    def _run(self) -> None:
        pause = self._gui.add_checkbox("pause", initial_value=False)
        self._tell(pause, "pause")
        self._button("one step", "step", hint="While it is paused: 1/80 s on.")
        pace = self._gui.add_slider("pace", 0.1, 1.0, 0.1, 1.0, hint="1 is real time.")
        self._tell(pace, "pace")
        self._button("reset", "reset", hint="A new episode on the same feet, with what was learnt.")
        self._seed = self._gui.add_number("seed", self._session.seed, min=0, max=10**6, step=1)
        self._button(
            "power up with this seed",
            "power_up",
            lambda: int(self._seed.value),
            hint="Another robot: fresh sensors, nothing broken, nothing learnt.",
        )

    def _loop(self) -> None:
        session = self._session
        feed = self._gui.add_dropdown(
            "controller gets",
            session.feeds,
            initial_value=session.settings["feed"],
            hint="Which centre of pressure the controller acts on.",
        )
        method = self._gui.add_dropdown(
            "calibrator",
            tuple(METHODS),
            initial_value=session.settings["method"],
            hint="It learns from when it is first chosen.",
        )
        self._chosen |= {"feed": feed, "method": method}
        self._tell(feed, "feed")
        self._tell(method, "method")

    def _cells(self) -> None:
        session, gui = self._session, self._gui
        self._slider("severity", "severity", 0.0, 5.0, 0.1, "Factor of all errors of the cells.")
        self._slider("drift", "drift", 0.0, 20.0, 0.5, "Factor of the speed of their drift.")
        self._slider("temperature, K", "temperature", -20, 40, 1, "How much warmer than at power-up.")
        self._cell = gui.add_dropdown("cell", session.layout.channel_names)
        self._cell.on_update(lambda event: self.show_cell())
        self._scale = gui.add_slider("its scale, %", -90, 100, 1, 0, hint="Error on top of its own.")
        limit = round(0.2 * session.drawing.weight, 0)
        self._offset = gui.add_slider(
            "its offset, N", -limit, limit, 0.1, 0.0, hint="Error on top of its own."
        )
        self._tell(self._scale, "scale", lambda percent: (self._channel(), 0.01 * float(percent)))
        self._tell(self._offset, "offset", lambda force: (self._channel(), float(force)))
        what = gui.add_dropdown("this cell", FAULTS)
        other = gui.add_dropdown("with", session.layout.channel_names[::-1], visible=False)

        def show_other(event: Any) -> None:
            other.visible = what.value == "swaps with"

        what.on_update(show_other)

        def fault() -> str:
            return " ".join([self._cell.value, what.value, *([other.value] if other.visible else [])])

        self._button("break it", "fault", fault, color="red")
        self._button("repair all", "repair")

    def _robot(self) -> None:
        session, gui = self._session, self._gui
        mass = session.drawing.weight / GRAVITY
        impulse = gui.add_slider("push, N s", 0.0, round(0.3 * mass, 1), 0.05, round(0.06 * mass, 1))
        ways = gui.add_button_group("direction", tuple(PUSHES))

        def push(event: Any) -> None:
            self._ask("push", [part * float(impulse.value) for part in PUSHES[ways.value]])

        ways.on_click(push)

        if session.world.carries:
            most = round(0.25 * mass, 1)
            self._slider("payload, kg", "payload", 0.0, most, 0.05, "A mass before the chest; at once.")
        self._slider("slope, °", "slope", -5.0, 5.0, 0.25, "The ground rises in front; at once.")
        if session.walks:
            self._slider("speed, m/s (next reset)", "speed", -0.06, 0.1, 0.01, "From the next reset on.")

    def _recordings(self) -> None:
        self.record = self._button("record", "record", hint="To the end of the episode at the latest.")
        self.commands = self._gui.add_markdown("")

    def show_recording(self, recording: bool, commands: Sequence[str] = ()) -> None:
        """Show whether it records, and the commands for the recording."""
        self.record.label = "stop recording" if recording else "record"
        self.record.color = "red" if recording else None
        if commands:
            self.commands.content = "\n".join(["```", *commands, "```"])
