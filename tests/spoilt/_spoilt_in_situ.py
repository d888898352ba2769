"""Spoilt in-situ logs: is each answered rightly, warned about or refused, and is the true cause named first?

    python tests/spoilt/_spoilt_in_situ.py
    python tests/spoilt/_spoilt_in_situ.py --only push --verbose

Each log is of the rig's leg (four masses, a minute each, all errors of the sensor and of its IMU) with one
thing wrong, with and without a gyroscope, with and without the factory matrix. An answer is wrong if its
wrenches, over sets that it has not seen, are off by more than three of its own standard deviations and by
more than 3 % of the load. Sound logs of other seeds must be answered. Kinds that nothing in
a log can show, as both sides of the model change alike, are counted by themselves.
"""

import argparse
import re
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from _in_situ_changes import (
    OFF,
    POUND,
    RATE,
    SEED,
    SIGMAS,
    SOUND_SEEDS,
    Log,
    Spoilt,
    clip,
    column,
    cut,
    each,
    entry,
    factory,
    hold,
    late,
    late_readings,
    low_pass,
    mix_channels,
    move,
    noisy,
    pull,
    read,
    readings,
    record,
    relabel,
    rotate_wrench,
    rows,
    scale_masses,
    spikes,
    spin,
    swap,
    touch_floor,
    turn,
    vectors,
    weigh,
)

from surefoot.calibration.in_situ import InSituFit, calibrate_in_situ
from surefoot.calibration.in_situ.fit import ErrorColumns, error_covariance
from surefoot.calibration.results import CalibrationRefused

PUSH = [-5.0, 3.0, -5.5, 1.0, 0.4, 0.2]  # 8 N and 1.1 N m
TOUCH = r"touch|push"
CLIP = r"clip|saturat|\bends at"
MASS_UNIT = r"in (g|grams|lb|pounds)\b|mass\w* .*(unit|grams|pounds)"
PLACE_UNIT = r"\bmm\b|\bcm\b|places .*unit"
GRAVITY_UNIT = r"m/s\^2|gravity is"
SCALE = r"calibrate the accelerometer|scale is off|gravity is"
WHOLE = r"transpos|inver[ts]|rows of the factory|units of (its|the factory)|order of"
PLACES = r"place|negat|lever"
SIGN = r"sign"
LATE = r"came about .* after"
SHIFTED = np.eye(6)
SHIFTED[3:, :3] = [[0.0, -0.1, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 0.0]]
ORTHOGONAL = np.linalg.qr(np.random.default_rng(SEED).normal(size=(6, 6)))[0]

