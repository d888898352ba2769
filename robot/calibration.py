"""The calibration of one robot's feet over all its episodes, with its knowledge of itself.

Wrappers of one robot and of many are made of it.
"""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Final, NamedTuple

import gymnasium as gym
import numpy as np

from surefoot.calibration import FootCalibrator, MomentumReference, Parameters, Reference
from surefoot.calibration.cop import FORCE_THRESHOLD
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.moment.config import Moment
from surefoot.calibration.native import ReferenceRecord
from surefoot.calibration.online import MethodOptions, method_entry, resolve_method
from surefoot.calibration.state import load_state, mass_share, save_state
from surefoot.checks import check_flag
from surefoot.names import plain_name
from surefoot.pickles import OfOneVersion
from surefoot.robot.beliefs.errors import USUAL, BeliefErrors, belief_errors
from surefoot.robot.beliefs.lag import check_lag, packets_per_join, usual_lag, waiting_samples
from surefoot.robot.beliefs.momentum import MomentumBeliefs, Touching
from surefoot.robot.beliefs.native import NativeBeliefs, native_beliefs
from surefoot.robot.beliefs.nominal import Masses, NominalModel
from surefoot.robot.beliefs.references import Beliefs
from surefoot.robot.chances import Chances
from surefoot.robot.foot_view import FootView, check_certainty, check_parts, default_parts, flaw_of
from surefoot.robot.native import SampleBackend, native_sample
from surefoot.robot.python import Outputs, believe
from surefoot.robot.sensing.equipment import Equipment
from surefoot.robot.sensing.instruments import layout_options
from surefoot.robot.sensing.sensors import RobotSensors
from surefoot.robot.starting_map import StartingMap
from surefoot.robot.streams import BELIEF_STREAM, check_stream, wants_fresh
from surefoot.sensors.presets import REFERENCE_WEIGHT


class Learnt(NamedTuple):
    """The memory that a robot keeps from episode to episode."""

    state: Any  # state of the calibrator
    initial: Parameters  # the map that it began from
    masses: Masses  # the robot's beliefs of its bodies


_ROBOT_FACTS: Final = frozenset({"curves", "dt", "layout", "mass"})  # which a user's own loop gives

ALIASED: Final = 4.0
"""Ripple of feet that are read in one substep of a control step: the last of ten substeps was from their mean
as far on a G1 that walks with targets held for 20 ms."""


def contact_force(weight: float) -> float:
    """Return the load in N above which a foot of a robot of this weight in N has a centre of pressure.

    It is 5 N under a NAO, and as much of the weight of heavier robots, whose cells are larger.
    """
    return FORCE_THRESHOLD * max(1.0, weight / REFERENCE_WEIGHT)


