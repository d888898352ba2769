r"""Check a table of weighings for outliers, exchanged labels and cells that do not follow the load.

The counts of a cell are linear in the load, code = g F + z, with noise of Student's t distribution, so that
outliers do not turn the line. The table is compared with tables in which two labels are exchanged, one label
is another load, or a zero jumped (:mod:`surefoot.calibration.diagnosis`). The log likelihood grows by
n ln(s / s') if the scale of the residuals of n readings falls from s to s'.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student
from scipy.stats import theilslopes

from surefoot.arrays import Floats
from surefoot.calibration.diagnosis import Experience, Fitted, Mistake, investigate
from surefoot.calibration.results import Finding
from surefoot.calibration.weights.curves import LEAST, CurveFit, Curves, fit_curve
from surefoot.experiments.force_torque.checks import RAILS
from surefoot.experiments.study.tables import round_to
from surefoot.experiments.weights.loop import LEAST as LEAST_LOOP
from surefoot.experiments.weights.loop import Memory, memory_of
from surefoot.experiments.weights.units import check_units

ODDS = 1e6  # odds above which a mistake is reported
EXPERIENCE = Experience(unknown=0.3, mimicked=0.02, size=1.0, spread=0.4)
"""Residuals relative to those of repeated readings. Curves and hysteresis leave up to twice as much. The
prior odds are those of walks (:mod:`surefoot.experiments.walking.judge`). Labels and jumps rarely mimic each
other."""

DRIFTED = 0.02  # drift as a share of the span of loads above which a scale that takes it in is refused
EXCHANGED = "labels exchanged"
JUMP = 0.1  # jump of a zero as a share of the span of readings below which it may be hysteresis or drift
FEWEST = 6  # readings of a cell in which a jump of its zero can be seen
MOST = 0.25  # share of a cell's readings that may be left out
NORMAL = 0.6745  # median of |z| for z ~ N(0, 1)
TAIL = 3.0  # degrees of freedom of Student's t
ROUNDING = 1.0 / np.sqrt(12.0)  # std of a count that was rounded
FOLLOWS = 5.0  # standard deviations that a slope must be from zero for a cell to follow its load
DEGREE = 3  # of the polynomial that gives the slope of a cell with too few loads for a curve


_note = partial(Finding, refuses=False)


@dataclass(frozen=True)
class Weighings:
    """A table of loads in N, (n,), and counts, (n, K), with the column and unit of the loads in the file."""

    load: Floats
    code: Floats
    cells: tuple[str, ...]  # their columns
    column: str  # of the loads
    unit: float  # N of one in that column

    def label(self, load: float) -> str:
        """Format a load in the unit of the file."""
        return f"{load / self.unit:.4g}"


@dataclass(frozen=True)
class Line:
    """Counts of one cell, code = slope load + level, with the scale of residuals in counts."""

    slope: float
    level: float
    scale: float
    residual: Floats  # in counts, NaN where not weighed
    slope_std: float

    @property
    def follows(self) -> bool:
        """Whether the counts depend on the load significantly."""
        return abs(self.slope) > FOLLOWS * self.slope_std


class Shape(NamedTuple):
    """Departures of one cell's readings from a line, each ``None`` if it is not significant."""

    curve: CurveFit | None
    memory: Memory | None

    @property
    def loop(self) -> Memory | None:
        """The memory if it shows how much hysteresis there is."""
        return self.memory if self.memory and np.isfinite(self.memory.hysteresis_std) else None


class Judged(NamedTuple):
    """A judged table of weighings."""

    findings: list[Finding]
    kept: Floats  # counts without those that are to be left out, shape (n, K)
    shapes: list[Shape]  # of the cells, by these counts


