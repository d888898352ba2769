"""Self-calibration of a robot while it walks, with what it knows of itself."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, NamedTuple, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from surefoot.calibration import FootCalibrator, Parameters, Reference
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.setup import method_name
from surefoot.calibration.state import load_state, save_state
from surefoot.names import plain_name
from surefoot.wrappers.belief_errors import USUAL, BeliefErrors, belief_errors
from surefoot.wrappers.beliefs import Beliefs
from surefoot.wrappers.chances import Chances
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.foot_view import DEFAULT, RAW, FootView, check_certainty, seen_below
from surefoot.wrappers.instruments import layout_options
from surefoot.wrappers.lag import check_lag, usual_lag, waiting_samples
from surefoot.wrappers.native_beliefs import NativeBeliefs, native_beliefs
from surefoot.wrappers.native_sample import NativeSample
from surefoot.wrappers.nominal import Masses, NominalModel
from surefoot.wrappers.source import (
    check_clock,
    check_stream,
    find_sensors,
    robot_note,
    split_options,
    wants_fresh,
)
from surefoot.wrappers.starting_map import StartingMap
from surefoot.wrappers.telemetry import Telemetry

BELIEF_STREAM = 0x5F01
"""Number of the random stream that the errors of the robot's beliefs are drawn from."""


class Learnt(NamedTuple):
    """What a robot takes with it from episode to episode.

    Attributes:
        state: State of the calibrator.
        initial: The map that it began from.
        masses: What the robot believes of its bodies.
    """

    state: Any
    initial: Parameters
    masses: Masses

    @classmethod
    def of(cls, calibrator: FootCalibrator, model: NominalModel) -> "Learnt":
        """Gather it."""
        initial = Parameters(*(np.asarray(part, dtype=np.float64) for part in calibrator.setup.initial))
        return cls(calibrator.state, initial, model.masses)


