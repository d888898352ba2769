"""Calibrates the feet of N robots as they go: one update of one calibrator for all.

The robots differ in the map that they start from, c raw + d, and in the mass m that they believe in, and a
calibrator knows one of each. Both are taken out of what it sees: in units of its own mass M,

    F0 = (c raw + d) M / m,        L' M / m,

the Newton-Euler equations are those of a robot of mass M, and F m / M is the force again.
"""

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import Parameters, Reference, online_method
from surefoot.calibration.episodes import select
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.setup import method_name, setup_from_options
from surefoot.wrappers.belief_errors import BeliefErrors
from surefoot.wrappers.beliefs import reference_info
from surefoot.wrappers.contacts import CONTACT_MARGIN
from surefoot.wrappers.instruments import layout_options
from surefoot.wrappers.lag import waiting_samples
from surefoot.wrappers.source import check_stream, wants_fresh
from surefoot.wrappers.starting_map import StartingMap
from surefoot.wrappers.vector.beliefs import BatchBeliefs
from surefoot.wrappers.vector.contacts import BatchKinematics, BatchPlan, BatchUpright
from surefoot.wrappers.vector.feet import BatchFeet
from surefoot.wrappers.vector.nominal import BatchNominal
from surefoot.wrappers.vector.sensors import BatchSensors, Seeds, seed_numbers, seed_of_each
from surefoot.wrappers.vector.truth_row import NO_PLAN

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class BatchCalibration:
    """Calibrates the readings of :class:`BatchSensors`, and makes the observations of the feet.

    Args:
        sensors: The robots' sensors.
        method: A key of :data:`surefoot.calibration.METHODS`.
        initial: The map to start from: ``"nominal"``, ``"calibrated"`` or parameters.
        lag: How many samples ago a reference describes the feet; ``None`` for as few as the link allows.
        fresh: Whether the calibration of a robot starts fresh at each of its resets.
        errors: How wrong the robots are about themselves.
        stream: Number of the random stream.
        options: Options of the method.

    Attributes:
        lag: How many samples ago a reference describes the feet.
        feet: What is observed of the feet, and the feet's observations.
        parameters: The robots' maps now, shape (N, K).
        reference: The calibrator's last reference.
        estimate: Its last estimate, in real units.

    Raises:
        ValueError: If the method or an option does not exist, a value has no meaning, or the robot is none
            that a nominal model can be made of: one free body, hinge joints, two feet.
    """

    def __init__(
        self,
        sensors: BatchSensors,
        method: str,
        *,
        initial: str | Parameters | Mapping[str, Any],
        show: Sequence[str],
        lag: int | None,
        fresh: bool,
        errors: BeliefErrors,
        stream: int,
        options: Mapping[str, Any],
    ) -> None:
        check_stream("VectorSelfCalibration", stream)
        drawing, instruments, dt = sensors.drawing, sensors.instruments, sensors.meaning.dt
        if len(drawing.feet) != 2:
            raise ValueError(
                f"Calibration while walking needs a robot on two feet, got the feet {drawing.feet}."
            )
        method = method_name(method)
        self._sensors, self._fresh, self._stream = sensors, fresh, stream
        self._initial = StartingMap(initial, instruments.nominal, errors)
        self._model = BatchNominal(drawing, sensors.count, errors)
        self._mass = self._model.drawn_mass
        delay = sensors.telemetry.delay
        needed = ceil(delay + 2.5 - instruments.age / dt - 1e-9)
        self.lag = max(needed, CONTACT_MARGIN) if lag is None else lag
        self._setup, own = setup_from_options(
            instruments.layout,
            mass=self._mass,
            initial=None,
            dt=dt,
            lag=self.lag,
            options=layout_options(instruments.layout, drawing, method) | dict(options),
        )
        self._method = online_method(method, self._setup, **own)
        self.feet = BatchFeet(sensors.count, instruments.layout, self._mass, drawing.flaw, show)
        self._beliefs = self._make_beliefs(averaged=True)
        sensors.listen()
        self._rng = np.random.default_rng()
        everyone = (sensors.count, instruments.channels)
        self._map: Floats = np.zeros((2, *everyone))
        self._share: Floats = np.ones((sensors.count, 1))
        self._wait = waiting_samples(self.lag, instruments.age, dt)
        self._waiting = np.zeros(sensors.count, dtype=np.int64)
        self._plan = BatchPlan(sensors.count, self.lag)
        self._kinematics = BatchKinematics(sensors.count)
        self._upright = BatchUpright(sensors.count, dt)
        self._state: Any = None
        self.parameters: Parameters
        self.reference: Reference
        self.estimate: Estimate

    def reset(self, mask: Mask | None, seed: Seeds = None, choice: str | None = None) -> None:
        """Take in robots that were reset, after their sensors did.

        Args:
            mask: These robots, shape (N,); ``None`` for all.
            seed: What they were reset with.
            choice: ``"fresh"`` or ``"keep"``, if it was asked for.
        """
        count, numbers = self._sensors.count, seed_numbers(seed)
        rng = np.random.default_rng([self._stream, *numbers]) if numbers else self._rng
        mask = np.ones(count, dtype=bool) if mask is None else mask
        if mask.all():
            self._rng = rng
        learnt = self._state is not None
        if not learnt:
            self._beliefs = self._make_beliefs(self._sensors.averaged)
        each = seed_of_each(seed, count)
        drawn = (self._sensors.sensors_fresh | self._fresh).tolist()
        wanted = [wants_fresh(choice, own, new, learnt) for own, new in zip(each, drawn, strict=True)]
        self._begin(mask, mask & np.array(wanted), rng)

    def step(self) -> None:
        """Calibrate by one sample, after the sensors stepped."""
        sensors = self._sensors
        readings, starting = sensors.stepped, sensors.starting
        assert readings.packet is not None
        if starting is not None:
            self._start_fresh(sensors.sensors_fresh | (starting & self._fresh), self._rng)
            self._begin_episodes(starting, self._wait)
            self.feet.begin_episode(starting)
        self._beliefs.update(readings.packet, starting)
        share, (scale, offset) = self._share, self._map
        self.reference = reference = self._next_reference(readings.contacts)
        scaled = reference._replace(angular_momentum_rate=reference.angular_momentum_rate / share)
        force = (scale * readings.raw + offset) / share
        self._state, estimate = self._method.update(self._state, force, scaled, sensors.meaning.dt)
        self.parameters = Parameters(
            estimate.scale * scale, estimate.scale * offset + estimate.offset * share
        )
        self.estimate = estimate = estimate._replace(
            force=estimate.force * share,
            wrench=estimate.wrench * share[..., None],
            vgrf=estimate.vgrf * share,
            scale=self.parameters.scale,
            offset=self.parameters.offset,
        )
        self.feet.take(estimate, *self._beliefs.soles())

    def retract(self, mask: Mask) -> None:
        """Take back what robots have learnt of late who have fallen, shape (N,)."""
        if mask.any():
            self._state = self._method.retract(self._state, mask)

    def begin_episode(self, mask: Mask) -> None:
        """Take in robots whose next episode starts within the step that ended one, after the sensors."""
        self._begin(mask, self._sensors.sensors_fresh | (mask & self._fresh), self._rng)

    def info(self, stepped: bool) -> dict[str, Any]:
        """Return what ``info`` holds, by the names that the wrapper for one robot has.

        Args:
            stepped: Whether it is of a step, and not of a reset, in which nothing is calibrated.
        """
        scale, offset = self.parameters
        known: dict[str, Any] = {
            "parameters": {"scale": scale.copy(), "offset": offset.copy()},
            "lag": np.full(self._sensors.count, self.lag),
        }
        if stepped:
            estimate = self.estimate
            known |= {"flags": estimate.flags.copy(), "vgrf": estimate.vgrf.copy()}
            known["reference"] = reference_info(self.reference)
        return known

    def _next_reference(self, contacts: Floats) -> Reference:
        """Take in plans and postures of one more sample, and return the references for it.

        They are NaN for robots whose samples are of two episodes, and for robots that are not upright.
        """
        unknown, none = self._waiting > 0, np.zeros((len(contacts), 2), dtype=bool)
        self._waiting = np.maximum(self._waiting - 1, 0)
        planned = contacts[0, 0] != NO_PLAN
        stance, swing = self._plan.at(contacts > 0.5) if planned else (none, none)
        reference = self._beliefs.reference(stance, swing, unknown)
        silent = unknown | ~self._upright.at(reference, self._beliefs.force_bias)
        if silent.any():
            reference = _silenced(reference, silent)
        self.retract(self._upright.fell)
        if planned:
            return reference
        stance, swing = self._kinematics.at(reference)
        return reference._replace(stance=stance, swing=swing)

    def _begin(self, mask: Mask, forget: Mask, rng: np.random.Generator) -> None:
        """Start episodes without a sample to learn from: the map is applied to the readings."""
        readings = self._sensors.readings
        assert readings.packet is not None
        self._start_fresh(forget, rng)
        self._begin_episodes(mask, self._wait - 1)
        self._beliefs.begin_episode(readings.packet, mask)
        self.feet.begin_episode(mask)
        force = self.parameters.scale * readings.raw + self.parameters.offset
        self.feet.apply(mask, force, *self._beliefs.soles())

    def _begin_episodes(self, mask: Mask, wait: int) -> None:
        self._waiting[mask] = wait
        self._plan.begin_episode(mask)
        self._kinematics.begin_episode(mask)
        self._upright.begin_episode(mask)

    def _start_fresh(self, mask: Mask, rng: np.random.Generator) -> None:
        """Draw what some robots are wrong about, and start from their starting maps."""
        if not mask.any():
            return
        self._model.draw(np.flatnonzero(mask).tolist(), rng)
        self._share = self._model.mass[:, None] / self._mass
        self._map = np.where(mask[:, None], self._start(rng), self._map)
        raw = self._sensors.readings.raw
        fresh = self._method.init(raw)
        if self._state is None or mask.all():
            # Nothing of what robots share is left, either.
            self._state = fresh
            self.parameters = Parameters(*self._map)
            return
        self._state = select(mask, fresh, self._state)
        self.parameters = Parameters(
            *(np.where(mask[:, None], new, old) for new, old in zip(self._map, self.parameters, strict=True))
        )

    def _start(self, rng: np.random.Generator) -> Floats:
        """Find the maps to start from, (scale, offset) of each robot, shape (2, N, K)."""
        shape = self._map.shape
        if self._initial.calibrated:
            true = self._sensors.true_parameters()
            return np.stack(self._initial.off(true, rng.standard_normal(shape)))
        return np.broadcast_to(np.stack(self._initial.known)[:, None], shape)

    def _make_beliefs(self, averaged: bool) -> BatchBeliefs:
        sensors = self._sensors
        age = self.lag * sensors.meaning.dt + sensors.instruments.age
        telemetry = sensors.telemetry
        return BatchBeliefs(self._model, telemetry.layout, sensors.meaning.dt, telemetry.delay, averaged, age)


def _silenced(reference: Reference, mask: Mask) -> Reference:
    """Take out what some robots believe, shape (N,): NaN, and of no foot whether it stands or swings."""
    parts = []
    for part in reference:
        where = mask.reshape(-1, *[1] * (part.ndim - 1))
        parts.append(part & ~where if part.dtype == bool else np.where(where, np.nan, part))
    return Reference(*parts)