def judge_weighings(table: Weighings) -> Judged:
    """Check a table; return findings, the counts without outliers, and the shape of each cell."""
    out = np.isin(table.code, RAILS)
    table, given = replace(table, code=np.where(out, np.nan, table.code)), table
    lines: list[Line | None] = [_fit(table.load, code) for code in table.code.T]
    found: list[Finding] = [*check_units(table, lines)]
    label = _check_mistakes(table, lines)
    for i, line in enumerate(lines):
        if line is not None and label is None:
            out[:, i] |= _outliers(table, i, line)
    kept = np.where(out, np.nan, given.code)
    shapes = [_find_shape(table.load, code) for code in kept.T]
    if label is not None:
        return Judged([label, *found], kept, shapes)
    for i, (line, shape) in enumerate(zip(lines, shapes, strict=True)):
        if line is not None:
            found += _check_cell(given, i, line, out[:, i], shape)
    return Judged([*found, *_check_shared(table, lines)], kept, shapes)


def _find_shape(load: Floats, code: Floats) -> Shape:
    there = np.isfinite(code + load)
    curve = fit_curve(code[there], load[there])
    return Shape(curve, find_memory(load[there], code[there], curve))


def _fit(load: Floats, code: Floats) -> Line | None:
    """Fit a line to one cell's counts; ``None`` if it saw fewer than three readings or two loads."""
    kept = np.isfinite(code) & np.isfinite(load)
    x, y = load[kept], code[kept]
    if len(x) < 3 or np.ptp(x) <= 0.0:
        return None
    # Theil and Sen: the median of slopes between medians of loads starts where outliers do not reach.
    loads = np.unique(x)
    middle = np.array([np.median(y[x == one]) for one in loads])
    slope = float(theilslopes(middle, loads).slope)
    level = float(np.median(y - slope * x))
    basis = np.column_stack([x / np.abs(loads).max(), np.ones_like(x)])
    r = y - slope * x - level
    scale = max(float(np.median(np.abs(r))) / NORMAL, ROUNDING)
    theta = np.array([slope * np.abs(loads).max(), level])
    for _ in range(30):
        weight = (TAIL + 1.0) / (TAIL + (r / scale) ** 2)
        root = np.sqrt(weight)[:, None]
        theta = np.linalg.lstsq(root * basis, root[:, 0] * y, rcond=None)[0]
        r = y - basis @ theta
        scale = max(float(np.sqrt(np.mean(weight * r**2))), ROUNDING)
    residual = np.full(len(code), np.nan)
    residual[kept] = r
    spread = max(scale, _scatter(x, y)[0]) / np.sqrt(np.sum((x - x.mean()) ** 2))
    if (np.diff(middle) * theta[0] <= 0.0).any():
        # Not a curve but a drift between weights, which repeated readings do not contain.
        means = np.array([r[x == one].mean() for one in loads])
        between = np.sum(means**2) / max(len(loads) - 2, 1) / np.sum((loads - loads.mean()) ** 2)
        spread = max(spread, np.sqrt(between))
    return Line(float(theta[0] / np.abs(loads).max()), float(theta[1]), scale, residual, float(spread))


def _likelihood(lines: list[Line | None]) -> float:
    """Return the log likelihood of all cells up to a constant."""
    total = 0.0
    for line in lines:
        if line is not None:
            z = line.residual[np.isfinite(line.residual)] / line.scale
            total -= len(z) * np.log(line.scale) + (TAIL + 1.0) / 2.0 * np.log1p(z**2 / TAIL).sum()
    return total


def _check_mistakes(table: Weighings, lines: list[Line | None]) -> Finding | None:
    """Return a finding about the mistake that explains the residuals: a wrong label, or a zero jump."""
    tried = [*_label_mistakes(table), *_zero_jumps(table, lines)]

    def fit(undone: Weighings) -> Fitted:
        fitted = [_fit(undone.load, code) for code in undone.code.T]
        return Fitted(_likelihood(fitted), _size(table, fitted), fitted)

    every = [one._replace(choices=len(tried)) for one in tried]
    diagnosis = investigate(table, every, fit, EXPERIENCE, len(table.load))
    limit, likely = float(np.log(ODDS)), diagnosis.likely
    if likely is None or likely.evidence <= limit:
        return None
    worst = max(
        abs(np.nanmax(np.abs(one.residual)) / one.slope) for one in lines if one is not None and one.slope
    )
    reason = f"The weighings contradict each other by up to {worst:.2g} N. {diagnosis.sentence()}"
    cure = f"{diagnosis.cure.removesuffix('.')}, or leave these rows out."
    kind = "labels" if likely.mistake.kind == EXCHANGED else likely.mistake.kind
    return Finding(kind, reason, cure, likely.evidence, limit, contradicts=True)


