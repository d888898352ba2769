"""A robot's stream in the browser: rows of a log as they come, by UDP, each a JSON object by its columns."""

import math
import socket
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser

from surefoot.calibration import GRAVITY, METHODS, FootCalibrator, Reference
from surefoot.calibration.contacts import LoadContacts, reference_of_contacts
from surefoot.experiments.logs.checks import check_load_cells
from surefoot.experiments.logs.clock import origin_of
from surefoot.experiments.logs.columns import (
    PHASES,
    fields_of,
    has_references,
    names_of,
    phase_names,
    raw_names_of,
)
from surefoot.experiments.logs.description import Description
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.view.player import SIZE
from surefoot.experiments.view.served import Served
from surefoot.experiments.view.server import when_changed
from surefoot.experiments.view.session import check_method
from surefoot.experiments.view.shown import NEED_NO_ROBOT, Shown, place_apart, show_feet
from surefoot.files import parse_json, read_text

LARGEST_PACKET = 65536  # bytes, which is all that UDP carries
MOST_AT_ONCE = 1000  # packets read between two frames; the rest is read after the next one
QUIET = 1.0  # s without a row after which the page reports it


class RowSocket:
    """Rows of a log that arrive at a UDP port, one or several lines of JSON in a packet.

    Raises OSError if the port is in use.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise OSError(f"UDP port {port} of {host} cannot be listened to: {error.strerror}.") from None
        self._socket.setblocking(False)
        self.port = int(self._socket.getsockname()[1])

    def lines(self) -> list[bytes]:
        """Return the lines that have arrived since the last call."""
        found: list[bytes] = []
        for _ in range(MOST_AT_ONCE):
            try:
                packet = self._socket.recv(LARGEST_PACKET)
            except BlockingIOError:
                break
            found += packet.splitlines()
        return [line for line in found if line.strip()]

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class StreamFeet:
    """A robot's feet, row by row, read by their data sheet and by a method.

    Rows hold the columns of a log. Without columns of references the feet are alone, which only the methods
    ``tare`` and ``none`` can calibrate. Raises LogError if the description is not of a plate or two feet on
    load cells, ValueError if the method does not exist.
    """

    def __init__(self, description: Path, method: str) -> None:
        told = parse_json(read_text(description, LogError), description.name, LogError)
        self.facts = facts = Description.read(told, f"{description.name}: the description")
        self.layout = facts.layout
        check_load_cells(self.layout, "description")
        if np.isnan(facts.dt_s):
            raise LogError(f"{description.name}: a stream needs 'dt_s', the time between its rows in s.")
        if np.isnan(facts.nominal.offset).any():
            raise LogError(f"{description.name}: a stream needs 'offset_N' of the nominal map.")
        self._names = names_of(self.layout)
        self._counts, self._curves = raw_names_of(self.layout), facts.straightening
        self.rows = 0
        self.shown: Shown | None = None
        self._time, self._alone, self._origin = math.nan, False, math.nan
        self.choose(method)

    def choose(self, method: str) -> None:
        """Switch to another method; ValueError if it does not exist."""
        self.method = check_method(method)
        self._begin()

    def take(self, line: bytes) -> None:
        """Process a row and prepare its drawing; LogError or ValueError if a column is missing or wrong."""
        row = parse_json(line.decode(errors="replace"), "The row", LogError)
        if not isinstance(row, Mapping):
            raise LogError(f"The row must be a JSON object of columns, got {type(row).__name__}.")
        alone = not has_references(row)
        if alone and self.method not in NEED_NO_ROBOT:
            raise LogError(
                f"Method '{self.method}' needs a robot's motion, and these rows are of feet alone: choose "
                "tare or none."
            )
        if alone != self._alone:
            self._alone = alone
            self._begin()
        time = _number(row, "time_s")
        if math.isnan(time):
            raise LogError("'time_s' must be a number, got null.")
        step = time - self._time
        if not step > 0.0 and not math.isnan(step):
            self._begin()  # the robot was restarted
        step = step if step > 0.0 else self.facts.dt_s
        raw = self._curves.straighten(np.array([_number(row, name) for name in self._counts]))
        reference = self._feel(row, raw) if alone else self._believe(row)
        raw_estimate, estimate = (one.update(raw, reference, step) for one in self._calibrators)
        self._time = time
        self.rows += 1
        soles = reference.position_sole, reference.R_level_sole
        if math.isnan(self._origin):
            self._origin = origin_of(time)
        self.shown = show_feet(time - self._origin, *soles, raw_estimate, estimate)

    def _begin(self) -> None:
        facts, alone = self.facts, self._alone
        self._contacts = LoadContacts(facts.mass_kg * GRAVITY, len(self.layout.feet), facts.dt_s)
        late = self._contacts.lag if alone else facts.lag_samples
        self._time = self._origin = math.nan
        self._calibrators = [
            FootCalibrator(
                self.layout, method, mass=facts.mass_kg, initial=facts.nominal, dt=facts.dt_s, lag=late
            )
            for method in ("none", self.method)
        ]

    def _believe(self, row: Mapping[str, Any]) -> Reference:
        values = {name: np.array([_number(row, name)]) for name in self._names}
        fields = fields_of(values, self.layout, "reference")
        return Reference(**{name: part[0] for name, part in fields.items()})

    def _feel(self, row: Mapping[str, Any], raw: Any) -> Reference:
        """Make a reference of feet side by side, with contacts from the row or estimated from the load."""
        names = [phase_names(self.layout, phase) for phase in PHASES]
        if names[0][0] in row:
            stance, swing = (np.array([_number(row, name) > 0.5 for name in some]) for some in names)
        else:
            force = self.facts.nominal.force(raw)
            stance, swing = self._contacts.update([force[part].sum() for part in self.layout.slices])
        return reference_of_contacts(stance, swing, place_apart(len(self.layout.feet)))


def _number(row: Mapping[str, Any], name: str) -> float:
    """Return a column's number, NaN for null: a reading that did not arrive."""
    try:
        value = row[name]
        return math.nan if value is None else float(value)
    except KeyError:
        raise LogError(f"The row lacks '{name}'; it has {len(row)} columns.") from None
    except (TypeError, ValueError):
        raise LogError(f"'{name}' must be a number or null, got {row[name]!r}.") from None


