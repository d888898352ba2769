"""Lets a robot calibrate its feet while it walks, with what it knows of itself."""

from collections import deque
from collections.abc import Mapping
from math import ceil
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.calibration import FeetLayout, FootCalibrator, FootLayout, Parameters, Reference
from surefoot.calibration.estimate import Estimate
from surefoot.envs import below_cells, load_nao_spec
from surefoot.wrappers.beliefs import HISTORY, Beliefs
from surefoot.wrappers.foot_sensors import FootSensors, check_stream
from surefoot.wrappers.nominal import NominalModel

BELIEF_STREAM = 0x5F01
"""Number of the random stream that the errors of the robot's beliefs are drawn from."""

CONTACT_MARGIN = 4
"""Samples by which a planned stance or swing must hold before and after one to be sure of it: joints follow
their targets late, and feet land when the ground comes."""

FORCE_BOUND, COP_BOUND = 1000.0, 1.0


class SelfCalibration(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Calibrate the counts of :class:`FootSensors` as the robot goes, and observe what they say.

    The observation keeps ``"foot_raw"`` and gains, from the counts alone,

    | Key | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | ``"foot_force"`` (8) | calibrated forces of the cells, as ``"foot_raw"`` | -1000 | 1000 | N |
    | ``"cop_foot"`` (2, 2) | centre of pressure of each foot (left, right), sole frame | -1 | 1 | m |
    | ``"cop"`` (2) | centre of pressure of both feet, level frame | -1 | 1 | m |
    | ``"cop_valid"`` (3) | whether the total, left and right one are defined | 0 | 1 | 1 |

    A centre of pressure is defined above 5 N; below, the last one is held and flagged. The reference that
    the calibrator holds the counts against is made of the robot's beliefs (telemetry and a nominal model with
    wrong masses, see :mod:`surefoot.wrappers.beliefs`), never of truth.

    ``info["surefoot"]`` gains ``"parameters"`` (:class:`~surefoot.calibration.Parameters`), ``"covariance"``
    (or ``None``), ``"flags"`` (8), ``"vgrf"`` (2) N, ``"reference"``
    (:class:`~surefoot.calibration.Reference`) and ``"lag"``, by how many samples the reference is late.

    Args:
        env: An environment with :class:`FootSensors` around it.
        method: A key of :data:`surefoot.calibration.METHODS`.
        initial: The map to start from: ``"nominal"``, the data sheet's; ``"bench"``, what a bench would have
            found just before the episode; or :class:`~surefoot.calibration.Parameters` (also as a mapping).
        lag: How many samples ago a reference describes the feet; by default as few as the link allows.
        mass_error: Relative error of the mass that the robot believes it has.
        com_offset: Distance in m by which its believed centre of mass is off.
        bench_scale_error: Relative standard deviation of a scale from the bench.
        bench_offset_error: Standard deviation of an offset from the bench in N.
        stream: Number of the random stream, for other errors of beliefs on the same episode.
        options: Options of the method.

    Attributes:
        calibrator: The calibrator of this episode.
        beliefs: The robot's beliefs.
        reference: What the calibrator was last told.
        reference_time: The moment that it describes, in s of the host's clock since the reset.
        estimate: What it last said.

    Raises:
        TypeError: If there is no :class:`FootSensors` below, or another wrapper of this kind, or if the
            observation is no ``Dict`` any more.
        ValueError: If the method or an option does not exist, or a value has no meaning.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        method: str = "surefoot",
        *,
        initial: str | Parameters | Mapping[str, Any] = "nominal",
        lag: int | None = None,
        mass_error: float = 0.005,
        com_offset: float = 0.003,
        bench_scale_error: float = 0.001,
        bench_offset_error: float = 0.02,
        stream: int = BELIEF_STREAM,
        **options: Any,
    ) -> None:
        sensors = _foot_sensors(env)
        start = _initial(initial, sensors.config.channels)
        gym.utils.RecordConstructorArgs.__init__(
            self,
            method=method,
            initial=start
            if isinstance(start, str)
            else {"scale": start.scale.tolist(), "offset": start.offset.tolist()},
            lag=lag,
            mass_error=mass_error,
            com_offset=com_offset,
            bench_scale_error=bench_scale_error,
            bench_offset_error=bench_offset_error,
            stream=stream,
            **options,
        )
        gym.Wrapper.__init__(self, env)
        self._sensors = sensors
        check_stream("SelfCalibration", stream)
        for name, value in {
            "bench_scale_error": bench_scale_error,
            "bench_offset_error": bench_offset_error,
        }.items():
            if not 0.0 <= value < float("inf"):
                raise ValueError(f"'{name}' must be finite and not negative, got {value}.")
        self._method, self._initial, self._options = method, start, options
        self._bench_error = (bench_scale_error, bench_offset_error)
        self._stream = stream
        self._rng = np.random.default_rng()
        self._model = NominalModel(load_nao_spec(), mass_error=mass_error, com_offset=com_offset)
        self.layout = _layout(self.unwrapped)
        self._lag = lag
        # A calibrator is made at each reset; one now refuses bad options before the first step.
        trial = self._nominal() if isinstance(start, str) else start
        self._calibrator(trial, 1.0 / 80.0, lag or 0)
        space = env.observation_space
        if not isinstance(space, spaces.Dict):
            raise TypeError(
                "SelfCalibration adds to a Dict of observations, as FootSensors shows them, and found "
                f"{type(space).__name__}; wrap in this order, and whatever changes observations around both: "
                f"SelfCalibration(FootSensors(env)). Got {env}."
            )
        self.observation_space = spaces.Dict(
            dict(space.spaces)
            | {
                "foot_force": spaces.Box(-FORCE_BOUND, FORCE_BOUND, (self.layout.channels,), np.float32),
                "cop_foot": spaces.Box(-COP_BOUND, COP_BOUND, (2, 2), np.float32),
                "cop": spaces.Box(-COP_BOUND, COP_BOUND, (2,), np.float32),
                "cop_valid": spaces.MultiBinary(3),
            }
        )
        self.calibrator: FootCalibrator
        self.beliefs: Beliefs
        self.reference: Reference
        self.reference_time = 0.0
        self.estimate: Estimate

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, and forget what was learnt.

        Args:
            seed: Seeds the environment, the sensors and the errors of the beliefs.
            options: Handed to the environment.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._rng = np.random.default_rng([self._stream, seed])
        sensors, rng = self._sensors, self._rng
        telemetry = sensors.telemetry
        self._model.draw(rng)
        initial = self._start(rng)
        self._age = sensors.config.nominal_age
        needed = telemetry.link.delay + 2.0 * telemetry.link.jitter + 2.5 * telemetry.period - self._age
        self._late = max(ceil(needed / telemetry.dt), CONTACT_MARGIN) if self._lag is None else self._lag
        self._check_history()
        self.calibrator = self._calibrator(initial, telemetry.dt, self._late)
        self.beliefs = Beliefs(
            self._model,
            telemetry.layout,
            telemetry.period,
            telemetry.link.delay,
            telemetry.averaged,
        )
        self.beliefs.update(sensors.packets)
        self._plan = Plan(self._late)
        self._cop = [0.0, 0.0]
        self._cop_foot = [[0.0, 0.0], [0.0, 0.0]]
        return self._calibrate(observation, info), info

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Step the environment and calibrate by one sample."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.beliefs.update(self._sensors.packets)
        return self._calibrate(observation, info), float(reward), terminated, truncated, info

    def _calibrate(self, observation: dict[str, Any], info: dict[str, Any]) -> dict[str, Any]:
        sensors, beliefs = self._sensors, self.beliefs
        command: Any = self.unwrapped.command  # type: ignore[attr-defined]
        stance, swing = self._plan.at(command.stance, command.swing)
        self.reference_time = sensors.time - self._late * sensors.telemetry.dt - self._age
        self.reference = reference = beliefs.reference(self.reference_time, stance, swing)
        self.estimate = estimate = self.calibrator.update(sensors.raw, reference)
        info.setdefault("surefoot", {}).update(
            parameters=Parameters(estimate.scale, estimate.offset),
            covariance=estimate.covariance,
            flags=estimate.flags,
            vgrf=estimate.vgrf,
            reference=reference,
            lag=self._late,
        )
        return self._observe(observation, estimate)

    def _observe(self, observation: dict[str, Any], estimate: Estimate) -> dict[str, Any]:
        """Put the calibrated feet into an observation; the level frame is that of now."""
        wrench, cop_foot = estimate.wrench.tolist(), estimate.cop_foot.tolist()
        valid = [bool(estimate.cop_valid), *estimate.cop_foot_valid.tolist()]
        for foot in (0, 1):
            if valid[1 + foot]:
                self._cop_foot[foot] = [_bounded(part) for part in cop_foot[foot]]
        if valid[0]:
            load = x = y = 0.0
            soles = self.beliefs.soles(self._sensors.time)
            for sole, (_, _, fz, tx, ty, _) in zip(soles, wrench, strict=True):
                u, v = sole.forward_x, sole.forward_y
                load += fz
                x += sole.x * fz - u * ty - v * tx
                y += sole.y * fz - v * ty + u * tx
            self._cop = [_bounded(x / load), _bounded(y / load)]
        seen = dict(observation)
        force = np.minimum(np.maximum(estimate.force, -FORCE_BOUND), FORCE_BOUND)
        seen["foot_force"] = force.astype(np.float32)
        seen["cop_foot"] = np.array(self._cop_foot, dtype=np.float32)
        seen["cop"] = np.array(self._cop, dtype=np.float32)
        seen["cop_valid"] = np.array(valid, dtype=np.int8)
        return seen

    def _nominal(self) -> Parameters:
        config = self._sensors.config
        return Parameters(config.nominal_scale, config.nominal_offset)

    def _start(self, rng: np.random.Generator) -> Parameters:
        """Find the map to start from."""
        if isinstance(self._initial, Parameters):
            return self._initial
        drawn = rng.standard_normal((2, self.layout.channels))
        if self._initial == "nominal":
            return self._nominal()
        scale_error, offset_error = self._bench_error
        found = Parameters(1.0 + scale_error * drawn[0], offset_error * drawn[1])
        return found.after(Parameters(*self._sensors.true_parameters()))

    def _check_history(self) -> None:
        """Refuse a lag so long that the packets it needs would no longer be kept."""
        telemetry = self._sensors.telemetry
        # The newest packet that can have come, when the jitter was kind.
        youngest = max(telemetry.link.delay - 6.0 * telemetry.link.jitter, 0.0)
        packets = ceil((self._late * telemetry.dt + self._age - youngest) / telemetry.period) + 3
        if packets > HISTORY:
            raise ValueError(
                f"A lag of {self._late} samples over {telemetry.link} needs {packets} packets, and at most "
                f"{HISTORY} are kept; choose a shorter 'lag', or a link with a lower rate or less jitter."
            )

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


