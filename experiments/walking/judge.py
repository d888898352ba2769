"""Judge a log before anything is learnt from it: does it fit itself, and if not, which mistake would mend it.

The log as it is competes with every mistake of :mod:`~surefoot.experiments.walking.hypotheses`, and with
troubles that a calibrator is there for: one channel that is broken, accelerations that are all noise. A
mistake is named if it beats all of these by odds of :data:`ODDS` to one, in each third of the log, and leaves
residuals as small as sound logs have.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from surefoot.calibration import Parameters
from surefoot.calibration.results import Finding
from surefoot.experiments.logs.columns import raw_names_of
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walking.claims import (
    AIR,
    COP,
    FORCE,
    WIDTHS,
    Claims,
    Fit,
    claims_of,
    condense,
    fit_claims,
    fit_parts,
    parts_of,
)
from surefoot.experiments.walking.hypotheses import (
    DELAY,
    JOINT,
    ORDERS,
    Hypothesis,
    hypotheses,
    joint_hypotheses,
    pulling_hypotheses,
)

ODDS = 1e6  # for a mistake and against all else from which it is named: one false alarm in a million logs
HINT = 1e2  # odds from which it is a notice: one that is wrong in a hundred logs
SOUND, GROSS = 2.0, 6.0
"""Scales of residuals in those of a sound log: up to the first a log fits; from the second on it contradicts
itself whatever the cause (15 mm, a tenth of the weight)."""
MENDED = 3.0
"""Up to which a mistake may leave residuals: a sound G1 that walks by a policy, with targets held for 20 ms,
has 2.2 to 2.4, as its accelerations are samples of what changes between them."""
TRIED = 200  # hypotheses, roughly
CLOSER = 8  # hypotheses of the likeliest kind, and of others, that are looked at more closely
LENGTH = 0.2  # of a foot in m where nothing says it
SHOWN = 0.999  # the surest that a sentence says
FOOT, PLATE = 0.5, 2.0  # m from the sole's origin beyond which no cell of a foot, or of a plate, is


class Explanation(NamedTuple):
    """A hypothesis, how well the log fits by it, and how likely it is among all that were tried."""

    hypothesis: Hypothesis
    fit: Fit
    probability: float


@dataclass(frozen=True)
class Judgement:
    """The verdict: findings, by falling likelihood the explanations, and the fit as the log is."""

    findings: tuple[Finding, ...]
    explanations: tuple[Explanation, ...]
    as_it_is: Fit


def judge_log(log: Log, initial: Parameters) -> Judgement:
    """Say whether counts, layout, mass, motion and contacts of a log belong together, by a starting map."""
    far = _check_layout(log)
    # Matrices are small: threads would cost more than they bring.
    with threadpool_limits(limits=1, user_api="blas"):
        claims = claims_of(log, initial, length_of(log))
        parts = condense(claims)
        plain = fit_parts(parts)
        if plain.rows == 0:
            return Judgement(tuple(far), (), plain)
        tried = list(hypotheses(log.layout))
        explanations = _explain(claims, parts, plain, tried)
        broken = _broken(claims, parts, raw_names_of(log.layout))
        found = _decide(claims, plain, explanations, broken)
        joints = list(joint_hypotheses(log))
        # A joint's sign takes its time: all references are made again.
        if joints and found and not (found[0].refuses and found[0].contradicts):
            explanations = _explain(claims, parts, plain, [*tried, *joints])
            found = _decide(claims, plain, explanations, broken)
    if far and found and found[0].contradicts:
        far = []
    return Judgement((*far, *found), tuple(explanations), plain)


def explain_pull(log: Log, initial: Parameters) -> Finding:
    """Return the likeliest mistake by which the feet pull the ground by a starting map."""
    claims = claims_of(log, initial, length_of(log))
    tried = list(pulling_hypotheses(claims, log.layout))
    sure, if_so = "", ""
    if len(tried) > 1 and not log.about.get("feet_alone"):  # which know no motion that tells them apart
        with threadpool_limits(limits=1, user_api="blas"):
            ranked = _rank(tried, [fit_parts(condense(one.undo(claims))) for one in tried])
        tried = [one.hypothesis for one in ranked]
        best, second = ranked[:2]
        if best.fit.worst <= MENDED and best.fit.evidence - second.fit.evidence > np.log(HINT):
            sure = f" (probability {_percent(best.probability)}; {_say_next(second)})"
    if len(tried) > 1 and not sure:
        sure, if_so = f" (which the log does not settle; or {tried[1].cause})", "if so, "
    cause, cure = f"The likeliest cause: {tried[0].cause}{sure}.", _sentence(if_so + tried[0].cure)
    return Finding(tried[0].kind, cause, cure)


def _check_layout(log: Log) -> list[Finding]:
    """Find cells that are too far from their foot to be in metres."""
    limit = FOOT if len(log.layout.feet) == 2 else PLATE
    for foot in log.layout.feet:
        if foot.position_cell_sole is None:
            continue
        farthest = float(np.linalg.norm(foot.position_cell_sole[:, :2], axis=1).max())
        if farthest > limit:
            return [
                Finding(
                    "layout",
                    f"A cell of the {foot.name} foot lies {farthest:.4g} m from the sole's origin, and none "
                    f"is farther than {limit:g} m.",
                    "Give position_cell_sole_m in metres, from the point below the ankle.",
                    farthest,
                    limit,
                )
            ]
    return []


def length_of(log: Log) -> float:
    """Return the length of a foot in m."""
    places = [foot.position_cell_sole for foot in log.layout.feet]
    known = [float(np.ptp(one[:, :2], axis=0).max()) for one in places if one is not None]
    return float(log.about.get("foot_length_m", max(known, default=LENGTH)))


def _explain(claims: Claims, parts: list[Claims], plain: Fit, tried: list[Hypothesis]) -> list[Explanation]:
    """Fit the log, condensed to ``parts``, by each hypothesis; return the likeliest by falling likelihood."""

    def mend(one: Hypothesis) -> list[Claims]:
        # All but what changes times or postures may as well be undone in the means of blocks.
        return (
            condense(one.undo(claims)) if one.kind in (DELAY, JOINT) else [one.undo(part) for part in parts]
        )

    # One prior is enough to see which are worth a closer look.
    rough = [fit_parts(mend(one), widths=WIDTHS[-1:]).evidence for one in tried]
    tried = [tried[i] for i in np.argsort(rough)[::-1]]
    others = [one for one in tried if one.kind != tried[0].kind]
    tried = [*[one for one in tried if one.kind == tried[0].kind][:CLOSER], *others[:CLOSER]]
    fits = [fit_parts(mend(one)) for one in tried]
    return _rank(tried, fits, plain)


def _rank(tried: list[Hypothesis], fits: list[Fit], *others: Fit) -> list[Explanation]:
    """Return explanations by falling likelihood among their fits and others."""
    evidence = np.array([fit.evidence for fit in (*fits, *others)])
    likely = np.exp(evidence - evidence.max())
    likely /= likely.sum()
    found = [Explanation(*one) for one in zip(tried, fits, likely[: len(fits)].tolist(), strict=True)]
    return sorted(found, key=lambda one: -one.fit.evidence)


def _broken(claims: Claims, parts: list[Claims], columns: list[str]) -> list[Explanation]:
    """Fit the log without one channel, and without its accelerations: troubles that calibrators cope with."""
    found = []
    for i, column in enumerate(columns):
        cure = "see whether it follows the load; the method watches for it and does without it"
        channel = Hypothesis("broken", f"column '{column}' does not go with the others", cure, lambda c: c)
        found.append(Explanation(channel, fit_parts(parts, without=i), 0.0))
    for quiet in _quiet(claims):
        noise = Hypothesis(
            "noise", "the accelerations are noise", "see that they are not delayed", lambda c: c
        )
        found.append(Explanation(noise, fit_claims(quiet), 0.0))
    return sorted(found, key=lambda one: -one.fit.evidence)


def _quiet(claims: Claims) -> Iterator[Claims]:
    """Yield the claims of a robot that moves slowly, without accelerations along some axes."""
    acceleration = claims.reference.com_acceleration
    for kept in ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)):
        reference = claims.reference._replace(com_acceleration=acceleration * kept)
        yield replace(claims, reference=reference)


def _decide(
    claims: Claims, plain: Fit, explanations: list[Explanation], broken: list[Explanation]
) -> list[Finding]:
    """Findings about a log: the mistake that mends it, a trouble of one channel, or none."""
    best, other = explanations[0], broken[0]
    limit, hint = (float(np.log(odds * TRIED)) for odds in (ODDS, HINT))
    gain, lead = (best.fit.evidence - one.evidence for one in (plain, other.fit))
    seen = _figures(plain)
    mends = gain > hint and best.fit.worst <= MENDED
    everywhere = mends and _everywhere(claims, best.hypothesis)
    # A log that fits as well as sound ones, and much better with a mistake undone, is worth a word.
    if everywhere or (mends and plain.worst <= SOUND and min(gain, lead) > limit):
        mistake, clear = best.hypothesis, everywhere and bool(min(gain, lead) > limit)
        # Exchanged channels are all misplaced: a reason that goes with one of them is that channel's own.
        if clear and mistake.kind in ORDERS:
            clear = bool(_without_one(claims, mistake) > 0.0)
        # Delays that are near each other are one cause.
        near = [one for one in explanations[1:] if one.hypothesis.kind == mistake.kind == DELAY]
        second = next(one for one in explanations[1:] if one not in near)
        rest = _say_next(second)
        sure = f"probability {_percent(sum(one.probability for one in (best, *near)))}"
        if not clear:
            sure = "which the log does not settle"
            rest = f"or {other.hypothesis.cause}" if lead < hint else rest
        reason = (
            f"Readings, layout, mass and motion contradict each other ({seen}). The likeliest cause: "
            f"{mistake.cause} ({sure}; {rest})."
        )
        cure = _sentence(mistake.cure)
        return [Finding(mistake.kind, reason, cure, gain, limit, refuses=clear, contradicts=True)]
    if other.fit.evidence - plain.evidence > 2.0 * limit and other.fit.worst <= SOUND:
        reason = f"The log does not fit itself as well as it might ({seen}): {other.hypothesis.cause}."
        cure = _sentence(other.hypothesis.cure)
        return [Finding(other.hypothesis.kind, reason, cure, plain.worst, SOUND, refuses=False)]
    if plain.worst > SOUND:
        parts = [fit for one in parts_of(claims) if (fit := fit_claims(one)).rows]
        refuses = plain.worst > GROSS and all(fit.worst > SOUND for fit in parts)
        reason = (
            f"Readings, layout, mass and motion contradict each other ({seen}), and no single mistake that "
            f"was tried mends it; closest is: {best.hypothesis.cause}."
        )
        cure = "Check which column is which, units, signs, clocks and the description, one by one."
        return [Finding("contradiction", reason, cure, plain.worst, GROSS, refuses=refuses)]
    return []


def _sentence(clause: str) -> str:
    return f"{clause[0].upper()}{clause[1:]}."


def _say_next(one: Explanation) -> str:
    return f"the next, {_percent(one.probability)}: {one.hypothesis.cause}"


def _percent(probability: float) -> str:
    if probability > SHOWN:
        return f"more than {100.0 * SHOWN:.1f} %"
    if probability < 1.0 - SHOWN:
        return f"less than {100.0 * (1.0 - SHOWN):.1f} %"
    return f"{100.0 * probability:.3g} %"


def _without_one(claims: Claims, mistake: Hypothesis) -> float:
    """Return by how much a mistake mends a log at least, whichever channel is left out."""
    plain, mended = condense(claims), condense(mistake.undo(claims))
    fits = ((fit_parts(mended, i), fit_parts(plain, i)) for i in range(claims.raw.shape[1]))
    return min(one.evidence - other.evidence for one, other in fits)


def _everywhere(claims: Claims, hypothesis: Hypothesis) -> bool:
    """Whether a hypothesis is likelier than the log as it is in each third of it that says anything."""
    mended = zip(parts_of(claims), parts_of(hypothesis.undo(claims)), strict=True)
    fits = [(fit_claims(one), fit_claims(other)) for one, other in mended]
    return all(other.evidence > one.evidence for one, other in fits if one.rows and other.rows)


def _figures(plain: Fit) -> str:
    """Say how far the log is from fitting itself."""
    force, cop, air = plain.scales
    parts = [f"by the best map {1e3 * cop * COP:.2g} mm and {100 * force * FORCE:.2g} % of the weight"]
    if air > 0.0:
        parts.append(f"{100 * air * AIR:.2g} % on a channel in the air")
    low, high = plain.map.scale.min(), plain.map.scale.max()
    return f"{', '.join(parts)}; its scales are {low:.2f} to {high:.2f} times those of the start"
