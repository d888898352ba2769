"""What the simulated in-situ experiment says, in sentences that are made of its figures."""

import numpy as np

from surefoot.experiments.in_situ.study import InSituStudyResults
from surefoot.experiments.in_situ.study_pieces import MOTIONS
from surefoot.experiments.in_situ.targets import consistency, over_bound, targets_of
from surefoot.experiments.study.tables import number

__all__ = [
    "bound_findings",
    "limb_findings",
    "motion_findings",
    "refusal_findings",
    "summary_findings",
]


def summary_findings(results: InSituStudyResults) -> tuple[str, ...]:
    """Say which targets all seeds reached, and how many reached the others."""
    targets = targets_of(results)
    met = [target for target in targets if target.met]
    said = [f"{len(met)} of {len(targets)} targets were reached by every seed, sensor and set."]
    said += [
        f"Not by all: {target.name}. {100.0 * target.share:.1f} % stay within {target.most:g}; the worst is "
        f"{_worst(target.values)}"
        + (f", and {target.refused} have none: refused." if target.refused else ".")
        for target in targets
        if not target.met
    ]
    clipped = results.fits[results.fits["clipped"]].drop_duplicates(["sensor", "seed"])
    if len(clipped):
        ours = results.fits[results.fits["clipped"] & (results.fits["method"] == "surefoot")]
        sensors = len(results.fits) // results.fits["method"].nunique()
        said.append(
            f"{len(clipped)} of {sensors} sensors reached the end of their converter; "
            f"{int((ours['said'] != '').sum())} of these were refused, as they must be."
        )
    return tuple(said)


def limb_findings(results: InSituStudyResults) -> tuple[str, ...]:
    """Say how heavy the limb comes out by each method, and what the loop model is worth."""
    said = []
    for sensor, part in results.fits.groupby("sensor", sort=False):
        errors = part.pivot(index="seed", columns="method", values="limb_error")
        mean, rms = 100.0 * errors.mean(), 100.0 * np.sqrt((errors**2).mean())
        said.append(
            f"{str(sensor).capitalize()}: III-C finds the limb {_signed(mean['paper'])} % off its weight in "
            f"the mean, the measurement-space fit {_signed(mean['surefoot'])} %, and without its hysteresis "
            f"{_signed(mean['no-loop'])} %; the root mean squares are {number(rms['paper'])}, "
            f"{number(rms['surefoot'])} and {number(rms['no-loop'])} %."
        )
    return tuple(said)


def bound_findings(results: InSituStudyResults) -> tuple[str, ...]:
    """Say how near to the bound the offsets are, and whether the covariance is right."""
    said = []
    for (kind, sensor), part in results.white.groupby(["kind", "sensor"], sort=False):
        known = consistency(part)
        where = "inside" if known.inside else "outside"
        if kind == "real":
            said.append(
                f"{str(sensor).capitalize()} with all errors of a sensor: errors are "
                f"{number(np.sqrt(known.mean))} times as large as claimed."
            )
            continue
        drift = "told of no drift" if kind == "still" else "left to find out about drift"
        said.append(
            f"{str(sensor).capitalize()}, {drift}: offsets err by {number(over_bound(part, 'force'))} "
            f"(forces) and {number(over_bound(part, 'torque'))} (torques) times the bound; NEES "
            f"{known.mean:.3f} lies {where} {known.low:.3f} to {known.high:.3f}."
        )
    return tuple(said)


def motion_findings(results: InSituStudyResults) -> tuple[str, ...]:
    """Hold the shortest fast motion that was answered against the longest slow one."""
    said = []
    for sensor, part in results.motions.groupby("sensor", sort=False):
        answered = part[part["said"] == ""]
        fast = [bool(MOTIONS[int(i)].fast) for i in answered["motion"]]
        slow_rows, fast_rows = answered[np.logical_not(fast)], answered[fast]
        name = str(sensor).capitalize()
        if slow_rows.empty or fast_rows.empty:
            which = "no slow" if slow_rows.empty else "no fast"
            said.append(f"{name}: {which} motion was answered with a calibration.")
            continue
        slow = slow_rows[slow_rows["minutes"] == slow_rows["minutes"].max()]
        quick = fast_rows[fast_rows["minutes"] == fast_rows["minutes"].min()]
        said.append(
            f"{name}: {number(slow['minutes'].iloc[0], 2)} minutes of slow sweeps leave "
            f"{_percent(slow['force_error'])} % of the forces, {_percent(slow['torque_error'])} % of the "
            f"torques and {_percent(slow['limb_error'].abs())} % of the limb's weight in the mean; "
            f"{number(quick['minutes'].iloc[0], 2)} minutes of fast swings {_percent(quick['force_error'])}, "
            f"{_percent(quick['torque_error'])} and {_percent(quick['limb_error'].abs())} %."
        )
    return tuple(said)


def refusal_findings(results: InSituStudyResults) -> tuple[str, ...]:
    """Say which spoilt experiments were answered all the same, and how wrong the answers are."""
    spoilt = results.refusals[~results.refusals["harmless"]]
    controls = results.refusals[results.refusals["harmless"]]
    cases = list(dict.fromkeys(spoilt["case"]))
    caught = [case for case in cases if spoilt[spoilt["case"] == case]["refused"].all()]
    said = [
        f"{len(caught)} of {len(cases)} kinds of spoilt experiments are refused with every sensor; of "
        f"{len(controls)} sound ones {int(controls['refused'].sum())} are."
    ]
    usual = controls[~controls["refused"]]
    for case in cases:
        if case in caught:
            continue
        part = spoilt[spoilt["case"] == case]
        answered = part[~part["refused"]]
        said.append(
            f"Answered {len(answered)} of {len(part)} times: {case}. Forces are then "
            f"{_percent(answered['force_error'])} % off and torques {_percent(answered['torque_error'])} %, "
            f"where sound experiments leave {_percent(usual['force_error'])} and "
            f"{_percent(usual['torque_error'])} %."
        )
    return tuple(said)


def _percent(values: object) -> str:
    return number(100.0 * float(np.mean(np.asarray(values, dtype=np.float64))))


def _signed(value: float) -> str:
    return ("+" if value > 0.0 else "") + number(value)


def _worst(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return number(float(np.max(values)), 4) if len(values) else "–"
