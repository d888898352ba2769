"""Devices by their names, and load cells for robots of other weights."""

from collections.abc import Mapping
from dataclasses import replace
from math import radians
from typing import Any, Final, TypeVar

from surefoot.files import read_toml
from surefoot.names import check_new_name, plain_name
from surefoot.sensors.configuration import from_mapping
from surefoot.sensors.devices.encoders import Encoders
from surefoot.sensors.devices.force_torque import ForceTorque
from surefoot.sensors.devices.imu import Imu
from surefoot.sensors.devices.load_cell_config import LoadCells
from surefoot.sensors.devices.strain_gauge_config import FTSENS_SN142, StrainGauges
from surefoot.sensors.severity import scaled
from surefoot.sensors.stages.affine import PER_SQRT_MINUTE
from surefoot.sensors.stages.mechanics import Mechanics
from surefoot.sensors.transport.link import Link
from surefoot.sensors.transport.wire import Wire

Config = TypeVar("Config")

REFERENCE_WEIGHT: Final = 5.305 * 9.81
"""Weight in N of a NAO, the robot for which the load cells below have their sizes."""

HX711_LOAD_CELLS = LoadCells()
"""Eight uncalibrated cells of 98.1 N and 1 mV/V on HX711 chips at gain 128 and nominally 80 SPS."""

BAR_CELLS_ON_HX711 = LoadCells(
    scale_tempco=5e-5,
    offset_tempco=5e-4 * 9.81,
    temperature_ramp=14.0 / 900.0,
    temperature_rise=14.0,
    settling=4,
    mechanics=Mechanics(
        nonlinearity=5e-4,
        hysteresis=5e-4,
        creep_shares=(3e-4, 2e-4),
        creep_time_constants=(20.0, 400.0),
        mounting_warp_std=0.5,
        overload_share=0.01,
    ),
    wire=Wire(
        spike_rate=1.0 / 60.0,
        wrong_words=1e-3,
        stale_repeats=0.01,
        packet_loss=5e-3,
        gap_share=0.002,
        gap_length=0.125,
        delay=0.020,
        jitter=0.004,
        under_way=4,
    ),
)
"""The same cells with every error: a cheap bar cell's data sheet (nonlinearity, hysteresis and creep in half
an hour of 5e-4 each, offset of 5e-5 of the capacity per kelvin), a foot that warms up by 14 K in a quarter of
an hour, an HX711 that settles in 4 conversions, and the CoP paper's wireless network (20 +- 4 ms). The warp
of an impact, the share of an overload and the rates of spikes, wrong words, repeats and losses are chosen
within what logs and bug reports report."""

NAO_FSR = LoadCells(
    capacity=25.0,
    rated_output=0.5,
    excitation=3.3,
    adc_gain=1.0,
    adc_bits=10,
    coding="two's complement",
    polarity=(1,),
    input_noise=1.6e-3,
    rate=None,
    initial_scale_std=0.3,
    initial_offset_std=0.1,
    scale_drift=0.02 * PER_SQRT_MINUTE,
    offset_drift=0.02 * PER_SQRT_MINUTE,
    mechanics=Mechanics(
        nonlinearity=0.06,
        hysteresis=0.1,
        creep_shares=(0.05, 0.05, 0.05),
        creep_time_constants=(1.0, 10.0, 100.0),
        mounting_common_std=0.05,
    ),
    wire=Wire(stale_repeats=0.73),
)
"""Eight force-sensing resistors under a NAO's soles. Seen: the range of 25 N (Aldebaran), offsets of at most
0.2 N in swing, 73 % of the readings repeated, and a robot of 5.3 kg that its feet call 3.5 kg (an own look
at a public log), for which the spread of the scales stands. By the data sheet of such resistors (Interlink
FSR 400): hysteresis of 10 %, drift of at most 5 % a decade of time. Inferred: 10 bits of 0.05 N, noise of
0.05 N, nonlinearity, drift and jumps. Readings that are stuck at zero half of the time are left out: add
:class:`~surefoot.sensors.Fault` s."""

PERFECT_LOAD_CELLS = scaled(LoadCells(adc_bits=0, polarity=(1,), rate=None, averaged=True), 0.0)
"""Cells that report the true mean load since they were last read, in N."""

ICUB_FORCE_TORQUE = ForceTorque()
"""Two sensors like the FTSens in an iCub's ankles."""

ATI_MINI45 = ForceTorque(
    full_scale_force=580.0,
    full_scale_torque=20.0,
    resolution_force=0.25,
    resolution_torque=0.005,
    noise_force=0.25,
    noise_torque=0.005,
    initial_scale_std=0.01,
    cross_talk_std=0.005,
    initial_offset_force_std=1.0,
    initial_offset_torque_std=0.03,
    scale_drift=0.0,
    offset_drift_force=0.05 * PER_SQRT_MINUTE,
    offset_drift_torque=0.001 * PER_SQRT_MINUTE,
)
"""Two sensors of the class of an ATI Mini45 with its range of 580 N and 20 N m. Of its errors only this is
published: offsets change within hours, calibration is to be repeated every year (in-situ paper), and the
offsets of a sister model, in a Valkyrie's feet, changed by 20 to 30 N. No data sheet was at hand: the range
is from memory, all other numbers are inferred from the class."""

