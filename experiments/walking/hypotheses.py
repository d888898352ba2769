"""Mistakes that last from a log's first row to its last: each hypothesis undoes one mistake.

A hypothesis changes a log's claims to those that the log would make without the mistake. Which of them mends
a log is for :func:`~surefoot.experiments.walking.claims.fit_claims` to say.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations, permutations
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import GRAVITY, FeetLayout, Parameters, Reference
from surefoot.calibration.diagnosis import Mistake
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walking.claims import Claims

JOINT = "joint sign"
ORDERS = ("feet exchanged", "cells exchanged", "cells in another order")
"""Kinds by which readings come from other channels."""

POUND = 0.45359237  # in kg
_TURN = "turn the signs of scale_N_per_count and offset_N round"
ANYWHERE = 0.1  # std in m of a centre of mass of which nothing is known but the robot


def hypotheses(layout: FeetLayout) -> Iterator[Mistake]:
    """Yield every mistake that is tried on a log with this layout."""
    for of_layout in (_wiring, _orders, _signs, _sizes):
        yield from of_layout(layout)
    for of_motion in (_accelerations, _places):
        yield from of_motion()


def pulling_hypotheses(claims: Claims, layout: FeetLayout) -> Iterator[Mistake]:
    """Yield every mistake by which feet seem to pull the ground.

    Offsets that were read in the air are those of loaded cells if the foot was another one, or stood: they
    are read again once the mistake is undone. So they are where the offsets alone are wrong.
    """
    cause = "all channels have the other sign"
    turned = partial(_multiply, factor=-np.ones(layout.channels))
    signs = Mistake("sign of channels", cause, f"{_TURN}: standing is positive", turned)
    if not claims.reference.swing.any():
        yield signs
        return
    own = "offset_N are not those of these channels"
    cure = "leave out offset_N, which is then read while a foot swings"
    for one in (signs, Mistake("offset", own, cure, lambda claims: claims), *_wiring(layout)):
        yield one._replace(undo=partial(_read_offsets, undo=one.undo))


def _read_offsets(claims: Claims, undo: Callable[[Claims], Claims]) -> Claims:
    """Undo a mistake, and let channels read nothing on average while their foot is in the air."""
    undone = undo(claims)
    scale, offset = undone.initial.scale, np.array(undone.initial.offset)
    air = undone.reference.swing[:, (undone.wrench_map != 0.0).any(axis=1).argmax(axis=0)]
    air = air & np.isfinite(undone.raw)
    for i in np.flatnonzero(air.any(axis=0)):
        offset[i] = -scale[i] * np.median(undone.raw[air[:, i], i])
    return replace(undone, initial=Parameters(scale, offset))


def joint_hypotheses(log: Log) -> Iterator[Mistake]:
    """Yield a wrong sign of each joint of a log whose references were made of joints."""
    for name, make in log.turned.items():
        yield Mistake(
            JOINT,
            f"the joint '{name}' has the other sign",
            f"turn the sign of column 'joint_{name}_rad' round",
            partial(_remake, make=cache(make)),
        )


def _remake(claims: Claims, make: Callable[[], Reference]) -> Claims:
    late = len(make().com) - len(claims.raw)  # made references are not late
    return replace(claims, reference=take_rows(make(), slice(late, None)))


def _wiring(layout: FeetLayout) -> Iterator[Mistake]:
    sizes = [foot.channels for foot in layout.feet]
    if len(sizes) == 2:
        first, second = (foot.name for foot in layout.feet)
        if sizes[0] == sizes[1]:
            yield Mistake(
                "feet exchanged",
                f"the readings of the {first} and of the {second} foot are exchanged",
                "exchange their plugs or their columns",
                partial(_order, order=np.roll(np.arange(layout.channels), sizes[0])),
            )
        yield Mistake(
            "contacts exchanged",
            f"the contacts of the {first} and of the {second} foot are exchanged",
            f"exchange the columns reference_{first}_stance, _swing and reference_{second}_stance, _swing",
            partial(_believe, change=_exchange_contacts),
        )
        yield Mistake(
            "references mirrored",
            "the references are mirrored: y points to the right in them",
            "give level axes of which y points to the left (x ahead, z up)",
            partial(_believe, change=_mirror),
        )
    yield Mistake(
        "stance and swing exchanged",
        "stance and swing are exchanged: feet that are surely in the air bear the weight",
        "exchange the columns '..._stance' and '..._swing'",
        partial(_believe, change=lambda r: r._replace(stance=r.swing, swing=r.stance)),
    )


def _orders(layout: FeetLayout) -> Iterator[Mistake]:
    """Yield other orders of channels: two exchanged, or the cells of a foot in any order."""
    names = [name.replace("/", " ") for name in layout.channel_names]
    sizes = [foot.channels for foot in layout.feet]
    plain, where = np.arange(layout.channels), layout.slices
    for i, j in combinations(plain, 2):
        order = plain.copy()
        order[[i, j]] = j, i
        yield Mistake(
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
            yield Mistake(
                "cells in another order",
                f"the cells of {of} are in another order: the columns hold {', '.join(there)}",
                "name the columns, or order the cells of the layout, as they are plugged",
                partial(_order, order=order),
            )


def _signs(layout: FeetLayout) -> Iterator[Mistake]:
    names = layout.channel_names
    groups: dict[str, Sequence[int]] = {
        f"the channel '{name.replace('/', ' ')}' has": [i] for i, name in enumerate(names)
    }
    for foot, where in zip(layout.feet, layout.slices, strict=True):
        groups[f"all channels of the {foot.name} foot have"] = range(where.start, where.stop)
    if torques := [i for i, name in enumerate(names) if name.endswith(("/tx", "/ty", "/tz"))]:
        groups["the torques of all sensors have"] = torques
    for whose, channels in groups.items():
        factor = np.ones(layout.channels)
        factor[list(channels)] = -1.0
        cause = f"{whose} the other sign"
        yield Mistake("sign of channels", cause, _TURN, partial(_multiply, factor=factor))


def _sizes(layout: FeetLayout) -> Iterator[Mistake]:
    large = "times as large as they should be"
    for factor, text in (
        (2.0, "64 in place of 128"),
        (4.0, "32 in place of 128"),
        (0.5, "128 in place of 64"),
    ):
        cause = f"all forces are {1 / factor:g} {large}: the amplifiers' gain is {text}"
        cure = f"multiply scale_N_per_count by {factor:g} and give the offsets that belong to it"
        yield Mistake("gain", cause, cure, partial(_multiply, factor=np.full(layout.channels, factor)))
    for factor, cause, cure in (
        (POUND, "mass_kg is in pounds", f"multiply it by {POUND:.4g}"),
        (1.0 / POUND, "mass_kg is too small by the factor of pounds in a kilogram, 2.205", "weigh the robot"),
    ):
        yield Mistake("mass", cause, cure, partial(_weigh, factor=factor))
    for foot, where in zip(layout.feet, layout.slices, strict=True) if len(layout.feet) == 2 else ():
        for factor in (2.0, 0.5):
            each = np.ones(layout.channels)
            each[where] = factor
            cause = f"the forces of the {foot.name} foot are {1 / factor:g} {large}"
            cure = f"multiply its scale_N_per_count by {factor:g} and give the offsets that belong to it"
            yield Mistake("gain of one foot", cause, cure, partial(_multiply, factor=each))
    measure = "measure the cells' places"
    for factor, text, cure in (
        (0.001, "in millimetres", "multiply it by 0.001"),
        (0.01, "in centimetres", "multiply it by 0.01"),
        (0.0254, "in inches", "multiply it by 0.0254"),
        (2.0, "half as large as the foot", measure),
        (0.5, "twice as large as the foot", measure),
    ):
        cause = f"position_cell_sole_m is {text}"
        yield Mistake("layout in other units", cause, cure, partial(_place, factor=factor))
    for axis, text in ((0, "x points back"), (1, "y points to the right")):
        cause = f"the layout is mirrored: {text} in position_cell_sole_m"
        cure = "give places in the sole frame (x ahead, y to the left)"
        yield Mistake("layout mirrored", cause, cure, partial(_reflect, axis=axis))


def _accelerations() -> Iterator[Mistake]:
    """Yield wrong accelerations, each as a linear map of vectors: gravity g is added before or after."""
    one, no, g = np.eye(3), np.zeros(3), np.array([0.0, 0.0, GRAVITY])
    named = "columns 'reference_com_acceleration_...'"
    accelerations = (
        # kind, cause, cure, and a' = A (a + before) - after
        ("acceleration negated", f"{named} have the other sign", "turn it round", -one, no, no),
        ("acceleration with gravity", f"{named} have gravity in them", f"subtract {GRAVITY} from z",
         one, no, g),
        ("acceleration with gravity", f"gravity was subtracted twice from {named}", f"add {GRAVITY} to z",
         one, g, no),
        ("acceleration in g", f"{named} are in g", f"multiply them by {GRAVITY}", GRAVITY * one, no, no),
        ("acceleration in g", f"{named} are in g and have gravity in them",
         f"subtract 1 from z and multiply by {GRAVITY}", GRAVITY * one, no, g),
        ("acceleration in other units", f"{named} are in cm/s^2", "divide them by 100", one / 100, no, no),
        ("acceleration in other units", f"{named} are in mm/s^2", "divide them by 1000", one / 1000,
         no, no),
    )  # fmt: skip
    mounted = "give the IMU's axes as it is mounted"
    # An IMU that is turned turns the specific force, and gravity with it.
    turns = [("IMU turned", f"the IMU is turned by 180 degrees about {axis}", mounted, np.diag(signs), g, g)
             for axis, signs in (("x", (1, -1, -1)), ("y", (-1, 1, -1)), ("z", (-1, -1, 1)))]  # fmt: skip
    turns += [("IMU turned", f"the IMU is turned by {90 * side} degrees about z", mounted, R, g, g)
              for side, R in ((1, _QUARTER), (-1, _QUARTER.T))]  # fmt: skip
    turns += [("accelerometer negated", f"the accelerometer's {axes} of the other sign", mounted,
               np.diag(signs), g, g)
              for axes, signs in (("x is", (-1, 1, 1)), ("y is", (1, -1, 1)), ("z is", (1, 1, -1)),
                                  ("x, y and z are", (-1, -1, -1)))]  # fmt: skip
    for kind, cause, cure, A, before, after in (*accelerations, *turns):
        change = partial(_accelerate, A=np.asarray(A, dtype=float), before=before, after=after)
        yield Mistake(kind, cause, cure, partial(_believe, change=change))


def _places() -> Iterator[Mistake]:
    """Yield mistakes of the centre of mass, alone or together with its acceleration."""
    com = "the centre of mass"
    for angle, R in ((90, _QUARTER), (-90, _QUARTER.T), (180, np.diag([-1.0, -1.0, 1.0]))):
        cause = f"centre of mass and acceleration are turned by {angle} degrees against the soles"
        cure, turn = "give all references in one level frame", partial(_turn, R=R)
        yield Mistake("references turned", cause, cure, partial(_believe, change=turn))
    exchanged, no = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]), np.zeros(3)
    columns, axes, sign = "exchange the columns of x and y", "axes exchanged", f"{com} has the other sign"
    mirrored, units = "centre of mass mirrored", "centre of mass in other units"
    named = "columns 'reference_com_...' are in"
    places: tuple[tuple[str, str, str, Callable[[Reference], Reference]], ...] = (
        (axes, "x and y of centre of mass and acceleration are exchanged", columns,
         partial(_turn, R=exchanged, spin=False)),
        (axes, "x and y of the acceleration are exchanged", columns,
         partial(_accelerate, A=exchanged, before=no, after=no)),
        (axes, f"x and y of {com} are exchanged", columns, partial(_place_com, A=exchanged)),
        (mirrored, f"x of {sign}", "turn it round", partial(_place_com, A=np.diag([-1.0, 1, 1]))),
        (mirrored, f"y of {sign}", "turn it round", partial(_place_com, A=np.diag([1.0, -1, 1]))),
        (units, f"{named} millimetres", "divide them by 1000", partial(_place_com, A=np.eye(3) / 1000)),
        (units, f"{named} centimetres", "divide them by 100", partial(_place_com, A=np.eye(3) / 100)),
    )  # fmt: skip
    for kind, cause, cure, change in places:
        yield Mistake(kind, cause, cure, partial(_believe, change=change))
    cause = "the IMU is tilted against its drawing, so that both soles seem to lean"
    cure = "give the IMU's axes as it is mounted; if the ground slopes, walk on level ground"
    yield Mistake("IMU tilted", cause, cure, partial(_believe, change=_level))
    cause = "the centre of mass, or the cells' places, are given from another origin than the soles"
    cure = "check position_cell_sole_m (from the point below the ankle), and the frame of the centre of mass"
    yield Mistake("centre of mass off", cause, cure, partial(replace, com_std=ANYWHERE))


_QUARTER = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


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


def _believe(claims: Claims, change: Callable[[Reference], Reference]) -> Claims:
    return replace(claims, reference=change(claims.reference))


def _accelerate(reference: Reference, A: Floats, before: Floats, after: Floats) -> Reference:
    acceleration = (reference.com_acceleration + before) @ A.T - after
    return reference._replace(com_acceleration=acceleration)


def _place_com(reference: Reference, A: Floats) -> Reference:
    """Change the centre of mass, counted from the ground below the middle of the soles."""
    middle = np.zeros_like(reference.com)
    middle[:, :2] = reference.position_sole[:, :, :2].mean(axis=1)
    return reference._replace(com=middle + (reference.com - middle) @ A.T)


def _turn(reference: Reference, R: Floats, spin: bool = True) -> Reference:
    turned = _place_com(reference, R)._replace(com_acceleration=reference.com_acceleration @ R.T)
    return turned._replace(angular_momentum_rate=reference.angular_momentum_rate @ R.T) if spin else turned


def _level(reference: Reference) -> Reference:
    """Turn all beliefs so that standing soles are level on average."""
    normals = reference.R_level_sole[..., 2][reference.stance]
    known = normals[np.isfinite(normals).all(axis=-1)]
    if len(known) == 0:
        return reference
    x, y, z = known.mean(axis=0)
    R = Rotation.from_rotvec(
        np.arctan2(np.hypot(x, y), z) / max(np.hypot(x, y), 1e-9) * np.array([y, -x, 0.0])
    )
    turned = _turn(reference, R.as_matrix())
    middle = reference.position_sole.mean(axis=1, keepdims=True)
    return turned._replace(
        position_sole=middle + (reference.position_sole - middle) @ R.as_matrix().T,
        R_level_sole=R.as_matrix() @ reference.R_level_sole,
    )


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
