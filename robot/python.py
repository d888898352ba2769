"""All of one sample of one robot by Python, which is the specification of :mod:`surefoot.robot.native`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import FootCalibrator
from surefoot.calibration.estimate import Estimate
from surefoot.robot.beliefs.momentum import MomentumBeliefs
from surefoot.robot.beliefs.native import NativeBeliefs
from surefoot.robot.beliefs.references import Beliefs
from surefoot.robot.chances import Chances
from surefoot.robot.foot_view import DETERMINED, FootView
from surefoot.robot.sensing.sensors import RobotSensors

AnyBeliefs = Beliefs | MomentumBeliefs | NativeBeliefs

Outputs = tuple[dict[str, NDArray[Any]], dict[str, Any]]
"""Observation of a sample, and ``info`` of its estimate, in fresh arrays."""


class PythonSample:
    """The specification; ``sampled`` says whether it has taken in any sample."""

    def __init__(
        self, beliefs: AnyBeliefs, calibrator: FootCalibrator, view: FootView, chances: Chances
    ) -> None:
        self._beliefs, self._calibrator, self._view, self._chances = beliefs, calibrator, view, chances
        self._estimate: Estimate
        self.sampled = False

    def sample(self, sensors: RobotSensors, then: float, command: Any, hold: bool) -> Outputs:
        """Take in the packets that have arrived and one sample; a fall takes back the latest learning.

        Args:
            sensors: The robot's sensors, which have read the sample.
            then: The moment that its reference describes, in s of the host's clock since the reset.
            command: The robot's command to itself, if any.
            hold: Whether nothing is learnt of it.
        """
        beliefs = self._beliefs
        if believe(beliefs, sensors, then, command, hold, self._chances):
            self._calibrator.retract()
        age = sensors.ages
        if age is not None:
            # What is handed out is of the middle of the last step; see CalibrationSetup.calibrator.
            age = age - 0.5 * sensors.telemetry.dt
        self._estimate = estimate = self._calibrator.update(sensors.raw, beliefs.believed, age=age)
        self.sampled = True
        shown = self._view.show(estimate, np.asarray(beliefs.soles(sensors.time)))
        # Copies, as an estimate may hold arrays of the one before.
        told = {
            "parameters": {"scale": estimate.scale.copy(), "offset": estimate.offset.copy()},
            "covariance": None if estimate.covariance is None else estimate.covariance.copy(),
            "flags": estimate.flags.copy(),
            "vgrf": estimate.vgrf.copy(),
            "reference": beliefs.info(),
        }
        shares = {name: getattr(estimate, name) for name in DETERMINED}
        return shown, told | {name: share.copy() for name, share in shares.items() if share is not None}

    def estimate(self) -> Estimate:
        """Return the last estimate."""
        return self._estimate


def believe(
    beliefs: AnyBeliefs, sensors: RobotSensors, then: float, command: Any, hold: bool, chances: Chances
) -> bool:
    """Find the reference of one sample, and count it; return whether the robot has just fallen.

    Arguments are those of :meth:`PythonSample.sample`.
    """
    waits = chances.next()
    beliefs.update(sensors.packets)
    fell = beliefs.sample(then, command, hold or waits)
    chances.add(beliefs.known, beliefs.standing)
    return fell
