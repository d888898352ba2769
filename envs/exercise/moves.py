"""The moves of an exercise, motions by their names, and the list of motions to choose among."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats

SWAYS: Final = ("forward", "left", "forward left", "forward right")
"""Lines of the sways over both feet, there and back."""

EXTENTS: Final = (1.4, 1.0, 0.5)
"""Extents of the motions that are offered, as shares of a path: the first that a robot can do."""

TEMPOS: Final = (0.5, 1.0, 1.4)  # tempos that they are offered with: factors on all speeds


class Move(NamedTuple):
    """A run along a path."""

    path: str  # name of the path
    start: float  # where it starts, s
    end: float  # where it ends, s
    time: float  # duration in multiples of that of a sway
    ends: bool = False  # whether a motion ends with it: the robot is back in its first posture


class Schedule(NamedTuple):
    """An episode's moves one after another, shape (moves,), or (N, moves) of N robots."""

    end: Floats  # when each ends in s; infinite after the last
    total: Any  # when the last one ends
    path: NDArray[np.intp]  # number of its path
    start: Floats  # where on it the move starts
    way: Floats  # how far it goes
    length: Floats  # how long it takes in s

    @classmethod
    def join(cls, plans: Sequence["Schedule"]) -> "Schedule":
        """Put the moves of many robots into one; where some have fewer, nothing follows."""
        most = max(plan.end.size for plan in plans)

        def rows(name: str, filled: float) -> NDArray[Any]:
            moves: list[NDArray[Any]] = [getattr(plan, name) for plan in plans]
            return np.array([np.pad(row, (0, most - row.size), constant_values=filled) for row in moves])

        return cls(
            end=rows("end", np.inf),
            total=np.array([plan.total for plan in plans]),
            path=rows("path", 0),
            start=rows("start", 0.0),
            way=rows("way", 0.0),
            length=rows("length", 1.0),
        )


def motions_of(name: str) -> list[Move]:
    """Return the moves of a motion that starts and ends in the middle, on both feet.

    The name has the kind, how far as a share of its path, and with "@" at which tempo, which is 1 otherwise:
    "sway forward 1.5", "squat 1 @ 0.5", "shift left", "stand left", "lean left 1" (stand on one foot and sway
    about it), "step" (in place, one foot after the other) or "march" (twice that, without a halt in the
    middle). Other names are refused with a ValueError.
    """
    what, _, tempo = name.partition("@")
    words = what.split()
    try:
        scale = 1.0 / float(tempo or 1.0)
        extent = float(words.pop()) if words[-1][-1].isdigit() else 1.0
    except (IndexError, ValueError, ZeroDivisionError):
        words, scale, extent = [], 1.0, 1.0
    kind, of = words[0] if words else "", " ".join(words[1:])
    feet = {"left": 0, "right": 1}
    if kind == "sway" and of in SWAYS:
        moves = [Move(of, 0.0, extent, 1.0), Move(of, extent, -extent, 1.6), Move(of, -extent, 0.0, 1.0)]
    elif kind == "squat" and not of:
        moves = [Move("squat", 0.0, extent, 1.0), Move("squat", extent, 0.0, 1.0)]
    elif kind == "shift" and of in feet:
        moves = [Move(f"shift {feet[of]}", *ends, 1.6) for ends in ((0.0, 1.0), (1.0, 0.0))]
    elif kind in ("stand", "lean") and of in feet:
        turns = {} if kind == "stand" else {"pitch": extent, "roll": extent}
        moves = one_leg(feet[of], turns)
    elif kind == "step" and not of:
        moves = [*one_leg(0, {}, 0.6), *one_leg(1, {}, 0.6)]
    elif kind == "march" and not of:
        # From foot to foot without a halt in the middle: two steps with each.
        moves = []
        for k in range(4):
            over = one_leg(k % 2, {}, 0.6)
            middle = [Move("across", float(k % 2), float(1 - k % 2), 2.4)]
            moves += [*over[: 1 if k == 0 else 0], *over[1:-1], *(over[-1:] if k == 3 else middle)]
    else:
        raise ValueError(
            f"There is no motion '{name}'. There are 'sway' with one of {SWAYS}, 'squat', 'step', 'march', "
            "and 'shift', 'stand' and 'lean' with 'left' or 'right'; then an extent such as 1.5, and a tempo "
            "such as '@ 0.5'."
        )
    moves = [move._replace(time=move.time * scale) for move in moves]
    return [*moves[:-1], moves[-1]._replace(ends=True)]


def one_leg(foot: int, turns: dict[str, float], pause: float = 1.0) -> list[Move]:
    """Return the moves by which a robot stands on one foot and sways about it by "pitch" and "roll", so far.

    ``pause`` is a factor on the time that it waits between moves, and that a lift takes.
    """
    moves = [Move(f"shift {foot}", 0.0, 1.0, 1.6), Move(f"shift {foot}", 1.0, 1.0, 0.2 * pause)]
    moves += [Move(f"lift {foot}", 0.0, 1.0, pause), Move(f"lift {foot}", 1.0, 1.0, 0.3 * pause)]
    for turn, s in turns.items():
        path = f"{turn} {foot}"
        moves += [Move(path, 0.0, s, 0.8), Move(path, s, -s, 1.2), Move(path, -s, 0.0, 0.8)]
    moves.append(Move(f"lift {foot}", 1.0, 0.0, pause))
    moves += [Move(f"shift {foot}", 1.0, 1.0, 0.2 * pause), Move(f"shift {foot}", 1.0, 0.0, 1.6)]
    return moves


def list_motions() -> list[list[str]]:
    """Return names of motions to choose among, of every kind, direction and tempo: farther ones first."""
    fixed = [
        "squat",
        "step",
        "march",
        *(f"{kind} {foot}" for kind in ("shift", "stand") for foot in ("left", "right")),
    ]
    scaled = [*(f"sway {way}" for way in SWAYS), "lean left", "lean right"]
    kinds = [[kind] for kind in fixed] + [[f"{kind} {extent:g}" for extent in EXTENTS] for kind in scaled]
    return [[f"{name} @ {tempo:g}" for name in names] for names in kinds for tempo in TEMPOS]
