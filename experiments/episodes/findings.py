"""The findings of an evaluation in words and against its claims: only the grammar is written beforehand."""

from collections.abc import Iterator

from surefoot.experiments.episodes.comparisons import CALIBRATED, trainings
from surefoot.experiments.episodes.scores import (
    Run,
    controllers_of,
    difference,
    severities_of,
    share_recovered,
)
from surefoot.experiments.episodes.tables import percent_interval
from surefoot.experiments.policy.controllers import BUILT_IN, labels
from surefoot.experiments.study.page import Words
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import Claim, Frame, Table, at_least, claim_table, interval_text


def target_table(frame: Frame) -> Table | None:
    """Table of the claims about a policy and about randomisation; ``None`` without policies.

    Untrained controllers have no target: of policies, the first that was trained on true feet has some.
    """
    trained = dict(zip(frame["controller"], frame["trained"], strict=True)) if "trained" in frame else {}
    learnt = [name for name in controllers_of(frame) if name not in BUILT_IN]
    if not learnt:
        return None
    controller = next((name for name in learnt if trained.get(name) == "true"), learnt[0])
    own = frame[frame["controller"] == controller]
    claims = [*_claims(own), *_claims_of_randomisation(frame)]
    used = difference(own, Run("true"), Run("true", "shuffled"))
    if used is not None:
        claims.append(_clearly("true CoP given less shuffled", used))
    title = f"Set out to reach, by {labels(controllers_of(frame))[controller]}"
    return claim_table(claims, title, Words("episodes")("targets"))


def _claims_of_randomisation(frame: Frame) -> Iterator[Claim]:
    """Claim that randomisation and calibration together are not clearly worse than either alone."""
    pair = trainings(frame)
    if pair is None:
        return
    clean, wild = pair
    for severity in severities_of(frame):
        both = Run(CALIBRATED, "given", wild)
        alone = {"calibration": Run(CALIBRATED, "given", clean), "randomisation": Run("none", "given", wild)}
        gaps = {name: difference(frame, both, other, severity) for name, other in alone.items()}
        found = {name: gap for name, gap in gaps.items() if gap is not None and gap.n > 1}
        if found:
            # The difference that ends lowest decides.
            name = min(found, key=lambda one: found[one].mean + found[one].half)
            what = f"severity {severity:g}: randomised and calibrated, less either alone"
            measured = f"{interval_text(found[name])} (less {name})"
            worse = found[name].apart and found[name].mean < 0.0
            yield Claim(what, "not clearly below 0", measured, not worse)


def _claims(own: Frame) -> Iterator[Claim]:
    """Return the claims about the feet of one policy."""
    given = own[own["cop_input"] == "given"]
    true = given[given["feed"] == "true"]
    if len(true):
        share = 100.0 * float(1.0 - true["fell"].mean())
        yield at_least("survives on true CoP (%)", share, 95.0, f"{share:.3g}")
    for severity in severities_of(own):
        at = f"severity {severity:g}: "
        drifting = mean_interval(given[(given["feed"] == "none") & (given["severity"] == severity)]["return"])
        on_true = mean_interval(true["return"])
        if drifting.n and on_true.n:
            what = f"{at}return on drifting CoP below that on true CoP"
            measured = f"{interval_text(drifting, digits=4)} and {interval_text(on_true, digits=4)}"
            apart = drifting.mean + drifting.half < on_true.mean - on_true.half
            yield Claim(what, "intervals apart", measured, apart)
        won = share_recovered(own, CALIBRATED, severity)
        if won is not None:
            measured = percent_interval(won, "{:.1f} ({:.1f} to {:.1f})")
            yield at_least(f"{at}of the loss won back by moment (%)", 100.0 * won[0], 90.0, measured)
        for other in ("window", "quasi-static"):
            gap = difference(own, Run(CALIBRATED), Run(other), severity)
            if gap is not None:
                yield _clearly(f"{at}moment less {other}", gap)


def _clearly(what: str, gap: Interval) -> Claim:
    return Claim(what, "> 0, clearly", interval_text(gap), gap.apart and gap.mean > 0.0)


def controller_findings(frame: Frame, controller: str) -> Iterator[str]:
    """Return a controller's loss on drifting feet and its gain on calibrated ones, in words."""
    name = labels(controllers_of(frame))[controller]
    own = frame[(frame["controller"] == controller) & (frame["cop_input"] == "given")]
    true = own[own["feed"] == "true"]
    if len(true):
        mean = interval_text(mean_interval(true["return"]), digits=4)
        yield f"{name}, true CoP: return {mean}, {int(true['fell'].sum())} of {len(true)} fall."
    for severity in severities_of(own):
        loss = difference(own, Run("true"), Run("none"), severity)
        if loss is None:
            continue
        text = f"{name}, severity {severity:g}: drifting feet cost {interval_text(loss)}"
        if not (loss.apart and loss.mean > 0.0):
            yield f"{text}, which is no clear loss, so that there is nothing to win back."
            continue
        falls = own[(own["feed"] == "none") & (own["severity"] == severity)]["fell"]
        text += f" and {int(falls.sum())} of {len(falls)} fall"
        shares = {feed: share_recovered(own, feed, severity) for feed in dict.fromkeys(own["feed"])}
        won = [
            percent_interval(share, f"{feed} wins {{:.1f}} % of it back ({{:.0f}} to {{:.0f}})")
            for feed, share in shares.items()
            if share is not None
        ]
        yield "; ".join([text, *won]) + "."