PERFECT_FORCE_TORQUE = scaled(ForceTorque(resolution_force=0.0, resolution_torque=0.0), 0.0)
"""Sensors that report the true mean wrench since they were last read, in N and N m."""

ICUB_FTSENS_LEG = StrainGauges()
"""The old FTSens in an iCub's leg, number 39."""

ICUB_FTSENS_FOOT = StrainGauges(
    FTSENS_SN142, scale_error_std=0.15, hysteresis_true_force=10.0, hysteresis_true_torque=0.5
)
"""The younger one in a foot, number 142; the weight of a foot of 0.8 kg shows as an ellipsoid with axes of
1.3 to 1 in the median (in-situ paper, Table I: 1.4), of 1.1 to 1.6 in 80 % of sensors."""

PERFECT_STRAIN_GAUGES = scaled(StrainGauges(adc_bits=0, creep_shares=(), creep_time_constants=()), 0.0)
"""Gauges of which the maker's matrix, that of the leg's sensor, makes the true wrench."""

NAO_IMU = Imu()
"""Accelerometer and gyroscope of a NAO V5."""

ONBOARD_IMU = Imu(
    accelerometer_noise=175e-6 * 9.81,
    gyroscope_noise=radians(0.014),
    accelerometer_resolution=12.0 * 9.81 / 2.0**15,
    gyroscope_resolution=radians(2000.0) / 2.0**15,
    accelerometer_range=12.0 * 9.81,
    gyroscope_range=radians(2000.0),
)
"""The IMU of a humanoid of today, by the data sheet of a chip that is common there (Bosch BMI088: noise of
175 ug and 0.014 degrees/s per sqrt(Hz), 16 bits, ranges of 12 g and 2000 degrees/s); biases as a NAO's, after
the usual zeroing."""

PERFECT_IMU = scaled(
    Imu(accelerometer_resolution=0.0, gyroscope_resolution=0.0, accelerometer_range=0.0, gyroscope_range=0.0),
    0.0,
)
"""An IMU that reports what happened on the average since it was last read."""

NAO_ENCODERS = Encoders()
"""The 12-bit joint encoders of a NAO."""

ONBOARD_ENCODERS = Encoders(bits=14)
"""Magnetic encoders of 14 bits on the joints' own axes, as in today's humanoids."""

ONBOARD_LINK = Link(rate=500.0, delay=0.002, jitter=0.0002)
"""The motors' bus of a humanoid whose policy runs on board: 500 packets/s, one packet late, as Unitree's
low-level state comes."""

NAO_LINK = Link()
"""NAOqi over a wireless network: 100 packets/s, 20 +- 4 ms late."""

PRESETS: dict[type, dict[str, Any]] = {
    LoadCells: {
        "hx711-load-cells": HX711_LOAD_CELLS,
        "hx711-bar-cells": BAR_CELLS_ON_HX711,
        "nao-fsr": NAO_FSR,
        "perfect": PERFECT_LOAD_CELLS,
    },
    ForceTorque: {
        "icub-ftsens": ICUB_FORCE_TORQUE,
        "icub-force-torque": ICUB_FORCE_TORQUE,
        "ati-mini45": ATI_MINI45,
        "perfect": PERFECT_FORCE_TORQUE,
    },
    StrainGauges: {
        "icub-ftsens-leg": ICUB_FTSENS_LEG,
        "icub-ftsens-foot": ICUB_FTSENS_FOOT,
        "perfect": PERFECT_STRAIN_GAUGES,
    },
    Imu: {
        "nao-imu": NAO_IMU,
        "onboard-imu": ONBOARD_IMU,
        "perfect": PERFECT_IMU,
    },
    Encoders: {
        "nao-encoders": NAO_ENCODERS,
        "onboard-encoders": ONBOARD_ENCODERS,
        "perfect": Encoders(bits=0, bias_std=0.0, noise_std=0.0),
    },
    Link: {
        "nao-wlan": NAO_LINK,
        "onboard-500hz": ONBOARD_LINK,
        "perfect": Link(rate=None, delay=0.0, jitter=0.0),
    },
}
"""Every preset by the class of its configuration and its name; :func:`register_preset` adds to it."""

SHIPPED = frozenset(name for named in PRESETS.values() for name in named)
"""Names of the presets of this package."""


