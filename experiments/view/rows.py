"""Feet that are read row by row: from a log at its own pace, or from a robot that sends rows by UDP."""

import math
import socket
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import GRAVITY, FootCalibrator, MomentumReference, Reference
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
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.view.shown import Reading, Shown, check_method, show_feet
from surefoot.files import parse_json, read_text

NEED_NO_ROBOT = ("none", "tare")  # methods that calibrate feet alone
LOADED = 0.05  # share of the weight above which a true centre of pressure is drawn; chosen
BETWEEN_SOLES = 0.2  # m between the soles of feet alone, whose places are not known; chosen
LARGEST_PACKET = 65536  # bytes, the limit of UDP
MOST_AT_ONCE = 1000  # packets that are read between two frames; others wait for the next frame
QUIET = 1.0  # s without a row after which the page reports it


class RowFeet(ABC):
    """Feet that are read in up to three ways, one row at a time.

    Attributes:
        layout: The feet and their channels.
        weight: The robot's weight in N.
        method: The method of the calibrated reading.
        shown: The newest sample, None before the first.
        rows: Number of rows so far.
        message: Why the newest row was refused, or "".
    """

    def __init__(self, what: str, known: Mapping[str, Any], alone: bool, method: str) -> None:
        self._known = dict(known)  # arguments of FootCalibrator
        self.layout = self._known["layout"]
        self.weight = float(self._known["mass"]) * GRAVITY
        check_load_cells(self.layout, what)
        feet = len(self.layout.feet)
        self._apart = np.zeros((feet, 3))
        self._apart[:, 1] = BETWEEN_SOLES * (0.5 * (feet - 1) - np.arange(feet))
        self.rows, self.message = 0, ""
        self.shown: Shown | None = None
        self._alone = alone
        self.choose(method)

    def choose(self, method: str) -> None:
        """Start to calibrate by another method; ValueError if it does not exist or needs a robot's motion."""
        method = check_method(method)
        self._check_alone(method, self._alone)
        self.method = method
        self.begin()

    def begin(self) -> None:
        """Start fresh calibrators, as after a restart of the robot."""
        self._calibrators = [FootCalibrator(method=m, **self._known) for m in ("none", self.method)]
        self._time = self._origin = math.nan
        self._soles: tuple[Any, Any] | None = None

    def take(
        self, time: float, raw: Floats, reference: Reference | MomentumReference, soles: Any, true: Any = None
    ) -> None:
        """Process a row and prepare its drawing: time in s, counts (K,), a reference, and poses of soles."""
        step = time - self._time if time > self._time else float(self._known["dt"])
        estimate, calibrated = (one.update(raw, reference, step) for one in self._calibrators)
        self._time = time
        self._origin = origin_of(time) if math.isnan(self._origin) else self._origin
        self.rows += 1
        if all(np.isfinite(part).all() for part in soles):
            self._soles = soles
        if self._soles is not None:
            position, R = self._soles
            self.shown = show_feet(time - self._origin, position, R, estimate, calibrated, true)

    @abstractmethod
    def advance(self, passed: float) -> None:
        """Take the rows that are due after a time in s."""

    @property
    @abstractmethod
    def status(self) -> str:
        """The position in the log or stream, in words."""

    def _check_alone(self, method: str, alone: bool) -> None:
        if alone and method not in NEED_NO_ROBOT:
            raise LogError(
                f"Method '{method}' needs a robot's motion, and these rows are of feet alone: choose tare or "
                "none."
            )


class LogFeet(RowFeet):
    """The feet of a log, played at the pace of its clock.

    Raises LogError if the log does not describe a plate or two feet on load cells, or the method needs
    columns that it does not have.
    """

    def __init__(self, log: Log, method: str) -> None:
        self.log = log
        known = {"layout": log.layout, "mass": log.mass, "initial": log.nominal, "dt": log.dt, "lag": log.lag}
        known["age"] = float(log.about.get("sample_age_s", 0.0))
        super().__init__("log", known, bool(log.about.get("feet_alone")), method)

    def begin(self) -> None:
        """Start again at the beginning of the log."""
        super().begin()
        self.rows, self._now = 0, float(self.log.time[0])

    def advance(self, passed: float) -> None:
        """Take the rows of the log that are due after a time in s."""
        self._now += passed
        log = self.log
        momentum = log.momentum if self.method == "moment" else None
        for i in range(self.rows, int(np.searchsorted(log.time, self._now, side="right"))):
            reference = take_rows(log.reference if momentum is None else momentum, i)
            self.take(float(log.time[i]), log.raw[i], reference, self._poses(i), self._truth(i))

    @property
    def status(self) -> str:
        """The position in the log, in words."""
        start, end = self.log.time[[0, -1]]
        return f"{min(self._now, end) - start:.2f} s of {end - start:.2f} s"

    def _poses(self, i: int) -> tuple[Any, Any]:
        if self._alone:
            return self._apart, np.broadcast_to(np.eye(3), (len(self._apart), 3, 3))
        if self.log.truth is not None:
            return self.log.truth.position_sole[i], self.log.truth.R_world_sole[i]
        row, reference = self.log.reference_rows[i], self.log.reference
        return np.asarray(reference.position_sole)[row], np.asarray(reference.R_level_sole)[row]

    def _truth(self, i: int) -> Reading | None:
        """Return the true reading, whose centre of pressure follows from the places of the cells."""
        if self.log.truth is None:
            return None
        force, (position, R) = self.log.truth.force[i], self._poses(i)
        cells = np.array([foot.position_cell_sole for foot in self.layout.feet])
        places = (position[:, None] + cells @ R.swapaxes(1, 2)).reshape(-1, 3)
        total = float(force.sum())
        loaded = total > LOADED * self.weight
        cop = force @ places[:, :2] / total if loaded else np.full(2, np.nan)
        return Reading(force, force.reshape(len(cells), -1).sum(axis=1), cop)