class SelfCalibration(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Calibrate the readings of :class:`FootSensors` while the robot moves, and observe the result.

    The observation gains, from the counts alone, what ``show`` names, and loses ``"foot_raw"`` unless that is
    named as well: counts are millions, which saturate a policy.

    | Key | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | ``"foot_force"`` (K) | calibrated channels, as ``"foot_raw"`` | -1000 | 1000 | N (N m) |
    | ``"cop_foot"`` (2, 2) | centre of pressure of each foot (left, right), sole frame | -1 | 1 | m |
    | ``"cop"`` (2) | centre of pressure of both feet, level frame | -1 | 1 | m |
    | ``"cop_valid"`` (3) | whether the total, left and right one are defined | 0 | 1 | 1 |
    | ``"foot_load"`` (K) | ``"foot_force"`` by the robot's weight | -1000 / weight | 1000 / weight | 1 (m) |
    | ``"foot_raw"`` (K) | readings as they come, see :class:`FootSensors` | 0 | 2^24 - 1 | count |
    | ``"wrench"`` (2, 6) | wrench of the ground on each sole, sole frame | -1000 | 1000 | N, N m |
    | ``"vgrf"`` (2) | vertical force on each foot, level frame | -1000 | 1000 | N |
    | ``"foot_force_std"`` (K) | standard deviation of ``"foot_force"`` | 0 | 1000 | N (N m) |
    | ``"cop_std"`` (2) | standard deviation of ``"cop"`` | 0 | 1 | m |
    | ``"foot_flags"`` (K) | :class:`~surefoot.calibration.estimate.Flag` bits | 0 | 2^31 - 1 | 1 |

    The first four are shown by default. A robot of more than 20 kg has wider bounds, five times its weight. A
    centre of pressure is defined above 5 N; below, the last one is held and flagged, as all are for feet
    without area. The reference that the calibrator holds the counts against is made of the robot's beliefs
    (telemetry and a nominal model with wrong masses, see :mod:`surefoot.wrappers.beliefs`), never of truth.
    Which feet stand and swing is what the environment's ``command`` plans, or else found by kinematics
    (:mod:`surefoot.wrappers.contacts`).

    ``info["surefoot"]`` gains ``"parameters"`` (``"scale"`` and ``"offset"``, each (K)), ``"covariance"`` (or
    ``None``), ``"flags"`` (K), ``"vgrf"`` (2) N, ``"reference"`` (a mapping of the fields of
    :class:`~surefoot.calibration.Reference`, and ``"known"``: where it is false they are 0) and ``"lag"``, by
    how many samples the reference is late.

    What was learnt is kept over resets, as the sensors are. Calibration starts fresh at a reset with a seed
    or with fresh sensors, and with ``fresh=True`` at each; ``options={"surefoot": {"calibration": choice}}``,
    ``"fresh"`` or ``"keep"``, decides for one.

    Args:
        env: An environment with :class:`FootSensors` around it.
        method: A key of :data:`surefoot.calibration.METHODS`.
        initial: The map to start from: ``"nominal"``, the data sheet's; ``"calibrated"``, what a
            calibration from known weights would have found just before the episode; or
            :class:`~surefoot.calibration.Parameters` (also as a mapping).
        show: What is observed. For a policy that scales nothing itself, ``("foot_load", "cop_foot", "cop",
            "cop_valid")``: none of it exceeds the order of one.
        lag: How many samples ago a reference describes the feet; by default as few as the link allows.
        fresh: Whether calibration starts fresh at each reset.
        errors: How wrong the robot is about itself, also as a mapping of some of the fields.
        stream: Number of the random stream, for other errors of beliefs on the same episode.
        options: Options of the method.

    Attributes:
        calibrator: The calibrator.
        beliefs: The robot's beliefs.
        reference_time: The moment that it describes, in s of the host's clock since the reset.
        frozen: Whether nothing is learnt for now.

    Raises:
        TypeError: If there is no :class:`FootSensors` below, or another wrapper of this kind, or if the
            observation is no ``Dict`` any more.
        RuntimeError: At a step, if a wrapper between both repeats steps or resets by itself.
        ValueError: If the method or an option does not exist, a value has no meaning, or the robot is none
            that a nominal model can be made of: one free body, hinge joints, two feet.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        method: str = "moment",
        *,
        initial: str | Parameters | Mapping[str, Any] = "nominal",
        show: Sequence[str] = DEFAULT,
        lag: int | None = None,
        fresh: bool = False,
        errors: BeliefErrors | Mapping[str, Any] = USUAL,
        stream: int = BELIEF_STREAM,
        **options: Any,
    ) -> None:
        method = method_name(method)
        sensors = find_sensors(env, SelfCalibration, FootSensors, gym.Wrapper)
        errors = belief_errors(errors, options)
        start = StartingMap(initial, sensors.instruments.nominal, errors)
        gym.utils.RecordConstructorArgs.__init__(
            self,
            method=method,
            initial=start.recorded(),
            show=list(show),
            lag=lag,
            fresh=fresh,
            errors=errors,
            stream=stream,
            **options,
        )
        gym.Wrapper.__init__(self, env)
        self._sensors = sensors
        check_stream("SelfCalibration", stream)
        self._method, self._start, self._stream = method, start, stream
        self._rng = np.random.default_rng()
        drawing = sensors.source.drawing
        if len(drawing.feet) != 2:
            raise ValueError(
                f"SelfCalibration needs a robot on two feet, got the feet {drawing.feet}: name two, or use "
                "FootSensors alone."
            )
        self._model = NominalModel.of_drawing(drawing, errors)
        self.layout = sensors.instruments.layout
        self._options = layout_options(self.layout, drawing, method) | options
        self._lag, self._fresh = lag, fresh
        self._age = sensors.instruments.age
        # A calibrator is made at a reset; one now refuses bad options before the first step.
        self._calibrator(start.known, 1.0 / 80.0, lag or 0)
        self._view = FootView(show, self.layout, self._model.mass, drawing.flaw)
        self._native: NativeSample | None = None
        check_certainty(show, method)
        space = env.observation_space
        if not isinstance(space, spaces.Dict):
            raise TypeError(
                "SelfCalibration adds to a Dict of observations, as FootSensors shows them, and found "
                f"{type(space).__name__}; wrap in this order, and whatever changes observations around both: "
                f"SelfCalibration(FootSensors(env)). Got {env}."
            )
        sensors.listen()
        self._show = tuple(show)
        self.observation_space = spaces.Dict(seen_below(space.spaces, show) | self._view.spaces)
        self.calibrator: FootCalibrator
        self.beliefs: Beliefs | NativeBeliefs
        self.reference_time = 0.0
        self._estimate: Estimate | None = None
        self.frozen = self._made = False
        self._waiting = 0
        self._chances = Chances()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment; what was learnt is kept, or calibration starts fresh.

        Args:
            seed: Seeds the environment, the sensors and the errors of the beliefs; calibration starts fresh.
            options: ``options["surefoot"]["calibration"]`` may be ``"fresh"`` or ``"keep"``; handed on.

        Raises:
            ValueError: If a choice does not exist, or the lag needs more telemetry than is kept.
        """
        _, asked = split_options(options, "sensors", "calibration")
        if self._made and not self.frozen and self._method != "none":
            self._chances.judge(self._moved(), self.calibrator.setup.dt)
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._rng = np.random.default_rng([self._stream, seed])
        sensors, always = self._sensors, self._fresh or self._sensors.sensors_fresh
        telemetry = sensors.telemetry
        if wants_fresh(asked.get("calibration"), seed, always, self._made):
            self._start_fresh(telemetry)
        else:
            self._wait_out()
        link, where = telemetry.link, telemetry.layout
        self.beliefs = native_beliefs(
            Beliefs(
                self._model,
                where,
                telemetry.period,
                link.delay,
                telemetry.averaged,
                lag=self._late,
                dt=telemetry.dt,
            )
        )
        self._view.begin_episode()
        return self._calibrate(observation, info), info

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment and calibrate by one sample."""
        before = self._sensors.time
        observation, reward, terminated, truncated, info = self.env.step(action)
        check_clock("SelfCalibration", self.env, self._sensors.time - before, self._sensors.telemetry.dt)
        observation = self._calibrate(observation, info)
        if terminated:
            # Mostly a fall, which began some moments ago; the estimate is of before.
            self._estimate = self.estimate
            self.calibrator.retract()
        return observation, reward, terminated, truncated, info

    @property
    def estimate(self) -> Estimate:
        """The calibrator's last estimate."""
        if self._estimate is None:
            if self._native is None:
                raise gym.error.ResetNeeded("There is no estimate before the first reset().")
            self._estimate = self._native.estimate()
        return self._estimate

    @property
    def reference(self) -> Reference:
        """The calibrator's last reference."""
        believed = self.beliefs.believed
        return believed if isinstance(believed, Reference) else believed.reference()

    def freeze(self, frozen: bool = True) -> None:
        """Learn nothing from now on, or learn again: readings are corrected by what was learnt so far.

        What was measured by now still counts, so that estimates may move for another fraction of a second.
        """
        self.frozen = frozen

    def save(self, path: str | PathLike[str]) -> None:
        """Write what was learnt, and the masses that it rests on, to an ``.npz`` without pickles.

        Raises:
            RuntimeError: If the environment has not been reset.
        """
        save_state(path, self._learnt(), **self._notes())

    def load(self, path: str | PathLike[str]) -> None:
        """Go on with what a file of :meth:`save` has learnt; a reset without a seed keeps it.

        Raises:
            RuntimeError: If the environment has not been reset.
            ValueError: If the file is of another robot, other sensors, another method or another lag.
        """
        learnt: Learnt = load_state(path, self._learnt(), **self._notes())
        self._model.masses = learnt.masses
        self.calibrator = self._calibrator(learnt.initial, self.calibrator.setup.dt, self._late)
        self.calibrator.state = learnt.state
        self._wait_out()

    def __getstate__(self) -> dict[str, Any]:
        # The library's record, of which an estimate is made, stays behind.
        return {**vars(self), "_estimate": self.estimate if self._made else None}

    def _moved(self) -> bool:
        """Return whether the map is no longer the starting map."""
        start, now = self.calibrator.setup.initial, self.estimate
        return bool((now.scale != start.scale).any() or (now.offset != start.offset).any())

    def _wait_out(self) -> None:
        """Learn nothing while the oldest sample that a reference needs is of the last episode."""
        self._waiting = waiting_samples(self._late, self._age, self._sensors.telemetry.dt)

    def _learnt(self) -> Learnt:
        if not self._made:
            raise RuntimeError("There is no calibrator before the first reset(), which makes it.")
        return Learnt.of(self.calibrator, self._model)

    def _notes(self) -> dict[str, str]:
        setup = self.calibrator.setup
        return {
            "method": f"{plain_name(self._method)} {self._options}",
            "robot": robot_note(self._sensors.source),
            "channels": " ".join(self.layout.channel_names),
            "timing": f"{setup.dt:.9g} s a sample, {setup.lag} samples late",
        }

    def _start_fresh(self, telemetry: Telemetry) -> None:
        """Draw what the robot is wrong about, and start from the starting map."""
        rng = self._rng
        self._model.draw(rng)
        initial = self._initial(rng)
        self._late = usual_lag(telemetry, self._age) if self._lag is None else self._lag
        check_lag(self._late, telemetry, self._age)
        self.calibrator = self._calibrator(initial, telemetry.dt, self._late)
        self._made, self._waiting = True, 0

    def _calibrate(self, observation: dict[str, Any], info: dict[str, Any]) -> dict[str, Any]:
        """Take in the packets that have arrived and one sample."""
        sensors = self._sensors
        self.reference_time = sensors.time - self._late * sensors.telemetry.dt - self._age
        hold, command = self.frozen or self._waiting > 0, getattr(sensors.source, "command", None)
        self._waiting = max(self._waiting - 1, 0)
        beliefs, native = self.beliefs, self._by_library()
        arrived = None if native is None else sensors.arrived()
        if arrived is None:
            beliefs.update(sensors.packets)
        if native is not None:
            self._estimate = None  # made of the library's record when somebody asks
            shown, told = native.step(
                sensors.raw, (self.reference_time, sensors.time), command, hold, arrived
            )
        else:
            if beliefs.sample(self.reference_time, command, hold):
                self.calibrator.retract()
            self._estimate = estimate = self.calibrator.update(sensors.raw, beliefs.believed)
            shown = self._view.show(estimate, beliefs.soles(sensors.time))
            # Copies, as an estimate may hold arrays of the one before.
            told = {
                "parameters": {"scale": estimate.scale.copy(), "offset": estimate.offset.copy()},
                "covariance": None if estimate.covariance is None else estimate.covariance.copy(),
                "flags": estimate.flags.copy(),
                "vgrf": estimate.vgrf.copy(),
                "reference": beliefs.info(),
            }
        self._chances.add(beliefs.known, beliefs.standing)
        told["lag"] = self._late
        info.setdefault("surefoot", {}).update(told)
        seen = {**observation, **shown}
        if RAW not in self._show:
            seen.pop(RAW, None)
        return seen

    def _by_library(self) -> NativeSample | None:
        """Return what takes in a whole sample in one call; ``None`` where Python does it, or its parts."""
        beliefs, native = self.beliefs, self.calibrator.native()
        if native is None or not isinstance(beliefs, NativeBeliefs):
            self._native = None
        elif self._native is None or not self._native.goes_on(beliefs, native[1]):
            self._native = NativeSample(beliefs, *native, self._view, self.calibrator.setup.dt)
        return self._native

    def _initial(self, rng: np.random.Generator) -> Parameters:
        """Find the map to start from."""
        start = self._start
        if start.given:
            return start.known
        # Drawn for the data sheet's as well: whichever of the two it is, what is drawn later is the same.
        drawn = rng.standard_normal((2, self.layout.channels))
        if not start.calibrated:
            return start.known
        return start.off(Parameters(*self._sensors.true_parameters()), drawn)

    def _calibrator(self, initial: Parameters, dt: float, lag: int) -> FootCalibrator:
        return FootCalibrator(
            self.layout,
            self._method,
            mass=self._model.mass,
            initial=initial,
            dt=dt,
            lag=lag,
            **self._options,
        )