def register_preset(name: str, config: Any, *, replace: bool = False) -> None:
    """Give a device of your own a name, to be used wherever the presets of this package are.

    Where your module is not imported, such as on the command line and in other processes, name it as well:
    ``"module:name"``. Registering the same again changes nothing.

    Args:
        name: A new name.
        config: :class:`LoadCells`, :class:`ForceTorque`, :class:`StrainGauges`, :class:`Imu`,
            :class:`Encoders` or :class:`Link` with your numbers.
        replace: Whether a preset of yours of that name is replaced.

    Raises:
        TypeError: If it is no such configuration.
        ValueError: If the name is taken or has no letters.
    """
    kind = type(config)
    if kind not in PRESETS:
        kinds = ", ".join(known.__name__ for known in PRESETS)
        raise TypeError(f"A preset must be one of {kinds}, got {kind.__name__}.")
    own = PRESETS[kind]
    if name in own and name not in SHIPPED and (replace or own[name] == config):
        own[name] = config
        return
    # A name means one device, of whatever class: under a foot there may be two of them.
    check_new_name("preset", name, {taken for named in PRESETS.values() for taken in named})
    own[name] = config


def preset(name: str, kind: type[Config] = LoadCells) -> Config:  # type: ignore[assignment]
    """Look up a device by its name, or read it from a file.

    Args:
        name: Such as ``"hx711-load-cells"``, ``"module:name"`` for one of yours, or the path of a file as
            :func:`read_preset` reads it.
        kind: The class of the configuration: :class:`LoadCells`, :class:`ForceTorque`,
            :class:`StrainGauges`, :class:`Imu`, :class:`Encoders` or :class:`Link`.

    Raises:
        ValueError: If the name is unknown (the message lists the known ones), its module cannot be imported,
            or the file is not a preset of this class.

    >>> preset("hx711-load-cells").adc_bits
    24
    """
    if name.endswith(PRESET_FILE):
        config = read_preset(name)
        if not isinstance(config, kind):
            raise ValueError(f"{name}: is a preset of {type(config).__name__}, not of {kind.__name__}.")
        return config
    name, found = plain_name(name), PRESETS[kind]
    if name not in found:
        raise ValueError(f"There is no {kind.__name__} preset '{name}'; there are {sorted(found)}.")
    return found[name]  # type: ignore[no-any-return]


PRESET_FILE = ".toml"  # end of the name of a preset that is a file


def read_preset(path: str) -> Any:
    """Read a preset from a TOML file: one table, which has the name of the class and some of its fields.

    ``surefoot check LOG --preset FILE.toml`` writes such a file. Raises ValueError if the file does not exist
    or is not a preset.
    """
    tables, kinds = read_toml(path), {kind.__name__: kind for kind in PRESETS}
    if len(tables) != 1 or not set(tables) <= set(kinds):
        raise ValueError(f"{path}: must contain one table out of {list(kinds)}, got {list(tables)}.")
    ((name, values),) = tables.items()
    return from_mapping(kinds[name], values)


def resolve(config: str | Mapping[str, Any] | Config, kind: type[Config], name: str = "config") -> Config:
    """Make a configuration of a preset's name or file, a mapping or a configuration.

    Messages name the argument.

    Raises:
        ValueError: If the name or a key of the mapping is unknown, or a value is refused.
        TypeError: If it is none of the three.
    """
    if isinstance(config, kind):
        return config
    if isinstance(config, str):
        return preset(config, kind)
    if isinstance(config, Mapping):
        return from_mapping(kind, config)
    raise refuse_config(config, name, kind.__name__)


def refuse_config(config: Any, name: str, kinds: str) -> TypeError:
    """Return the error for an argument that is no configuration, nor anything that one is made of."""
    way_out = f"; call it: {config.__name__}(...)" if isinstance(config, type) else ""
    wanted = f"the name of a preset, a mapping or a configuration ({kinds})"
    return TypeError(f"'{name}' must be {wanted}, got {config!r}{way_out}.")


def sized(config: LoadCells, weight: float) -> LoadCells:
    """Choose cells of the same kind for a robot of another weight.

    All that is given in newtons goes with the weight: capacity, offsets with their drift and temperature
    coefficient, their change by impacts, and the change of load that counts as an impact. A relative number
    stays; noise and rounding are shares of the range, so they go along.

    Args:
        config: Cells as they would be under a NAO of 52 N; it is not changed.
        weight: Weight of the robot in N.

    Raises:
        ValueError: If the weight is not positive and finite.

    >>> cells = sized(LoadCells(), 33.3 * 9.81)
    >>> round(cells.capacity), round(cells.initial_offset_std, 1), cells.initial_scale_std
    (616, 9.4, 0.12)
    """
    if not 0.0 < weight < float("inf"):
        raise ValueError(f"'weight' must be finite and positive, in N, got {weight}.")
    factor, mechanics = float(weight) / REFERENCE_WEIGHT, config.mechanics
    return replace(
        config,
        capacity=config.capacity * factor,
        initial_offset_std=config.initial_offset_std * factor,
        offset_drift=config.offset_drift * factor,
        offset_tempco=config.offset_tempco * factor,
        mechanics=replace(
            mechanics,
            mounting_warp_std=mechanics.mounting_warp_std * factor,
            mounting_common_std=mechanics.mounting_common_std * factor,
            impact_threshold=mechanics.impact_threshold * factor,
        ),
    )
