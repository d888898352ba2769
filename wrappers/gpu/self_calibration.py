"""Calibrators for thousands of robots at once: readings and beliefs in, calibrated forces out, on the device.

    calibrator = SelfCalibrationModule(layout, "moment", env.num_envs, env.device, mass=35.0,
                                       dt=env.step_dt, lag=0, initial=feet.nominal)
    estimate = calibrator(counts, reference, step=env.common_step_counter)
    calibrator.reset(env_ids)

A step is one kernel made of the headers in ``native/``, with one thread per robot. Nothing is copied to the
host. The kernel computes in double precision for any dtype of the tensors, because the filters need it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from surefoot.calibration import (
    Estimate,
    FeetLayout,
    MomentumReference,
    OnlineSetup,
    Parameters,
    Reference,
    online_method,
)
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.moment.filter import MomentFilter
from surefoot.calibration.native import NativeFilter, constants_of
from surefoot.calibration.native.config import Constants
from surefoot.calibration.online import MethodOptions, resolve_method
from surefoot.calibration.setup import setup_from_options
from surefoot.calibration.state import check_leaves
from surefoot.calibration.weights.curves import Curves
from surefoot.names import page, plain_name
from surefoot.robot.beliefs.lag import waiting_samples
from surefoot.wrappers.gpu.batch import BatchModule, Counter, RobotIds, mask_of, views
from surefoot.wrappers.gpu.kernels import kernel, threads_at_once

_ADVANCE, _FROZEN, _FRESH, _RETRACT = 1, 2, 4, 8
"""Commands to a thread: take a step, do not learn, or in place of a step start afresh or retract the last
seconds, if its robot is marked."""

_HEADERS = "surefoot_moment", "surefoot_beliefs", "surefoot_tare"


def _block_sizes(setup: OnlineSetup, options: dict[str, Any]) -> dict[str, int]:
    """Return the sizes of arrays that only the moment filter has."""
    core = MomentFilter(setup, Moment(**options))
    talks = len(core.model.talk_to)
    return {"COMPONENTS": core.columns.components, "BLOCK": core.blocks.capacity, "TALKS": talks}


class _Steps(NamedTuple):
    """A method in C: its state, its workspace, its own constants, calls of its functions, its sizes."""

    state: str
    work: str
    own: str
    step: str
    retract: str = ""
    sizes: Callable[[OnlineSetup, dict[str, Any]], dict[str, int]] = lambda setup, options: {}


_STEPS = {
    "moment": _Steps(
        "sf_moment_state",
        "sf_moment_work",
        "sf_moment_config",
        "sf_moment_step(c, m, s, work, raw, &belief.reference, dt, out)",
        "sf_moment_retract(c, m, s)",
        _block_sizes,
    ),
    "tare": _Steps(
        "sf_tare_state",
        "char",
        "sf_tare_config",
        "sf_tare_step(c, m, s, raw, &belief.reference, dt, out)",
    ),
    "none": _Steps("sf_front", "char", "char", "sf_uncorrected_step(c, s, raw, &belief.reference, dt, out)"),
}

_BODY = """
    const sf_config *c = (const sf_config *)config.data;
    const {own} *m = (const {own} *)rest.data;
    {state} *s = ({state} *)state.data + robot;
    {work} *work = ({work} *)own.data + worker;
    if (what & 12) {{
        if (!((const unsigned char *)given.data)[robot]) return;
        if (what & 4) *s = *(const {state} *)more.data;
        else {{ {retract}; }}
        return;
    }}
    unsigned char *starts = (unsigned char *)marks.data + robot;
    int *waits = (int *)other.data + robot;
    if (!*starts && !(what & 1)) return;
    sf_belief belief = ((const sf_belief *)more.data)[robot];
    if (what & 2 || *waits > 0) {{ /* nothing is learnt of a reference that is not known */
        belief.reference.com[0] = (sf_real)NAN;
        memset(belief.reference.stance, 0, sizeof belief.reference.stance);
        memset(belief.reference.swing, 0, sizeof belief.reference.swing);
    }}
    *waits -= *waits > 0;
    *starts = 0;
    const sf_real *raw = (const sf_real *)given.data + (size_t)robot * c->channels;
    sf_estimate *out = (sf_estimate *)found.data + robot;
    (void)m, (void)work;
    {step};