class RowSocket:
    """Receives rows of a log at a UDP port, as one or several lines of JSON per packet.

    Raises OSError if the port is in use.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise OSError(f"UDP port {port} of {host} cannot be opened: {error.strerror}.") from None
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


class StreamFeet(RowFeet):
    """The feet of a running robot, whose rows have the columns of a log.

    Rows without reference columns are of feet alone. Raises LogError if the description is incomplete or does
    not describe a plate or two feet on load cells, ValueError if the method does not exist.
    """

    def __init__(self, description: Path, method: str, socket: RowSocket | None = None) -> None:
        values = parse_json(read_text(description, LogError), description.name, LogError)
        self.facts = facts = Description.read(values, f"{description.name}: the description")
        self._socket, self._quiet = socket, 0.0
        if np.isnan(facts.dt_s):
            raise LogError(f"{description.name}: a stream needs 'dt_s', the time between its rows in s.")
        if np.isnan(facts.nominal.offset).any():
            raise LogError(f"{description.name}: a stream needs 'offset_N' of the nominal map.")
        known = {"layout": facts.layout, "mass": facts.mass_kg, "initial": facts.nominal, "dt": facts.dt_s}
        self._names, self._counts = names_of(facts.layout), raw_names_of(facts.layout)
        super().__init__("description", known | {"lag": facts.lag_samples}, False, method)

    def begin(self) -> None:
        """Start fresh calibrators, as after a restart of the robot."""
        self._contacts = LoadContacts(self.weight, len(self.layout.feet), self.facts.dt_s)
        self._known["lag"] = self._contacts.lag if self._alone else self.facts.lag_samples
        super().begin()

    def advance(self, passed: float) -> None:
        """Take the rows that have arrived."""
        lines = self._socket.lines() if self._socket else []
        self._quiet = 0.0 if lines else self._quiet + passed
        for line in lines:
            try:
                self.take_line(line)
                self.message = ""
            except (LogError, ValueError) as error:
                self.message = str(error)

    @property
    def status(self) -> str:
        """The number of rows, in words."""
        if not self.rows and self._socket:
            return f"Waiting for rows at UDP port {self._socket.port}."
        silent = f"; no row for {self._quiet:.0f} s" if self._quiet > QUIET else ""
        return f"{self.shown.time if self.shown else 0.0:.2f} s, {self.rows} rows{silent}"

    def take_line(self, line: bytes) -> None:
        """Process a row of JSON; LogError or ValueError if a column is missing or wrong."""
        row = parse_json(line.decode(errors="replace"), "The row", LogError)
        if not isinstance(row, Mapping):
            raise LogError(f"The row must be a JSON object of columns, got {type(row).__name__}.")
        alone = not has_references(row)
        self._check_alone(self.method, alone)
        time = _number(row, "time_s")
        if math.isnan(time):
            raise LogError("'time_s' must be a number, got null.")
        if alone != self._alone or time <= self._time:  # the latter after a restart of the robot
            self._alone = alone
            self.begin()
        raw = self.facts.straightening.straighten(np.array([_number(row, name) for name in self._counts]))
        reference = self._feel(row, raw) if alone else self._believe(row)
        self.take(time, raw, reference, (reference.position_sole, reference.R_level_sole))

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
        return reference_of_contacts(stance, swing, self._apart)


def _number(row: Mapping[str, Any], name: str) -> float:
    """Return a column's number, NaN for null, which is a reading that did not arrive."""
    try:
        value = row[name]
        return math.nan if value is None else float(value)
    except KeyError:
        raise LogError(f"The row lacks '{name}'; it has {len(row)} columns.") from None
    except (TypeError, ValueError):
        raise LogError(f"'{name}' must be a number or null, got {row[name]!r}.") from None