class CalibrationSetup:
    """How the robots of a kind are calibrated.

    Args:
        owner: The wrapper that asks, for messages.
        equipment: The equipment of each.
        method: As of :class:`~surefoot.wrappers.SelfCalibration`, like all that follow.
        initial: The map to start from.
        show: Parts of the observation; ``None`` for forces and the centres of pressure that there are.
        lag: How many samples ago a reference describes the feet; ``None`` for as few as the link allows.
        fresh: Whether calibration starts fresh at each reset.
        errors: How wrong the robots are about themselves.
        stream: Number of the random stream.
        options: Of the method.

    Attributes:
        method: Name of the method.
        given: Options of the method, as they were given.
        start: The map to start from.
        layout: The feet and their channels.
        ages: How old readings of each channel are on average when they are taken, in s, shape (K,).
        errors: How wrong the robots are about themselves.
        touching: The parts of the feet that may touch the ground.
        by_momentum: Whether the method learns from momentum.

    Raises:
        ValueError: If the method or an option does not exist, a value has no meaning, or the robot is none
            that a nominal model can be made of: one free body, hinge joints, feet.
    """

    def __init__(
        self,
        owner: str,
        equipment: Equipment,
        method: str | MethodOptions = "moment",
        /,
        *,
        initial: str | Parameters | Mapping[str, Any] = "nominal",
        show: Sequence[str] | None = None,
        lag: int | None = None,
        fresh: bool = False,
        errors: BeliefErrors | Mapping[str, Any] = USUAL,
        stream: int = BELIEF_STREAM,
        **options: Any,
    ) -> None:
        self.method, options = resolve_method(method, options)
        if own := sorted(_ROBOT_FACTS & options.keys()):
            raise ValueError(
                f"'{own[0]}' is no option of {owner}: it follows from the robot's model and its sensors. "
                "What the robot believes wrongly is 'errors', such as errors={'mass': 0.02}."
            )
        self.given = options
        self.errors = belief_errors(errors)
        instruments, drawing = equipment.instruments, equipment.drawing
        names = instruments.layout.channel_names
        self.start = StartingMap(initial, instruments.nominal, self.errors, names)
        check_stream(owner, stream)
        check_flag("fresh", fresh)
        show = default_parts(flaw_of(instruments.layout, drawing.flaw)) if show is None else show
        check_parts(show)
        self.layout, self.drawing, self.age = instruments.layout, drawing, instruments.age
        self.ages = instruments.ages
        self.lag, self.fresh, self.stream, self.show = lag, fresh, stream, tuple(show)
        usual = {"gravity": drawing.gravity, "force_threshold": contact_force(drawing.weight)}
        if equipment.seldom and self.method == "moment":
            usual["ripple"] = ALIASED
        if instruments.residue > Moment.tare_noise and self.method == "moment":
            usual["tare_noise"] = instruments.residue
        if instruments.cross_talk is not None and self.method == "moment":
            usual["cross_talk"] = instruments.cross_talk
        self.options = usual | layout_options(self.layout, drawing) | options
        self.touching, self.by_momentum = Touching.of(drawing), method_entry(self.method).momentum
        self._nominal = NominalModel.of_drawing(drawing, self.errors)
        if drawing.caveat:
            warnings.warn(drawing.caveat, stacklevel=3)
        self.mass = self._nominal.mass
        # Calibrators are made at resets; one now refuses bad options before the first step.
        self.calibrator(self.mass, self.start.known, 1.0 / 80.0, lag or 0)
        self.spaces = self.view().spaces
        check_certainty(self.show, self.method)

    def model(self) -> NominalModel:
        """Make a robot's model of itself, as drawn."""
        return self._nominal.another()

    def calibrator(self, mass: float, initial: Parameters | None, dt: float, lag: int) -> FootCalibrator:
        """Make a calibrator; arguments as of :class:`~surefoot.calibration.FootCalibrator`."""
        # What is handed out is of the last step, of which ideal cells give the mean: of its middle.
        age = np.maximum(self.ages - 0.5 * dt, 0.0)
        options: dict[str, Any] = {"age": age.tolist(), "curves": self.start.curves} | self.options
        return FootCalibrator(self.layout, self.method, mass=mass, initial=initial, dt=dt, lag=lag, **options)

    def view(self) -> FootView:
        """Make the view of one robot's feet."""
        drawing, rolls = self.drawing, self.touching.rolls
        return FootView(self.show, self.layout, self.mass, drawing.flaw, drawing.gravity, rolls)


