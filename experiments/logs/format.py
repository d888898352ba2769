"""Logs of walks of simulated and real robots. docs/log-format.md documents their columns.

A log is a Parquet or CSV table with one row per sample of the foot sensors, and a description of the robot:
in the metadata of the schema under ``surefoot``, or in ``walk.json`` beside ``walk.csv``. Calibrators never
read columns that begin with ``truth_``. References can be computed from joint angles, an IMU and a model that
the description names under ``motion`` (extra ``[sim]``).
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from surefoot.arrays import Floats, take_rows
from surefoot.calibration.contacts import contacts_from_load, reference_of_contacts
from surefoot.calibration.cop import sole_wrenches
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, MomentumReference, Reference
from surefoot.experiments.logs.bag import Bag, is_bag, is_motion, read_bag
from surefoot.experiments.logs.checks import (
    check_columns,
    check_readings,
    check_reference,
    check_time,
    clock_of,
    naming_cure,
)
from surefoot.experiments.logs.clock import LOST_ROWS as LOST_ROWS
from surefoot.experiments.logs.columns import (
    PHASES,
    columns_of,
    fields_of,
    has_references,
    names_of,
    part_names,
    phase_names,
    raw_names_of,
    stack,
)
from surefoot.experiments.logs.contacts import FELT, check_steps, contacts
from surefoot.experiments.logs.description import Description, MotionFacts, describe
from surefoot.experiments.logs.mapping import TableMapping, merge
from surefoot.experiments.logs.motion import read_motion
from surefoot.experiments.logs.table import LogError, LogTable
from surefoot.files import atomic_path, parse_json, read_text, write_text
from surefoot.names import page

METADATA_KEY = b"surefoot"


@dataclass(frozen=True, eq=False)
class LogTruth:
    """True values of N samples, which only a simulator knows."""

    force: Floats  # force of the ground on each channel in N, shape (N, K)
    position_sole: Floats  # origins of the sole frames in the world in m, shape (N, 2, 3)
    R_world_sole: Floats  # rotations from the sole frames to the world, shape (N, 2, 3, 3)
    scale: Floats  # scale in N per count of the map that corrects the channels' errors, shape (N, K)
    offset: Floats  # offset in N of that map, shape (N, K)


@dataclass(frozen=True, eq=False)
class Log:
    """N samples of a walk and the description of the robot."""

    time: Floats  # of the samples in s, increasing, shape (N,)
    raw: Floats  # readings in counts, shape (N, K); NaN where no sample arrived
    reference: Reference  # N rows in every field; row k describes the feet of row k - ``lag``
    layout: FeetLayout
    mass: float  # in kg, as the robot knows it
    nominal: Parameters  # the map by the data sheet of the sensors, F = c raw + d
    calibrated: Parameters | None  # the map from known weights before the session
    dt: float  # time between samples in s
    lag: int  # number of samples by which the reference is late
    seed: int | None = None  # of a simulated walk
    momentum: MomentumReference | None = None  # the reference as momentum, which "moment" prefers
    truth: LogTruth | None = None  # only of simulated walks
    about: dict[str, Any] = field(default_factory=dict)  # further facts as JSON values, such as the speed
    turned: Mapping[str, Callable[[], Reference]] = field(default_factory=dict)
    """References with the sign of one joint inverted, by joint, if they were computed from joint angles."""
    motion: MotionFacts | None = None  # how references were computed from joint angles

    def __len__(self) -> int:
        """The number of samples, N."""
        return len(self.time)

    def __repr__(self) -> str:
        """Summary on one line."""
        feet = ", ".join(foot.name for foot in self.layout.feet)
        span = f"{self.time[0]:g} to {self.time[-1]:g} s" if len(self) else "empty"
        more = ", with truth" * (self.truth is not None)
        return (
            f"Log({len(self)} samples of {self.layout.channels} channels ({feet}), {span} at "
            f"{1.0 / self.dt:g} Hz, {self.mass:g} kg{more})"
        )

    @property
    def reference_rows(self) -> NDArray[np.intp]:
        """The row of ``reference`` that describes the feet of each row, at most the last row."""
        return np.minimum(np.arange(len(self)) + self.lag, len(self) - 1)

    def cut(self, rows: slice) -> "Log":
        """Return a log of some of the rows."""
        truth = self.truth and LogTruth(**{name: part[rows] for name, part in vars(self.truth).items()})
        return replace(
            self,
            time=self.time[rows],
            raw=self.raw[rows],
            reference=take_rows(self.reference, rows),
            momentum=self.momentum and take_rows(self.momentum, rows),
            truth=truth,
            turned={},
        )

    def to_pandas(self) -> Any:
        """Return the table as a data frame with one row per sample."""
        import pandas as pd

        return pd.DataFrame(columns_of(self))


def write_log(log: Log, path: str | Path) -> Path:
    """Write a log as ``.parquet``, or as ``.csv`` with its description in ``.json`` beside it.

    Returns the path. The file appears only when it is complete. Raises LogError for other endings.
    """
    path = Path(path)
    columns = columns_of(log)
    description = json.dumps(describe(log), indent=1)
    if path.suffix == ".parquet":
        table = pa.table(columns).replace_schema_metadata({METADATA_KEY: description.encode()})
        with atomic_path(path) as part:
            pq.write_table(table, part)
    elif path.suffix == ".csv":
        write_text(path.with_suffix(".json"), description)
        with atomic_path(path) as part:
            csv.write_csv(pa.table(columns), part)
    else:
        raise LogError(f"{path.name}: a log ends in .parquet or .csv; rename the file.")
    return path


def read_log(
    path: str | Path,
    max_gap: float = LOST_ROWS,
    topics: str | Path | None = None,
    *,
    feet_alone: bool = False,
) -> Log:
    """Read and check a log: a ``.parquet`` file, a ``.csv`` file with its ``.json``, or a ROS bag.

    A ``.toml`` file beside a table gives names and units of its columns, and further tables.

    Args:
        path: The log.
        max_gap: Longest time between two rows in s. With infinity, gaps are accepted: the calibrator flags
            them, keeps its parameters and starts its filters again.
        topics: Mapping file of a bag, by default ``.topics.toml`` beside it.
        feet_alone: Whether a log may lack all references, such as those of insoles, plates and boards.

    Raises:
        LogError: If the file does not exist or is not a log, a column is missing or has invalid values, or
            there are gaps in time. The message names the file, the column and the remedy.
    """
    path = Path(path)
    description, table, moved, averaged = _read_sources(path, None if topics is None else Path(topics))
    facts, layout = description.facts(), description.layout
    made = description.motion is not None
    bare = not made and not has_references(table.names)
    alone = feet_alone and bare
    counts = ["time_s", *raw_names_of(layout)]
    kinds = _kinds_in(table, ["truth"] if bare or made else ["truth", "momentum"])
    names = [*(counts if alone or made else names_of(layout)), *_names_of_kinds(layout, kinds)]
    values = check_columns(table, names, ALONE if bare else "")
    clock = clock_of(values["time_s"], path.name, joined=bool(np.isinf(max_gap)))
    time, found = clock.time, tuple(f"{path.name}: column 'time_s' {text}." for text in clock.notices)
    check_time(time, description.dt_s, max_gap, path.name)
    _check_length(len(time), facts["lag"], path.name)
    curves = description.straightening
    raw = curves.straighten(stack(values, counts[1:]))
    if unread := np.isnan(facts["nominal"].offset).any():
        check_readings(raw, counts[1:], path.name)
    if alone:
        reference, more, about = _refer_to_feet(table, raw, facts)
    elif made:
        reference, more, about = _make_beliefs(path, table, moved or table, description, time, averaged)
    else:
        reference, more, about = Reference(**fields_of(values, layout, "reference")), {}, {}
        check_reference(reference, path.name)
        if "momentum" in kinds:
            shared = {phase: getattr(reference, phase) for phase in PHASES}
            more["momentum"] = MomentumReference(**fields_of(values, layout, "momentum", reference), **shared)
    about |= {"notices": notices} if (notices := table.notices + found) else {}
    curved = {"curves": curves.as_plain()} if curves.any else {}
    facts |= {**more, "about": facts["about"] | curved | about}
    if unread:
        swing = np.asarray(reference.swing)[facts["lag"] :]
        facts["nominal"] = _tare_map(facts["nominal"], raw[: len(swing)], swing, layout, path.name)
    truth = LogTruth(**fields_of(values, layout, "truth")) if "truth" in kinds else None
    del table, moved, values
    pa.default_memory_pool().release_unused()  # pyarrow would keep as much memory as the log needs
    return Log(time=time, raw=raw, reference=reference, truth=truth, **facts)


def _check_length(rows: int, lag: int, name: str) -> None:
    """Raise LogError if a log is shorter than the delay of its references."""
    if rows <= lag:
        raise LogError(
            f"{name}: {rows} rows are too few where references come lag_samples = {lag} rows late; record "
            "some seconds."
        )


def _kinds_in(table: LogTable, kinds: list[str]) -> list[str]:
    """Return those kinds of columns, named by their prefix, that a table contains."""
    return [kind for kind in kinds if any(name.startswith(f"{kind}_") for name in table.names)]


def _names_of_kinds(layout: FeetLayout, kinds: list[str]) -> list[str]:
    return [name for kind in kinds for name in part_names(layout, kind)]


def _read_sources(path: Path, topics: Path | None) -> tuple[Description, LogTable, LogTable | None, bool]:
    """Read a log's description, its table, and the table of the robot's motion if it is separate.

    Also return whether a row of the IMU is the mean since the previous row.
    """
    moved: LogTable | None = None
    if is_bag(path):
        mapping, tables = TableMapping(), list[LogTable]()
        bag: Bag | None = read_bag(path, topics)
    elif topics is not None:
        raise LogError(
            f"{path.name}: is a table; --topics names columns of bags, and {path.stem}.toml those of tables."
        )
    else:
        mapping = TableMapping.beside(path)
        tables = mapping.read_all(path, "'surefoot demo' records logs under out/demo/logs.")
        bag = merge(tables) if len(tables) > 1 else None
    told = _description(path, tables[0].data.schema.metadata if tables else None)
    table = tables[0] if bag is None else bag.table(lambda name: not is_motion(name))
    description = Description.read(told, f"{path.name}: the description")
    averaged = description.motion is not None and description.motion.averaged
    if bag is not None:
        moved, averaged = bag.motion(averaged)
    if description.motion is not None and description.motion.table:
        beside = path.parent / description.motion.table
        moved = mapping.read_by_mapping(beside, "motion.table gives its path from the log.")
        tables.append(moved)
    mapping.check_units(tables)
    if np.isnan(description.dt_s):
        table.require(["time_s"], naming_cure(table, raw_names_of(description.layout)))
        description = description.model_copy(update={"dt_s": table.step})
    return description, table, moved, averaged


def _tare_map(nominal: Parameters, raw: Floats, swing: Any, layout: FeetLayout, file: str) -> Parameters:
    """Return a map whose offsets make the median force of each channel zero while its foot swings."""
    offset = np.full(layout.channels, np.nan)
    for i, name in enumerate(raw_names_of(layout)):
        foot = int((layout.wrench_map[:, :, i] != 0.0).any(axis=1).argmax())
        hanging = raw[swing[:, foot], i]
        if not np.isfinite(hanging).any():
            raise LogError(
                f"{file}: the description's nominal has no 'offset_N', and the {layout.feet[foot].name} foot "
                f"is never surely in the air, where it could be read; lift it, or give for '{name}' minus "
                "scale times what the channel reads unloaded."
            )
        offset[i] = -nominal.scale[i] * np.nanmedian(hanging)
    return Parameters(nominal.scale, offset)


ALONE = "Feet alone, without references, can be calibrated by --method tare or none."


Found = tuple[Reference, dict[str, Any], dict[str, Any]]
"""A reference, further fields of the log, and entries of ``about``."""


def _refer_to_feet(table: LogTable, raw: Floats, facts: dict[str, Any]) -> Found:
    """Return a reference of level feet that contains only contacts.

    Contacts are estimated from the load if the log does not contain them.
    """
    layout = facts["layout"]
    feet = len(layout.feet)
    names = [name for phase in PHASES for name in phase_names(layout, phase)]
    if any(name in table for name in names):
        flags = check_columns(table, names)
        down = stack(flags, names) > 0.5
        stance, swing, source, more = down[:, :feet], down[:, feet:], "as the log says", {}
    else:
        scale, offset = facts["nominal"]
        load = sole_wrenches(scale * raw + np.nan_to_num(offset), layout)[..., 2]
        stance, swing = contacts_from_load(load, facts["mass"] * GRAVITY, facts["dt"])
        if np.isnan(offset).any() and not swing.any(axis=0).all():
            check_steps(load, facts["mass"], table.file)
        source, more = FELT, {"lag": 0}
    reference = reference_of_contacts(stance, swing, np.zeros((len(raw), feet, 3)))
    return reference, more, {"feet_alone": True, "contacts": source}


def _make_beliefs(
    path: Path, table: LogTable, moved: LogTable, description: Description, time: Floats, averaged: bool
) -> Found:
    feet, dt = description.layout.feet, description.dt_s
    if description.motion is None or len(feet) != 2:
        raise LogError(
            f"{path.name}: motion needs the layout of two feet, got {len(feet)}; "
            "give the reference columns of a single plate."
        )
    facts = description.motion.of_log(path.parent, moved.step if moved is not table else dt)
    try:
        from surefoot.experiments.logs.model import check_spin, load_model, make_beliefs, moving_soles
    except ImportError as error:
        raise LogError(
            f"{path.name}: joints and IMU need a model of the robot, for which {error.name} is missing; "
            'install it with `pip install "surefoot[sim]"`, or give the reference columns.'
        ) from None
    model, R_torso_imu = load_model(facts, path.name)
    motion = read_motion(moved, facts, model.joint_names).rotate(R_torso_imu)
    check_spin(motion, model, moved.file)
    known = (
        facts.model_copy(update={"averaged": averaged}),
        model,
        description.mass_kg,
        description.layout,
        dt,
    )
    reference, momentum = make_beliefs(time, motion, *known)
    if not np.isfinite(reference.com).all(axis=-1).any():
        raise LogError(
            f"{moved.file}: joints and IMU reach from {motion.time[0]:.12g} to {motion.time[-1]:.12g} s, "
            f"and the feet from {time[0]:.12g} to {time[-1]:.12g} s; give both on one clock, and "
            "motion.delay_s."
        )
    names = feet[0].name, feet[1].name
    stance, swing, source = contacts(table, names, reference, dt)
    about: dict[str, Any] = {"contacts": source, "model": facts.model.name, "model_mass_kg": model.mass}

    def turn(joint: int) -> Reference:
        found, _ = make_beliefs(time, motion.turn(joint), *known)
        down, up, _ = contacts(table, names, found, dt)
        return found._replace(stance=down, swing=up)

    legs = moving_soles(model, motion.joint)
    turned = {name: partial(turn, model.joint_names.index(name)) for name in legs}
    reference = reference._replace(stance=stance, swing=swing)
    momentum = momentum._replace(stance=stance, swing=swing)
    return reference, {"momentum": momentum, "turned": turned, "motion": facts}, about


def _description(path: Path, metadata: Any) -> Any:
    """Read the description from the metadata of a Parquet file, or from the ``.json`` beside the file."""
    side, text = path, (metadata or {}).get(METADATA_KEY)
    if text is None:
        side = path.with_suffix(".json")
        if not side.is_file():
            within = ", nor within it under the key 'surefoot'" if path.suffix == ".parquet" else ""
            raise LogError(
                f"{path.name}: the description {side.name} is not beside it{within}; it holds layout, mass "
                f"and calibrations; {page('log-format')} shows one."
            )
        text = read_text(side, LogError)
    return parse_json(text, f"{side.name}: the description", LogError)
