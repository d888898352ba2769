"""What may be wrong with a log from its first row to its last: each hypothesis undoes one mistake.

A hypothesis changes a log's claims to those that the log would make without the mistake. Which of them mends
a log is for :func:`~surefoot.experiments.walking.claims.fit_claims` to say.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, permutations
from typing import Any

import numpy as np

from surefoot.calibration import GRAVITY, FeetLayout, Parameters, Reference
from surefoot.experiments.arrays import Floats
from surefoot.experiments.walking.claims import Claims

DELAY = "feet late or early"
LATEST, STEP = 0.5, 0.025  # longest delay in s that is tried, and the step between two
LEAST = 0.05  # delay in s from which on one is a mistake; below it a filter finds it
POUND = 0.45359237  # in kg


@dataclass(frozen=True)
class Hypothesis:
    """One mistake.

    Attributes:
        kind: What it is of, for tables and tests.
        cause: What is wrong, as a clause.
        cure: What to do about it, as a clause.
        undo: Changes claims to those without the mistake.
    """

    kind: str
    cause: str
    cure: str
    undo: Callable[[Claims], Claims]


def hypotheses(layout: FeetLayout) -> Iterator[Hypothesis]:
    """Yield every mistake that is tried on a log with this layout."""
    yield from _wiring(layout)
    yield from _signs(layout)
    yield from _sizes(layout)
    yield from _times()
    yield from _beliefs(len(layout.feet))


def _wiring(layout: FeetLayout) -> Iterator[Hypothesis]:
    names = [name.replace("/", " ") for name in layout.channel_names]
    sizes = [foot.channels for foot in layout.feet]
    K, where = layout.channels, layout.slices
    plain = np.arange(K)
    if len(sizes) == 2:
        first, second = (foot.name for foot in layout.feet)
        if sizes[0] == sizes[1]:
            yield Hypothesis(
                "feet exchanged",
                f"the readings of the {first} and of the {second} foot are exchanged",
                "exchange their plugs or their columns",
                partial(_order, order=np.roll(plain, sizes[0])),
            )
        yield Hypothesis(
            "contacts exchanged",
            f"the contacts of the {first} and of the {second} foot are exchanged",
            f"exchange the columns reference_{first}_stance, _swing and reference_{second}_stance, _swing",
            partial(_believe, change=_exchange_contacts),
        )
        yield Hypothesis(
            "references mirrored",
            "the references are mirrored: y points to the right in them",
            "give level axes of which y points to the left (x ahead, z up)",
            partial(_believe, change=_mirror),
        )
    yield Hypothesis(
        "stance and swing exchanged",
        "stance and swing are exchanged: feet that are surely in the air bear the weight",
        "exchange the columns '..._stance' and '..._swing'",
        partial(_believe, change=lambda r: r._replace(stance=r.swing, swing=r.stance)),
    )
    for i, j in combinations(range(K), 2):
        order = plain.copy()
        order[[i, j]] = j, i
        yield Hypothesis(
            "cells exchanged",
            f"the channels '{names[i]}' and '{names[j]}' are exchanged",
            "exchange their plugs or their columns",
            partial(_order, order=order),
        )
    # More than two cells of a foot in another order: in one foot, or in both in the same way.
    for feet in [(0,), (1,), (0, 1)][: 1 if len(sizes) == 1 else 3]:
        k = sizes[feet[0]]
        if k > 4 or k < 3 or any(sizes[foot] != k for foot in feet):
            continue
        for one in permutations(range(k)):
            moved = sum(i != j for i, j in enumerate(one))
            if moved == 0 or (moved == 2 and len(feet) == 1):
                continue
            order = plain.copy()
            for foot in feet:
                order[where[foot]] = where[foot].start + np.array(one)
            of = "both feet" if len(feet) == 2 else f"the {layout.feet[feet[0]].name} foot"
            there = [layout.feet[feet[0]].channel_names[i] for i in one]
            yield Hypothesis(
                "cells in another order",
                f"the cells of {of} are in another order: the columns hold {', '.join(there)}",
                "name the columns, or order the cells of the layout, as they are plugged",
                partial(_order, order=order),
            )


def _signs(layout: FeetLayout) -> Iterator[Hypothesis]:
    K = layout.channels
    groups: list[tuple[str, Sequence[int]]] = [
        (f"the channel '{name.replace('/', ' ')}'", [i]) for i, name in enumerate(layout.channel_names)
    ]
    for foot, where in zip(layout.feet, layout.slices, strict=True):
        groups.append((f"all channels of the {foot.name} foot", range(where.start, where.stop)))
    torque = [i for i, name in enumerate(layout.channel_names) if name.endswith(("/tx", "/ty", "/tz"))]
    if torque:
        groups.append(("the torques of all sensors", torque))
    for what, channels in groups:
        factor = np.ones(K)
        factor[list(channels)] = -1.0
        yield Hypothesis(
            "sign of channels",
            f"{what} has the other sign" if len(channels) == 1 else f"{what} have the other sign",
            "turn the signs of scale_N_per_count and offset_N round",
            partial(_multiply, factor=factor),
        )


def _sizes(layout: FeetLayout) -> Iterator[Hypothesis]:
    for factor, text in (
        (2.0, "64 in place of 128"),
        (4.0, "32 in place of 128"),
        (0.5, "128 in place of 64"),
    ):
        yield Hypothesis(
            "gain",
            f"all forces are {1 / factor:g} times as large as they should be: the amplifiers' gain is {text}",
            f"multiply scale_N_per_count by {factor:g} and give the offsets that belong to it",
            partial(_multiply, factor=np.full(layout.channels, factor)),
        )
    for factor, text, cure in (
        (POUND, "mass_kg is in pounds", f"multiply it by {POUND:.4g}"),
        (1.0 / POUND, "mass_kg is too small by the factor of pounds in a kilogram, 2.205", "weigh the robot"),
    ):
        yield Hypothesis("mass", text, cure, partial(_weigh, factor=factor))
    for foot, where in zip(layout.feet, layout.slices, strict=True) if len(layout.feet) == 2 else ():
        for factor in (2.0, 0.5):
            each = np.ones(layout.channels)
            each[where] = factor
            yield Hypothesis(
                "gain of one foot",
                f"the forces of the {foot.name} foot alone are {1 / factor:g} times as large as they should be",
                f"multiply its scale_N_per_count by {factor:g} and give the offsets that belong to it",
                partial(_multiply, factor=each),
            )
    lengths = {0.001: "millimetres", 0.01: "centimetres", 0.0254: "inches"}
    for factor, unit in lengths.items():
        yield Hypothesis(
            "layout in other units",
            f"position_cell_sole_m is in {unit}",
            f"multiply it by {factor:g}",
            partial(_place, factor=factor),
        )
    yield Hypothesis(
        "layout in other units", "position_cell_sole_m is half as large as the foot",
        "measure the cells' places", partial(_place, factor=2.0),
    )  # fmt: skip
    yield Hypothesis(
        "layout in other units", "position_cell_sole_m is twice as large as the foot",
        "measure the cells' places", partial(_place, factor=0.5),
    )  # fmt: skip
    for axis, text in ((0, "x points back"), (1, "y points to the right")):
        sign = np.ones(2)
        sign[axis] = -1.0
        yield Hypothesis(
            "layout mirrored",
            f"the layout is mirrored: {text} in position_cell_sole_m",
            "give places in the sole frame (x ahead, y to the left)",
            partial(_reflect, axis=axis),
        )


def _times() -> Iterator[Hypothesis]:
    steps = np.arange(LEAST, LATEST + STEP / 2, STEP)
    for delay in (*-steps[::-1], *steps):
        side = "late" if delay > 0.0 else "early"
        yield Hypothesis(
            DELAY,
            f"the readings of the feet are about {abs(delay):.3g} s {side} against the references",
            "give both on one clock, and lag_samples or motion.delay_s",
            partial(_shift, delay=float(delay)),
        )


def _beliefs(feet: int) -> Iterator[Hypothesis]:
    def of(kind: str, cause: str, cure: str, change: Callable[[Reference], Reference]) -> Hypothesis:
        return Hypothesis(kind, cause, cure, partial(_believe, change=change))

    up = np.array([0.0, 0.0, GRAVITY])
    columns = "reference_com_acceleration"
    acceleration: dict[tuple[str, str, str], Callable[[Floats], Floats]] = {
        ("acceleration negated", f"columns '{columns}_...' have the other sign", "turn it round"): lambda a: -a,
        ("acceleration with gravity", f"columns '{columns}_...' have gravity in them",
         f"subtract {GRAVITY} m/s^2 from z"): lambda a: a - up,
        ("acceleration with gravity", f"gravity was subtracted twice from columns '{columns}_...'",
         f"add {GRAVITY} m/s^2 to z"): lambda a: a + up,
        ("acceleration in g", f"columns '{columns}_...' are in g",
         f"multiply them by {GRAVITY}"): lambda a: GRAVITY * a,
        ("acceleration in g", f"columns '{columns}_...' are in g and have gravity in them",
         f"subtract 1 from z and multiply by {GRAVITY}"): lambda a: GRAVITY * a - up,
        ("acceleration in other units", f"columns '{columns}_...' are in cm/s^2",
         "divide them by 100"): lambda a: 0.01 * a,
        ("acceleration in other units", f"columns '{columns}_...' are in mm/s^2",
         "divide them by 1000"): lambda a: 0.001 * a,
    }  # fmt: skip
    for (kind, cause, cure), change in acceleration.items():
        yield of(kind, cause, cure, partial(_change, fields=("com_acceleration",), change=change))
    # An IMU that is turned turns the specific force, gravity with it.
    for signs in ((-1, -1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, -1), (1, 1, -1), (-1, 1, 1), (1, -1, 1)):
        axes = ", ".join(axis for axis, sign in zip("xyz", signs, strict=True) if sign < 0)
        turned = {(-1, -1, 1): "z", (1, -1, -1): "x", (-1, 1, -1): "y"}.get(signs)
        cause = (
            f"the IMU is turned by 180 degrees about {turned}"
            if turned
            else f"the accelerometer's {axes} {'has' if len(axes) == 1 else 'have'} the other sign"
        )
        s = np.array(signs, dtype=float)
        yield of(
            "IMU turned" if turned else "accelerometer negated",
            cause,
            "give the IMU's axes as it is mounted",
            partial(_change, fields=("com_acceleration",), change=lambda a, s=s: s * (a + up) - up),
        )
    for name, R in (
        ("by 90 degrees", np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])),
        ("by -90 degrees", np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])),
        ("by 180 degrees", np.diag([-1.0, -1, 1])),
    ):
        yield of(
            "IMU turned", f"the IMU is turned {name} about z", "give the IMU's axes as it is mounted",
            partial(_change, fields=("com_acceleration",), change=lambda a, R=R: a @ R.T),
        ) if "90" in name else of(
            "references turned",
            f"centre of mass and acceleration are turned {name} against the soles",
            "give all references in one level frame",
            partial(_turn, R=R),
        )  # fmt: skip
        if "90" in name:
            yield of(
                "references turned",
                f"centre of mass and acceleration are turned {name} against the soles",
                "give all references in one level frame",
                partial(_turn, R=R),
            )
    for fields, what in (
        (("com", "com_acceleration"), "centre of mass and acceleration"),
        (("com",), "the centre of mass"),
        (("com_acceleration",), "the centre of mass's acceleration"),
    ):
        yield of(
            "axes exchanged",
            f"x and y of {what} are exchanged",
            "exchange the columns",
            partial(_change, fields=fields, change=lambda a: a[:, [1, 0, 2]]),
        )
    for axis, sign in (("x", (-1, 1, 1)), ("y", (1, -1, 1))):
        s = np.array(sign, dtype=float)
        yield of(
            "centre of mass mirrored",
            f"{axis} of the centre of mass has the other sign",
            "turn it round",
            partial(_change, fields=("com",), change=lambda a, s=s: s * a),
        )
    for factor, unit in ((0.001, "millimetres"), (0.01, "centimetres")):
        yield of(
            "centre of mass in other units",
            f"columns 'reference_com_...' are in {unit}",
            f"multiply them by {factor:g}",
            partial(_change, fields=("com",), change=lambda a, f=factor: f * a),
        )
    yield Hypothesis(
        "centre of mass off",
        "the centre of mass is not where the references say",
        "see in which frame it is, and from which origin",
        lambda claims: replace(claims, com_std=0.1),
    )


def _order(claims: Claims, order: Any) -> Claims:
    return replace(claims, raw=claims.raw[:, order])


def _multiply(claims: Claims, factor: Floats) -> Claims:
    initial = Parameters(*(factor * part for part in claims.initial))
    return replace(claims, initial=initial, air=claims.air * np.abs(factor))


def _weigh(claims: Claims, factor: float) -> Claims:
    return replace(claims, weight=factor * claims.weight)


def _place(claims: Claims, factor: float) -> Claims:
    scaled = claims.wrench_map.copy()
    scaled[:, 3:] *= factor
    return replace(claims, wrench_map=scaled)


def _reflect(claims: Claims, axis: int) -> Claims:
    """Reflect places along x (0) or y (1): it turns the sign of the moment about the other axis."""
    reflected = claims.wrench_map.copy()
    reflected[:, 4 - axis] *= -1.0
    return replace(claims, wrench_map=reflected)


def _shift(claims: Claims, delay: float) -> Claims:
    k = round(delay / claims.dt)
    raw = np.full_like(claims.raw, np.nan)
    if k > 0:
        raw[:-k] = claims.raw[k:]
    elif k < 0:
        raw[-k:] = claims.raw[:k]
    return replace(claims, raw=raw)


def _believe(claims: Claims, change: Callable[[Reference], Reference]) -> Claims:
    return replace(claims, reference=change(claims.reference))


def _change(reference: Reference, fields: tuple[str, ...], change: Callable[[Floats], Floats]) -> Reference:
    """Change vectors that are counted from below the middle of the soles."""
    middle = np.zeros_like(reference.com)
    middle[:, :2] = reference.position_sole[:, :, :2].mean(axis=1)
    found = {}
    for field in fields:
        value = getattr(reference, field)
        found[field] = middle + change(value - middle) if field == "com" else change(value)
    return reference._replace(**found)


def _turn(reference: Reference, R: Floats) -> Reference:
    turned = _change(reference, ("com", "com_acceleration"), lambda a: a @ R.T)
    return turned._replace(angular_momentum_rate=reference.angular_momentum_rate @ R.T)


def _exchange_contacts(reference: Reference) -> Reference:
    return reference._replace(stance=reference.stance[:, ::-1], swing=reference.swing[:, ::-1])


def _mirror(reference: Reference) -> Reference:
    S = np.diag([1.0, -1.0, 1.0])
    spin = reference.angular_momentum_rate * (-1.0, 1.0, -1.0)
    return reference._replace(
        com=reference.com @ S,
        com_acceleration=reference.com_acceleration @ S,
        angular_momentum_rate=spin,
        position_sole=reference.position_sole @ S,
        R_level_sole=S @ reference.R_level_sole @ S,
    )