class Plan:
    """Tells which feet surely stood, or surely swung, some samples ago.

    Args:
        lag: How many samples ago.
    """

    def __init__(self, lag: int) -> None:
        self._needed = CONTACT_MARGIN + 1 + min(CONTACT_MARGIN, lag)
        self._runs = deque([[0, 0, 0, 0]], maxlen=max(lag - CONTACT_MARGIN, 0) + 1)

    def at(
        self, stance: NDArray[np.bool_], swing: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Take in what is planned now, and tell of then.

        Args:
            stance: Feet planned to stand, shape (2,).
            swing: Feet planned to swing, shape (2,).

        Returns:
            Feet that surely stood and feet that surely swung ``lag`` samples ago, shape (2,) each.
        """
        planned = [*stance.tolist(), *swing.tolist()]
        self._runs.append([run + 1 if held else 0 for run, held in zip(self._runs[-1], planned, strict=True)])
        sure = [run >= self._needed for run in self._runs[0]]
        return np.array(sure[:2]), np.array(sure[2:])


def _bounded(place: float) -> float:
    return min(max(place, -COP_BOUND), COP_BOUND)


def _foot_sensors(env: gym.Env[Any, Any]) -> FootSensors:
    """Find the sensors among the wrappers."""
    below: gym.Env[Any, Any] = env
    while isinstance(below, gym.Wrapper):
        if isinstance(below, SelfCalibration):
            raise TypeError(
                "SelfCalibration found another SelfCalibration below it; one is enough, wrap once: "
                f"SelfCalibration(FootSensors(env)). Got {env}."
            )
        if isinstance(below, FootSensors):
            return below
        below = below.env
    raise TypeError(
        "SelfCalibration calibrates the counts of FootSensors and found none below it; wrap in this order: "
        f"SelfCalibration(FootSensors(env)). Got {env}."
    )


def _initial(initial: Any, channels: int) -> str | Parameters:
    """Read the map to start from: a name, or one scale and one offset a channel."""
    if isinstance(initial, str) and initial in ("nominal", "bench"):
        return initial
    if isinstance(initial, Parameters):
        initial = initial._asdict()
    if not isinstance(initial, Mapping):
        raise ValueError(
            "'initial' must be 'nominal', 'bench' or Parameters (scale, offset), also as a mapping, "
            f"got {initial!r}."
        )
    if set(initial) != set(Parameters._fields):
        raise ValueError(
            f"'initial' as a mapping must have exactly the keys {list(Parameters._fields)}, "
            f"got {list(initial)}."
        )
    return Parameters(*(_channels(name, initial[name], channels) for name in Parameters._fields))


def _channels(name: str, given: Any, channels: int) -> NDArray[np.float64]:
    """Read one finite number a channel."""
    try:
        # A copy: what the caller does to its array later must not change where an episode starts.
        part = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        part = np.empty(0)
    if part.shape != (channels,) or not np.isfinite(part).all():
        raise ValueError(
            f"'initial.{name}' must hold one finite number for each of the {channels} channels, "
            f"got {given!r}."
        )
    return part


def _layout(env: Any) -> FeetLayout:
    """Lay out the cells where the drawing has them, over the sole plates that it has."""
    plates = below_cells(env.model)
    return FeetLayout(
        tuple(
            FootLayout.load_cells(name, position, mass_below=float(mass), com_below_sole=com)
            for name, position, mass, com in zip(
                ("left", "right"), env.position_cell_sole, plates.mass, plates.com_sole, strict=True
            )
        )
    )