class RobotCalibration(OfOneVersion):
    """One robot's beliefs and its calibrator.

    Args:
        setup: How it is calibrated.
        sensors: Its sensors.

    Attributes:
        calibrator: The calibrator, from the first reset on.
        initial: The map that it began from.
        model: The robot as it believes itself to be.
        beliefs: Its beliefs.
        late: How many samples ago that was.
        frozen: Whether nothing is learnt for now.
        made: Whether there was a reset.
    """

    def __init__(self, setup: CalibrationSetup, sensors: RobotSensors) -> None:
        self._setup, self._sensors = setup, sensors
        self.model = setup.model()
        self._view = setup.view()
        self._rng = np.random.default_rng()
        self._backend: SampleBackend | None = None
        self._chosen_for: Any = None
        self._timing: tuple[Any, int] | None = None
        self._estimate: tuple[int, Estimate] | None = None
        self.calibrator: FootCalibrator
        self.initial: Parameters
        self.beliefs: Beliefs | MomentumBeliefs | NativeBeliefs
        self.frozen = self.made = False
        self.late = 0
        self._chances = Chances()

    def judge(self) -> bool:
        """Warn, before a reset, if nothing was learnt for long; return whether that was done."""
        if not self.made or self.frozen or self._setup.method == "none":
            return False
        needs_swing = self._setup.method == "tare"
        return self._chances.judge(self._map_has_moved(), self._sensors.telemetry.dt, needs_swing)

    def reset(self, seed: int | None = None, choice: str | None = None) -> bool:
        """Start an episode, after the sensors did; results are kept, or calibration starts fresh.

        Args:
            seed: Of the reset.
            choice: ``"fresh"`` or ``"keep"``, if it was asked for.

        Returns:
            Whether it started fresh.
        """
        setup, sensors, telemetry = self._setup, self._sensors, self._sensors.telemetry
        if seed is not None:
            self._rng = np.random.default_rng([setup.stream, seed])
        fresh = wants_fresh(choice, seed, setup.fresh or sensors.sensors_fresh, self.made)
        if fresh:
            self._start_fresh()
        else:
            self._wait_out()
        if self._timing == (telemetry, self.late):
            self.beliefs = self.beliefs.begin_episode()
        else:
            self._timing = telemetry, self.late
            beliefs = Beliefs(
                self.model,
                telemetry.layout,
                telemetry.period,
                telemetry.link.delay,
                telemetry.averaged,
                lag=self.late,
                dt=telemetry.dt,
                joined=packets_per_join(telemetry.period),
                touching=setup.touching.places,
                rolls=setup.touching.rolls,
            )
            self.beliefs = native_beliefs(
                MomentumBeliefs(beliefs) if setup.by_momentum else beliefs, self.calibrator.library
            )
        self._view.begin_episode()
        self._choose()
        return fresh

    def _choose(self) -> None:
        """Choose who takes samples from here on: the one before if it is for the same parts."""
        before, calibrator = self._backend, self.calibrator
        if before is not None and self._chosen_for == (self.beliefs, calibrator):
            return
        if before is not None and before.sampled:
            self._keep_estimate()
        self._chosen_for = self.beliefs, calibrator
        self._backend = native_sample(self.beliefs, calibrator, self._view, self._chances)

    @property
    def backend(self) -> SampleBackend:
        """Who takes samples in this episode."""
        if self._backend is None:
            raise gym.error.ResetNeeded("There is no estimate before the first reset().")
        return self._backend

    def believe(self, command: Any) -> bool:
        """Take in packets and find the reference of one sample; return whether the robot has just fallen."""
        return believe(self.beliefs, self._sensors, self.reference_time, command, self.frozen, self._chances)

    def sample(self, command: Any) -> Outputs:
        """Take in one sample; return the observation and the ``info``, as fresh arrays."""
        shown, told = self.backend.sample(self._sensors, self.reference_time, command, self.frozen)
        told["lag"] = self.late
        return shown, told

    def retract(self) -> None:
        """Take back the latest learning of a robot that has fallen; the estimate is of before."""
        self._keep_estimate()
        self.calibrator.retract()

    @property
    def estimate(self) -> Estimate:
        """The calibrator's last estimate."""
        return self._keep_estimate()

    def _keep_estimate(self) -> Estimate:
        """Return the last estimate, made of the library's record when somebody asks first."""
        if self._estimate is None or self._estimate[0] != self._chances.samples:
            self._estimate = self._chances.samples, self.backend.estimate()
        return self._estimate[1]

    @property
    def reference(self) -> Reference | MomentumReference:
        """The last reference."""
        believed = self.beliefs.believed
        return believed.reference() if isinstance(believed, ReferenceRecord) else believed

    def learnt(self) -> Learnt:
        """Return the robot's memory.

        Raises:
            RuntimeError: If there was no reset.
        """
        if not self.made:
            raise RuntimeError("There is no calibrator before the first reset(), which makes it.")
        initial = Parameters(*(np.asarray(part, dtype=np.float64) for part in self.initial))
        return Learnt(self.calibrator.state, initial, self.model.masses)

    @property
    def drawn_mass(self) -> float:
        """The mass of the drawing in kg."""
        return self._setup.mass

    def take_over(self, learnt: Learnt, share: float = 1.0) -> None:
        """Go on with a saved memory of a robot whose mass was a share of the present one."""
        self.initial = learnt.initial
        if share == 1.0:
            self.model.masses = learnt.masses
        self._make()
        former = float(learnt.masses.mass.sum())
        self.calibrator.adopt(learnt.state, 1.0 if share == 1.0 else former / self.model.mass)
        self._choose()
        self._wait_out()

    def limits(self) -> dict[str, tuple[Any, Any]]:
        """Return the least and greatest values of saved numbers: start and body are somewhat like its own."""
        setup, (mass, inertia, com) = self.calibrator.setup, self.model.masses
        most, (scale, offset) = setup.plausible_weights, setup.initial
        ends = np.sort([scale / most, scale * most], axis=0)
        reach, least = np.abs(com).max() + most * setup.length, most * (np.abs(offset).max() + setup.weight)
        return {
            **self.calibrator.limits,
            "initial.scale": (ends[0], ends[1]),
            "initial.offset": (-least, least),
            "masses.mass": (mass / most, mass * most),
            "masses.inertia": (inertia / most, inertia * most),
            "masses.com": (-reach, reach),
        }

    def notes(self) -> dict[str, str]:
        """Name the robot and the sensors that a saved state belongs to."""
        setup, equipment = self._setup, self._sensors.equipment
        return {
            "robot": equipment.notes()["robot"],
            "channels": " ".join(setup.layout.channel_names),
            "method": f"{plain_name(setup.method)} {setup.given}",
            "timing": f"{self._sensors.telemetry.dt:.9g} s a sample, {self.late} samples late",
        }

    def __getstate__(self) -> dict[str, Any]:
        # The library's record, of which an estimate is made, stays behind.
        if self.made:
            self._keep_estimate()
        return {**super().__getstate__(), "_backend": None}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        super().__setstate__(kept)
        if self.made:
            self._choose()

    def _map_has_moved(self) -> bool:
        """Return whether the map is no longer the starting map."""
        start, now = self.calibrator.setup.initial, self.estimate
        return bool((now.scale != start.scale).any() or (now.offset != start.offset).any())

    @property
    def reference_time(self) -> float:
        """The moment that the last sample's reference describes, in s of the host's clock since the reset."""
        return float(self.reference_time_at(self._sensors.time))

    def reference_time_at(self, time: Any) -> Any:
        """Return the moment that a sample's reference describes, of the host's time, or of many."""
        return time - self.late * self._sensors.telemetry.dt - self._setup.age

    def _wait_out(self) -> None:
        """Learn nothing while the oldest sample that a reference needs is of the last episode."""
        self._chances.wait(waiting_samples(self.late, self._setup.age, self._sensors.telemetry.dt))

    def _start_fresh(self) -> None:
        """Draw the robot's errors about itself, and start from the starting map."""
        setup, telemetry, rng = self._setup, self._sensors.telemetry, self._rng
        self.model.draw(rng)
        self.initial = self._first_map(rng)
        link, period = telemetry.link, telemetry.period
        self.late = usual_lag(link, period, telemetry.dt, setup.age) if setup.lag is None else setup.lag
        check_lag(self.late, telemetry, setup.age)
        self._make()
        self._chances.wait(0)
        self.made = True

    def _make(self) -> None:
        dt = self._sensors.telemetry.dt
        self.calibrator = self._setup.calibrator(self.model.mass, self.initial, dt, self.late)

    def _first_map(self, rng: np.random.Generator) -> Parameters:
        """Find the map to start from."""
        start = self._setup.start
        if start.given:
            return start.known
        # Drawn for the data sheet's as well: whichever of the two it is, what is drawn later is the same.
        drawn = rng.standard_normal((2, self._setup.layout.channels))
        if not start.calibrated:
            return start.known
        return start.off(self._sensors.true_parameters(), drawn)