def _label_mistakes(table: Weighings) -> Iterator[Mistake]:
    """Yield two labels that are exchanged, and labels of another load."""
    loads = np.unique(table.load[np.isfinite(table.load)])
    if len(loads) < 4:
        return
    column = f"in column '{table.column}'"

    def relabel(load: Floats) -> Callable[[Weighings], Weighings]:
        return lambda table: replace(table, load=load)

    for a, b in combinations(loads, 2):
        changed = np.where(table.load == a, b, np.where(table.load == b, a, table.load))
        cause = f"{column} the labels {table.label(a)} and {table.label(b)} are exchanged"
        yield Mistake(EXCHANGED, cause, "exchange them", relabel(changed))
    for a in loads:
        if (np.isfinite(table.code) & (table.load == a)[:, None]).sum() < 2:
            continue  # a single reading is an outlier, not a wrong label
        others = [_fit(np.where(table.load == a, np.nan, table.load), code) for code in table.code.T]
        means = [
            (np.median(code[table.load == a]) - line.level) / line.slope
            for code, line in zip(table.code.T, others, strict=True)
            if line is not None and line.slope != 0.0
        ]
        if means and np.isfinite(means).any():
            true = float(np.nanmedian(means))
            cause = f"{column} the readings under {table.label(a)} are those of {table.label(true)}"
            changed = np.where(table.load == a, true, table.load)
            yield Mistake("labels", cause, "weigh that load again", relabel(changed), free=1)


def _zero_jumps(table: Weighings, lines: Sequence[Line | None]) -> Iterator[Mistake]:
    """Yield the likeliest jump of each cell's zero, as of a tare that was pressed in the middle."""
    for i, line in enumerate(lines):
        rows = np.flatnonzero(np.isfinite(table.code[:, i]) & np.isfinite(table.load))
        if line is None or len(rows) < FEWEST:
            continue
        x, y, best = table.load[rows], table.code[rows, i], (np.inf, 0, 0.0)
        for k in range(2, len(rows) - 1):
            A = np.column_stack([x, np.ones_like(x), np.arange(len(rows)) >= k])
            theta, rest = np.linalg.lstsq(A, y, rcond=None)[:2]
            if len(rest) and rest[0] < best[0]:
                best = float(rest[0]), k, float(theta[2])
        _, k, jump = best
        slope = _fit(x, np.where(np.arange(len(rows)) >= k, y - jump, y))
        if slope is not None and slope.follows and abs(jump) > JUMP * abs(slope.slope) * np.ptp(x):
            code = table.code.copy()
            code[rows[k:], i] -= jump
            cause = (
                f"the zero of column '{table.cells[i]}' jumps by {jump:.4g} counts before line {rows[k] + 2}"
            )
            undo = partial(_recount, code=code)
            yield Mistake("zero jump", cause, "weigh this cell again without a tare", undo, free=1)


def _recount(table: Weighings, code: Floats) -> Weighings:
    return replace(table, code=code)


def _size(table: Weighings, lines: Sequence[Line | None]) -> float:
    """Return the largest scale of a cell's residuals in that of its repeated readings."""
    return max((_repeat(table, i, line) for i, line in enumerate(lines) if line is not None), default=1.0)


def _check_shared(table: Weighings, lines: Sequence[Line | None]) -> Iterator[Finding]:
    """Find rows in which several cells follow one load, as if each had a weight of its own."""
    follows = [i for i, line in enumerate(lines) if line is not None and line.follows]
    together = (np.isfinite(table.code[:, follows]).sum(axis=1) > 1) & (np.abs(table.load) > 0.0)
    if together.any():
        reason = (
            f"In {together.sum()} rows {len(follows)} cells follow the load in column '{table.column}' at "
            "the same time: each is taken to bear all of it."
        )
        cure = (
            "If one weight stood on all of them, each bore a share, and its scale comes out too large: put "
            "the weight on one cell at a time and leave the other columns empty."
        )
        yield _note("shared weight", reason, cure)