class StreamPage(Served):
    """A robot's stream in the browser, on an empty page."""

    def __init__(self, server: viser.ViserServer, feet: StreamFeet, rows: RowSocket) -> None:
        self.feet, self._rows = feet, rows
        weight = feet.facts.mass_kg * GRAVITY
        super().__init__(server, layout=feet.layout, weight=weight, size=SIZE, aside=0.0)
        self._method = self.server.gui.add_dropdown("calibrator", tuple(METHODS), initial_value=feet.method)
        when_changed(self._method, partial(self._ask, "method"))
        self._drawn, self._quiet = 0, 0.0
        self._told = f"Waiting for rows at UDP port {rows.port}."
        self._paint(feet.method)

    def _advance(self, passed: float) -> None:
        lines = self._rows.lines()
        self._quiet = 0.0 if lines else self._quiet + passed
        for line in lines:
            self._try("row", line)

    def draw(self) -> None:
        """Draw the newest row unless it was drawn before."""
        shown, rows = self.feet.shown, self.feet.rows
        if shown is None or (rows == self._drawn and self._quiet < QUIET):
            return
        self._drawn = rows
        silent = f"; no row for {self._quiet:.0f} s" if self._quiet > QUIET else ""
        with self.server.atomic():
            self._board.draw(shown)
            self._meters.draw(shown, f"{shown.time:.2f} s, {rows} rows{silent}", self._told)

    def _do(self, what: str, value: Any) -> str:
        if what == "row":
            self.feet.take(value)
            return ""
        self.feet.choose(str(value))
        self._forget()
        self._paint(self.feet.method)
        return ""
