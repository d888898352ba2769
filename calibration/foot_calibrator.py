"""The calibrator for a robot's control loop: an online method together with its state."""

from collections.abc import Mapping
from hashlib import sha256
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration.backend import FilterBackend, LibraryFilter, PythonFilter
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.front_end.ages import alignment_lag, mean_age
from surefoot.calibration.front_end.readings import LONGEST_GAP, FrontState
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

    It calls the pure functions of :mod:`surefoot.calibration.online` for one robot and stores their state.
    The methods of this package run in C if the library is compiled, with the same results up to rounding.

    Args:
        layout: How the channels make up the feet's wrenches.
        method: A key of :data:`~surefoot.calibration.online.METHODS`, ``"module:name"`` for a method of your
            own, or the options of a method, such as ``Moment(scale_std=0.2)``.
        mass: Mass of the robot as the robot knows it, in kg.
        initial: The starting map, for example the nominal one or one from known weights. Also the JSON file
            that ``surefoot calibrate weights`` writes, or its contents, with its curves. By default, readings
            are forces in newtons.
        curves: Curves that linearise the channels before all maps, as measured with known weights.
        dt: Nominal time between samples in s.
        lag: How many samples ago the foot sample was taken that a reference describes: 2 at 80 Hz for
            telemetry that arrives 20 ms late, 0 without delay.
        options: ``gravity`` in m/s^2 if it is not 9.81, further fields of
            :class:`~surefoot.calibration.online.OnlineSetup` and options of the method.

    Raises:
        ValueError: If the method or an option does not exist, or a value is out of range.

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
            initial, map_curves = read_map(initial, layout.channel_names)
            curves = map_curves if curves is None else curves
        self.setup, options = setup_from_options(
            layout, mass=mass, initial=initial, dt=dt, lag=lag, options=options
        )
        self._options = options
        self._curves = curves if curves is not None and curves.any else None
        if self._curves is not None and len(self._curves.knots) != layout.channels:
            raise ValueError(
                f"'curves' are for {len(self._curves.knots)} channels, but the layout has {layout.channels}."
            )
        self._begin()

    def _begin(self) -> None:
        """Build the method from the setup and the options, and choose its backend."""
        self._pure = online_method(self.method, self.setup, **self._options)
        libraries = CALIBRATION.rooms()
        filters = (native_filter(library, self.method, self.setup, self._options) for library in libraries)
        native = next(filter(None, filters), None)
        self._backend: FilterBackend = LibraryFilter(native, self._pure) if native else self._in_python()

    def _in_python(self) -> PythonFilter:
        """Return the Python backend of a method, which may be the user's."""
        state = self._pure.init(np.zeros(self.setup.layout.channels))
        # The state of a method that learns nothing is the FrontState itself.
        if not isinstance(getattr(state, "front", state), FrontState):
            raise TypeError(
                f"Method {self.method!r} has a state {type(state).__name__} without a FrontState as 'front'; "
                "see register_method of surefoot.calibration."
            )
        return PythonFilter(self._pure)

    def __getstate__(self) -> dict[str, Any]:
        attributes = {**super().__getstate__(), "state": self.state}
        return {name: value for name, value in attributes.items() if name not in ("_pure", "_backend")}

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        state = attributes.pop("state", None)
        super().__setstate__(attributes)
        self._begin()
        self.state = state

    @property
    def state(self) -> Any:
        """The state, a value that can be stored and set again, or ``None`` before the first sample."""
        return self._backend.state

    @state.setter
    def state(self, state: Any) -> None:
        self._backend.state = state

    @property
    def limits(self) -> Mapping[str, tuple[Any, Any]]:
        """Smallest and largest values of the state's leaves that :meth:`load` accepts."""
        return self._pure.limits

    def update(
        self,
        raw: ArrayLike,
        reference: Reference | MomentumReference | ReferenceRecord,
        dt: float | None = None,
        age: ArrayLike | None = None,
    ) -> Estimate:
        """Process one sample.

        Args:
            raw: Readings, shape (K,). NaN means that no reading arrived.
            reference: The robot's state estimate ``lag`` samples ago. The method ``"moment"`` also takes a
                :class:`~surefoot.calibration.MomentumReference`.
            dt: Time since the last sample in s, by default the nominal time.
            age: Age of each reading in s, shape (K,), from a device that reports when it converted: the time
                from the middle of the conversion until now. NaN or ``None`` stands for the mean ``age`` of
                :class:`~surefoot.calibration.online.OnlineSetup`.

        Returns:
            The calibrated sample.

        Raises:
            ValueError: If an array has a wrong shape, for example that of several robots.
        """
        raw = np.asarray(raw, dtype=np.float64)
        if self._curves is not None:
            self.setup.layout.check_reading(raw)
            raw = self._curves.straighten(raw)
        dt = self.setup.dt if dt is None else dt
        if age is None:
            return self._backend.update(raw, reference, dt)
        return self._backend.update(raw, reference, dt, self.lateness(age))

    def lateness(self, age: ArrayLike) -> Floats:
        """Return by how much readings of an age in s, shape (K,), are older than on average."""
        if np.shape(age) != (self.setup.layout.channels,):
            raise ValueError(
                f"'age' must hold one age in s for each of the {self.setup.layout.channels} channels, "
                f"got shape {np.shape(age)}."
            )
        late = np.asarray(age, dtype=np.float64) - mean_age(self.setup)
        # Readings of the future and of hours ago are errors of a clock.
        known = np.abs(late) <= LONGEST_GAP * self.setup.dt
        return np.where(known, late, 0.0)

    @property
    def aligned_lag(self) -> int:
        """How many samples ago the common moment of the aligned values of an estimate was."""
        return alignment_lag(self.setup)

    @property
    def library(self) -> Library | None:
        """The library in which the filter runs, or ``None`` if it runs in Python."""
        return self._backend.library

    def native(self) -> tuple[NativeFilter, StateRecord] | None:
        """Return the library's filter and its state, for callers that step them directly.

        ``None`` if the filter runs in Python, or has curves, which the library does not apply.
        """
        return None if self._curves is not None else self._backend.native()

    def retract(self) -> None:
        """Discard what was learnt in the last seconds, after the robot has fallen or was seized.

        Both begin before they are detected. The moment filter returns to its estimate of 1.5 to 3 s ago and
        keeps that until it has learnt for 1.5 s again. Other methods do nothing.
        """
        self._backend.retract()

    def reset(self) -> None:
        """Discard everything that was learnt. The next sample begins from the starting map."""
        self.state = None

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything that was learnt to an ``.npz`` file without pickles.

        Raises:
            RuntimeError: If there was no sample yet.
            ValueError: If the state holds values that :meth:`load` would refuse, or the path is not that of a
                regular file. An existing file is then left unchanged.
        """
        if self.state is None:
            raise RuntimeError("There is nothing to save before the first update().")
        save_state(path, self.state, self.limits, **self._notes(), mass=repr(float(self.setup.mass)))

    def load(self, path: str | PathLike[str]) -> None:
        """Continue from a file that :meth:`save` wrote, with bit-identical estimates.

        Only the comparison with the starting map (:attr:`Flag.WORSE_THAN_START`) begins again, because the
        sensors may have changed in the meantime. The robot's mass may have changed by up to a fifth, for
        example with another battery. This raises a warning, and the map of the channels is kept.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If the file belongs to another method or setup, or its arrays do not fit or are
                implausible. The calibration then does not change.
        """
        fresh = self._pure.init(np.zeros(self.setup.layout.channels))
        state = load_state(path, fresh, self.limits, **self._notes())
        self.adopt(state, mass_share(path, float(self.setup.mass)))

    def adopt(self, state: Any, share: float = 1.0) -> None:
        """Continue from a state that was saved when the robot's mass was ``share`` of the present one."""
        self.state = self._pure.adopt(state, share)

    def _notes(self) -> dict[str, str]:
        """Describe the setup that a saved state belongs to."""
        setup = self.setup
        # Adding zero turns -0.0 into 0.0.
        wrench_map = np.asarray(setup.layout.wrench_map, dtype=np.float64) + 0.0
        maps = zip(Parameters._fields, setup.initial, strict=True)
        return {
            "method": plain_name(self.method),
            # Earlier versions defined offsets after scaling, so their states must not be loaded.
            **({"unknowns": "F = a (F0 + o)"} if self.method == "moment" else {}),
            "channels": " ".join(setup.layout.channel_names),
            # Files of earlier versions do not contain gravity.
            **({"gravity": repr(float(setup.gravity))} if setup.gravity != GRAVITY else {}),
            "dt": repr(float(setup.dt)),
            "lag": str(int(setup.lag)),
            **({} if self._curves is None else {"curves": repr(self._curves.as_plain())}),
            **{f"initial.{name}": str(np.asarray(part, dtype=np.float64).tolist()) for name, part in maps},
            "wrench_map": f"{wrench_map.shape} {sha256(wrench_map.tobytes()).hexdigest()[:16]}",
        }
