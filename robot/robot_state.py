"""A robot's state estimate from its encoders and its IMU: the references that calibrators take.

:class:`RobotState` brings together what a robot's own loop needs: kinematics and masses from a model file
(:mod:`surefoot.robot.model_file`), the clock of the encoders and the IMU (:class:`SampleClock`), and
:mod:`surefoot.robot.beliefs`, which find velocity, attitude and contacts.
"""

from collections.abc import Mapping, Sequence
from math import ceil, isfinite
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surefoot.arrays import Floats
from surefoot.calibration import FeetLayout, MomentumReference, Reference
from surefoot.robot.beliefs.believed import nothing, unknown
from surefoot.robot.beliefs.contacts import CONTACT_MARGIN
from surefoot.robot.beliefs.lag import packets_per_join
from surefoot.robot.beliefs.momentum import MomentumBeliefs
from surefoot.robot.beliefs.native import NativeBeliefs, native_beliefs
from surefoot.robot.beliefs.nominal import Masses
from surefoot.robot.beliefs.references import FILLED_TIME, LARGEST_VALUE, Beliefs
from surefoot.robot.model_file import read_robot
from surefoot.sensors.telemetry.computer import TelemetryLayout
from surefoot.sensors.transport.link import Packet

START = 50  # samples of encoders and IMU by which their rate is measured, half a second at 100 Hz
MEMORY = 256  # samples over which the clock's rate and phase are averaged
LARGEST_RATE_ERROR = 0.1  # share by which a measured rate may differ from the stated one
NEEDED_PERIODS = 2.5  # joined samples after a moment that differences and interpolation need
EVEN = 0.2  # share of a step by which half of the steps may differ for times to be even
UNLIKELY = 4.0  # mean absolute deviations, three standard deviations of normal jitter
CLOCK_RESET = 1.0  # time in s that a clock must be off by to be one that was set anew
OUT_OF_ORDER = (
    50  # samples by which a late one may be behind the newest; a number farther behind begins again
)


class Plan(NamedTuple):
    """Contacts that a robot plans for now."""

    stance: Any  # feet planned to stand (bool), shape (F,)
    swing: Any  # feet planned to be in the air (bool), shape (F,)


class SampleClock:
    """Number samples by their times, so that a late sample is in order and a lost one leaves a gap.

    The line time = origin + number * period follows the times by a recursive least-squares fit. A sample that
    is later than the next number's time by half a period, and by more than chance, shows that others were
    lost.

    Args:
        times: The first times in s, which do not decrease.
        numbers: Their numbers, if the robot counts them.
    """

    def __init__(self, times: Floats, numbers: Sequence[int] | None = None) -> None:
        if numbers is not None:
            self.numbers = list(numbers)
        else:
            steps = np.diff(times)
            middle = float(np.median(steps))
            even = np.median(np.abs(steps - middle)) < EVEN * middle
            # Times of uneven steps come from a link that delivers in bursts: their median says little.
            typical = middle if even else float(steps.mean())
            lost = np.maximum(np.rint(steps / typical), 1.0) if even else np.ones(len(steps))
            self.numbers = [0, *np.cumsum(lost).astype(int).tolist()]
        self.period, self.origin = (float(part) for part in np.polyfit(self.numbers, times, 1))
        off = np.abs(times - self.origin - self.period * np.array(self.numbers))
        self.spread = float(off.mean())  # mean absolute distance of times from the line in s
        self._last, self._count = self.numbers[-1], len(times)

    def number(self, time: float, number: int | None = None) -> int:
        """Take in the time in s of the next sample; return its number, by default the one that fits."""
        # A clock that was set anew: what came before does not belong to what comes now.
        if number is not None and abs(time - self.origin - number * self.period) > CLOCK_RESET:
            self.origin = time - number * self.period
        elif time < self.origin + self._last * self.period - CLOCK_RESET:
            self.origin = time - (self._last + MEMORY) * self.period
        late = time - self.origin - (self._last + 1) * self.period
        if number is None:
            lost = late > 0.5 * self.period + UNLIKELY * self.spread
            number = self._last + 1 + (round(late / self.period) if lost else 0)
        off = time - self.origin - number * self.period
        n = self._count = min(self._count + 1, MEMORY)
        # Gains of a line's least-squares fit to n samples, at the newest one (Brookner 1998, section 1.2.10).
        level, slope = 2.0 * (2 * n - 1) / (n * (n + 1)) * off, 6.0 / (n * (n + 1)) * off
        self.period += slope
        self.origin += level - slope * number
        self.spread += (abs(off) - self.spread) / n
        self._last = number
        return number


