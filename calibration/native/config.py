"""The constants of one robot, as the library wants them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.moment.config import MomentFilterConfig
from surefoot.calibration.moment.stream import MomentStream
from surefoot.calibration.native.library import installed
from surefoot.calibration.setup import OnlineSetup
from surefoot.native import Library, c_header, required

_LIKE = np.zeros(1)


def config_record(library: Library, stream: MomentStream) -> NDArray[Any] | None:
    """Return the record of constants, shape (); ``None`` for a robot that the library is not made for."""
    if not stream.unknowns.diagonal:
        return None
    record = library.filled("config", _values(stream))
    return record if record is not None and library.functions.surefoot_fits(record.ctypes.data) else None


def c_source(setup: OnlineSetup, **options: Any) -> str:
    """Return a header with the sizes and constants of one robot, as ``sf_config robot``, for its controller.

    Args:
        setup: The robot.
        options: Fields of :class:`~surefoot.calibration.moment.config.MomentFilterConfig`.

    Raises:
        RuntimeError: If there is no library here.
        ValueError: If the library is not made for such a robot.
    """
    record = config_record(required(installed()), MomentStream(setup, MomentFilterConfig(**options)))
    if record is None:
        raise ValueError("The library is not made for such a robot; docs/native.md has its limits.")
    sizes = {
        name.upper(): int(record[name]) for name in ("channels", "feet", "lag", "every", "settle", "kinds")
    }
    sizes["GROUPS"] = sizes["EVERY"] // int(record["average"])
    sizes["CELLS"] = int(record["cells"].sum())
    # An array without an element is none in C.
    sizes |= {name.upper(): max(1, int(record[name])) for name in ("sensors", "parities")}
    return c_header("surefoot_calibration.h", sizes, {"sf_config robot": record})


def _values(stream: MomentStream) -> dict[str, Any]:
    """Return the constants by their names in ``sf_config``."""
    setup, config, unknowns = stream.setup, stream.config, stream.unknowns
    layout = setup.layout
    own, newton = stream._constants.like(_LIKE), stream.newton_euler
    faults, front = stream._faults, stream._front_end
    rows, distal = newton._constants.like(_LIKE), newton._distal
    beyond = distal._constants.like(_LIKE)
    stand_in, hypotheses = faults.stand_in._constants.like(_LIKE), faults.hypotheses
    load = hypotheses._constants.like(_LIKE)
    parity = stream.parity._constants.like(_LIKE).parity
    return {
        "channels": layout.channels,
        "feet": len(layout.feet),
        "lag": setup.lag,
        "every": config.every,
        "average": config.average,
        "settle": config.settle,
        "kinds": newton.kinds,
        "sensors": len(beyond.mass),
        "parities": len(parity),
        "pairs": len(hypotheses._first),
        "keep_every": stream._keep_every,
        "distal_matters": distal.matter,
        "foot_of_channel": layout.foot_of_channel,
        "cells": faults.stand_in.cells,
        "together": stand_in.together,
        "first": hypotheses._first,
        "second": hypotheses._second,
        "foot_of_sensor": distal._foot_of,
        "dt": setup.dt,
        "weight": setup.weight,
        "mass": setup.mass,
        "length": setup.length,
        "reach": front.motions._reach,
        "force_threshold": setup.force_threshold,
        "scale": own.scale,
        "offset": own.offset,
        "lowest": front.plausible[0],
        "highest": front.plausible[1],
        "wrench_map": layout.wrench_map,
        "unit": unknowns.unit,
        "start": unknowns.start,
        "first_variance": np.diagonal(own.covariance),
        "walk": np.diagonal(own.walk),
        "learnt": unknowns.learnt,
        "sure": unknowns.sure,
        "change": np.diagonal(own.change),
        "aged": unknowns.aged[unknowns.map],
        "stated": unknowns.std[unknowns.map] ** 2,
        "row_scale": rows.scale,
        "row_variance": rows.variance,
        "timing_noise": config.timing_noise,
        "gate": config.gate,
        "reject": config.reject,
        "still": config.still,
        "mass_change": config.mass_change,
        "swing_noise": config.swing_noise,
        "swing_load": config.swing_load,
        "parity_noise": config.parity_noise,
        "parity": parity,
        "leap": faults._leap,
        "renewal": faults.stand_in._renewal,
        "prior": stand_in.prior,
        "load_largest": load.largest,
        "load_loose": np.diagonal(load.loose),
        "sensor_mass": beyond.mass,
        "sensor_com": beyond.com,
        "sensor_share": beyond.share,
        "felt": beyond.felt,
        "curve_every": distal._curves[config.every].like(_LIKE).curve,
        "curve_span": distal._curves[config.span].like(_LIKE).curve,
    }