"""


class SelfCalibrationModule(BatchModule):
    """Calibrate the feet of N robots while they move.

    **Steps** are counted as in :class:`~surefoot.wrappers.gpu.FootSensorsModule`: with the number of the
    step, from the argument ``step`` or from ``counter``, repeated calls in one step process the sample once.

    **Resets.** A robot that begins a new episode keeps its calibration, and nothing is learnt before its
    references are of the new episode. With ``fresh=True``, for a robot that got fresh sensors, it starts
    fresh.

    **Beliefs.** A reference must hold a robot's own knowledge of itself, never the simulator's truth: joint
    encoders and an IMU with their errors, and a model with a mass and a centre of mass that are a little off.

    Each robot is a :class:`~surefoot.calibration.FootCalibrator` of its own, with its numbers to rounding.

    Args:
        layout: How the channels make up the feet's wrenches.
        method: ``"moment"``, ``"tare"`` or ``"none"``, or options of one of them.
        num_envs: Number N of robots, one by default.
        device: Where everything is.
        dtype: Of readings and estimates, ``float32`` or ``float64``.
        mass: Mass of the robots as they believe it, in kg.
        dt: Time between steps in s. Options that count samples (``every``, ``average``, ``settle``) are made
            for 80 samples per second.
        lag: How many steps ago the readings were taken that a reference describes.
        initial: The map to start from, such as a :class:`FootSensorsModule`'s ``nominal``. By default
            readings are in newtons.
        curves: Curves of channels that are not linear, in front of all maps.
        counter: Returns the number of the simulation step.
        options: Further fields of :class:`~surefoot.calibration.online.OnlineSetup` and options of the
            method.

    Attributes:
        method: The method's name.
        setup: The method's setup.
        frozen: Whether nothing is learnt for the time being.

    Raises:
        ValueError: If the method or an option does not exist or lacks a kernel, or a value is not allowed.
    """

    def __init__(
        self,
        layout: FeetLayout,
        method: str | MethodOptions = "moment",
        num_envs: int = 1,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
        *,
        mass: float,
        dt: float = 1.0 / 50.0,
        lag: int = 0,
        initial: Parameters | None = None,
        curves: Curves | None = None,
        counter: Counter | None = None,
        **options: Any,
    ) -> None:
        super().__init__(num_envs, device, dtype, dt, counter)
        self.frozen = False
        self.method, options = resolve_method(method, options)
        self.setup, options = setup_from_options(
            layout, mass=mass, initial=initial, dt=dt, lag=lag, options=options
        )
        self._curves = _Straightener(curves, layout.channels, self.device)
        self._options = dict(sorted(options.items()))
        self._limits = dict(online_method(self.method, self.setup, **options).limits)
        if self.method not in _STEPS:
            raise ValueError(
                f"Method {self.method!r} has no kernel; methods that have one: {', '.join(_STEPS)}."
            )
        self._make_records(self._compile(options))

    def _compile(self, options: dict[str, Any]) -> Constants:
        """Choose the kernel, and return the constants of one robot.

        Raises:
            ValueError: If the method lacks a kernel for such a robot.
        """
        steps, layout = _STEPS[self.method], self.setup.layout
        sizes = {
            "CHANNELS": layout.channels,
            "FEET": len(layout.feet),
            "LAG": max(8, self.setup.lag),
            **steps.sizes(self.setup, options),
        }
        body, fits = _BODY.format(**steps._asdict()), ("surefoot_fits",)
        self._kernel = kernel("calibration", _HEADERS, body, fits, tuple(sizes.items()), False)
        constants = constants_of(self._kernel.library, self.method, self.setup, options)
        if constants is None:
            raise ValueError(
                f"There is no kernel of {self.method!r} for {len(layout.feet)} feet with the options "
                f"{self._options}; {page('native')} has its limits, and FootCalibrator none."
            )
        return constants

    def _make_records(self, constants: Constants) -> None:
        """Make the records of all robots."""
        native = NativeFilter(self._kernel.library, constants)
        places, work = native.library.places, _STEPS[self.method].work
        fresh, given, robots = native.pack(constants.like).now, native.references, self.num_envs
        self._config, self._fresh = self._record(constants.config), self._record(fresh)
        self._own = self._config if constants.own is None else self._record(constants.own)
        # Workspaces keep nothing between robots, so that robots of one thread share one.
        self._workers = min(robots, threads_at_once(self.device))
        self._work = self._nothing(
            self._workers, 1 if work == "char" else places[work.removeprefix("sf_")][""][2]
        )
        self._beliefs = {kind: self._record(record.now, robots) for kind, record in given.items()}
        self._state = self._register("state", self._fresh.expand(robots, -1))
        self._estimate = self._register("estimate", self._nothing(robots, places["estimate"][""][2]))
        self._waiting = self._register("waiting", torch.zeros(robots, dtype=torch.int32, device=self.device))
        self._kinds = {kind: record.dtype for kind, record in given.items()}
        self._layouts = fresh.dtype, native.estimate.now.dtype
        self._view()
        self._covariance = constants.covariance
        self._untold = constants.untold

    def forward(
        self, counts: Tensor, reference: Reference | MomentumReference, step: int | None = None
    ) -> Estimate:
        """Take in one sample of all robots.

        Args:
            counts: Readings, shape (N, K), NaN where no sample arrived.
            reference: The robots' beliefs ``lag`` steps ago, fields of shape (N, ...). Method ``"moment"``
                also accepts a :class:`~surefoot.calibration.MomentumReference`.
            step: Number of the simulation step, for a module without a ``counter``.

        Returns:
            The calibrated sample, the caller's own.

        Raises:
            TypeError: If readings or a field are not tensors, or the method does not accept the reference.
            ValueError: If a shape or a device is not the module's.
        """
        counts = self._bring(counts, "counts", (("channels",),), self.setup.layout.channels)
        kind = type(reference)
        if kind not in self._believed:
            names = " or a ".join(taken.__name__ for taken in self._believed)
            raise TypeError(f"'reference' must be a {names}, got {kind.__name__}.")
        believed = self._believed[kind]
        for name, values in reference._asdict().items():
            if name in believed:
                believed[name].copy_(self._belief(name, values, believed[name].shape))
        advances = self._begins(step)
        if advances or self._asked:
            told = _ADVANCE * advances + _FROZEN * self.frozen
            self._run(told, self._curves.straighten(counts.double()).contiguous(), self._beliefs[kind])
            self._asked = False
        one: dict[str, Any] = {name: self._copy(part) for name, part in self._found.items()}
        one |= dict.fromkeys(self._untold)
        if self._covariance is not None:
            one["covariance"] = self._copy(self._learnt[self._covariance])
        return Estimate(**{name: one.get(name) for name in Estimate._fields})

    def reset(self, env_ids: RobotIds = None, fresh: bool = False) -> None:
        """Start new episodes.

        Args:
            env_ids: Robots that begin an episode, by default all.
            fresh: Whether their calibration starts afresh.

        Raises:
            ValueError: If a robot does not exist.
        """
        mask = self._note_starting(env_ids)
        # Readings of the last episode wait for references for as long.
        age = float(np.max(self.setup.age))
        self._waiting.masked_fill_(mask, 0 if fresh else waiting_samples(self.setup.lag, age, self.dt))
        if fresh:
            self._run(_FRESH, mask, self._fresh)

    def retract(self, env_ids: RobotIds = None) -> None:
        """Undo the learning of the last seconds of robots that have fallen, because a fall begins earlier.

        Args:
            env_ids: The robots that have fallen, by default all.

        Raises:
            ValueError: If a robot does not exist.
        """
        self._run(_RETRACT, mask_of(env_ids, self.num_envs, self.device), self._fresh)

    def freeze(self, frozen: bool = True) -> None:
        """Stop or resume learning. The calibration is applied in both cases.

        Samples that were measured by now still count, so that estimates may move for another fraction of a
        second.

        Args:
            frozen: Whether to stop.
        """
        self.frozen = frozen

    def get_extra_state(self) -> dict[str, Any]:
        """Return everything for ``state_dict()``."""
        return self._state_of(self._kernel, self._identity()) | {"frozen": self.frozen}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore a result of :meth:`get_extra_state`. Later results are equal bit for bit.

        Raises:
            ValueError: If it is from another calibrator or has impossible values. It is not restored then.
        """
        if getattr(state.get("state"), "shape", None) == self._state.shape:
            saved = views(state["state"], self._layouts[0])
            leaves = {name: part.cpu().numpy() for name, part in saved.items()}
            check_leaves(leaves, self._limits, "The saved state is none to go on with")
        self._restore(self._kernel, state, self._identity())
        self.frozen = state["frozen"]

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)  # type: ignore[no-untyped-call]
        self._view()  # a copy of a view does not share memory with the copied tensor

    def _view(self) -> None:
        self._believed = {kind: views(self._beliefs[kind], layout) for kind, layout in self._kinds.items()}
        self._learnt = views(self._state, self._layouts[0])
        self._found = views(self._estimate, self._layouts[1])

    def _run(self, what: int, given: Tensor, more: Tensor) -> None:
        given_to = self._config, self._state, self._work, given, more, self._estimate, self._starting
        arrays = *given_to, self._waiting, self._own
        self._kernel.launch(self.num_envs, arrays, what, dt=self.dt, workers=self._workers)

    def _copy(self, part: Tensor) -> Tensor:
        """Return numbers of a kernel as the caller's own."""
        return part.to(self.dtype if part.is_floating_point() else part.dtype, copy=True)

    def _nothing(self, rows: int, size: int) -> Tensor:
        return torch.zeros((rows, size), dtype=torch.uint8, device=self.device)

    def _belief(self, name: str, values: Tensor, shape: torch.Size) -> Tensor:
        """Check one field of a reference."""
        if not isinstance(values, Tensor):
            raise TypeError(f"'reference.{name}' must be a torch tensor, got {type(values).__name__}.")
        if values.device != self.device:
            raise ValueError(
                f"'reference.{name}' is on {values.device}, but the module on {self.device}; make the module "
                f"with device='{values.device}'."
            )
        if values.shape != shape:
            raise ValueError(f"'reference.{name}' must have shape {tuple(shape)}, got {tuple(values.shape)}.")
        return values.detach()

    def _identity(self) -> dict[str, Any]:
        setup = self.setup
        return {
            "method": plain_name(self.method),
            "options": repr(self._options),
            "channels": " ".join(setup.layout.channel_names),
            "mass": float(setup.mass),
            "lag": int(setup.lag),
            "curves": self._curves.said,
            "age": np.asarray(setup.age, dtype=np.float64).tolist(),
            "initial": repr([[float(value) for value in part] for part in setup.initial]),
            "num_envs": self.num_envs,
            "dt": self.dt,
        }


