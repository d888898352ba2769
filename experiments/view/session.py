"""A robot on feet that are read in three ways at once, and changed while it walks; nothing is drawn here."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

import surefoot
from surefoot.arrays import Floats
from surefoot.calibration import METHODS, FootCalibrator, MomentumReference, Parameters, Reference
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.online import method_entry
from surefoot.calibration.setup import method_name
from surefoot.controllers import Stabiliser
from surefoot.envs.gait.footsteps import GaitTiming
from surefoot.envs.gait.pattern import plan_walk
from surefoot.experiments.logs.format import Log
from surefoot.experiments.policy.controllers import load_controller
from surefoot.experiments.view.shown import WAYS, Reading, Shown, show_feet
from surefoot.experiments.view.world import LiveWorld
from surefoot.experiments.walks.record import Recording
from surefoot.experiments.walks.walkers import STAND_TIME, TruthTap
from surefoot.robot.calibration import CalibrationSetup, RobotCalibration
from surefoot.robot.foot_view import FootView, default_parts
from surefoot.robot.sensing.instruments import layout_options, usual_cells
from surefoot.robot.sensing.live_errors import LiveErrors
from surefoot.robot.sensing.raw_view import TRUE_KEYS
from surefoot.sensors import LoadCells
from surefoot.sensors.presets import BAR_CELLS_ON_HX711
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration
from surefoot.wrappers.source import find_source, with_source

WALK = "surefoot/NaoWalk-v0"  # the environment that is shown unless another is named
WALK_TIME = 60.0  # how long a plan of a walk is in s, standing included
LONGEST_RECORDING = 600.0  # time in s after which a recording ends by itself
ERROR_STREAM = 0x5F02  # number of the random stream that live errors draw from

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
"""What can be chosen before the power-up, and what it is unless somebody chooses."""

_RANGES = {"severity": (0.0, 10.0), "drift": (0.0, 100.0), "temperature": (-40.0, 60.0)}


class Change(NamedTuple):
    """One thing that was changed: the step since the power-up, the thing, and its value."""

    step: int
    what: str
    value: Any


class _Line:
    """One calibrator that is fed with the readings, and a controller's view of it."""

    def __init__(self, env: SelfCalibration, sensors: FootSensors, method: str) -> None:
        setup, drawing = env.calibrator.setup, sensors.source.drawing
        options: dict[str, Any] = {"age": setup.age, **layout_options(env.layout, drawing)}
        self.calibrator = FootCalibrator(
            env.layout,
            method,
            mass=setup.mass,
            initial=sensors.instruments.nominal,
            dt=setup.dt,
            lag=setup.lag,
            **options,
        )
        self.view = FootView(default_parts(drawing.flaw), env.layout, setup.mass, drawing.flaw)
        self.momentum = method_entry(method).momentum
        self.estimate: Estimate
        self.seen: Mapping[str, Any] = {}

    def update(self, raw: Floats, reference: Reference | MomentumReference, soles: Any) -> None:
        self.estimate = self.calibrator.update(raw, reference)
        self.seen = self.view.show(self.estimate, soles)


