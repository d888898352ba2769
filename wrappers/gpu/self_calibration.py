"""Calibrators for thousands of robots at once: readings and beliefs in, calibrated forces out, on the device.

    calibrator = SelfCalibrationModule(layout, "moment", env.num_envs, env.device, mass=35.0,
                                       dt=env.step_dt, lag=0, initial=feet.nominal)
    estimate = calibrator(counts, reference, step=env.common_step_counter)
    calibrator.reset(env_ids)

Nothing is copied to the host but a few bits a step: whether anything is to be done for faults.
"""

from typing import Any

import torch
from torch import Tensor

from surefoot.calibration import Estimate, FeetLayout, Parameters, Reference, online_method
from surefoot.calibration.episodes import begin_episode, select, update_frozen
from surefoot.calibration.setup import method_name, setup_from_options
from surefoot.names import plain_name
from surefoot.wrappers.gpu.batch import BatchModule, Counter, RobotIds, mask_of, restored, saved_leaves


class SelfCalibrationModule(BatchModule):
    """Calibrate the feet of N robots while they move.

    **Steps.** As of :class:`~surefoot.wrappers.gpu.FootSensorsModule`: with a step's number, from the
    argument ``step`` or from ``counter``, a sample is taken in once however often it is handed over.

    **Resets.** A robot that begins a new episode keeps what it has learnt, and nothing is learnt from samples
    on two sides of the seam. With ``fresh=True``, for a robot that got fresh sensors, it starts fresh.

    **Beliefs.** A reference must hold what a robot can know of itself, never the simulator's truth: joint
    encoders and an IMU with their errors, and a model with a mass and a centre of mass that are a little off.

    Args:
        layout: How the channels make up the feet's wrenches.
        method: A key of :data:`~surefoot.calibration.online.METHODS`.
        num_envs: Number N of robots.
        device: Where everything is.
        dtype: Of readings and estimates.
        mass: Mass of the robots as they believe it, in kg.
        dt: Time between steps in s. Options that count samples (``every``, ``average``, ``settle``) are made
            for 80 of them a second.
        lag: How many steps ago the readings were taken that a reference describes.
        initial: The map to start from, such as a :class:`FootSensorsModule`'s ``nominal``; by default
            readings are taken for newtons.
        counter: Returns the number of the simulation step.
        options: Further fields of :class:`~surefoot.calibration.online.OnlineSetup` and options of the
            method.

    Attributes:
        method: The method's name.
        setup: What the method was given.
        frozen: Whether nothing is learnt for the time being.

    Raises:
        ValueError: If the method or an option does not exist, or a value has no meaning.
    """

    def __init__(
        self,
        layout: FeetLayout,
        method: str,
        num_envs: int,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
        *,
        mass: float,
        dt: float = 1.0 / 50.0,
        lag: int = 0,
        initial: Parameters | None = None,
        counter: Counter | None = None,
        **options: Any,
    ) -> None:
        super().__init__(num_envs, device, dtype, dt, counter)
        self.method, self.frozen = method_name(method), False
        self.setup, options = setup_from_options(
            layout, mass=mass, initial=initial, dt=dt, lag=lag, options=options
        )
        self._method = online_method(self.method, self.setup, **options)
        self._options = dict(sorted(options.items()))
        self._fresh = self._method.init(
            torch.zeros((num_envs, layout.channels), dtype=dtype, device=self.device)
        )
        self._state = self._fresh
        self._estimate: Estimate | None = None

    def forward(self, counts: Tensor, reference: Reference, step: int | None = None) -> Estimate:
        """Take in one sample of all robots.

        Args:
            counts: Readings, shape (N, K); NaN where no sample arrived.
            reference: The robots' beliefs ``lag`` steps ago, fields of shape (N, ...).
            step: Number of the simulation step, if the module has no ``counter``.

        Returns:
            The calibrated sample. Its arrays may be the module's own: do not write into them.

        Raises:
            TypeError: If readings or a field are no tensor.
            ValueError: If a shape or a device is not the module's.
        """
        counts = self._bring(counts, "counts", (("channels",),), self.setup.layout.channels)
        reference = Reference(*(self._belief(name, part) for name, part in reference._asdict().items()))
        begins = self._begins(step)
        if self._estimate is not None and not begins and self._starting is None:
            return self._estimate
        state, estimate = self._update(counts, reference)
        if self._estimate is not None and not begins and self._starting is not None:
            # Asked again within a step: only robots whose episode has started since are updated.
            state = select(self._starting, state, self._state)
            estimate = select(self._starting, estimate, self._estimate)
        self._state, self._estimate, self._starting = state, estimate, None
        return estimate

    def reset(self, env_ids: RobotIds = None, fresh: bool = False) -> None:
        """Start new episodes.

        Args:
            env_ids: Robots that begin one; all by default.
            fresh: Whether their calibration starts fresh.

        Raises:
            ValueError: If there is no such robot.
        """
        mask = self._note_starting(env_ids)
        self._state = (select if fresh else begin_episode)(mask, self._fresh, self._state)

    def retract(self, env_ids: RobotIds = None) -> None:
        """Take back what robots have learnt in the last seconds: they have fallen, which began before.

        Args:
            env_ids: These robots; all by default.

        Raises:
            ValueError: If there is no such robot.
        """
        which = mask_of(env_ids, self.num_envs, self.device)
        self._state = self._method.retract(self._state, which)

    def freeze(self, frozen: bool = True) -> None:
        """Stop learning, or go on: what was learnt is applied either way, and stays bit for bit meanwhile.

        Args:
            frozen: Whether to stop.

        Raises:
            ValueError: If the method learns at every sample, ``every=1``, and so cannot be kept from it.
        """
        if frozen and self._options.get("every") == 1:
            raise ValueError(
                "A method that learns at every sample cannot be frozen; build it with 'every' of 2 or more."
            )
        if self.frozen and not frozen:
            everyone = mask_of(None, self.num_envs, self.device)
            self._state = begin_episode(everyone, self._fresh, self._state)
        self.frozen = frozen

    def get_extra_state(self) -> dict[str, Any]:
        """Return everything for ``state_dict()``."""
        estimate = self._estimate
        return {
            "identity": self._identity(),
            "leaves": saved_leaves(self._state),
            "estimate": None if estimate is None else saved_leaves(tuple(estimate)),
            **self._saved_steps(),
            "frozen": self.frozen,
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Go on, bit for bit, from what :meth:`get_extra_state` returned.

        Raises:
            ValueError: If it is of another calibrator.
        """
        self._check_saved(state, self._identity())
        self._state = restored(self._fresh, state["leaves"], self.device)
        estimate = state["estimate"]
        parts = () if estimate is None else restored(tuple(estimate), estimate, self.device)
        self._estimate = Estimate(*parts) if parts else None
        self._restore_steps(state)
        self.frozen = state["frozen"]

    def _update(self, counts: Tensor, reference: Reference) -> tuple[Any, Estimate]:
        if self.frozen:
            return update_frozen(self._method, self._state, counts, reference, self.dt)
        return self._method.update(self._state, counts, reference, self.dt)

    def _belief(self, name: str, values: Tensor) -> Tensor:
        """Check one field of a reference and bring it to the module's dtype, without its graph."""
        if not isinstance(values, Tensor):
            raise TypeError(f"'reference.{name}' must be a torch tensor, got {type(values).__name__}.")
        if values.device != self.device:
            raise ValueError(
                f"'reference.{name}' is on {values.device}, but the module on {self.device}; make the module "
                f"with device='{values.device}'."
            )
        return values if values.dtype == torch.bool else values.detach().to(self.dtype)

    def _identity(self) -> dict[str, Any]:
        setup = self.setup
        return {
            "method": plain_name(self.method),
            "options": repr(self._options),
            "channels": " ".join(setup.layout.channel_names),
            "mass": float(setup.mass),
            "lag": int(setup.lag),
            "initial": repr([[float(value) for value in part] for part in setup.initial]),
            "num_envs": self.num_envs,
            "dt": self.dt,
            "dtype": str(self.dtype),
        }
