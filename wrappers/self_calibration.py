"""Self-calibration of a robot while it walks, with its own state estimates."""

from collections.abc import Mapping, Sequence
from typing import Any, SupportsFloat

import gymnasium as gym
from gymnasium import spaces

from surefoot.calibration import FootCalibrator, Parameters
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.online import MethodOptions
from surefoot.pickles import OfOneVersion
from surefoot.robot.beliefs.errors import USUAL, BeliefErrors
from surefoot.robot.calibration import CalibrationFace, CalibrationSetup, RobotCalibration
from surefoot.robot.foot_view import RAW, drop_counts
from surefoot.robot.streams import BELIEF_STREAM
from surefoot.wrappers.foot_sensors import FootSensors
from surefoot.wrappers.source import check_clock, find_sensors, split_options


class SelfCalibration(
    OfOneVersion, CalibrationFace, gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs
):
    """Calibrate the readings of :class:`FootSensors` while the robot moves, and observe the result.

    The observation gains the parts that ``show`` names, computed from the counts. ``"foot_raw"`` is removed
    unless ``show`` names it, because counts of several millions saturate a policy.

    | Key | Observation | Min | Max | Unit |
    |-----|-------------|-----|-----|------|
    | ``"foot_force"`` (K) | calibrated channels, ordered as ``"foot_raw"`` | -1000 | 1000 | N (N m) |
    | ``"cop_foot"`` (F, 2) | centre of pressure of each foot, the left one first, sole frame | -1 | 1 | m |
    | ``"cop"`` (2) | centre of pressure of all feet together, level frame | -1 | 1 | m |
    | ``"cop_valid"`` (1 + F) | whether the total one and those of the feet are defined | 0 | 1 | 1 |
    | ``"foot_load"`` (K) | ``"foot_force"`` by the robot's weight | -1000 / weight | 1000 / weight | 1 (m) |
    | ``"foot_raw"`` (K) | raw readings, see :class:`FootSensors` | 0 | 2^24 - 1 | count |
    | ``"wrench"`` (F, 6) | wrench of the ground on each sole, sole frame | -1000 | 1000 | N, N m |
    | ``"vgrf"`` (F) | vertical force on each foot, level frame | -1000 | 1000 | N |
    | ``"foot_force_std"`` (K) | standard deviation of ``"foot_force"`` | 0 | 1000 | N (N m) |
    | ``"cop_std"`` (2) | standard deviation of ``"cop"`` | 0 | 1 | m |
    | ``"contact_probability"`` (F) | probability that a foot bears load | 0 | 1 | 1 |
    | ``"undetermined"`` (K) | share of a scale's variance that is open | 0 | 1 | 1 |
    | ``"foot_force_aligned"`` (K) | calibrated channels at one common moment | -1000 | 1000 | N (N m) |
    | ``"cop_foot_aligned"`` (F, 2) | centres of pressure of the feet then, sole frame | -1 | 1 | m |
    | ``"cop_aligned"`` (2) | centre of pressure of all feet then, level frame of now | -1 | 1 | m |
    | ``"foot_flags"`` (K) | :class:`~surefoot.calibration.estimate.Flag` bits | 0 | 2^31 - 1 | 1 |

    F is the number of feet. The first four are shown by default, ``"cop_foot"`` only for feet that have an
    area and measure the point of action. ``"contact_probability"`` and ``"undetermined"`` need the method
    ``"moment"``. The common moment of aligned values was ``FootCalibrator.aligned_lag`` samples ago, usually
    one. They suit a learner or a log, the others a controller that reacts within a step. For a robot of more
    than 20 kg the bounds are five times its weight. A centre of pressure is defined above 5 N. Below that,
    the last one is held and flagged. The calibrator compares the counts with a reference that the robot
    computes from telemetry and a nominal model with wrong masses (:mod:`surefoot.robot.beliefs`), never from
    truth. Stance and swing are taken from the environment's ``command`` or, without one, from kinematics
    (:mod:`surefoot.robot.beliefs.contacts`).

    ``info["surefoot"]`` gains ``"parameters"`` (``"scale"`` and ``"offset"``, each (K)), ``"covariance"`` (or
    ``None``), ``"flags"`` (K), ``"vgrf"`` (F) N, of method ``"moment"`` ``"contact_probability"`` (F) and
    ``"undetermined"`` (K), ``"reference"`` (a mapping of the fields of
    :class:`~surefoot.calibration.Reference`, which are 0 while its ``"known"`` is false) and ``"lag"``, the
    delay of the reference in samples.

    Resets keep the calibration, as they keep the sensors. It starts again at a reset with a seed or with
    fresh sensors, and with ``fresh=True`` at every reset. ``options={"surefoot": {"calibration": choice}}``
    with ``"fresh"`` or ``"keep"`` decides for one reset.

    Args:
        env: An environment with :class:`FootSensors` around it.
        method: A key of :data:`surefoot.calibration.METHODS`.
        initial: The initial map: ``"nominal"``, that of the data sheet; ``"calibrated"``, the result of a
            calibration with known weights just before the episode; or
            :class:`~surefoot.calibration.Parameters` (also as a mapping), or the JSON file of
            ``surefoot calibrate weights``.
        show: Parts of the observation; ``None`` for the first four. For a policy without its own scaling use
            ``("foot_load", "cop_foot", "cop", "cop_valid")``, which are of the order of one.
        lag: Delay of the reference in samples; by default the least that the link allows.
        fresh: Whether calibration starts again at each reset.
        errors: Errors of the robot's model of itself, also as a mapping of some of the fields.
        stream: Number of the random stream; another one gives other model errors in the same episode.
        options: Options of the method.

    Attributes:
        robot: The robot's beliefs and its calibrator, which persist over episodes.
        layout: The feet and their channels.

    Raises:
        TypeError: If there is no :class:`FootSensors` below, or another wrapper of this kind, or if the
            observation is no ``Dict`` any more.
        RuntimeError: At a step, if a wrapper between both repeats steps or resets by itself.
        ValueError: If the method or an option does not exist, a value has no meaning, or the robot is none
            that a nominal model can be made of: one free body, hinge joints, feet.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        method: str | MethodOptions = "moment",
        *,
        initial: str | Parameters | Mapping[str, Any] = "nominal",
        show: Sequence[str] | None = None,
        lag: int | None = None,
        fresh: bool = False,
        errors: BeliefErrors | Mapping[str, Any] = USUAL,
        stream: int = BELIEF_STREAM,
        **options: Any,
    ) -> None:
        self._sensors = sensors = find_sensors(env, SelfCalibration, FootSensors, gym.Wrapper)
        given: dict[str, Any] = {"lag": lag, "fresh": fresh, "stream": stream}
        options |= {"initial": initial, "show": show, "errors": errors}
        setup = CalibrationSetup("SelfCalibration", sensors.robot.equipment, method, **given, **options)
        given |= {"initial": setup.start.as_plain(), "show": list(setup.show), "errors": setup.errors}
        gym.utils.RecordConstructorArgs.__init__(self, method=setup.method, **given, **setup.given)
        gym.Wrapper.__init__(self, env)
        space = env.observation_space
        if not isinstance(space, spaces.Dict):
            raise TypeError(
                "SelfCalibration adds to a Dict of observations, as FootSensors shows them, and found "
                f"{type(space).__name__}; wrap in this order, and whatever changes observations around both: "
                f"SelfCalibration(FootSensors(env)). Got {env}."
            )
        sensors.listen()
        self.robot, self.layout = RobotCalibration(setup, sensors.robot), setup.layout
        self._shows_raw = RAW in setup.show
        self.observation_space = spaces.Dict(drop_counts(space.spaces, setup.show) | setup.spaces)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, and keep the calibration or start it again.

        Args:
            seed: Seeds the environment, the sensors and the errors of the beliefs; calibration starts again.
            options: ``options["surefoot"]["calibration"]`` may be ``"fresh"`` or ``"keep"``. All options are
                passed on.

        Raises:
            ValueError: If a choice does not exist, or the lag needs more telemetry than is kept.
        """
        _, asked = split_options(options, "sensors", "calibration")
        self.robot.judge()
        observation, info = self.env.reset(seed=seed, options=options)
        self.robot.reset(seed, asked.get("calibration"))
        return self._calibrate(observation, info), info

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment and calibrate by one sample."""
        sensors = self._sensors.robot
        before = sensors.time
        observation, reward, terminated, truncated, info = self.env.step(action)
        check_clock("SelfCalibration", self.env, sensors.time - before, sensors.telemetry.dt)
        observation = self._calibrate(observation, info)
        if terminated:
            # Usually a fall, which began some samples earlier.
            self.robot.retract()
        return observation, reward, terminated, truncated, info

    @property
    def _robot(self) -> RobotCalibration:
        """The robot, which has a calibrator and beliefs after its first reset."""
        if not self.robot.made:
            raise gym.error.ResetNeeded("There are no calibrator and no beliefs before the first reset().")
        return self.robot

    @property
    def calibrator(self) -> FootCalibrator:
        """The calibrator; available after the first reset."""
        return self._robot.calibrator

    @property
    def beliefs(self) -> Any:
        """The robot's beliefs in the form that the method needs; available after the first reset."""
        return self._robot.beliefs

    @property
    def estimate(self) -> Estimate:
        """The calibrator's last estimate."""
        return self.robot.estimate

    @property
    def reference(self) -> Any:
        """The calibrator's last reference: a ``Reference``, or for ``"moment"`` a ``MomentumReference``."""
        return self.robot.reference

    @property
    def reference_time(self) -> float:
        """The time of the last reference on the host's clock in s since the reset."""
        return self.robot.reference_time

    @property
    def _robots(self) -> Sequence[RobotCalibration]:
        return [self.robot]

    def _calibrate(self, observation: dict[str, Any], info: dict[str, Any]) -> dict[str, Any]:
        """Process the packets that have arrived and one sample."""
        shown, told = self.robot.sample(getattr(self._sensors.source, "command", None))
        info.setdefault("surefoot", {}).update(told)
        seen = {**observation, **shown}
        if not self._shows_raw:
            seen.pop(RAW, None)
        return seen