class Session:
    """Steps an environment, reads its feet in three ways, and takes changes between two steps.

    The true readings are the simulator's, the raw ones are those of the sensors by their data sheet, and the
    calibrated ones those of a method that learns from the same counts. A method learns from when it is first
    chosen, and goes on if another is chosen. The same seed and changes give the same session.

    ``start`` are the entries of :data:`START` that differ; the controller is one of
    :func:`~surefoot.experiments.policy.controllers.load_controller`, by default the stabiliser where there is
    a pattern to follow, and otherwise zeros; ``feet`` are bodies of a robot whose feet cannot be guessed, and
    with ``soles`` feet without area get flat ones.

    ``changes`` are all since the power-up, choices before it included; ``over`` says whether the episode has
    ended, so that the next step needs a reset; ``feeds`` are the possible ones of :data:`WAYS`, ``settings``
    the present choice of :data:`START`; ``walks`` says whether the walk can be planned afresh. TypeError if
    the environment is not built on MuJoCo; ValueError if it has no two feet with room for load cells, or a
    choice does not exist.
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
        self._made = {"controller": controller, "feet": feet, "soles": soles}
        self.settings = dict(START) | dict(start or {})
        self._planned = float(self.settings["speed"])
        options: dict[str, Any] = {}
        if self.walks:
            options = {"speed": self._planned, "duration": WALK_TIME, "stand_time": STAND_TIME}
            options["push_impulse"] = (0.0, 0.0)
        self._tap = TruthTap(gym.make(env_id, disable_env_checker=True, **options))
        env = with_source(self._tap, feet=feet, soles=soles or None)
        source: Any = find_source(env)
        if source.drawing.position_cell_sole is None:
            raise ValueError(f"{source.drawing.flaw} Or give flat soles to feet without area, with --soles.")
        self._sensors = self._wear(env, usual_cells(source.drawing))
        self._env = SelfCalibration(self._sensors, "none")
        # What methods that learn from momentum are given besides.
        robot = self._sensors.robot
        self._momentum = RobotCalibration(CalibrationSetup("Session", robot.equipment), robot)
        self.source, self.drawing, self.layout = source, source.drawing, self._env.layout
        self.dt = float(source.dt)
        self.world = LiveWorld(source)
        seen = self._tap.observation_space
        true = isinstance(seen, gym.spaces.Dict) and set(TRUE_KEYS) <= set(seen.spaces)
        self.feeds = WAYS if true else WAYS[1:]
        if self.settings["feed"] not in self.feeds:
            raise ValueError(f"There is no feed '{self.settings['feed']}'. Available: {self.feeds}.")
        self._controller = self._load_controller(controller)
        self._actions: Mapping[str, Callable[[Any], None]] = {
            **{what: partial(self._set, what) for what in _RANGES},
            "scale": partial(self._set_channel, "scale", -0.9, 2.0),
            "offset": partial(self._set_channel, "offset", -self.drawing.weight, self.drawing.weight),
            "fault": lambda words: self.errors.break_channel(str(words)),
            "repair": lambda _: self.errors.repair(),
            "push": self.world.push,
            "payload": lambda mass: self.world.load(float(mass)),
            "slope": lambda degrees: self.world.tilt(float(degrees)),
            "speed": self._check_speed,
            "feed": self._check_feed,
            "method": self._choose,
            "reset": lambda _: self._reset(None),
        }
        self.errors: LiveErrors
        self.changes: list[Change] = []
        self.fell = self.over = False
        self.steps = self._episode_steps = 0
        self.recording: Recording | None = None
        self.power_up(seed)

    def _wear(self, env: gym.Env[Any, Any], cells: LoadCells) -> FootSensors:
        """Put cells under the feet; their drift and warmth are those of LiveErrors, which can be changed."""
        self._walk_densities = cells.scale_drift, cells.offset_drift
        # The usual cells do not warm up; those whose data sheet says what that does are of the same kind.
        known = BAR_CELLS_ON_HX711
        self._tempcos = known.scale_tempco, known.offset_tempco * cells.capacity / known.capacity
        return FootSensors(env, replace(cells, scale_drift=0.0, offset_drift=0.0))

    def power_up(self, seed: int) -> None:
        """Begin again with the sensors, the robot and the chances of a seed, and nothing broken."""
        self.seed, self.steps = int(seed), 0
        self.changes = [Change(0, what, value) for what, value in self.settings.items()]
        rng = np.random.default_rng([ERROR_STREAM, self.seed])
        self.errors = LiveErrors(
            self._sensors.instruments, self._walk_densities, self._tempcos, self.drawing.sides, self.dt, rng
        )
        self._lines: dict[str, _Line] = {}
        for what in ("severity", "drift", "temperature", "payload", "slope"):
            # A robot without a torso carries nothing, which is no reason to refuse it.
            if what != "payload" or self.world.carries:
                self._actions[what](self.settings[what])
        self._reset(self.seed)

    def change(self, what: str, value: Any = None) -> None:
        """Change something before the next step.

        | What | Value |
        |------|-------|
        | ``"severity"`` | factor of the sensors' errors |
        | ``"drift"`` | factor of the speed of their drift |
        | ``"temperature"`` | how much warmer the cells are than at power-up in K |
        | ``"scale"``, ``"offset"`` | (channel, its own relative error, or its own error in N) |
        | ``"fault"`` | words, such as ``"left/2 dies"`` |
        | ``"repair"`` | nothing is broken any more |
        | ``"push"`` | impulse (forward, left) in N s |
        | ``"payload"``, ``"slope"`` | in kg, in degrees |
        | ``"speed"`` | in m/s, from the next reset on |
        | ``"feed"``, ``"method"`` | the controller's feed, and the calibrator |
        | ``"reset"`` | a new episode on the same feet, with their calibration |

        Raises:
            ValueError: If it is refused; nothing has changed then.
        """
        if what not in self._actions:
            raise ValueError(f"There is no change '{what}'. Available: {', '.join(self._actions)}.")
        self._actions[what](value)
        if what in self.settings:
            self.settings[what] = value
        self.changes.append(Change(self.steps, what, value))

    def step(self) -> None:
        """Step the robot once, by the controller's action on its feed; RuntimeError after the end."""
        if self.over:
            raise RuntimeError("The episode has ended; change('reset') or power_up(seed) begins another.")
        action = self._controller(self._fed)
        observation, _, self.fell, truncated, _ = self._env.step(action)
        self.world.advance()
        self.steps += 1
        self._episode_steps += 1
        self._take_in(observation)
        if self.fell:
            self._retract()
        self.over = bool(self.fell or truncated)
        reference, truth = self._env.reference, self.source.truth
        # Not before the robot knows where it is.
        if self.recording is not None and np.isfinite(reference.com).all():
            force, undone = truth.force_cell[-1], self.errors.parameters
            self.recording.keep(self.time, self._raw, force, truth, undone, reference)

    @property
    def time(self) -> float:
        """Time since the episode start in s."""
        return self._episode_steps * self.dt

    @property
    def standing(self) -> bool:
        """Whether the robot still stands, so that calibrators can begin, before it walks."""
        return self.walks and self.time < STAND_TIME

    def state_to_draw(self) -> Shown:
        """State to draw now."""
        truth = self.source.truth
        position, R = truth.position_sole[-1].copy(), truth.R_world_sole[-1].copy()
        force = np.asarray(truth.force_cell[-1], dtype=np.float64).copy()
        true = Reading(force, np.asarray(truth.vgrf()), np.asarray(truth.cop_world()))
        lines = self._lines["none"], self._lines[self.settings["method"]]
        found = (line.estimate._replace(cop=line.seen["cop"]) for line in lines)
        return show_feet(self.time, position, R, *found, true=true)

    def record(self) -> None:
        """Record from now on, to the end of the episode at the latest."""
        self.recording = Recording(self.dt)

    def stop_recording(self) -> Log:
        """Stop recording and return the log; ValueError if nothing was."""
        recording, self.recording = self.recording, None
        if recording is None or len(recording) < 2:
            raise ValueError("Nothing was recorded yet: record, and let the robot go on for a while.")
        setup = self._env.calibrator.setup
        about: dict[str, Any] = {"surefoot": surefoot.__version__, "start": "nominal", "fell": self.fell}
        about["view"] = {"env": self.env_id, "seed": self.seed, **self._made, "changes": self.changes}
        return recording.log(
            layout=self.layout,
            mass=float(setup.mass),
            nominal=self._sensors.instruments.nominal,
            calibrated=None,
            lag=int(setup.lag),
            seed=self.seed,
            about=about,
        )

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    @property
    def record_is_full(self) -> bool:
        """Whether a recording must be taken now: its episode has ended, or it is as long as it may be."""
        if self.recording is None:
            return False
        return self.over or len(self.recording) * self.dt >= LONGEST_RECORDING

    def _reset(self, seed: int | None) -> None:
        """Begin an episode: with a seed everything is fresh, without one feet and calibration stay."""
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
        self._take_in(observation)

    def _take_in(self, observation: Mapping[str, Any]) -> None:
        """Read the feet in all ways, and keep the controller's feed."""
        sensors = self._sensors
        self._raw = self.errors.read(sensors.raw, Parameters(*sensors.true_parameters()))
        if self._momentum.believe(getattr(self.source, "command", None)):
            self._retract()
        for line in self._lines.values():
            self._update(line)
        self._observation = observation
        self._feed()

    def _retract(self) -> None:
        """Take back the learning while the robot fell."""
        for line in self._lines.values():
            line.calibrator.retract()

    def _update(self, line: _Line) -> None:
        """Feed a calibrator with the sample, and with the reference that its method learns from."""
        reference = self._momentum.reference if line.momentum else self._env.reference
        line.update(self._raw, reference, self._env.beliefs.soles(self._sensors.time))

    def _feed(self) -> None:
        feed = self.settings["feed"]
        if feed == "true":
            seen: Mapping[str, Any] = {key: self._tap.seen[key] for key in TRUE_KEYS}
        else:
            seen = self._lines["none" if feed == "raw" else self.settings["method"]].seen
        self._fed = {**self._observation, **seen}

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
            raise ValueError(f"Only '{WALK}' is planned afresh at another speed.")
        _plan(float(value), 3.0 * STAND_TIME)

    def _check_feed(self, feed: Any) -> None:
        if feed not in self.feeds:
            raise ValueError(f"There is no feed '{feed}'. Available: {', '.join(self.feeds)}.")
        self.settings["feed"] = feed
        self._feed()

    def _choose(self, method: Any) -> None:
        method = check_method(method)
        if method not in self._lines:
            line = self._lines[method] = _Line(self._env, self._sensors, method)
            self._update(line)
        self.settings["method"] = method
        self._feed()


def check_method(name: Any) -> str:
    """Return a calibrator's name of today; ValueError if there is none: a page's word imports no module."""
    method = method_name(str(name))
    if method not in METHODS:
        raise ValueError(f"Method '{method}' does not exist. Available: {', '.join(map(repr, METHODS))}.")
    return method


def _plan(speed: float, duration: float) -> Any:
    return plan_walk(speed, 0.0, duration, timing=GaitTiming(stand_time=STAND_TIME))


def _within(name: str, value: Any, low: float, high: float) -> float:
    number = float(value)
    if not low <= number <= high:
        raise ValueError(f"'{name}' lies from {low:g} to {high:g}, got {number:g}.")
    return number
