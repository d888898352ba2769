"""A leg with two six-axis F/T sensors on a stand: the model of in-situ calibration, and its added masses.

The numbers of the leg are those of rig.xml. The masses that are added to it are those of the experiment
of Traversaro, Pucci and Nori, "In situ calibration of six-axes force-torque sensors using accelerometer
measurements" (ICRA 2015), which its first author published.

Signs are defined here. A wrench is the limb's load on the robot through the sensor, at and in the
sensor's frame: at rest w = M(m, c) g with M = [m I; m [c]x] (Eqs. 3-5 of that paper). MuJoCo's force and
torque sensors measure the load that the parent exerts on the child, which is the opposite.
"""

from collections.abc import Mapping
from importlib.resources import files
from types import MappingProxyType
from typing import Final, NamedTuple

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.options import positive

SENSORS: Final = ("foot", "leg")  # the order of the F/T sensors everywhere

HIP_JOINTS: Final = ("hip_front_back", "hip_lateral")
"""The order of the hip's joints: positive is forward, and outward (to the right)."""

HIP_RANGE: Final[Floats] = np.radians([70.0, 90.0])
"""What the hip's joints sweep, from minus to plus the half of it, in rad, shape (2,)."""

FOOT_IN_LEG: Final[Floats] = np.array([-0.0035, 0.0, 0.3636])
"""Origin of the foot's sensor in the frame of the leg's, to which its own is parallel, in m, shape (3,)."""

STEEL: Final = 7850.0  # density of the added masses in kg/m^3

CONTACT_ANGLE: Final = float(np.radians(-15.0))
"""Front-back angle in rad below which the tip of the beam touches the floor, at lateral angle 0."""

CONTACT_STIFFNESS: Final = 150.0
"""Force in N per m by which the tip of the beam presses the floor, a block of foam, in (within a fifth)."""

_FOAM_IMPEDANCE = 0.05
_FOAM_STIFFNESS = 35.0
_FOAM_DAMPING = 2.0


class AddedMass(NamedTuple):
    """The mass that one data set adds to the foot."""

    mass: float  # in kg
    com_foot: tuple[float, float, float]  # centre of mass in the frame of the foot's sensor in m
    parts: str  # its parts: "cube" (0.51102 kg), "cantilever" (0.19198 kg), both or none

    @property
    def com_leg(self) -> tuple[float, float, float]:
        """Centre of mass in the frame of the leg's sensor in m, while the knee does not bend."""
        x, y, z = (FOOT_IN_LEG + self.com_foot).tolist()
        return x, y, z

    @property
    def width(self) -> float:
        """Edge of a solid steel cube of that mass in m."""
        return float(np.cbrt(self.mass / STEEL))

    @property
    def inertia(self) -> float:
        """Moment of inertia of that cube about axes through its centre in kg m^2 (ours: not published)."""
        return self.mass * self.width**2 / 6.0


ADDED_MASSES: Final[Mapping[int, AddedMass]] = MappingProxyType(
    {
        1: AddedMass(0.0, (0.0, 0.0, 0.0), "none"),
        2: AddedMass(0.703, (-0.018, 0.108341707, 0.003776111), "cube and cantilever"),
        3: AddedMass(0.703, (0.222, 0.108341707, 0.003776111), "cube and cantilever"),
        4: AddedMass(0.703, (0.262, 0.025223889, -0.093879972), "cube and cantilever"),
        5: AddedMass(0.51102, (0.39, -0.0347, 0.029), "cube"),
        6: AddedMass(0.51102, (0.21, 0.0, 0.0637), "cube"),
        7: AddedMass(0.0, (0.0, 0.0, 0.0), "none"),
        8: AddedMass(0.51102, (-0.04, 0.0, 0.0637), "cube"),
    }
)
"""The eight data sets of the paper, which fits on 1 to 4 and validates on 5 to 8."""


def added_mass(configuration: int) -> AddedMass:
    """Look up a data set of the paper; ValueError if there is none."""
    if configuration not in ADDED_MASSES:
        raise ValueError(
            f"There is no configuration {configuration!r}; the paper's data sets are {list(ADDED_MASSES)}."
        )
    return ADDED_MASSES[configuration]


def load_leg_rig_spec(
    configuration: int = 1, *, knee_slack: float = 0.0, floor: bool = False
) -> mujoco.MjSpec:
    """Build the rig of one data set in memory: a specification of its own, to ``compile()``.

    With masses 1 to 8 (:data:`ADDED_MASSES`); the knee bends by ``knee_slack`` rad per N m, where 0 holds it
    and 0.02 bends it by some degrees; with ``floor`` a block of foam stands where the tip of the beam meets
    it at the rear end of the front-back range. ValueError if there is no such configuration or the slack is
    not finite, or negative.
    """
    load = added_mass(configuration)
    slack = positive("knee_slack", knee_slack, or_zero=True)
    xml = files("surefoot.envs.leg_rig").joinpath("rig.xml").read_text(encoding="utf-8")
    spec = mujoco.MjSpec.from_string(xml)
    body, geom = spec.body("added_mass"), spec.geom("added_mass")
    # A body's frame may lie anywhere: only its place, mass and inertia say what it is.
    body.pos = _in_body(load.com_foot)
    body.mass = load.mass
    body.inertia = np.full(3, load.inertia)
    geom.size = np.full(3, max(load.width / 2.0, 1e-6))
    if slack > 0.0:
        spec.body("shank").add_joint(
            name="knee",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0.0, -1.0, 0.0],
            stiffness=1.0 / slack,
            damping=0.5 / np.sqrt(slack),
        )
    if floor:
        _add_floor(spec)
    return spec


