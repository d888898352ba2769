"""By how many samples the feet wait for the telemetry that tells what the robot did."""

from math import ceil

from surefoot.wrappers.beliefs import HISTORY
from surefoot.wrappers.contacts import CONTACT_MARGIN
from surefoot.wrappers.telemetry import Telemetry


def usual_lag(telemetry: Telemetry, age: float) -> int:
    """Tell after how many samples the packets that a reference needs have come, as good as always.

    Args:
        telemetry: The way of encoders and IMU to the host.
        age: How old a reading of the feet is when it is taken, in s.
    """
    needed = telemetry.link.delay + 2.0 * telemetry.link.jitter + 2.5 * telemetry.period - age
    return max(ceil(needed / telemetry.dt), CONTACT_MARGIN)


def held_samples(lag: int, age: float, dt: float) -> int:
    """Tell for how many samples of an episode a reference may still be about the one before.

    Args:
        lag: How many samples ago a reference describes the feet.
        age: As of :func:`usual_lag`.
        dt: Time between samples in s.
    """
    return lag + 1 + ceil(age / dt - 1e-9)


def check_lag(lag: int, telemetry: Telemetry, age: float) -> None:
    """Refuse a lag so long that the packets it needs would no longer be kept.

    Args:
        lag: In samples.
        telemetry: As of :func:`usual_lag`.
        age: As of :func:`usual_lag`.

    Raises:
        ValueError: If they would not.
    """
    # The newest packet that can have come, when the jitter was kind.
    youngest = max(telemetry.link.delay - 6.0 * telemetry.link.jitter, 0.0)
    packets = ceil((lag * telemetry.dt + age - youngest) / telemetry.period) + 3
    if packets > HISTORY:
        raise ValueError(
            f"A lag of {lag} samples over {telemetry.link} needs {packets} packets, and at most "
            f"{HISTORY} are kept; choose a shorter 'lag', or a link with a lower rate or less jitter."
        )
