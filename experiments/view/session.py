"""A simulated robot whose feet are read in three ways and can be changed while it walks. Nothing is drawn."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import surefoot
from surefoot.calibration import FootCalibrator, Parameters
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.online import method_entry
from surefoot.controllers import Stabiliser
from surefoot.envs.gait.footsteps import GaitTiming
from surefoot.envs.gait.pattern import plan_walk
from surefoot.experiments.logs.format import Log
from surefoot.experiments.policy.controllers import load_controller
from surefoot.experiments.view.shown import WAYS, Reading, Shown, check_method, show_feet
from surefoot.experiments.view.world import LiveWorld
from surefoot.experiments.walks.record import Recording
from surefoot.experiments.walks.walkers import STAND_TIME, TruthTap
from surefoot.robot.calibration import CalibrationSetup, RobotCalibration
from surefoot.robot.foot_view import FootView, default_parts
from surefoot.robot.sensing.instruments import layout_options, usual_cells
from surefoot.robot.sensing.live_errors import LiveErrors
from surefoot.robot.sensing.raw_view import TRUE_KEYS
from surefoot.sensors.presets import BAR_CELLS_ON_HX711
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration
from surefoot.wrappers.source import find_source, with_source

WALK = "surefoot/NaoWalk-v0"  # default environment
WALK_TIME = 60.0  # duration of a planned walk in s, standing included
LONGEST_RECORDING = 600.0  # time in s after which a recording ends by itself
ERROR_STREAM = 0x5F02  # number of the random stream of the live errors

START: Mapping[str, Any] = {
    "severity": 1.0,
    "drift": 1.0,
    "temperature": 0.0,
    "feed": "calibrated",
    "method": "moment",
    "payload": 0.0,
    "slope": 0.0,
    "speed": 0.04,
}
"""Settings that can be chosen before the power-up, with their default values."""

_RANGES = {"severity": (0.0, 10.0), "drift": (0.0, 100.0), "temperature": (-40.0, 60.0)}


class Change(NamedTuple):
    """One change: the number of steps since the power-up, the name of the setting, and its value."""

    step: int
    what: str
    value: Any


class _Line:
    """A calibrator and the observation that a controller gets from its estimate."""

    def __init__(self, env: SelfCalibration, sensors: FootSensors, method: str) -> None:
        setup, drawing = env.calibrator.setup, sensors.source.drawing
        known: dict[str, Any] = {"mass": setup.mass, "dt": setup.dt, "lag": setup.lag, "age": setup.age}
        known |= {"initial": sensors.instruments.nominal, **layout_options(env.layout, drawing)}
        self.calibrator = FootCalibrator(env.layout, method, **known)
        self.view = FootView(default_parts(drawing.flaw), env.layout, setup.mass, drawing.flaw)
        self.momentum = method_entry(method).momentum
        self.estimate: Estimate
        self.observation: Mapping[str, Any] = {}


class Session:
    """Steps an environment, reads its feet in three ways, and accepts changes between two steps.

    The true readings come from the simulator, the raw ones from the sensors by their data sheet. The
    calibrated ones come from a method that learns from the same counts. A method learns from the moment it is
    first chosen, and continues to learn when another one is chosen. The same seed and changes repeat the same
    session.

    Args:
        env_id: Name of the environment.
        seed: Seed of the first power-up.
        start: Entries of :data:`START` that differ.
        controller: One of :func:`~surefoot.experiments.policy.controllers.load_controller`. The default is
            the stabiliser if there is a walking pattern to follow, and zero actions otherwise.
        feet: Bodies that are the feet of a robot, if they cannot be guessed.
        soles: Whether feet without area get flat soles.

    Attributes:
        changes: All changes since the power-up, including the settings before it.
        over: Whether the episode has ended, so that a reset must follow.
        feeds: The entries of :data:`WAYS` that can be fed to the controller.
        settings: Present values of the entries of :data:`START`.
        walks: Whether the walk can be planned again at another speed.

    Raises:
        TypeError: If the environment is not built on MuJoCo.
        ValueError: If it does not have two feet with room for load cells, or a setting does not exist.
    """

    def __init__(
        self,
        env_id: str = WALK,
        *,
        seed: int = 0,
        start: Mapping[str, Any] | None = None,
        controller: str | None = None,
        feet: Sequence[str] | None = None,
        soles: bool = False,
    ) -> None:
        self.env_id, self.walks = env_id, env_id == WALK
        self._options = {"controller": controller, "feet": feet, "soles": soles}
        self.settings = dict(START) | dict(start or {})
        self._planned = float(self.settings["speed"])
        walk: dict[str, Any] = {"speed": self._planned, "duration": WALK_TIME, "stand_time": STAND_TIME}
        walk["push_impulse"] = (0.0, 0.0)
        self._tap = TruthTap(gym.make(env_id, disable_env_checker=True, **(walk if self.walks else {})))
        env = with_source(self._tap, feet=feet, soles=soles or None)
        source: Any = find_source(env)
        if source.drawing.position_cell_sole is None:
            raise ValueError(f"{source.drawing.flaw} Or give flat soles to feet without area, with --soles.")
        # Drift and temperature are simulated by LiveErrors, because they can be changed. The usual cells have
        # no temperature coefficients; those of cells of the same kind are scaled to their capacity.
        cells, known = usual_cells(source.drawing), BAR_CELLS_ON_HX711
        self._drifts = cells.scale_drift, cells.offset_drift
        self._tempcos = known.scale_tempco, known.offset_tempco * cells.capacity / known.capacity
        self._sensors = FootSensors(env, replace(cells, scale_drift=0.0, offset_drift=0.0))
        self._env = SelfCalibration(self._sensors, "none")
        robot = self._sensors.robot
        self._momentum = RobotCalibration(CalibrationSetup("Session", robot.equipment), robot)
        self.source, self.drawing, self.layout = source, source.drawing, self._env.layout
        self.dt, self.weight = float(source.dt), float(source.drawing.weight)
        self.world = LiveWorld(source)
        observed: Any = getattr(self._tap.observation_space, "spaces", {})
        self.feeds = WAYS if set(TRUE_KEYS) <= set(observed) else WAYS[1:]
        if self.settings["feed"] not in self.feeds:
            raise ValueError(f"There is no feed '{self.settings['feed']}'. Available: {self.feeds}.")
        self._controller = self._load_controller(controller)
        self.errors: LiveErrors
        self.changes: list[Change] = []
        self.fell = self.over = False
        self.steps = self._episode_steps = 0
        self._actions = self._list_actions()
        self.recording: Recording | None = None
        self.power_up(seed)

    def _list_actions(self) -> Mapping[str, Callable[[Any], None]]:
        return {
            **{what: partial(self._set, what) for what in _RANGES},
            "scale": partial(self._set_channel, "scale", -0.9, 2.0),
            "offset": partial(self._set_channel, "offset", -self.weight, self.weight),
            "fault": lambda words: self.errors.break_channel(str(words)),
            "repair": lambda _: self.errors.repair(),
            "push": self.world.push,
            "payload": lambda mass: self.world.load(float(mass)),
            "slope": lambda degrees: self.world.tilt(float(degrees)),
            "speed": self._check_speed,
            "feed": self._choose_feed,
            "method": self._choose_method,
            "reset": lambda _: self._reset(None),
        }

    def power_up(self, seed: int) -> None:
        """Begin again with the sensors, the robot and the random numbers of a seed, and without faults."""
        self.seed, self.steps = int(seed), 0
        self.changes = [Change(0, what, value) for what, value in self.settings.items()]
        rng = np.random.default_rng([ERROR_STREAM, self.seed])
        self.errors = LiveErrors(
            self._sensors.instruments, self._drifts, self._tempcos, self.drawing.sides, self.dt, rng
        )
        self._lines: dict[str, _Line] = {}
        for what in (*_RANGES, "payload", "slope"):
            # The default payload of a robot without a torso is not an error.
            if what != "payload" or self.world.carries:
                self._actions[what](self.settings[what])
        self._reset(self.seed)

    def change(self, what: str, value: Any = None) -> None:
        """Change something before the next step.

        | What | Value |
        |------|-------|
        | ``"severity"`` | factor of the sensors' errors |
        | ``"drift"`` | factor of the speed of their drift |
        | ``"temperature"`` | temperature of the cells above that at power-up in K |
        | ``"scale"``, ``"offset"`` | (channel, additional relative error, or error in N) |
        | ``"fault"`` | words, such as ``"left/2 dies"`` |
        | ``"repair"`` | ends all faults |
        | ``"push"`` | impulse (forward, left) in N s |
        | ``"payload"``, ``"slope"`` | in kg, in degrees |
        | ``"speed"`` | in m/s, from the next reset |
        | ``"feed"``, ``"method"`` | feed of the controller, and calibration method |
        | ``"reset"`` | starts another episode with the same feet and their calibration |

        Raises:
            ValueError: If the change is refused. Then nothing has changed.
        """
        if what not in self._actions:
            raise ValueError(f"There is no change '{what}'. Available: {', '.join(self._actions)}.")
        self._actions[what](value)
        if what in self.settings:
            self.settings[what] = value
        self.changes.append(Change(self.steps, what, value))

    def step(self) -> None:
        """Step the robot once with the action that the controller computes from its feed."""
        if self.over:
            raise RuntimeError("The episode has ended; change('reset') or power_up(seed) begins another.")
        observation, _, self.fell, truncated, _ = self._env.step(self._controller(self._fed))
        self.world.advance()
        self.steps += 1
        self._episode_steps += 1
        self._read_feet(observation)
        if self.fell:
            self._retract()
        self.over = bool(self.fell or truncated)
        reference, truth = self._env.reference, self.source.truth
        # Recording begins once the robot's own state is known.
        if self.recording is not None and np.isfinite(reference.com).all():
            force, undone = truth.force_cell[-1], self.errors.parameters
            self.recording.keep(self.time, self._raw, force, truth, undone, reference)

    @property
    def time(self) -> float:
        """Time since the start of the episode in s."""
        return self._episode_steps * self.dt

    @property
    def standing(self) -> bool:
        """Whether the robot still stands before it walks, which lets the calibrators begin."""
        return self.walks and self.time < STAND_TIME

    def state_to_draw(self) -> Shown:
        """Return the present sample."""
        truth = self.source.truth
        position, R = truth.position_sole[-1].copy(), truth.R_world_sole[-1].copy()
        force = np.asarray(truth.force_cell[-1], dtype=np.float64).copy()
        true = Reading(force, np.asarray(truth.vgrf()), np.asarray(truth.cop_world()))
        raw, calibrated = (
            line.estimate._replace(cop=line.observation["cop"])
            for line in (self._lines["none"], self._lines[self.settings["method"]])
        )
        return show_feet(self.time, position, R, raw, calibrated, true)

    def record(self) -> None:
        """Record from now on, to the end of the episode at the latest."""
        self.recording = Recording(self.dt)

    def stop_recording(self) -> Log:
        """Stop recording and return the log."""
        recording, self.recording = self.recording, None
        if recording is None or len(recording) < 2:
            raise ValueError("Nothing was recorded yet: record, and let the robot continue for a while.")
        setup = self._env.calibrator.setup
        about: dict[str, Any] = {"surefoot": surefoot.__version__, "start": "nominal", "fell": self.fell}
        about["view"] = {"env": self.env_id, "seed": self.seed, **self._options, "changes": self.changes}
        return recording.log(
            layout=self.layout,
            mass=float(setup.mass),
            nominal=self._sensors.instruments.nominal,
            calibrated=None,
            lag=int(setup.lag),
            seed=self.seed,
            about=about,
        )

    @property
    def record_is_full(self) -> bool:
        """Whether the recording must end now, because the episode has ended or it is too long."""
        if self.recording is None:
            return False
        return self.over or len(self.recording) * self.dt >= LONGEST_RECORDING

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    def _reset(self, seed: int | None) -> None:
        """Begin an episode. With a seed everything starts fresh; without one, the calibration continues."""
        speed = float(self.settings["speed"])
        if self.walks and speed != self._planned:
            self.source.pattern, self._planned = _plan(speed, WALK_TIME), speed
        self.recording = None
        self.world.put_down()
        observation, _ = self._env.reset(seed=seed)
        self._momentum.reset(seed)
        self.world.pick_up()
        if hasattr(self._controller, "reset"):
            self._controller.reset()
        self.fell = self.over = False
        self._episode_steps = 0
        if seed is not None:
            for method in dict.fromkeys(("none", self.settings["method"])):
                self._lines[method] = _Line(self._env, self._sensors, method)
        for line in self._lines.values():
            line.view.begin_episode()
        self._read_feet(observation)

    def _read_feet(self, observation: Mapping[str, Any]) -> None:
        sensors = self._sensors
        self._raw = self.errors.read(sensors.raw, Parameters(*sensors.true_parameters()))
        if self._momentum.believe(getattr(self.source, "command", None)):
            self._retract()
        for line in self._lines.values():
            self._update(line)
        self._observation = observation
        self._feed()

    def _retract(self) -> None:
        """Discard what was learnt while the robot fell."""
        for line in self._lines.values():
            line.calibrator.retract()

    def _update(self, line: _Line) -> None:
        reference = self._momentum.reference if line.momentum else self._env.reference
        line.estimate = line.calibrator.update(self._raw, reference)
        line.observation = line.view.show(line.estimate, self._env.beliefs.soles(self._sensors.time))

    def _feed(self) -> None:
        feed = self.settings["feed"]
        if feed == "true":
            parts: Mapping[str, Any] = {key: self._tap.seen[key] for key in TRUE_KEYS}
        else:
            parts = self._lines["none" if feed == "raw" else self.settings["method"]].observation
        self._fed = {**self._observation, **parts}

    def _load_controller(self, name: str | None) -> Any:
        layout = getattr(self.source, "state_layout", None)
        if name is None and layout is not None and "cop_reference" in layout:
            return Stabiliser(layout, engage_after=STAND_TIME if self.walks else 0.0)
        if name in (None, "zero"):
            space: Any = self._env.action_space
            still = np.zeros(space.shape, dtype=space.dtype)
            return lambda observation: still
        return load_controller(name, self._env)

    def _set(self, what: str, value: Any) -> None:
        setattr(self.errors, what, _within(what, value, *_RANGES[what]))

    def _set_channel(self, what: str, low: float, high: float, value: Any) -> None:
        channel, error = int(value[0]), float(value[1])
        if not 0 <= channel < self.layout.channels:
            raise ValueError(f"There is no channel {channel}; they are 0 to {self.layout.channels - 1}.")
        getattr(self.errors, what)[channel] = _within(what, error, low, high)

    def _check_speed(self, value: Any) -> None:
        if not self.walks:
            raise ValueError(f"Only '{WALK}' can be planned at another speed.")
        _plan(float(value), 3.0 * STAND_TIME)

    def _choose_feed(self, feed: Any) -> None:
        if feed not in self.feeds:
            raise ValueError(f"There is no feed '{feed}'. Available: {', '.join(self.feeds)}.")
        self.settings["feed"] = feed
        self._feed()

    def _choose_method(self, method: Any) -> None:
        method = check_method(method)
        if method not in self._lines:
            line = self._lines[method] = _Line(self._env, self._sensors, method)
            self._update(line)
        self.settings["method"] = method
        self._feed()


def _plan(speed: float, duration: float) -> Any:
    return plan_walk(speed, 0.0, duration, timing=GaitTiming(stand_time=STAND_TIME))


def _within(name: str, value: Any, low: float, high: float) -> float:
    number = float(value)
    if not low <= number <= high:
        raise ValueError(f"'{name}' must be from {low:g} to {high:g}, got {number:g}.")
    return number