SPOILTS: dict[str, Spoilt] = {
    "step of a zero": Spoilt(
        r"zero|step|leap|jump",
        {
            "5 N, set 2": read([3.0, 2.0, 3.5, 0.2, 0.3, 0.1], 1, 0.5, 1.0),
            "15 N, set 3": read([9.0, 6.0, 10.0, 0.6, 0.9, 0.3], 2, 0.3, 1.0),
            "40 N, set 1": read([24.0, 16.0, 28.0, 1.8, 2.7, 0.9], 0, 0.6, 1.0),
        },
    ),
    "push": Spoilt(
        TOUCH,
        {
            "8 N for 3 s": read(PUSH, 2, 0.4, 0.45),
            "8 N for 9 s": read(PUSH, 1, 0.2, 0.35),
            "8 N for 18 s": read(PUSH, 3, 0.5, 0.8),
        },
    ),
    "clipped channel": Spoilt(
        CLIP, {"3 %": clip(0.03, 1, 3), "10 %": clip(0.1, 2, 0), "25 %": clip(0.25, 0, 5)}
    ),
    "masses in g": Spoilt(MASS_UNIT, {"": scale_masses(1000.0)}),
    "masses in lb": Spoilt(MASS_UNIT, {"": scale_masses(1.0 / POUND)}, (True,)),
    "places in mm": Spoilt(PLACE_UNIT, {"": scale_masses(1.0, 1000.0)}),
    "places in cm": Spoilt(PLACE_UNIT, {"": scale_masses(1.0, 100.0)}),
    "gravity in cm/s^2": Spoilt(GRAVITY_UNIT, {"": vectors(lambda g: 100.0 * g)}),
    "gravity in mg": Spoilt(GRAVITY_UNIT, {"": vectors(lambda g: g / 9.80665e-3)}),
    "gravity in g": Spoilt(GRAVITY_UNIT, {"": vectors(lambda g: g / 9.80665)}),
    "IMU turned": Spoilt(
        r"estimate_rotation|turned|rotat",
        {"5 deg": turn([3.0, -4.0, 0.0]), "10 deg": turn([6.0, 4.0, -7.0]), "90 deg": turn([0, 0, 90])},
    ),
    "accelerometer's bias": Spoilt(
        r"calibrate the accelerometer|bias",
        {
            "0.3": vectors(lambda g: np.add(g, [0.2, -0.1, 0.2])),
            "1": vectors(lambda g: np.add(g, [0.0, 0.6, -0.8])),
        },
    ),
    "accelerometer's scale": Spoilt(
        SCALE,
        {f"{100 * s - 100:+.0f} %": vectors(lambda g, s=s: s * g) for s in (1.05, 1.12, 0.88)},  # type: ignore[misc]
    ),
    "factory transposed": Spoilt(WHOLE, {"": factory(lambda F: F.T)}, (True,)),
    "factory inverted": Spoilt(WHOLE, {"": factory(lambda F: np.asarray(np.linalg.inv(F)))}, (True,)),
    "factory torques first": Spoilt(WHOLE, {"": factory(lambda F: np.roll(F, 3, axis=0))}, (True,)),
    "factory in N mm": Spoilt(
        WHOLE, {"": factory(lambda F: F * np.repeat([[1.0], [1e3]], 3, axis=0))}, (True,)
    ),
    "factory negated": Spoilt(SIGN, {"": factory(np.negative)}, (True,)),
    "gravity negated": Spoilt(SIGN, {"": vectors(np.negative)}, (True,)),
    "factory entry": Spoilt(
        r"[Ee]ntry \[",
        {"sign": entry(2, 4, -1.0), "times 10": entry(0, 5, 10.0), "a tenth": entry(1, 1, 0.1)},
        (True,),
    ),
    "one mass": Spoilt(
        r"mass of 'set 3'", {f"{100 * s - 100:+.0f} %": scale_masses(s, 1.0, (2,)) for s in (0.8, 1.1, 1.2)}
    ),
    "one place": Spoilt(
        r"mass of 'set 4'", {"4 cm": move([0.0, 0.04, 0.0], 3), "10 cm": move([0.06, 0.0, -0.08], 3)}
    ),
    "two sets swapped": Spoilt(r"swap|exchang", {"2, 3": swap(1, 2), "1, 4": swap(0, 3)}),
    "all places negated": Spoilt(PLACES, {"": scale_masses(1.0, -1.0)}, (True,)),
    "fast without a gyroscope": Spoilt(
        r"too fast|fast",
        {
            "38 deg/s": {"speed_deg": 38.0, "rate": 50.0},
            "76 deg/s": {"speed_deg": 76.0, "rate": 50.0},
            "swings": {"fast_motion": True, "rate": 100.0},
        },
        gyroscope=(False,),
    ),
    "limb not rigid": Spoilt(
        r"bend|not rigid|gives", {f"{slack}": {"knee_slack": slack} for slack in (0.005, 0.02, 0.06)}
    ),
    "foot on the floor": Spoilt(TOUCH, {"": readings(touch_floor)}),
    "channels exchanged": Spoilt(
        r"channels? .* (are )?exchanged", {"": factory(lambda F: F[:, [3, 1, 2, 0, 4, 5]])}, (True,)
    ),
    "left-handed frame": Spoilt(
        r"left-handed", {"": factory(lambda F: F * np.array([[-1.0], [1], [1], [-1], [1], [1]]))}, (True,)
    ),
    "factory turned": Spoilt(
        r"turned",
        {f"{a} deg": factory(lambda F, a=a: rotate_wrench(a) @ F) for a in (90, 180)},  # type: ignore[misc]
        (True,),
    ),
    "factory about a point 10 cm off": Spoilt(r"point", {"": factory(lambda F: SHIFTED @ F)}, (True,)),
    "factory of another sensor": Spoilt(
        r"this sensor's", {"": factory(lambda F: np.abs(F).max(axis=1)[:, None] * ORTHOGONAL)}, (True,)
    ),
    "copied channel": Spoilt(r"copy", {"": readings(lambda raw, *_: column(raw, 4, raw[:, 1]))}),
    "gauge off": Spoilt(
        r"follow gravity|connected",
        {"": readings(lambda raw, *_: column(raw, 4, spikes(0.0 * raw, 2 * len(raw), 6.0)[:, 4]))},
    ),
    "copied set": Spoilt(
        r"copy", {"": lambda log: each(lambda _: replace(log.sets[1], name="set 3"), (2,))(log)}
    ),
    "readings held": Spoilt(
        r"repeat", {f"{n / RATE} s": readings(lambda raw, *_, n=n: hold(raw, n)) for n in (2, 20)}
    ),
    "spikes": Spoilt(
        r"stand alone", {f"{n}": readings(lambda raw, *_, n=n: spikes(raw, n, 5e3)) for n in (6, 30)}
    ),
    "readings late": Spoilt(LATE, {f"{delay} s": late_readings(delay) for delay in (0.3, 3.0)}),
    "IMU late": Spoilt(LATE, {"1.5 s": lambda log: late(1.5)(log, 0)}),
    "readings low-passed": Spoilt(LATE, {"1 s": readings(lambda raw, *_: low_pass(raw, 1.0))}),
    "accelerometer low-passed": Spoilt(
        LATE, {"1 s": vectors(lambda g: low_pass(g, 1.0))}, gyroscope=(False,)
    ),
    "accelerometer held": Spoilt(
        LATE + "|repeat", {"1 s": vectors(lambda g: hold(g, 10))}, gyroscope=(False,)
    ),
    "zero that follows": Spoilt(r"drift|zero", {"20 s": readings(lambda raw, *_: raw - low_pass(raw, 20.0))}),
    "limb's weight taken off": Spoilt(
        r"driver", {"": lambda log: weigh(-log.truth.limb.mass, list(log.truth.limb.com), 0)(log)}
    ),
    "payload from set 3 on": Spoilt(r"from 'set 3' on", {"": weigh(-1.0, [0.0, 0.0, 0.1], 2)}),
    "shoe from set 3 on": Spoilt(r"from 'set 3' on", {"": weigh(0.3, [0.02, 0.0, 0.4], 2)}),
    "rope in set 4": Spoilt(r"from 'set 4' on|added mass of 'set 4'", {"": weigh(-1.4, [0.0, 0.0, 0.3], 3)}),
    "cable pulls": Spoilt(r"cable", {f"{size} N/rad": pull(size, False) for size in (6.0, 20.0)}),
    "cable drags": Spoilt(r"cable", {"2 N": pull(2.0, True)}),
    "mass falls off": Spoilt(r"hangs in 'set 4' changed at (39|40|41)\.", {"": readings(cut)}),
    "labels late": Spoilt(r"leaps at|touched|hangs in .* changed", {"6 s": relabel}),
    "gain of a set": Spoilt(
        r"readings of 'set 3'|gain .*in 'set 3'",
        {f"{s}": each(lambda d, s=s: replace(d, raw=s * d.raw), (2,)) for s in (1.1, 0.5)},  # type: ignore[misc]
    ),
    "gain of a channel": Spoilt(
        r"channel", {"+8 %": readings(lambda raw, *_: column(raw, 3, 1.08 * raw[:, 3]), 2)}
    ),
    "another sensor": Spoilt(
        r"sensor", {"set 4": readings(lambda raw, _, log, __: raw @ mix_channels(log).T, 3)}
    ),
    "scale grows": Spoilt(r"scale changes", {"6 %": readings(lambda raw, _, __, j: (1.0 + 0.02 * j) * raw)}),
    "axis of all places": Spoilt(
        r"places",
        {
            "sign of y": each(lambda one: replace(one, added_com=one.added_com * [1, -1, 1])),
            "x, y swapped": each(lambda one: replace(one, added_com=one.added_com[[1, 0, 2]])),
        },
    ),
    "axis of the accelerometer": Spoilt(
        r"IMU",
        {"sign of y": vectors(lambda g: g * [1, -1, 1]), "x, y swapped": vectors(lambda g: g[:, [1, 0, 2]])},
        gyroscope=(False,),
    ),
    "scale of an accelerometer's axis": Spoilt(SCALE, {"4 %": vectors(lambda g: g * [1, 1.04, 1])}),
    "accelerometer clipped": Spoilt(
        CLIP + "|accelerometer", {"8 m/s^2": vectors(lambda g: np.clip(g, -8.0, 8.0))}
    ),
    "accelerometer stands still": Spoilt(
        r"still|repeat", {"set 3": each(lambda one: replace(one, gravity=hold(one.gravity, 400)), (2,))}
    ),
    "IMU of the torso": Spoilt(
        r"turn", {"": vectors(lambda g: [0.0, 0.0, 9.81] + 1e-3 * (g - np.mean(g, axis=0)))}
    ),
    "gyroscope's axes": Spoilt(r"gyro|rate", {"swapped": spin(lambda w: w[:, [1, 0, 2]])}, gyroscope=(True,)),
    "clamps of 0.15 kg": Spoilt(r"mass", {"": weigh(0.15, [0.1, 0.07, 0.3], 1)}, unknowable=True),
    "masses on strings of 10 cm": Spoilt(
        PLACES,
        {"": each(lambda one: replace(one, added_com=np.add(one.added_com, [0.0, 0.0, 0.1])))},
        unknowable=True,
    ),
    "places times 1.2": Spoilt(PLACES, {"": scale_masses(1.0, 1.2)}, unknowable=True),
    "gravity negated, no factory": Spoilt(SIGN, {"": vectors(np.negative)}, (False,), unknowable=True),
    "places negated, no factory": Spoilt(PLACES, {"": scale_masses(1.0, -1.0)}, (False,), unknowable=True),
    "masses in lb, no factory": Spoilt(MASS_UNIT, {"": scale_masses(1.0 / POUND)}, (False,), unknowable=True),
}