def _repeat(table: Weighings, i: int, line: Line) -> float:
    """Scale of a cell's residuals in that of its repeated readings under one load; 1 without repeats."""
    spread = [
        (code - code.mean()) * np.sqrt(len(code) / (len(code) - 1.0))
        for one in np.unique(table.load[np.isfinite(table.load)])
        if len(code := table.code[(table.load == one) & np.isfinite(table.code[:, i]), i]) > 1
    ]
    if not spread:
        return 1.0
    inner = max(float(np.median(np.abs(np.concatenate(spread)))) / NORMAL, ROUNDING)
    return float(line.scale / inner)


def _outliers(table: Weighings, i: int, line: Line) -> NDArray[np.bool_]:
    code = table.code[:, i]
    middle = float(np.nanmedian(np.abs(line.residual))) / NORMAL
    # The quantile of one reading in a million, for a line and a noise estimated from so many readings.
    noise = max(line.scale, middle)
    reach = noise * float(student.ppf(1.0 - 0.5 / ODDS, max(np.isfinite(line.residual).sum() - 2, 1)))
    far: NDArray[np.bool_] = np.abs(line.residual) > reach
    # All readings of one load depart from the line of a curved cell. An outlier also departs from them.
    for row in np.flatnonzero(far):
        like = (table.load == table.load[row]) & np.isfinite(code)
        if like.sum() > 2 and abs(code[row] - np.median(code[like])) < reach:
            far[row] = False
    return far


def _check_cell(
    table: Weighings, i: int, line: Line, out: NDArray[np.bool_], shape: Shape
) -> Iterator[Finding]:
    """Yield findings about one cell: whether it follows its load, its outliers, and its shape."""
    name, code, load = table.cells[i], table.code[:, i], table.load
    read = np.isfinite(code)
    kept = read & np.isfinite(load) & ~out
    x, span = load[kept], float(np.ptp(load[kept])) if kept.any() else 0.0
    if not line.follows:
        ends = f"from {table.label(x.min())} to {table.label(x.max())}"
        reason = (
            f"Column '{name}' does not follow the load: {ends} its counts change by "
            f"{abs(line.slope) * span:.3g}, and they scatter by {line.scale:.3g}."
        )
        cure = "Check its wiring and that the weights rest on it, or leave the column out."
        if (np.isfinite(table.code[read]).sum(axis=1) > 1).any():
            empty = "Leave its readings empty where the weight rested on another cell"
            cure = f"{empty}; else {cure[0].lower()}{cure[1:]}"
        yield Finding("dead cell", reason, cure, abs(line.slope) / line.slope_std, FOLLOWS)
        return
    if out.any():
        rows, many = np.flatnonzero(out), out.sum() > MOST * read.sum()
        listed = ", ".join(f"{row + 2}" for row in rows[:6]) + (" and more" if len(rows) > 6 else "")
        far = np.nanmax(np.abs(code[out] - line.slope * load[out] - line.level)) / abs(line.slope)
        reason = (
            f"Column '{name}': {len(rows)} of {read.sum()} readings lie off the line of the others by up to "
            f"{far:.3g} N (line {listed} of the file, such as {code[rows[0]]:.10g})."
        )
        cure = "Weigh this cell again." if many else "They are left out."
        yield Finding("outliers", reason, cure, len(rows) / len(code), MOST, refuses=bool(many))
        if many:
            return
    bend = _bend(load[kept], code[kept], line)
    yield from _check_line(name, line, span, (bend[0], table.label(bend[1]), bend[2]), shape)
    yield from _check_memory(name, shape.memory, span)