def place_added_mass(model: mujoco.MjModel, data: mujoco.MjData, configuration: int) -> None:
    """Hang the masses of another data set onto a compiled rig; ValueError if there is none."""
    load = added_mass(configuration)
    body, geom = model.body("added_mass").id, model.geom("added_mass").id
    model.body_pos[body] = _in_body(load.com_foot)
    model.body_mass[body] = load.mass
    model.body_inertia[body] = load.inertia
    model.geom_size[geom] = max(load.width / 2.0, 1e-6)
    model.geom_rbound[geom] = np.linalg.norm(model.geom_size[geom])
    mujoco.mj_setConst(model, data)


def read_wrenches(sensordata: Floats) -> Floats:
    """Read the limb's load on the robot through both sensors off sensor data of a rig, shape (..., S).

    Wrenches (fx, fy, fz, tx, ty, tz) at and in the sensors' frames, (foot, leg), in N and N m, (..., 2, 6).
    """
    # rig.xml lists the leg's force and torque first, then the foot's.
    leg, foot = sensordata[..., 0:6], sensordata[..., 6:12]
    return -np.stack([foot, leg], axis=-2)


class LimbBody(NamedTuple):
    """The bodies beyond one F/T sensor as one, without the added mass."""

    mass: float  # in kg
    mass_com: Floats  # first moment m c in the sensor's frame in kg m, shape (3,)
    inertia: Floats  # about the sensor's origin in its frame in kg m^2, shape (3, 3)


def limb_beyond(model: mujoco.MjModel, data: mujoco.MjData, sensor: str) -> LimbBody:
    """Add up the bodies that hang on the sensor "foot" or "leg", in a posture with evaluated kinematics."""
    site = data.site(f"{sensor}_ft")
    R_world_sensor = site.xmat.reshape(3, 3)
    first, added = int(model.site(f"{sensor}_ft").bodyid[0]), model.body("added_mass").id
    mass, mass_com, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for body in range(first, model.nbody):
        ancestor = body
        while ancestor > first:
            ancestor = int(model.body_parentid[ancestor])
        if ancestor != first or body == added:
            continue
        m = float(model.body_mass[body])
        com = R_world_sensor.T @ (data.xipos[body] - site.xpos)
        axes = R_world_sensor.T @ data.ximat[body].reshape(3, 3)
        mass += m
        mass_com += m * com
        # Steiner: moments about the sensor's origin.
        inertia += axes * model.body_inertia[body] @ axes.T
        inertia += m * (com @ com * np.eye(3) - np.outer(com, com))
    return LimbBody(mass, mass_com, inertia)


def sensor_frames(data: mujoco.MjData) -> tuple[Floats, Floats]:
    """Read the frames of the (foot, leg) sensors: origins (2, 3) in m and R_world_sensor (2, 3, 3)."""
    sites = [data.site(f"{sensor}_ft") for sensor in SENSORS]
    return np.array([s.xpos for s in sites]), np.array([s.xmat.reshape(3, 3) for s in sites])


def _in_body(com_foot: tuple[float, float, float]) -> Floats:
    """Turn a place in the foot's sensor frame into the axes of its body, which is not rolled by pi."""
    return np.array(com_foot) * (1.0, -1.0, -1.0)


def _add_floor(spec: mujoco.MjSpec) -> None:
    """Put a block of foam under the tip of the beam, which it meets at CONTACT_ANGLE."""
    tip = spec.geom("beam_tip")
    place = np.array(tip.pos)
    body = tip.parent
    while body.name != "hip_front_back":
        place = place + body.pos
        body = body.parent
    x, _, z = place
    reach = x * np.sin(CONTACT_ANGLE) + z * np.cos(CONTACT_ANGLE) - tip.size[0]
    top = float(spec.body("torso").pos[2] + reach)
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0.2, 0.0, top / 2.0],
        size=[0.3, 0.45, top / 2.0],
        material="foam",
        contype=0,
        conaffinity=0,
        group=1,
    )
    # At a small, constant impedance the contact is a spring, which MuJoCo scales by the mass it feels.
    spec.add_pair(
        geomname1="floor",
        geomname2="beam_tip",
        condim=1,
        solref=[-_FOAM_STIFFNESS, -_FOAM_DAMPING],
        solimp=[_FOAM_IMPEDANCE, _FOAM_IMPEDANCE, 0.001, 0.5, 2.0],
    )
