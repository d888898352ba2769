"""The constants of one robot, as the library wants them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import comparison
from surefoot.calibration.baselines import SwingTare, tare
from surefoot.calibration.front_end.readings import FrontEnd
from surefoot.calibration.moment import (
    columns,
    health,
    model,
    modes,
    motion,
    severity,
    still,
    suspects,
    versus_start,
)
from surefoot.calibration.moment import filter as stream
from surefoot.calibration.moment import tare as tares
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.faults import ChannelFaults
from surefoot.calibration.moment.filter import MomentFilter
from surefoot.calibration.setup import OnlineSetup
from surefoot.names import page
from surefoot.native import CALIBRATION, Library, PointerRecord, c_header, require

_METHODS = {"moment": 0, "tare": 1, "none": 2}
"""Numbers of methods in ``native/calibration.c``."""

_STATES = "moment_state", "tare_state", "front"
_OWN = "moment_config", "tare_config", None
"""The records of their states, and of their own constants besides ``config``."""


class Constants(NamedTuple):
    """The constants of one robot and one method."""

    number: int  # of the method in ``native/calibration.c``
    config: NDArray[Any]  # the record of the robot's, shape ()
    own: NDArray[Any] | None  # that of the method's, if it has one
    state: str  # name of the record of the state
    like: Any  # a state of the method's Python, before any sample
    front: FrontEnd  # the way of a sample
    covariance: str | None = None
    """Name of the state's leaf that is the covariance of an estimate; or ``None``."""
    contact: bool = False  # whether it says how likely feet bear load, and how much is undetermined

    @property
    def untold(self) -> tuple[str, ...]:
        """Parts of an estimate that the method does not have."""
        of_contact = () if self.contact else ("undetermined", "contact_probability")
        certain = () if self.covariance else ("force_std", "cop_covariance", "nis", "nis_rows")
        return of_contact + certain

    def filter(self, library: Library) -> PointerRecord:
        """Return the record that the library is called with."""
        own = 0 if self.own is None else self.own
        return PointerRecord(library, "filter", {"config": self.config, "own": own, "method": self.number})


def constants_of(
    library: Library, method: str, setup: OnlineSetup, options: dict[str, Any]
) -> Constants | None:
    """Return the constants; ``None`` for a method or a robot that the library is not made for."""
    if method not in _METHODS:
        return None
    number, raw = _METHODS[method], np.zeros(setup.layout.channels)
    if library.record("config", {"offset": raw.shape, "wrench_map": setup.layout.wrench_map.shape}) is None:
        return None
    own: tuple[Any, ...] = ()
    like: Any
    covariance = faults = None
    if method == "moment":
        moment = MomentFilter(setup, Moment(**options))
        front, like, faults = moment.front_end, moment.init(raw), moment.faults
        own, covariance = moment_constants(moment), "covariance"
    else:
        front = FrontEnd(setup, imu=False, extrapolates=method == "tare")
        like = front.init(raw)
        if method == "tare":
            config = SwingTare(**options)
            like = tare(setup, config).init(raw)
            own = (
                {
                    "settle": round(config.settle / setup.dt),
                    "spread": config.spread * setup.weight,
                    "limit": config.offset_range * setup.weight,
                },
                config,
            )
    record, name = library.constants("config", *_robot(front, faults)), _OWN[number]
    of_method = library.constants(name, *own) if name else None
    if record is None or (name and of_method is None):
        return None
    contact = method == "moment"
    found = Constants(number, record, of_method, _STATES[number], like, front, covariance, contact)
    return found if library.functions.surefoot_fits(found.filter(library).address) else None


def c_source(setup: OnlineSetup, method: str = "moment", **options: Any) -> str:
    """Return a header with the sizes and constants of one robot, for its controller.

    It declares ``sf_config robot``, and ``sf_moment_config moment`` or ``sf_tare_config tare``.

    Args:
        setup: The robot.
        method: A method of :data:`~surefoot.calibration.online.METHODS` that the library has.
        options: Fields of its config, such as
            :class:`~surefoot.calibration.moment.config.Moment`.

    Raises:
        RuntimeError: If there is no library here.
        ValueError: If the library is not made for such a robot.
    """
    found = constants_of(require(CALIBRATION.installed()), method, setup, options)
    if found is None:
        raise ValueError(f"The library is not made for such a robot; {page('native')} has its limits.")
    record, own, name = found.config, found.own, _OWN[found.number]
    sizes = {"CHANNELS": int(record["channels"]), "FEET": int(record["feet"]), "LAG": int(record["kept"])}
    records = {"sf_config robot": record}
    if own is not None and name is not None:
        records[f"sf_{name} {name.removesuffix('_config')}"] = own
        if method == "moment":
            sizes |= {
                "COMPONENTS": int(own["components"]),
                "BLOCK": int(own["capacity"]),
                "TALKS": int(own["talks"]),
            }
            return c_header("surefoot_moment.h", sizes, records)
    return c_header("surefoot_tare.h", sizes, records)


def moment_constants(core: MomentFilter) -> tuple[Any, ...]:
    """List the sources of a moment filter's constants, by their names in ``sf_moment_config``."""
    own = {
        **{f"mode_{name}": [getattr(mode, name) for mode in modes.MODES] for name in modes.Mode._fields},
        "held": modes.MODES.index(modes.HELD),
        "steady": modes.MODES.index(modes.STEADY),
        "versus_slack": core.repairs.versus_start.slack,
        "versus_factor": versus_start.SLACK,
        "versus_explained": versus_start.EXPLAINED,
        "versus_memory": versus_start.MEMORY,
        "versus_independent": comparison.INDEPENDENT,
        "versus_sure": comparison.SURE,
        "talks": len(core.model.talk_to),
        "tare_variance": core.tare.variance,
        "loaded": core.tare.loaded,
        "tare_share": tares.LEAST_SHARE,
        "tare_surprise": tares.LARGEST_SURPRISE,
        "tare_leap": tares.LEAP,
    }
    parts = core, core.config, core.columns, core.blocks, core.spread, core.model
    return own, *parts, stream, model, tares, still, severity, columns, health, modes, motion, suspects


def _robot(front: FrontEnd, faults: ChannelFaults | None) -> tuple[Any, ...]:
    """List the sources of a robot's constants, by their names in ``sf_config``."""
    setup, (lowest, highest) = front.setup, front.plausible
    own = {"feet": len(setup.layout.feet), "lowest": lowest, "highest": highest}
    without: dict[str, Any] = dict.fromkeys(("leap", "renewal"), 0.0)
    without |= dict.fromkeys(("leap_alone", "prior", "by_others", "cells", "together"), np.zeros(0))
    of_faults = [part for part in (faults, faults and faults.stand_in) if part]
    return own, front, setup, setup.layout, setup.initial, front.motions, *of_faults, without