def _check_line(
    name: str, line: Line, span: float, bend: tuple[float, str, float], shape: Shape
) -> Iterator[Finding]:
    """Yield a finding about the departure of a cell from its line.

    ``span`` is that of its loads in N, ``bend`` the largest departure in N, its load, and its deviation in N.
    """
    (size, at, doubt), curve, memory = bend, shape.curve, shape.memory
    scatter = abs(line.scale / line.slope)
    bent = f"Column '{name}' is no line: under {at} its readings lie {size:.2g} N from it"
    if curve is not None:
        cure = (
            f"A {curve.shape} takes its place; weights that were left out are found to {curve.std:.2g} N "
            f"(by a line to {curve.line_std:.2g} N)."
        )
        yield _note("curve", f"{bent}.", cure, curve.line_std, LEAST * span)
    elif size > max(FOLLOWS * doubt, LEAST * span):
        reason = f"{bent}, and they scatter by {scatter:.2g} N."
        cure = "Forces between the weights are that uncertain; weigh near the loads that matter."
        yield _note("curve", reason, cure, size, LEAST * span)
    elif not (memory and memory.loops) and scatter > FOLLOWS * LEAST * span:
        reason = (
            f"Column '{name}' scatters by {scatter:.2g} N about its line, of {span:.3g} N: a curve, creep, "
            "or weights that do not rest on it alone."
        )
        cure = "Weigh each load three times or more, up and down."
        yield _note("scatter", reason, cure, scatter, FOLLOWS * LEAST * span)


def find_memory(load: Floats, code: Floats, curve: CurveFit | None) -> Memory | None:
    """Find hysteresis and drift of readings of one cell, which its curve makes straight, if it has one."""
    straight = code if curve is None else Curves([curve.knots]).straighten(code[:, None])[:, 0]
    degree = min(DEGREE, len(np.unique(load)) - 1) if curve is None else 1
    if degree < 1:
        return None
    slope = np.polynomial.Polynomial.fit(load, straight, degree).deriv()(load)
    if not (slope > 0.0).all() and not (slope < 0.0).all():
        return None
    # Within a load all that counts is by how many newtons readings differ.
    return memory_of(load, straight / slope, ROUNDING / float(np.abs(slope).max()))


def _check_memory(name: str, memory: Memory | None, span: float) -> Iterator[Finding]:
    """Yield findings about hysteresis and drift of a cell."""
    if memory is None:
        return
    share, std = (100.0 * part for part in (memory.hysteresis, memory.hysteresis_std))
    if memory.loops:
        value, deviation = round_to(abs(share), std)
        reason = (
            f"Column '{name}' reads {'more' if share > 0.0 else 'less'} on the way down than on the way up: "
            f"a hysteresis of {value} ± {deviation} % of full scale, {abs(memory.hysteresis) * span:.2g} N "
            "at half the load."
        )
        cure = "No line or curve undoes it: forces are off by up to half of it, up or down."
        limit = max(LEAST_LOOP, memory.reach * memory.hysteresis_std)
        yield _note("hysteresis", reason, cure, abs(memory.hysteresis), limit)
    if memory.drifts and abs(memory.drift) > LEAST * span:
        drift = f"{memory.drift:+.2g} N from its first row to its last"
        reason = f"Column '{name}' drifts while it is weighed, by {drift}."
        cure = "Let the cell warm up for a quarter of an hour under no load, and weigh again."
        # Loads that only rise are correlated with time, so the drift biases the scale.
        one_way = not np.isfinite(memory.hysteresis_std)
        if one_way:
            cure += " Weigh up and down: with loads in one order its scale takes the drift for load."
        refuses = one_way and abs(memory.drift) > DRIFTED * span
        yield Finding("drift", reason, cure, abs(memory.drift), LEAST * span, refuses=refuses)


def _bend(load: Floats, code: Floats, line: Line) -> tuple[float, float, float]:
    """Return the largest mean residual of a load in N, that load, and its standard deviation."""
    slope, level = np.polyfit(load, code, 1)
    groups = {float(one): code[load == one] for one in np.unique(load)}
    means = [(abs(part.mean() - slope * one - level) / abs(slope), one) for one, part in groups.items()]
    noise, free = _scatter(load, code)
    bend, at = max(means)
    count = int((load == at).sum())
    return bend, float(at), (noise if free else line.scale) / abs(slope) / np.sqrt(count)


def _scatter(load: Floats, code: Floats) -> tuple[float, int]:
    """Return the standard deviation of readings under one load in counts, and its degrees of freedom."""
    groups = [code[load == one] for one in np.unique(load)]
    free = len(code) - len(groups)
    return max(float(np.sqrt(sum(len(one) * one.var() for one in groups) / max(free, 1))), ROUNDING), free