class _Straightener:
    """Curves of channels on a device, as :class:`~surefoot.calibration.weights.curves.Curves` has them.

    Attributes:
        said: The curves in words, empty without curves.

    Raises:
        ValueError: If the number of channels differs.
    """

    def __init__(self, curves: Curves | None, channels: int, device: torch.device) -> None:
        if curves is not None and len(curves.knots) != channels:
            raise ValueError(f"'curves' are of {len(curves.knots)} channels, and the layout has {channels}.")
        self.said = repr(curves.as_plain()) if curves is not None and curves.any else ""
        self._cubics: list[tuple[int, Tensor, Tensor]] = []
        for i, cubic in (curves.cubics if curves is not None else {}).items():
            knots, powers = (torch.as_tensor(part.copy(), device=device) for part in (cubic.x, cubic.c))
            self._cubics.append((i, knots, powers))

    def straighten(self, counts: Tensor) -> Tensor:
        """Return straight readings, shape (N, K). A curve is extrapolated linearly beyond its ends."""
        if not self._cubics:
            return counts
        straight = counts.clone()
        for i, knot, powers in self._cubics:
            raw = counts[:, i].contiguous()
            inside = raw.clamp(knot[0], knot[-1])
            piece = (torch.searchsorted(knot, inside, right=True) - 1).clamp(0, len(knot) - 2)
            cubed, squared, slope, level = powers[:, piece]
            x = inside - knot[piece]
            rise = (3.0 * cubed * x + 2.0 * squared) * x + slope
            straight[:, i] = ((cubed * x + squared) * x + slope) * x + level + rise * (raw - inside)
        return straight
