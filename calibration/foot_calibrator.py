"""A calibrator for people at a robot: an online method that keeps its own state."""

from collections.abc import Mapping
from hashlib import sha256
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from surefoot.calibration.backend import FilterBackend, LibraryFilter, PythonFilter
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.front_end.readings import FrontState
from surefoot.calibration.layout import FeetLayout
from surefoot.calibration.native import NativeFilter, ReferenceRecord, native_filter
from surefoot.calibration.online import MethodOptions, online_method, resolve_method
from surefoot.calibration.parameters import Parameters
from surefoot.calibration.reference import GRAVITY, MomentumReference, Reference
from surefoot.calibration.setup import setup_from_options
from surefoot.calibration.state import load_state, mass_share, save_state
from surefoot.calibration.weights.curves import Curves
from surefoot.calibration.weights.known_map import read_map
from surefoot.names import plain_name
from surefoot.native import CALIBRATION, Library, StateRecord
from surefoot.pickles import OfOneVersion


class FootCalibrator(OfOneVersion):
    """Calibrate the feet of a robot while it moves.

    A thin object over the pure functions of :mod:`surefoot.calibration.online`, which carries their state
    along, for one robot. A method of this package runs in C where the library of
    :mod:`surefoot.calibration.native` lies, with the same numbers to rounding.

    Args:
        layout: How the channels make up the feet's wrenches.
        method: A key of :data:`~surefoot.calibration.online.METHODS`, ``"module:name"`` for one of yours, or
            options as a value, such as ``Moment(scale_std=0.2)``.
        mass: Mass of the robot as it believes it, in kg.
        initial: The map to start from, the nominal one or that of known weights; by default readings are
            taken for newtons. Also the JSON file that ``surefoot calibrate weights`` writes, or its contents,
            with its curves.
        curves: Curves of channels that are not linear, as known weights show them, in front of all maps.
        dt: Nominal time between samples in s.
        lag: How many samples ago the foot sample was taken that a reference describes: 2 at 80 Hz for
            telemetry that comes 20 ms late, 0 without delay.
        options: ``gravity`` in m/s^2 where it is not 9.81, and further fields of
            :class:`~surefoot.calibration.online.OnlineSetup` and options of the method.

    Raises:
        ValueError: If the method or an option does not exist, or a value has no meaning.

    >>> import numpy as np
    >>> from surefoot.calibration.layout import nao_shoe_layout
    >>> calibrator = FootCalibrator(nao_shoe_layout(), "none", mass=5.3, lag=0)
    >>> eye = np.broadcast_to(np.eye(3), (2, 3, 3))
    >>> soles = np.array([(0.0, 0.05, 0.0), (0.0, -0.05, 0.0)])
    >>> at_rest = Reference(
    ...     com=np.array([0.02397, 0.0, 0.26]),
    ...     com_acceleration=np.zeros(3),
    ...     angular_momentum_rate=np.zeros(3),
    ...     position_sole=soles,
    ...     R_level_sole=eye,
    ...     stance=np.ones(2, bool),
    ...     swing=np.zeros(2, bool),
    ...     accelerometer=np.array([0.0, 0.0, 9.81]),
    ...     gyroscope=np.zeros(3),
    ... )
    >>> estimate = calibrator.update(np.full(8, 6.5), at_rest)
    >>> estimate.vgrf, estimate.cop.round(4)
    (array([26., 26.]), array([0.024, 0.   ]))
    """

    def __init__(
        self,
        layout: FeetLayout,
        method: str | MethodOptions = "moment",
        *,
        mass: float,
        initial: Parameters | str | PathLike[str] | Mapping[str, Any] | None = None,
        curves: Curves | None = None,
        dt: float = 1.0 / 80.0,
        lag: int = 2,
        **options: Any,
    ) -> None:
        self.method, options = resolve_method(method, options)
        if isinstance(initial, str | PathLike | Mapping):
            initial, own = read_map(initial, layout.channel_names)
            curves = own if curves is None else curves
        self.setup, options = setup_from_options(
            layout, mass=mass, initial=initial, dt=dt, lag=lag, options=options
        )
        self._options = options
        self._curves = curves if curves is not None and curves.any else None
        if self._curves is not None and len(self._curves.knots) != layout.channels:
            raise ValueError(
                f"'curves' are of {len(self._curves.knots)} channels, and the layout has {layout.channels}."
            )
        self._begin()

    def _begin(self) -> None:
        """Build the method from the setup and the options, and choose who runs it."""
        self._pure = online_method(self.method, self.setup, **self._options)
        each = (native_filter(room, self.method, self.setup, self._options) for room in CALIBRATION.rooms())
        native = next(filter(None, each), None)
        self._backend: FilterBackend = LibraryFilter(native, self._pure) if native else self._in_python()

    def _in_python(self) -> PythonFilter:
        """Return the backend of a method in Python, which may be a user's."""
        state = self._pure.init(np.zeros(self.setup.layout.channels))
        # A method that learns nothing has no more than what it remembers of the stream.
        if not isinstance(getattr(state, "front", state), FrontState):
            raise TypeError(
                f"Method {self.method!r} has a state {type(state).__name__} without a FrontState as 'front'; "
                "see register_method of surefoot.calibration."
            )
        return PythonFilter(self._pure)

    def __getstate__(self) -> dict[str, Any]:
        kept = {**super().__getstate__(), "state": self.state}
        return {name: part for name, part in kept.items() if name not in ("_pure", "_backend")}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        state = kept.pop("state", None)
        super().__setstate__(kept)
        self._begin()
        self.state = state

    @property
    def state(self) -> Any:
        """The state, a value that can be kept and given back; ``None`` before the first sample."""
        return self._backend.state

    @state.setter
    def state(self, kept: Any) -> None:
        self._backend.state = kept

    @property
    def limits(self) -> Mapping[str, tuple[Any, Any]]:
        """Least and greatest values of the state's leaves that :meth:`load` accepts."""
        return self._pure.limits

    def update(
        self,
        raw: ArrayLike,
        reference: Reference | MomentumReference | ReferenceRecord,
        dt: float | None = None,
    ) -> Estimate:
        """Take in one sample.

        Args:
            raw: Readings, shape (K,). NaN: no sample arrived.
            reference: The robot's beliefs ``lag`` samples ago, in NumPy arrays, or a record; method
                ``"moment"`` takes a :class:`~surefoot.calibration.MomentumReference` as well.
            dt: Time since the last sample in s; the nominal one by default.

        Returns:
            The calibrated sample.

        Raises:
            ValueError: If an array has a wrong shape, such as that of several robots.
        """
        raw = np.asarray(raw, dtype=np.float64)
        if self._curves is not None:
            self.setup.layout.check_reading(raw)
            raw = self._curves.straighten(raw)
        return self._backend.update(raw, reference, self.setup.dt if dt is None else dt)

    @property
    def library(self) -> Library | None:
        """The library that it runs in, if it does."""
        return self._backend.library

    def native(self) -> tuple[NativeFilter, StateRecord] | None:
        """Return the library's filter and its state, for somebody who goes on with both.

        ``None`` where the filter runs in Python, or has curves in front of it that the library does not know.
        """
        return None if self._curves is not None else self._backend.native()

    def retract(self) -> None:
        """Take back the learning of the last seconds, for a robot that has fallen or was seized.

        Both begin before anybody notices. The moment filter goes back by 1.5 to 3 s, and hands out nothing
        new before it has learnt for 1.5 s again; other methods go on as they are.
        """
        self._backend.retract()

    def reset(self) -> None:
        """Drop all that was learnt: the next sample begins from the starting map."""
        self.state = None

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything that was learnt to a file, an ``.npz`` without pickles.

        Raises:
            RuntimeError: If no sample came yet.
            ValueError: If the state holds values that :meth:`load` would refuse, or something else than a
                regular file bears the name; the old file is left as it is.
        """
        if self.state is None:
            raise RuntimeError("There is nothing to save before the first update().")
        save_state(path, self.state, self.limits, **self._notes(), mass=repr(float(self.setup.mass)))

    def load(self, path: str | PathLike[str]) -> None:
        """Go on from a file that :meth:`save` wrote: estimates are the same, bit for bit.

        Only the comparison with the starting map (:attr:`Flag.WORSE_THAN_START`) begins again, as sensors may
        have changed meanwhile. The robot's mass may have changed by up to a fifth, for example with another
        battery: a warning says so, and the map of the channels is kept.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file is not from this method and setup, its arrays do not fit, or they hold
                impossible values; the calibration stays as it was.
        """
        fresh = self._pure.init(np.zeros(self.setup.layout.channels))
        state = load_state(path, fresh, self.limits, **self._notes())
        self.adopt(state, mass_share(path, float(self.setup.mass)))

    def adopt(self, state: Any, share: float = 1.0) -> None:
        """Go on from a state of this robot, when its mass was a share of the present one."""
        self.state = self._pure.adopt(state, share)

    def _notes(self) -> dict[str, str]:
        """Name the setup that a saved state belongs to."""
        setup = self.setup
        # Adding zero makes -0.0 the 0.0 that it equals.
        wrench_map = np.asarray(setup.layout.wrench_map, dtype=np.float64) + 0.0
        maps = zip(Parameters._fields, setup.initial, strict=True)
        return {
            "method": plain_name(self.method),
            # Offsets of earlier versions stood behind the scale: their states would be misread.
            **({"unknowns": "F = a (F0 + o)"} if self.method == "moment" else {}),
            "channels": " ".join(setup.layout.channel_names),
            # Files of earlier versions do not name it.
            **({"gravity": repr(float(setup.gravity))} if setup.gravity != GRAVITY else {}),
            "dt": repr(float(setup.dt)),
            "lag": str(int(setup.lag)),
            **({} if self._curves is None else {"curves": repr(self._curves.as_plain())}),
            **{f"initial.{name}": str(np.asarray(part, dtype=np.float64).tolist()) for name, part in maps},
            "wrench_map": f"{wrench_map.shape} {sha256(wrench_map.tobytes()).hexdigest()[:16]}",
        }