def outcome(log: Log, cause: str = "") -> dict[str, Any]:
    """Calibrate, compare with the truth, and see whether the message names the cause."""
    start, off, sigmas = time.process_time(), np.nan, np.nan
    try:
        fit = calibrate_in_situ(log.sets, factory_matrix=log.factory, limb=log.limb, options=log.options)
    except CalibrationRefused as refusal:
        answer, message = "refused", str(refusal)
    except (ValueError, np.linalg.LinAlgError) as error:
        answer, message = "crashed", f"{type(error).__name__}: {error}"
    else:
        answer, message = "warned" if fit.warnings else "answered", " ".join(fit.warnings)
        off, sigmas = errors(fit, log)
    seconds, wrong = time.process_time() - start, off > OFF and sigmas > SIGMAS
    named = answer != "crashed" and bool(cause) and re.search(cause, _first_cause(message)) is not None
    right = answer == "answered" and not wrong
    return {
        "came out": answer,
        "off %": round(100.0 * off, 1),
        "sigmas": round(sigmas, 1),
        "wrong": answer == "answered" and wrong,
        "wrong, warned": answer == "warned" and wrong,
        "right": named or right,
        "verdict": "yes" if named else "right" if right else "NO",
        "seconds": seconds,
        "message": message,
    }


def errors(fit: InSituFit, log: Log) -> tuple[float, float]:
    """Return how far wrenches are off, as a share of the load and in stated deviations; the worse of both."""
    C, A = fit.matrix, log.truth.response
    zero = C @ (log.truth.offset - fit.offset)
    off = log.loads @ (C @ A - np.eye(6)).T + zero
    to = ErrorColumns.of(len(fit.offset))
    covariance = error_covariance(fit)
    slopes = np.zeros((len(log.loads), 6, len(covariance)))
    slopes[:, :, to.offset] = C
    for axis in range(6):
        slopes[:, axis, to.response.start + 6 * axis : to.response.start + 6 * axis + 6] = log.loads
    stated = np.einsum("nac,cd,nad->na", slopes, covariance, slopes)
    shares, sigmas = [], []
    for block in (slice(0, 3), slice(3, 6)):
        size = np.sqrt(np.mean(off[:, block] ** 2))
        shares.append(size / np.sqrt(np.mean(log.loads[:, block] ** 2)))
        sigmas.append(size / np.sqrt(np.mean(stated[:, block])))
    worst = int(np.argmax([s if z > SIGMAS else 0.0 for s, z in zip(shares, sigmas, strict=True)]))
    return float(shares[worst]), float(sigmas[worst])


