"""Check a log of any kind without calibrating: its contents, its flaws, and a measurement to resolve each."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from surefoot.calibration import Parameters, Reference
from surefoot.calibration.diagnosis import Mistake
from surefoot.calibration.results import CalibrationRefused, Finding
from surefoot.experiments.force_torque.log import InSituLog
from surefoot.experiments.instrument.channels import (
    ChannelFacts,
    Wrong,
    facts_of,
    find_wrong,
    say_time,
    settling_motion,
)
from surefoot.experiments.instrument.recording import Recording, read_recording
from surefoot.experiments.logs.format import Log
from surefoot.experiments.logs.table import LogError
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.tables import (
    NOTHING,
    Table,
    Verdict,
    decimal,
    number,
    percent,
    sentence,
    span,
)
from surefoot.experiments.walking.agreement import compare_with_start
from surefoot.experiments.walking.claims import Claims, claims_of, fit_claims, parts_of
from surefoot.experiments.walking.judge import BROKEN, HINT, SOUND, Judgement, judge_log, length_of
from surefoot.experiments.walking.lateness import make_punctual
from surefoot.experiments.walking.notices import motion_notices, weigh_feet
from surefoot.experiments.walks.replay import foot_length_of, replay_log, starting_map
from surefoot.experiments.weights.calibrate import fit_cells, read_weighings
from surefoot.experiments.weights.judge import Weighings, judge_weighings

PARTS = 6  # parts of a log that are judged separately, to find the time at which a mistake began
ONSET = 0.2  # resolution in s of the reported onset (two blocks of a fit)


@dataclass(frozen=True, eq=False)
class Checked:
    """A log, the facts of its channels, and its flaws, with refusing ones first."""

    recording: Recording
    facts: list[ChannelFacts]
    wrong: tuple[Wrong, ...]

    @property
    def sound(self) -> bool:
        """Whether every command accepts the log and all channels work."""
        return not any(one.finding.refuses for one in self.wrong)

    @property
    def tables(self) -> tuple[Table, ...]:
        """Tables of the flaws and of the channels."""
        return (wrong_table(self), channel_table(self))


def check_log(path: Path, topics: Path | None = None) -> Checked:
    """Check a log of any kind, and return the facts of its channels and its flaws.

    Raises LogError if the file cannot be read.
    """
    with working("reading the log") as then:
        recording = read_recording(path, topics)
        then("looking at the channels")
        facts = facts_of(recording)
        then("judging the log")
        channels, judged = list(find_wrong(recording, facts)), list(_judge(recording, path))
        if any(one.finding.refuses for one in channels):
            # A flaw of the channel itself also explains its disagreement with the others.
            judged = [one for one in judged if one.finding.name != BROKEN]
        wrong = [*judged, *channels]
    return Checked(recording, facts, tuple(sorted(wrong, key=lambda one: not one.finding.refuses)))


def _judge(recording: Recording, path: Path) -> Iterator[Wrong]:
    """Yield the findings of the command that reads this kind of log."""
    read = recording.read
    if recording.refusal:
        reason = recording.refusal.removeprefix(f"{recording.file}: ")
        # A refusal about another file starts with the name of that file.
        yield Wrong(Finding("unreadable", reason if reason == recording.refusal else sentence(reason)))
    elif recording.kind == "weighings":
        yield from _judge_weighings(read_weighings(path))
    elif isinstance(read, Log):
        yield from _judge_walk(recording, read)
    elif isinstance(read, InSituLog):
        yield from _judge_sets(read)


def _judge_weighings(weighings: Weighings) -> Iterator[Wrong]:
    judged = judge_weighings(weighings)
    yield from (Wrong(one, settle=settling_motion(one.name)) for one in judged.findings)
    if not any(one.refuses for one in judged.findings):
        try:
            fit_cells(weighings, judged)
        except CalibrationRefused as refusal:
            yield Wrong(Finding("loads", refusal.reason, refusal.cure))


def _judge_walk(recording: Recording, log: Log) -> Iterator[Wrong]:
    if not any(np.ptp(raw[np.isfinite(raw)]) > 0.0 for raw in log.raw.T if np.isfinite(raw).any()):
        return  # the findings about channels report it
    length: dict[str, float] = {}
    try:
        length = foot_length_of(log, recording.file)
    except LogError as error:
        yield Wrong(Finding("unreadable", sentence(str(error).removeprefix(f"{recording.file}: "))))
    initial = starting_map(log)
    for notice in motion_notices(log):
        yield Wrong(Finding("notice", sentence(notice), refuses=False))
    if one := weigh_feet(log, "nominal", initial):
        yield Wrong(replace(one, reason=sentence(one.reason)), settle=settling_motion(one.name))
        return
    if log.about.get("feet_alone"):
        return
    verdict = judge_log(log, initial)
    row, size = _first_bad(log, initial, verdict), (len(log) - log.lag) // PARTS
    # A mistake is clearer in the rows after its onset. It may be inside a part, so try without that part too.
    rest = (replace(log.cut(slice(start, None)), truth=None) for start in (row, row + size) if row)
    late = [judge_log(part, initial) for part in rest]
    named = (one for one in (*late, verdict) if one.findings and one.findings[0].contradicts)
    clear = next(named, verdict)
    if row and clear.findings[0].contradicts:
        row = _onset(claims_of(log, initial, length_of(log)), clear.causes[0].mistake, row, size)
    since = f"about {say_time(round(log.time[row], 2))}" if row else "all along"
    for one in clear.findings:
        yield Wrong(one, since, settling_motion(one.name))
    if not any(one.refuses for one in clear.findings):
        punctual = make_punctual(log, verdict.lateness.seconds)
        estimate = replay_log(punctual, "moment", initial, **length)
        yield from map(Wrong, compare_with_start(punctual, initial, estimate, verdict.findings))


def _onset(claims: Claims, mistake: Mistake, row: int, size: int) -> int:
    """Return the onset of a mistake: undoing it in all rows after the onset gives the best fit.

    The search runs from one part before ``row`` to two parts after it. A part has ``size`` rows.
    """
    undone = mistake.undo(claims)
    if undone.initial is not claims.initial or undone.wrench_map is not claims.wrench_map:
        return row  # a mistake in the maps applies to the whole log
    rows = np.arange(max(row - size, 1), row + 2 * size, max(round(ONSET / claims.dt), 1))
    return int(rows[np.argmax([fit_claims(_mix_row(claims, undone, one)).evidence for one in rows.tolist()])])


def _mix_row(claims: Claims, undone: Claims, row: int) -> Claims:
    """Return claims with ``row`` and all later rows replaced by those of ``undone``."""
    pairs = zip(claims.reference, undone.reference, strict=True)
    reference = Reference(*(np.concatenate([np.asarray(a)[:row], np.asarray(b)[row:]]) for a, b in pairs))
    return replace(claims, raw=np.concatenate([claims.raw[:row], undone.raw[row:]]), reference=reference)


def _first_bad(log: Log, initial: Parameters, verdict: Judgement) -> int:
    """Return the first row of the first part that contradicts itself, or 0 if the whole log does."""
    if not verdict.findings:
        return 0
    claims = claims_of(log, initial, length_of(log))
    fits = [fit_claims(part) for part in parts_of(claims, PARTS)]
    bad = [fit.rows > 0 and fit.worst > SOUND for fit in fits]
    mended = [one for one in verdict.causes if one.mistake.kind == verdict.findings[0].name]
    if mended:
        # A part is evidence of the mistake only if undoing it improves the fit. Standing rarely shows this.
        undone = [fit_claims(part).evidence for part in parts_of(mended[0].mistake.undo(claims), PARTS)]
        bad = [fit.evidence < other + np.log(HINT) for fit, other in zip(fits, undone, strict=True)]
    first = bad.index(True) if True in bad else 0
    return round(first * (len(log) - log.lag) / PARTS)


def _judge_sets(log: InSituLog) -> Iterator[Wrong]:
    try:
        fit = log.fit()
    except CalibrationRefused as refusal:
        yield Wrong(Finding("sets", refusal.reason, refusal.cure))
        return
    for one in fit.refusals:
        yield Wrong(Finding("sets", one.reason, one.cure), settle=settling_motion("sets"))
    for text in fit.warnings:
        yield Wrong(Finding("notice", text, refuses=False))


def wrong_table(checked: Checked) -> Table:
    """Table of all findings about a log."""
    rows = tuple(
        (
            Verdict.of(not one.finding.refuses, "wrong" if one.finding.refuses else "note"),
            one.finding.name,
            one.since,
            one.finding.cure or NOTHING,
            one.settle or NOTHING,
            one.finding.reason,
        )
        for one in checked.wrong
    )
    columns = ("", "what", "since", "what to do", "what would settle it", "what is seen")
    title = "What is wrong" if rows else "Nothing is wrong that can be seen"
    return Table("wrong", title, columns, rows)


def channel_table(checked: Checked) -> Table:
    """Table of the facts of each channel."""
    recording = checked.recording
    unit = "counts" if recording.scale is None else "N"
    rows = []
    for i, one in enumerate(checked.facts):
        scale = 1.0 if recording.scale is None else abs(float(recording.scale[i]))
        sign = 1.0 if recording.scale is None else float(np.sign(recording.scale[i]))
        rate = 1.0 / one.noise.interval if np.isfinite(one.noise.interval) else np.nan
        rows.append(
            (
                one.name.removeprefix("raw_").removesuffix("_count"),
                percent(one.missing, ".3g"),
                span(one.low, one.high, ".10g") if np.isfinite(one.low) else NOTHING,
                number(one.step),
                percent(one.repeats, ".3g") if np.isfinite(one.repeats) else NOTHING,
                number(rate),
                number(scale * one.noise.white),
                number(scale * one.noise.walk * np.sqrt(60.0)),
                number(60.0 * scale * one.slope * sign),
            )
        )
    columns = (
        "channel", "missing", "range (counts)", "step", "repeats", "rate (Hz)",
        f"noise ({unit})", f"random walk ({unit}/√min)", f"drift ({unit}/min)",
    )  # fmt: skip
    where = "unloaded" if recording.unloaded.any() else "quietest"
    note = f"Noise and random walk by the Allan deviation where channels are {where}."
    return Table("channels", "Channels", columns, tuple(rows), note)


def words_of(checked: Checked) -> str:
    """Findings as lines of text, with a verdict at the end."""
    lines = []
    for one in checked.wrong:
        kind = "Wrong" if one.finding.refuses else "Note"
        settle = f" What would settle it: {one.settle}" if one.settle else ""
        lines.append(f"{kind} ({one.since}): {one.finding.reason} {one.finding.cure}".rstrip() + settle)
    sound = "Sound, as far as can be seen."
    if checked.recording.kind == "feet alone":
        sound = "Clock, channels and weight are sound; feet alone show no wrong signs, places or exchanges."
    elif checked.recording.kind == "channels" and not checked.recording.has_loads:
        sound = "Clock and channels are sound; nothing says what they carry."
    lines.append(sound if checked.sound else "Not sound.")
    return "\n".join(lines)


def facts_table(one: Recording) -> Table:
    """Table of a log's kind, size and rate."""
    rows = [
        ("file", one.file),
        ("kind", one.kind),
        ("samples", decimal(len(one.raw), "d")),
        ("channels", decimal(len(one.names), "d")),
    ]
    if one.has_times:
        rows.append(("time", f"{say_time(one.time[0])} to {say_time(one.time[-1])}"))
        steps = np.diff(one.time)
        step = float(np.median(steps))
        if step > 0.0:
            near = steps[np.abs(steps - step) < 0.5 * step]
            jitter = float(near.std())
            if jitter < np.spacing(np.abs(one.time).max()):
                jitter = 0.0  # below the resolution of the times
            rows.append(("rows", f"{1.0 / step:.4g} a second, jitter {1e3 * jitter:.2g} ms"))
    if isinstance(one.read, Log):
        rows.append(("mass", f"{one.read.mass:.4g} kg"))
        rows.append(("contacts", str(one.read.about.get("contacts", "as the log says"))))
    return Table("log", "The log", ("what", ""), tuple(rows))
