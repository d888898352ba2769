"""Record walks as logs: the truth, the robot's beliefs, and the readings of several kinds of cells.

The robot walks on its true centre of pressure, and its cells do not act back on it: one walk serves all
conditions. The calibration from weights is done with those very cells before the walk.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from scipy.linalg import block_diag

import surefoot
from surefoot.arrays import Floats, stack_rows
from surefoot.calibration import GRAVITY, MomentumReference, Parameters, Reference
from surefoot.controllers import Stabiliser
from surefoot.envs import RobotDrawing
from surefoot.envs.nao.env import CONTROL_STEP
from surefoot.experiments.logs.format import Log, LogTruth
from surefoot.experiments.walks.walkers import G1_FEET, STAND_TIME, TruthTap, make_g1
from surefoot.experiments.weights.weighing import weigh_cells
from surefoot.robot.beliefs.believed import nothing, unknown
from surefoot.robot.sensing.instruments import Instruments, SensorsInAnkles
from surefoot.sensors import ForceTorque, LoadCells, sized
from surefoot.sensors.presets import HX711_LOAD_CELLS
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.self_calibration import SelfCalibration

_STREAM = 0x10605  # keeps the instruments' randomness apart from every other stream with the same seed
_SETTLING = 16  # rows cut off at the beginning of a log, in which telemetry has not yet arrived


@dataclass(frozen=True)
class Condition:
    """The cells that a robot walks on (``None`` for none), and its knowledge of them."""

    name: str
    title: str
    cells: LoadCells | None
    start: str  # the map of calibrators: ``"calibrated"`` or ``"nominal"``
    ankle: ForceTorque | None = None  # six-axis sensors

    @property
    def age(self) -> float:
        """Mean age in s of a reading when the host takes it; the cells' where there are both."""
        device = self.cells or self.ankle
        return 0.0 if device is None else device.nominal_age


class Recording:
    """Samples of one walk, ``dt`` s apart, kept one by one to become a log."""

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._rows: list[tuple[Any, ...]] = []

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self._rows)

    def keep(self, time: float, raw: Floats, force: Floats, truth: Any, undone: Any, *beliefs: Any) -> None:
        """Keep one sample: time since the start in s, counts, true forces in N, (K,) each, and beliefs.

        Of the ``truth`` of the simulator there are the soles' poses; ``undone`` is the map that undoes the
        errors of the readings. Beliefs are a Reference, and perhaps a MomentumReference.
        """
        kept = [type(one)(*map(np.array, one)) for one in beliefs]
        pose = truth.position_sole[-1].copy(), truth.R_world_sole[-1].copy()
        self._rows.append((time, raw.copy(), kept, np.array(force), *pose, *undone))

    def log(self, first: int = 0, **known: Any) -> Log:
        """Return the log of samples from a first one on, with the facts of robot and recording."""
        time, raw, beliefs, *truth = zip(*self._rows[first:], strict=True)
        reference, *momentum = map(stack_rows, zip(*beliefs, strict=True))
        return Log(
            time=np.array(time),
            raw=np.array(raw),
            reference=reference,
            momentum=momentum[0] if momentum else None,
            truth=LogTruth(*map(np.array, truth)),
            dt=self._dt,
            **known,
        )


