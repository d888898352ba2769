"""By how many samples the feet wait for the telemetry of the robot's motion."""

from math import ceil

from surefoot.robot.beliefs.contacts import CONTACT_MARGIN
from surefoot.sensors.telemetry.computer import Telemetry
from surefoot.sensors.transport.link import JITTER_BOUND, Link

HISTORY = 64  # how many joined packets are kept: more than any lag needs

JOINED_TIME = 0.01
"""Time in s over which packets of a faster link are joined into one: a NAO's period. Second differences of
joint angles amplify noise and rounding of the encoders by one over its square."""


def packets_per_join(period: float) -> int:
    """Return how many packets of a link become one, of the time between them in s."""
    return max(1, round(JOINED_TIME / period))


def usual_lag(link: Link, period: float, dt: float, age: float) -> int:
    """Return after how many samples the packets that a reference needs have almost always come.

    Args:
        link: The way of encoders and IMU to the host.
        period: Time between its packets in s.
        dt: Time between samples in s.
        age: How old a reading of the feet is when it is taken, in s.
    """
    needed = link.delay + 2.0 * link.jitter + 2.5 * packets_per_join(period) * period - age
    return max(ceil(needed / dt), CONTACT_MARGIN)


def waiting_samples(lag: int, age: float, dt: float) -> int:
    """Return for how many samples, ``dt`` s apart, a reference may still be about the episode before.

    It describes the feet ``lag`` samples ago; the age is as of :func:`usual_lag`.
    """
    return lag + 1 + ceil(age / dt - 1e-9)


def check_lag(lag: int, telemetry: Telemetry, age: float) -> None:
    """Raise ValueError if a lag in samples is so long that the packets it needs are no longer kept."""
    # The newest packet that can have come, when the jitter was kind.
    youngest = max(telemetry.link.delay - JITTER_BOUND * telemetry.link.jitter, 0.0)
    period = packets_per_join(telemetry.period) * telemetry.period
    packets = ceil((lag * telemetry.dt + age - youngest) / period) + 3
    if packets > HISTORY:
        raise ValueError(
            f"A lag of {lag} samples over {telemetry.link} needs {packets} packets, and at most "
            f"{HISTORY} are kept; choose a shorter 'lag', or a link with a lower rate or less jitter."
        )
