"""The moves of an exercise, and calibration motions by name: sways, squats and lifts."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats

SWAYS: Final = ("forward", "left", "forward left", "forward right")
"""Directions of the sways over both feet."""

EXTENTS: Final = (1.4, 1.0, 0.5)
"""Extents of the offered sways, as shares of a path. The first that a robot can do is used."""

TEMPOS: Final = (0.5, 1.0, 1.4)  # tempos of the offered motions: factors on all speeds


class Move(NamedTuple):
    """A run along a path."""

    path: str  # name of the path
    start: float  # where it starts, s
    end: float  # where it ends, s
    time: float  # duration in multiples of that of a sway
    ends: bool = False  # whether a motion ends with it, in the first posture


class Schedule(NamedTuple):
    """The sequence of moves of an episode, shape (moves,), or (N, moves) for N robots."""

    end: Floats  # end of each move in s; infinite after the last
    total: Any  # end of the last move in s
    path: NDArray[np.intp]  # index of the path
    start: Floats  # start of the move on the path
    way: Floats  # length of the move on the path
    length: Floats  # duration in s

    @classmethod
    def join(cls, plans: Sequence["Schedule"]) -> "Schedule":
        """Join the moves of many robots, padded to the longest sequence."""
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

    A name has the kind, its extent as a share of the path, and after "@" the tempo, a factor on all speeds.
    Both numbers default to 1.

    * "sway forward 1.4", "sway forward left": to one side, to the other and back.
    * "squat 1 @ 0.5": down and up again.
    * "lift @ 1.4": stand on the left foot, then on the right one, and lift the other. It has no extent.

    Raises:
        ValueError: If there is no such motion.
    """
    what, _, tempo = name.partition("@")
    words = what.split()
    try:
        scale = 1.0 / float(tempo or 1.0)
        extent = float(words.pop()) if words[-1][-1].isdigit() and words[0] != "lift" else 1.0
    except (IndexError, ValueError, ZeroDivisionError):
        words, scale, extent = [], 1.0, 1.0
    kind, way = words[0] if words else "", " ".join(words[1:])
    if kind == "sway" and way in SWAYS:
        moves = [Move(way, 0.0, extent, 1.0), Move(way, extent, -extent, 1.6), Move(way, -extent, 0.0, 1.0)]
    elif kind == "squat" and not way:
        moves = [Move("squat", 0.0, extent, 1.0), Move("squat", extent, 0.0, 1.0)]
    elif kind == "lift" and not way:
        # From foot to foot without a stop in the middle.
        on_left, on_right = (one_leg(foot, {}, 0.6) for foot in (0, 1))
        moves = [*on_left[:-1], Move("across", 0.0, 1.0, 2.4), *on_right[1:]]
    else:
        raise ValueError(
            f"There is no motion '{name}'. There are 'sway' with one of {SWAYS}, 'squat' and 'lift'; then an "
            "extent such as 1.5 (not for 'lift'), and a tempo such as '@ 0.5'."
        )
    moves = [move._replace(time=move.time * scale) for move in moves]
    return [*moves[:-1], moves[-1]._replace(ends=True)]


def one_leg(foot: int, turns: dict[str, float], pause: float = 1.0) -> list[Move]:
    """Return the moves by which a robot stands on one foot, with sways about "pitch" and "roll" by an extent.

    ``pause`` is a factor on the pauses between moves and on the duration of a lift.
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
    """Return lists of alternatives to choose among, in each list the largest motion first."""
    kinds = [["squat"], ["lift"], *([f"sway {way} {extent:g}" for extent in EXTENTS] for way in SWAYS)]
    return [[f"{name} @ {tempo:g}" for name in names] for names in kinds for tempo in TEMPOS]