class FootInstruments:
    """The readings of one condition under one walk, by a random stream of an ``index``.

    ``nominal`` and ``calibrated`` are maps of K channels, by the data sheets and from weights before the walk
    (``None`` unless there are load cells alone); ``about`` holds the errors that maps axis by axis leave out:
    cross-talk, and the weight that counts as part of the zero.
    """

    def __init__(
        self, condition: Condition, *, index: int, seed: int, truth: Any, drawing: RobotDrawing, dt: float
    ) -> None:
        self._condition, cells, ankle = condition, condition.cells, condition.ankle
        if cells is None and ankle is None:
            raise ValueError("A condition needs load cells, ankle sensors or both, and has neither.")
        self._all = Instruments(tuple(one for one in (cells, ankle) if one is not None), drawing, dt)
        self.layout, self.nominal = self._all.layout, self._all.nominal
        key = [_STREAM, index, seed]
        self._streams = {"cells": np.random.default_rng(key), "ankles": np.random.default_rng([*key, 1])}
        self._state = self._all.init(self._streams)
        self.calibrated: Parameters | None = None
        if cells is not None:
            if ankle is None:
                self.calibrated = weigh_cells(cells, self._state.cells, seed)
            # Every chip delivers once before the walk, as they do while a robot boots.
            part: Any = self._all.parts[0]
            period = 1.0 / cells.rate[0] if cells.rate else 0.0125
            load, stream = part.load(truth), self._streams["cells"]
            _, booted = part.device.apply(load, self._state.cells, stream, period)
            self._state = self._state._replace(cells=booted)
        self.about = {} if ankle is None else self._errors_between_axes()
        self._dt, self._kept = dt, Recording(dt)

    def read(self, truth: Any, believed: tuple[Reference, MomentumReference]) -> None:
        """Take the readings after a control step, with the robot's beliefs at that moment."""
        dt, kept = self._dt, self._kept
        raw, self._state = self._all.read(truth, self._state, self._streams, dt)
        force = self._all.join([part.force(truth) for part in self._all.parts])
        kept.keep(dt * (len(kept) + 1), raw, force, truth, self._all.true_map(self._state), *believed)

    def log(self, about: Mapping[str, Any], **known: Any) -> Log:
        """Return the readings as a log, with what is known of the walk."""
        # The truth is the mean over a step, which is half a step old itself.
        age = max(self._condition.age - 0.5 * self._dt, 0.0)
        own = {"condition": self._condition.name, "start": self._condition.start, "sample_age_s": age}
        return self._kept.log(
            _SETTLING,
            layout=self.layout,
            nominal=self.nominal,
            calibrated=self.calibrated,
            about={**about, "surefoot": surefoot.__version__, **self.about, **own},
            **known,
        )

    def _errors_between_axes(self) -> dict[str, Any]:
        parts, order = self._all.parts, self._all.order
        talks = [
            part.cross_talk(self._state.ankles) if isinstance(part, SensorsInAnkles) else np.zeros((n, n))
            for part, n in ((part, part.channels) for part in parts)
        ]
        preload = [getattr(part, "preload", np.zeros(part.channels)) for part in parts]
        talk = block_diag(*talks)[np.ix_(order, order)]
        return {"truth_cross_talk": talk.tolist(), "truth_preload": self._all.join(preload).tolist()}


CONDITIONS = (
    Condition(
        "paper",
        "the paper's conditions",
        LoadCells(scale_drift=0.005 * PER_SQRT_MINUTE, offset_drift=0.2 * PER_SQRT_MINUTE),
        "calibrated",
    ),
    Condition("bad-start", "bad start", HX711_LOAD_CELLS, "nominal"),
)
"""The CoP paper's, calibrated from weights and then drifting mildly (0.5 % and 0.2 N per square root of a
minute); and a bad start: never calibrated (scales 12 % off, offsets 1.5 N) and drifting by 2 % and 1 N."""


