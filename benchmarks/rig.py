"""Sensors on the simulated rig of in-situ calibration: from true wrenches and motion to a robot's readings.

Everything random belongs to a seed. Offsets jump between data sets, as masses are changed.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.imu import calibrate_accelerometer, gravity_from_imu
from surefoot.calibration.in_situ import InSituSet, Limb
from surefoot.envs.leg_rig.recording import RigRecording
from surefoot.sensors import Imu, StrainGauges, imu, preset, strain_gauges
from surefoot.sensors.devices.native_device import native_here
from surefoot.sensors.devices.native_kinds import STRAIN_GAUGES
from surefoot.sensors.devices.strain_gauges import StrainGaugeState, shift_offset, true_response
from surefoot.sensors.randomness import Stream

XSENS_MTX = Imu(
    accelerometer_noise=2.0e-3,
    gyroscope_noise=8.7e-4,
    accelerometer_bias_std=0.05,
    gyroscope_bias_std=1.0e-3,
    accelerometer_walk=5.0e-5,
    gyroscope_walk=2.0e-5,
    accelerometer_resolution=50.0 / 2**15,
    gyroscope_resolution=1.0e-4,
    accelerometer_range=50.0,
    gyroscope_range=20.9,
    averaged=False,
)
"""An IMU like the one of the in-situ paper (XSens MTx): noise densities of 0.002 m/s^2 and 0.05 deg/s per
root hertz, ranges of 50 m/s^2 and 1200 deg/s. Its gyroscope was zeroed at rest; its accelerometer was not
calibrated. The random walks are assumptions, because the data sheet gives none."""

SENSORS = ("foot", "leg")
OFFSET_SHIFT = (2.0, 0.05)  # standard deviation of the jumps of the offsets between sets, in N and N m

_STREAM = 0x1F75


class SensorTruth(NamedTuple):
    """The simulator's truth of a sensor."""

    response: Floats  # A in counts per N and N m, shape (6, 6)
    offsets: Floats  # o in counts, mean of the beginning and the end of each set, shape (J, 6)
    offset: Floats  # o at the end of the last set in counts, shape (6,)
    limb: Limb  # beyond the sensor, nothing added


def sensor_config(sensor: str, *, white: bool = False, exact: bool = False) -> StrainGauges:
    """Return the sensor of "foot" or "leg".

    With ``white`` its only error is white noise, besides its matrix and offsets; with ``exact`` it has no
    noise.
    """
    config = preset(f"icub-ftsens-{sensor}", StrainGauges)
    if white or exact:
        config = replace(
            config,
            adc_bits=0,
            hysteresis=0.0,
            creep_shares=(),
            creep_time_constants=(),
            offset_drift_force=0.0,
            offset_drift_torque=0.0,
        )
    return replace(config, noise_force=0.0, noise_torque=0.0) if exact else config


def read_sensor(
    config: StrainGauges, sensor: str, recordings: Sequence[RigRecording], seed: int
) -> tuple[Floats, SensorTruth]:
    """Return the counts (J, n, 6) of a seed's sensor in J recordings of one rate, and the truth."""
    place = SENSORS.index(sensor)
    rng, stream = np.random.default_rng([_STREAM, place + 2, seed]), Stream.of(_STREAM, place, seed)
    state = strain_gauges(config).init((config.channels,), rng)
    response = true_response(config, state)[0]
    dt = float(recordings[0].time[1] - recordings[0].time[0])
    counts: list[Floats] = []
    first: list[Floats] = []
    last: list[Floats] = []
    for recording in recordings:
        if first:
            # The sensor is switched on again for each set, and only its offsets have changed since the last
            # one.
            state = shift_offset(config, state, rng, *OFFSET_SHIFT)
        raw, after = read_sequence(config, getattr(recording, f"wrench_{sensor}"), state, stream, dt)
        counts.append(raw)
        first.append(state.offset)
        last.append(after.offset)
    offsets = (np.array(first) + np.array(last)) / 2.0
    limb = Limb(*getattr(recordings[0], f"limb_{sensor}"))
    return np.array(counts), SensorTruth(response, offsets, last[-1], limb)


def read_sequence(
    config: StrainGauges, wrench: Floats, state: StrainGaugeState, stream: Stream, dt: float
) -> tuple[Floats, StrainGaugeState]:
    """Read wrenches (n, 6) at intervals of ``dt`` s; return the counts (n, k) and the sensor's last state.

    The library in C is used where it is installed: it takes a tenth of the time.
    """
    native = native_here(STRAIN_GAUGES, config)
    if native is not None:
        kept = native.pack(state)
        return np.array([native.step(kept, one, stream, dt) for one in wrench]), kept.python()
    sensor, counts = strain_gauges(config), []
    for one in wrench:
        read, state = sensor.apply(one, state, stream, dt)
        counts.append(read)
    return np.array(counts), state


def read_imu(recordings: Sequence[RigRecording], seed: int, config: Imu = XSENS_MTX) -> Floats:
    """Read specific force and angular velocity with the IMU of a seed, shape (J, n, 6)."""
    device, rng = imu(config), np.random.default_rng([_STREAM, 4, seed])
    first = device.init((6,), np.random.default_rng([_STREAM, 5, seed]))
    found = []
    for recording in recordings:
        felt, state = np.hstack([recording.specific_force, recording.angular_velocity]), first
        dt = float(recording.time[1] - recording.time[0])
        for i, row in enumerate(felt):
            felt[i], state = device.apply(row, state, rng, dt)
        found.append(felt)
    return np.array(found)


def static_sets(
    sensor: str, recordings: Sequence[RigRecording], counts: Floats, specific_force: Floats
) -> tuple[InSituSet, ...]:
    """Return sets of a limb at rest, from counts (J, n, 6) and specific force without bias (J, n, 3)."""
    parts = zip(recordings, counts, specific_force, strict=True)
    return tuple(_set(sensor, recording, raw, -force) for recording, raw, force in parts)


def moving_sets(
    sensor: str,
    recordings: Sequence[RigRecording],
    counts: Floats,
    readings: Floats,
    bias: Floats,
    window: int = 15,
) -> tuple[InSituSet, ...]:
    """Return sets of a moving limb at the sensor, from readings of an IMU (J, n, 6) and its bias in m/s^2.

    The angular acceleration is the slope over a window of samples, an odd number.
    """
    found = []
    for recording, raw, read in zip(recordings, counts, readings, strict=True):
        place, dt = getattr(recording, f"position_imu_{sensor}"), float(recording.time[1] - recording.time[0])
        motion = gravity_from_imu(read[:, :3] - bias, read[:, 3:], dt=dt, position_imu=place, window=window)
        turning = {name: getattr(motion, name) for name in ("angular_velocity", "angular_acceleration")}
        found.append(_set(sensor, recording, raw, motion.gravity, **turning))
    return tuple(found)


def _set(sensor: str, recording: RigRecording, raw: Floats, gravity: Floats, **motion: Floats) -> InSituSet:
    added_com = getattr(recording, f"added_com_{sensor}")
    about: dict[str, Any] = {"time": recording.time, "name": recording.name, **motion}
    return InSituSet(raw, gravity, recording.added_mass, added_com, **about)


def accelerometer_bias(specific_force: Floats) -> Floats:
    """Return the bias of an accelerometer, calibrated from its readings (..., 3) as a robot would do it."""
    return calibrate_accelerometer(specific_force.reshape(-1, 3), model="bias").bias