class RobotState:
    """Estimate a robot's motion and contacts from encoders and IMU, for a calibrator of its feet.

    Call :meth:`update` with each sample of encoders and IMU, and :meth:`reference` once for each sample of
    the feet's sensors. It needs NumPy, SciPy and MuJoCo, and runs no simulation.

    Args:
        model_path: The robot's MJCF or URDF file: bodies with masses, and hinge joints.
        feet: Names of the feet, the left one first. The soles of bodies with collision shapes are measured.
            A site, or a body without shapes, is a sole frame: z up, x to the toes. By default the two lowest
            bodies that can touch the ground, if the robot stands on them in its zero pose or its keyframe
            "stand", "standing" or "home".
        imu: Site or body that carries the IMU, in whose axes it measures. By default the site of the model's
            accelerometer, or else the frame of the body that floats.
        joints: Names of the joints in the order of ``joint_position``; by default all of the model's.
        held: Angles in rad of joints that have no encoder.
        layout: The feet's channels, whose places are what touches the ground if ``feet`` names frames.
        mass: The robot's mass in kg if it was weighed; the model's masses are scaled to it.
        rate: Samples of encoders and IMU per second. The exact rate is measured.
        delay: How long in s before ``time`` encoders and IMU were measured.
        averaged: Whether a sample of the IMU is the mean since the sample before it.
        dt: Time in s between samples of the feet.
        age: How long in s before its time a sample of the feet was measured.
        lag: How many samples of the feet ago a reference is of; by default the fewest that suffice.
        momentum: Whether references hold velocity and angular momentum, as method ``"moment"`` takes them,
            or accelerations, as the other methods do.

    Attributes:
        joint_names: Names of the joints in the order of ``joint_position``.
        mass: The robot's mass in kg.
        lag: How many samples of the feet ago a reference is of. Pass it to the calibrator.
        dt: Time in s between samples of the feet.
        fell: Whether the robot was upright until the last reference, and no longer is. Call
            :meth:`FootCalibrator.retract` then.

    Raises:
        FileNotFoundError: If there is no model file.
        ValueError: If the model cannot be used, or a name or a number has no meaning.

    >>> from importlib.resources import files
    >>> import numpy as np
    >>> state = RobotState(files("surefoot.envs") / "robots" / "nao.xml")
    >>> len(state.joint_names), round(state.mass, 2), state.lag
    (24, 5.31, 4)
    >>> for k in range(200):
    ...     state.update(np.zeros(24), np.zeros(3), [0.0, 0.0, 9.81], time=0.01 * k)
    ...     if k % 2:
    ...         reference = state.reference(time=0.01 * k)
    >>> reference.stance, reference.com_velocity.round(3)
    (array([ True,  True]), array([0., 0., 0.]))
    """

    def __init__(
        self,
        model_path: str | PathLike[str],
        *,
        feet: Sequence[str] | None = None,
        imu: str | None = None,
        joints: Sequence[str] | None = None,
        held: Mapping[str, float] | None = None,
        layout: FeetLayout | None = None,
        mass: float | None = None,
        rate: float = 100.0,
        delay: float = 0.0,
        averaged: bool = False,
        dt: float = 1.0 / 80.0,
        age: float = 0.0,
        lag: int | None = None,
        momentum: bool = True,
    ) -> None:
        for name, value, least in (
            ("rate", rate, 1e-3),
            ("dt", dt, 1e-6),
            ("delay", delay, 0.0),
            ("age", age, 0.0),
        ):
            if not (isfinite(value) and value >= least):
                raise ValueError(f"'{name}' must be finite and at least {least:g}, got {value!r}.")
        self._robot = read_robot(model_path, feet, imu, layout)
        model = self._robot.model
        if mass is not None:
            if not 0.5 < mass / model.mass < 2.0:
                raise ValueError(
                    f"'mass' is {mass!r} kg, and the model's masses add up to {model.mass:.4g} kg; "
                    "give the mass of the whole robot in kg, or correct the model."
                )
            factor = mass / model.mass
            weights, inertia, com = model.masses
            model.masses = Masses(factor * weights, factor * inertia, com)
        self._joints(joints, held or {})
        self.mass, self.gravity, self.dt = model.mass, model.gravity, dt
        self._rate, self._delay, self._averaged, self._age = rate, delay, averaged, age
        self._momentum = momentum
        period = packets_per_join(1.0 / rate) / rate
        needed = ceil((delay + NEEDED_PERIODS * period - age) / dt - 1e-9)
        self.lag = max(needed, CONTACT_MARGIN) if lag is None else lag
        self._layout = TelemetryLayout(len(model.joint_names))
        self._values = np.zeros(self._layout.size)
        self._waiting: list[tuple[float, int | None, Floats]] = []
        self._newest: tuple[float, int | None, Floats] = (-np.inf, None, self._values)
        self._clock: SampleClock | None = None
        self._number, self._added = -1, 0  # of the newest sample, and what is added to the robot's numbers
        self._beliefs: Beliefs | MomentumBeliefs | NativeBeliefs | None = None
        self.fell = False

    def _joints(self, joints: Sequence[str] | None, held: Mapping[str, float]) -> None:
        """Find where each measured joint is in the model, and the angles of the others."""
        names = self._robot.model.joint_names
        if joints is None:
            joints = [name for name in names if name not in held]
        wrong = [name for name in (*joints, *held) if name not in names]
        if wrong or len({*joints}) < len(joints) or {*joints} & {*held}:
            raise ValueError(
                f"'joints' and 'held' must name joints of the model, each once, got {list(joints)} and "
                f"{dict(held)}; the model's are {list(names)}."
            )
        if missing := [name for name in names if name not in joints and name not in held]:
            raise ValueError(
                f"'joints' lacks {missing}; measure them, or give their angles in rad, held={{name: angle}}."
            )
        self.joint_names = tuple(joints)
        self._order = np.array([names.index(name) for name in joints], dtype=int)
        self._angles = np.array([held.get(name, 0.0) for name in names])

    def update(
        self,
        joint_position: ArrayLike,
        gyroscope: ArrayLike,
        accelerometer: ArrayLike,
        time: float,
        number: int | None = None,
    ) -> None:
        """Take in one sample of encoders and IMU.

        A sample with NaN or an impossible number counts as lost, and so does one that is repeated or out of
        order. A clock that jumps, a counter that begins again, and lost samples leave a gap; nothing is
        raised.

        Args:
            joint_position: Angles in rad in the order of :attr:`joint_names`, shape (J,).
            gyroscope: Angular velocity in rad/s in the IMU's axes, shape (3,).
            accelerometer: Specific force in m/s^2 in the same axes, gravity included, shape (3,): of a robot
                at rest it points up.
            time: When it was measured, or came, in s on the clock of the feet's samples.
            number: The sample's number, if the robot counts its samples. Give it where times differ from an
                even clock by more than a third of the step between them, as over a wireless link.

        Raises:
            ValueError: If a shape is wrong, or samples come at another rate than ``rate``.
        """
        values = self._packet(joint_position, gyroscope, accelerometer)
        # NaN compares as false.
        if not (np.abs(values).max() <= LARGEST_VALUE and isfinite(time)):
            return
        sample = float(time) - self._delay, number, values
        before, last, known = self._newest
        repeated = sample[0] == before and bool((values == known).all())
        restarts = False
        if number is not None and last is not None:
            restarts = number <= last - OUT_OF_ORDER
            late = number <= last and not restarts
        else:
            late = before - CLOCK_RESET < sample[0] < before
        if late or repeated:
            return
        self._newest = sample
        if self._clock is not None:
            counted = None if number is None or restarts else number + self._added
            self._number = self._clock.number(sample[0], counted)
            if number is not None:
                self._added = self._number - number
            self._feed(self._number, values)
            return
        if sample[0] < before or restarts:
            self._waiting.clear()
        self._waiting.append(sample)
        if len(self._waiting) == START:
            self._begin()

    def _packet(self, joint_position: ArrayLike, gyroscope: ArrayLike, accelerometer: ArrayLike) -> Floats:
        """Return the content of a packet of telemetry, in the torso's axes."""
        angles, spin, force = (np.asarray(part, float) for part in (joint_position, gyroscope, accelerometer))
        for name, part, size in (
            ("joint_position", angles, len(self._order)), ("gyroscope", spin, 3), ("accelerometer", force, 3)
        ):  # fmt: skip
            if part.shape != (size,):
                raise ValueError(f"'{name}' must have shape ({size},), got {part.shape}.")
        values, where, R = self._values.copy(), self._layout, self._robot.R_torso_imu
        position = self._angles.copy()
        position[self._order] = angles
        values[where.joint_position] = position
        values[where.accelerometer], values[where.gyroscope] = R @ force, R @ spin
        return values

    def _begin(self) -> None:
        """Measure the rate of the first samples, and take them in."""
        times, numbers = np.array([time for time, _, _ in self._waiting]), [n for _, n, _ in self._waiting]
        known = [number for number in numbers if number is not None]
        clock = SampleClock(times, known if len(known) == len(numbers) else None)
        if not abs(clock.period * self._rate - 1.0) < LARGEST_RATE_ERROR:
            self._waiting.clear()
            raise ValueError(
                f"Encoders and IMU came {1.0 / max(clock.period, 1e-9):.4g} times a second, and 'rate' is "
                f"{self._rate:g}; give the true rate, and times in seconds."
            )
        robot, joined = self._robot, packets_per_join(clock.period)
        beliefs = Beliefs(
            robot.model, self._layout, clock.period, 0.0, self._averaged,
            lag=self.lag, dt=self.dt, joined=joined, touching=robot.touching, rolls=robot.rolls,
        )  # fmt: skip
        self._period, self._clock, self._number = clock.period, clock, clock.numbers[-1]
        self._beliefs = native_beliefs(MomentumBeliefs(beliefs) if self._momentum else beliefs)
        for number, (_, _, values) in zip(clock.numbers, self._waiting, strict=True):
            self._feed(number, values)
        self._waiting.clear()

    def _feed(self, number: int, values: Floats) -> None:
        """Hand one sample over. Its arrival is on a clock of its own, which is exactly even."""
        assert self._beliefs is not None
        self._beliefs.update((Packet(number, number * self._period, values),))

    def reference(
        self, time: float, stance: ArrayLike | None = None, swing: ArrayLike | None = None
    ) -> MomentumReference | Reference:
        """Return the reference that a calibrator takes with the feet's sample of a time.

        It describes the robot ``lag`` samples before, as :class:`~surefoot.calibration.FootCalibrator`
        expects. It is NaN, from which no calibrator learns, in the first half second, in gaps, and while the
        robot is not upright.

        Args:
            time: When the feet's sample came, in s. Times increase by ``dt`` from call to call.
            stance: Feet that the robot's own plan has standing now (bool), shape (F,). Without a plan
                contacts are found by kinematics.
            swing: Feet that it has in the air now, the same way.
        """
        feet = self._robot.model.feet
        if (stance is None) != (swing is None):
            raise ValueError("Give both 'stance' and 'swing', or neither.")
        plan = None if stance is None else Plan(np.asarray(stance, bool), np.asarray(swing, bool))
        if plan is not None and not plan.stance.shape == plan.swing.shape == (feet,):
            raise ValueError(
                f"'stance' and 'swing' must have shape ({feet},), a value for each foot, got "
                f"{plan.stance.shape} and {plan.swing.shape}."
            )
        beliefs, clock = self._beliefs, self._clock
        if beliefs is None or clock is None:
            return unknown(feet) if self._momentum else nothing(feet)
        moment = float(time) - self.lag * self.dt - self._age
        exact = (moment - clock.origin) / clock.period if isfinite(moment) else -np.inf
        self.fell = beliefs.sample(exact * self._period, plan)
        if (exact - self._number) * self._period > FILLED_TIME:
            # Encoders and IMU have stopped: what is believed is of their last sample.
            return unknown(feet) if self._momentum else nothing(feet)
        found = beliefs.believed
        return found if isinstance(found, Reference | MomentumReference) else found.reference()