def record_walk(
    speed: float,
    seed: int,
    duration: float,
    conditions: Sequence[Condition] = CONDITIONS,
    *,
    sensors: Mapping[str, Any] | None = None,
    beliefs: Mapping[str, Any] | None = None,
    clock_error: float = 0.0,
    held: tuple[float, float, float] = (0.0, 0.0, 0.0),
    policy: str = "",
    **env_options: Any,
) -> dict[str, Log]:
    """Walk once, and return the readings of each condition's cells: a log by its name.

    The walk takes ``duration`` s, standing included, at a speed in m/s; a fall ends it earlier. As in the CoP
    paper nobody pushes, unless ``push_impulse`` says so. The seed is that of the walk, the sensors, the
    beliefs and the weighing; references are timed for each condition's own cells. Further options are those
    of :class:`~surefoot.wrappers.FootSensors` (IMU, encoders and link), of
    :class:`~surefoot.wrappers.SelfCalibration` (how wrong the robot is about itself) and of
    :class:`~surefoot.envs.nao.walk.NaoWalkEnv`. Telemetry is ``clock_error`` s later than the robot believes:
    the believed moment of a reference is that much earlier in truth. The robot is ``held`` as :func:`lift`
    says. With a ``policy`` it is a Unitree G1, on larger cells of the same kind.
    """
    base, act = _walker(speed, duration, policy, env_options)
    bare: Any = base.unwrapped
    weight = float(bare.model.body_subtreemass[0]) * GRAVITY
    if policy:
        conditions = [replace(c, cells=sized(c.cells, weight)) if c.cells else c for c in conditions]
    youngest = min(condition.age for condition in conditions)
    worn = _put_on(base, conditions, weight if policy else None, sensors or {})
    env, source = SelfCalibration(worn, "moment", **(beliefs or {})), worn.source
    _, info = env.reset(seed=seed)
    dt = source.dt
    known: Any = {"seed": seed, "truth": source.truth, "drawing": source.drawing, "dt": dt}
    feet = [FootInstruments(condition, index=i, **known) for i, condition in enumerate(conditions)]
    torso, steps = bare.model.body(source.drawing.torso).id, 0
    terminated = truncated = False
    while not (terminated or truncated) and steps * dt <= duration - 0.5 * dt:
        now = steps * dt
        if held[0]:
            bare.data.xfrc_applied[torso, 2] = weight * lift(now, *held)
        _, _, terminated, truncated, info = env.step(act(now))
        steps += 1
        earlier = {c.age: c.age - youngest + clock_error for c in conditions}
        believed = {age: _believe(env, env.reference_time - by) for age, by in earlier.items()}
        for condition, one in zip(conditions, feet, strict=True):
            one.read(source.truth, believed[condition.age])
    env.close()
    known = {"seed": seed, "mass": env.calibrator.setup.mass, "lag": int(info["surefoot"]["lag"])}
    about = {"speed_m_s": speed, "fell": bool(terminated), "duration_s": duration}
    named = zip(conditions, feet, strict=True)
    return {condition.name: one.log(about, **known) for condition, one in named}


def _put_on(
    base: gym.Env[Any, Any], conditions: Sequence[Condition], weight: float | None, sensors: Mapping[str, Any]
) -> FootSensors:
    """Put a NAO, or a G1 of a weight in N, on feet whose readings are not used, with all other sensors."""
    # The youngest cells ask for the longest wait for telemetry.
    cells = HX711_LOAD_CELLS
    if min(condition.age for condition in conditions) <= 0.0:
        averaged = all(c.cells is not None and c.cells.averaged for c in conditions)
        cells = replace(cells, rate=None, averaged=averaged)
    if weight is None:
        return FootSensors(base, cells, **sensors)
    return FootSensors(base, sized(cells, weight), feet=G1_FEET, **sensors)


def lift(time: float, share: float, begin: float, end: float) -> float:
    """Return the share of its weight that somebody takes off a robot at a time in s, within half a second."""
    return share * float(np.clip(2.0 * min(time - begin, end - time), 0.0, 1.0))


def _walker(
    speed: float, duration: float, policy: str, options: Mapping[str, Any]
) -> tuple[gym.Env[Any, Any], Callable[[float], Any]]:
    """Return a robot and its controller, which stands first: a NAO with its true CoP fed back, or a G1."""
    if policy:
        robot = make_g1(policy)
        base: Any = robot.unwrapped
        return robot, lambda time: base.policy(
            base.state(), np.array([speed, 0.0, 0.0]) * (time > STAND_TIME)
        )
    # The walk is cut off before the pattern stops: what is recorded is standing first and then walking.
    tap = TruthTap(
        gym.make(
            "surefoot/NaoWalk-v0",
            max_episode_steps=round(duration / CONTROL_STEP),
            disable_env_checker=True,
            **{"push_impulse": (0.0, 0.0), **options},
            speed=speed,
            duration=duration + 2 * STAND_TIME,
            stand_time=STAND_TIME,
        )
    )
    bare: Any = tap.unwrapped
    controller = Stabiliser(bare.state_layout, engage_after=STAND_TIME)
    return tap, lambda time: controller(tap.seen)


def _believe(env: SelfCalibration, moment: float) -> tuple[Reference, MomentumReference]:
    """Beliefs of a moment in s, with the contacts of the last sample; of both kinds."""
    stance, swing = env.reference.stance, env.reference.swing
    if not env.beliefs.known:
        return nothing(len(stance)), unknown(len(stance))
    return env.beliefs.reference(moment, stance, swing), env.beliefs.momentum(moment, stance, swing)
