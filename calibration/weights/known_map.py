"""The map of known weights, as ``surefoot calibrate weights`` writes it into a file."""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.calibration.parameters import Parameters
from surefoot.calibration.weights.curves import Curves
from surefoot.files import parse_json, read_text
from surefoot.names import slug

KEYS = ("channels", "scale_N_per_count", "offset_N")


def read_map(
    given: str | PathLike[str] | Mapping[str, Any],
    names: Sequence[str],
    refusal: type[ValueError] = ValueError,
) -> tuple[Parameters, Curves]:
    """Read a map of channels, (K,) each, and the curves in front of it, of a JSON file or its contents.

    Names are as in a layout (``left/front_left``) or in columns (``left_front_left``). ValueError, or
    ``refusal``, if there is no such file, or no map of every channel in it.

    >>> read_map({"channels": ["b", "a"], "scale_N_per_count": [2.0, 1.0], "offset_N": [0.0, 5.0]}, ["a"])[0]
    Parameters(scale=array([1.]), offset=array([5.]))
    """
    file = "The map" if isinstance(given, Mapping) else Path(given).name
    told: Any = given
    if not isinstance(given, Mapping):
        told = parse_json(read_text(given, refusal), f"{file}: the map", refusal)
    try:
        found = [slug(str(name)) for name in told["channels"]]
        twice = [name for name in found if found.count(name) > 1]
        if twice:
            raise ValueError(f"the channel {twice[0]!r} stands in it more than once")
        values = [[float(x) for x in told[key]] for key in KEYS[1:]]
        maps = dict(zip(found, zip(*values, strict=True), strict=True))
        curves = Curves.from_plain(told.get("curves", [None] * len(found)), len(found))
        bent = dict(zip(found, curves.knots, strict=True))
        if not np.isfinite(values).all() or 0.0 in values[0]:
            raise ValueError("scales must be finite and not zero, offsets finite")
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise refusal(
            f"{file}: is no map ({type(error).__name__} {error}); it needs channels, scale_N_per_count "
            "and offset_N, one of each a channel, as `surefoot calibrate weights` writes them."
        ) from None
    wanted = [slug(name) for name in names]
    missing = [name for name in wanted if name not in maps]
    if missing:
        raise refusal(
            f"{file}: holds no map for the channel {missing[0]!r}; it has {found}. Name the columns "
            f"of the weighings 'raw_{missing[0]}_count' and so on."
        )
    scale, offset = np.array([maps[name] for name in wanted]).T
    return Parameters(scale, offset), Curves([bent[name] for name in wanted])


def is_file_of_map(given: Any) -> bool:
    """Whether something is a JSON file, or the contents of one that holds a map."""
    if isinstance(given, Mapping):
        return KEYS[1] in given
    return isinstance(given, str | PathLike) and str(given).endswith(".json")