class CalibrationFace(ABC):
    """The common part of wrappers that calibrate, one robot or many."""

    @property
    @abstractmethod
    def _robots(self) -> Sequence[RobotCalibration]: ...

    def _gather(self) -> None:  # noqa: B027
        """Note that robots have other records; nothing to do for one."""

    @property
    def frozen(self) -> bool:
        """Whether nothing is learnt for now."""
        return self._robots[0].frozen

    def freeze(self, frozen: bool = True) -> None:
        """Learn nothing from now on, or learn again: readings are corrected by the calibration so far.

        Samples that were measured by now still count, so that estimates may move for another fraction of a
        second.
        """
        check_flag("frozen", frozen)
        for robot in self._robots:
            robot.frozen = frozen

    def save(self, path: str | PathLike[str]) -> None:
        """Write the calibration, and the masses that it rests on, to an ``.npz`` without pickles.

        Raises:
            RuntimeError: If the environment has not been reset.
        """
        first = self._robots[0]
        save_state(path, self._learnt(), first.limits(), **first.notes(), mass=repr(first.drawn_mass))

    def load(self, path: str | PathLike[str]) -> None:
        """Go on with the calibration of a file of :meth:`save`; a reset without a seed keeps it.

        The robot's mass may have changed by up to a fifth since. A warning says so: the map of the channels
        is kept, and the robot believes in its present masses.

        Raises:
            RuntimeError: If the environment has not been reset.
            ValueError: If the file is of other or of more robots, other sensors, another method or another
                lag.
        """
        like, first = self._learnt(), self._robots[0]
        found = load_state(path, like, first.limits(), **first.notes())
        share = mass_share(path, first.drawn_mass)
        for robot, learnt in zip(self._robots, (found,) if isinstance(like, Learnt) else found, strict=True):
            robot.take_over(learnt, share)
        self._gather()

    def _learnt(self) -> Any:
        """Return the memory of one robot as it is, and of many side by side."""
        found = tuple(robot.learnt() for robot in self._robots)
        return found[0] if len(found) == 1 else found