def main() -> None:
    """Print the tables and their totals."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), help="the logs I, I + N, I + 2 N, ...")
    parser.add_argument("--sound", default="", help="sound logs alone, of kinds whose name contains this")
    parser.add_argument("--verbose", action="store_true", help="messages whole")
    parser.add_argument("--seed", type=int, default=SEED)
    arguments = parser.parse_args()
    first, step = arguments.part
    cases = [
        (kind, spoilt, *case)
        for kind, spoilt in SPOILTS.items()
        for case in product(spoilt.sizes.items(), spoilt.gyroscope, spoilt.factory)
        if arguments.only in kind and not arguments.sound
    ]
    rows: list[dict[str, Any]] = []
    for kind, spoilt, (size, change), gyroscope, given in cases[first::step]:
        of_rig = change if isinstance(change, dict) else {}
        log = record(arguments.seed, gyroscope, **of_rig)
        log = log if of_rig else change(log)
        row = {
            "kind": kind,
            "unknowable": spoilt.unknowable,
            "size": size,
            "gyro": gyroscope,
            "factory": given,
        }
        rows.append(row | outcome(log if given else replace(log, factory=None), spoilt.cause))
    if rows:
        tell(pd.DataFrame(rows), arguments.verbose)
    if arguments.sound or not arguments.only:
        tell_sound(arguments.sound, first, step)


def tell(data: pd.DataFrame, verbose: bool) -> None:
    """Print spoilt logs, and how many of each kind were answered wrongly and named rightly."""
    shown = data.drop(columns=["unknowable", "wrong", "wrong, warned", "right", "seconds"])
    print(shown.to_string(index=False, max_colwidth=None if verbose else 110))
    for unknowable, of in data.groupby("unknowable"):
        print("\nNothing can show it:" if unknowable else "\nAll others:")
        kinds = of.groupby("kind", sort=False).agg(
            logs=("right", "size"), silent=("wrong", "sum"), right=("right", "sum")
        )
        print(kinds.to_string(), "\n", kinds.sum().to_string())
    print(f"{data['seconds'].sum():.1f} s of CPU")


def _first_cause(message: str) -> str:
    """Find the likeliest cause of a message, or all of it where it has none."""
    found = re.search(
        r"(?:The likeliest cause|The closest of them): (.*?)(?: \(probability|, which leaves)", message
    )
    return found.group(1) if found else message


SOUND: dict[str, Callable[[Log, int], Log]] = {
    "as it is": lambda log, _: log,
    **{f"accelerometer's noise {size} m/s^2": noisy(size) for size in (0.02, 0.05, 0.1)},
    **{f"IMU late by {1e3 * delay:.0f} ms": late(delay) for delay in (0.005, 0.02, 0.05)},
    "no times": rows(1, times=False),
    "24 poses": rows(25, times=True),
    "24 poses, no times": rows(25, times=False),
}
"""Logs that have nothing wrong."""


def tell_sound(kinds: str, first: int, step: int) -> None:
    """Calibrate sound logs of other seeds; print those that are not answered rightly."""
    chosen = [kind for kind in SOUND if kinds in kind]
    rows = []
    for kind, seed, gyroscope, given in list(product(chosen, SOUND_SEEDS, (False, True), (False, True)))[
        first::step
    ]:
        sensor = ("leg", "foot")[seed % 2]
        log = SOUND[kind](record(seed, gyroscope, sensor), seed)
        row = {"kind": kind, "sensor": sensor, "seed": seed, "gyro": gyroscope, "factory": given}
        rows.append(row | outcome(log if given else replace(log, factory=None)))
    data = pd.DataFrame(rows)
    print(data[~data["right"]].drop(columns=["seconds", "verdict"]).to_string(index=False, max_colwidth=150))
    refused = (data["came out"].isin(["refused", "crashed"])).sum()
    silent, warned = data["wrong"].sum(), data["wrong, warned"].sum()
    print(f"of {len(data)} sound logs: {refused} refused, {silent} wrong, {warned} wrong with a warning")


if __name__ == "__main__":
    main()
