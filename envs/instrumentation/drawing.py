"""The drawing by a robot's maker: bodies, joints and masses, where its sensors sit, and no truth."""

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.geometry import below
from surefoot.envs.instrumentation.robot import MeasuredRobot, joint_name
from surefoot.envs.robots.nao import FEET, cell_positions, hinge_joint_names, nao_model

WEIGHTLESS: Final = 1e-9  # share of a body's mass that is left of one whose weight is compensated, above zero

Placed = tuple[str, Floats, Floats]  # a site's body, its place there in m and its quaternion

_JOINTS = {
    mujoco.mjtJoint.mjJNT_HINGE: "hinge",
    mujoco.mjtJoint.mjJNT_SLIDE: "slide",
    mujoco.mjtJoint.mjJNT_BALL: "ball",
}


class BelowSensor(NamedTuple):
    """The mass below a sensor of each foot, (left, right), in the sole frames."""

    position_sensor_sole: Floats  # origins of the sensors' frames in m, shape (2, 3)
    R_sole_sensor: Floats  # rotations from the sensors' frames to the sole frames, shape (2, 3, 3)
    mass: Floats  # mass below in kg, shape (2,)
    com_sole: Floats  # its centre of mass in m, shape (2, 3)


@dataclass(frozen=True, eq=False)
class RobotDrawing:
    """A robot as its maker describes it: enough for kinematics, centre of mass and angular momentum.

    The skeleton hangs on one free joint, whatever carries the robot in the simulation (Walker2d's torso has
    two slides and a hinge there), and moves the joints that encoders measure.

    Attributes:
        xml: The skeleton as MJCF: bodies with explicit inertials, joints and the sites below; numbers have
            all their digits.
        torso: Name of the body that floats.
        imu: Name of the IMU's site, which sits on the torso.
        soles: Names of the F soles' sites, the left one first.
        feet: Names of the feet's bodies.
        sides: The feet's names in channels and messages.
        joint_names: The J hinge joints of the skeleton in model order.
        position_cell_sole: Places of the load cells in the sole frames in m, shape (F, 4, 3); None without.
        flaw: Why there are no cells, or empty.
        below_cells: The mass on the load cells besides the ground's force; None without cells.
        below_ankle: The mass below the sensors at the ankles.
        touching: The parts of each foot that may touch: centres in the sole's frame and radii in m, 0 of a
            point, shape (F, n, 4). Of a foot with an area these are its cells' places.
        caveat: Why references that follow from the skeleton are not exact, or empty.
    """

    xml: str
    torso: str
    imu: str
    soles: tuple[str, ...]
    feet: tuple[str, ...]
    sides: tuple[str, ...]
    joint_names: tuple[str, ...]
    position_cell_sole: Floats | None
    flaw: str
    below_cells: BelowSensor | None
    below_ankle: BelowSensor
    touching: Floats
    caveat: str = ""

    @functools.cached_property
    def weight(self) -> float:
        """Weight in N of all that hangs on the torso, less what ``gravcomp`` carries."""
        model = self.spec().compile()
        return self.gravity * float(model.body_subtreemass[model.body(self.torso).id])

    @functools.cached_property
    def gravity_world(self) -> Floats:
        """Acceleration of free fall in the robot's world in m/s^2, shape (3,)."""
        return np.array(self.spec().option.gravity)

    @functools.cached_property
    def gravity(self) -> float:
        """Its magnitude in m/s^2."""
        return float(np.linalg.norm(self.gravity_world))

    def spec(self) -> mujoco.MjSpec:
        """Read the skeleton afresh, to perturb in memory and then ``compile()``."""
        return mujoco.MjSpec.from_string(self.xml)


@functools.cache
def draw_nao() -> RobotDrawing:
    """Draw nao.xml."""
    model = nao_model()
    soles = tuple(f"{foot}_sole" for foot in FEET)
    sites = {}
    for name in ("imu", *soles):
        site = model.site(name)
        sites[name] = (model.body(int(site.bodyid[0])).name, site.pos.copy(), site.quat.copy())
    return RobotDrawing(
        xml=skeleton(model, "torso", sites),
        torso="torso",
        imu="imu",
        soles=soles,
        feet=tuple(sites[sole][0] for sole in soles),
        sides=FEET,
        joint_names=hinge_joint_names(model),
        position_cell_sole=cell_positions(model),
        flaw="",
        below_cells=below_sites(model, [f"{foot}_sole" for foot in FEET]),
        below_ankle=below_sites(model, [f"{foot}_ankle_ft" for foot in FEET]),
        touching=np.pad(cell_positions(model), ((0, 0), (0, 0), (0, 1))),
    )


def draw_robot(
    model: mujoco.MjModel, data: mujoco.MjData, layout: MeasuredRobot, *, imu: str, prefix: str
) -> RobotDrawing:
    """Draw a robot whose feet were measured in the pose of ``data``, of which the kinematics were evaluated.

    ``imu`` is its own IMU's site; empty for one at the torso's origin, in the torso's axes. Names of other
    sites begin with ``prefix``.
    """
    upright, none = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    place = model.site(imu).pos.copy() if imu else none
    imu = imu or f"{prefix}imu"
    sites: dict[str, Placed] = {imu: (layout.torso, place, upright)}
    arms, rotations, masses, coms = [], [], [], []
    for foot in layout.feet:
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, foot.R_foot_sole.ravel())
        sites[f"{prefix}{foot.body}_sole"] = (foot.body, foot.position_sole_foot, quaternion)
        body = model.body(foot.body).id
        com_foot = data.xmat[body].reshape(3, 3).T @ (data.subtree_com[body] - data.xpos[body])
        arms.append(foot.R_foot_sole.T @ (foot.position_ankle_foot - foot.position_sole_foot))
        rotations.append(foot.R_foot_sole.T)
        masses.append(float(model.body_subtreemass[body]))
        coms.append(foot.R_foot_sole.T @ (com_foot - foot.position_sole_foot))
    places = [cells for cells in layout.cells if cells is not None]
    feet = tuple(foot.body for foot in layout.feet)
    number = len(feet)
    has_cells = len(places) == number
    # The plate over the cells has no mass.
    plates = BelowSensor(
        np.zeros((number, 3)), np.tile(np.eye(3), (number, 1, 1)), np.zeros(number), np.zeros((number, 3))
    )
    return RobotDrawing(
        xml=skeleton(model, layout.torso, sites),
        torso=layout.torso,
        imu=imu,
        soles=tuple(sites)[1:],
        feet=feet,
        sides=FEET if number == 2 else feet,
        joint_names=layout.joint_names,
        position_cell_sole=np.pad(np.array(places), ((0, 0), (0, 0), (0, 1))) if has_cells else None,
        flaw=layout.flaw,
        below_cells=plates if has_cells else None,
        below_ankle=BelowSensor(np.array(arms), np.array(rotations), np.array(masses), np.array(coms)),
        touching=_touching(layout),
        caveat=_gravcomp_caveat(model, model.body(layout.torso).id),
    )


def _touching(layout: MeasuredRobot) -> Floats:
    """Return the parts of each foot that may touch, (F, n, 4); feet of fewer parts repeat their last one."""
    parts = [
        foot.round if cells is None else np.pad(cells, ((0, 0), (0, 2)))
        for foot, cells in zip(layout.feet, layout.cells, strict=True)
    ]
    most = max(map(len, parts))
    return np.array([np.pad(part, ((0, most - len(part)), (0, 0)), mode="edge") for part in parts])


def skeleton(model: mujoco.MjModel, torso: str, sites: Mapping[str, Placed]) -> str:
    """Write the bodies that hang on a torso as MJCF: inertials, joints and some sites, with all digits.

    The joints that carry the torso are replaced by a free one. Masses are less by the share that ``gravcomp``
    carries.
    """
    root = model.body(torso).id
    inside = below(model, root)
    heavy = np.maximum(model.body_mass * (1.0 - model.body_gravcomp), WEIGHTLESS * model.body_mass)
    names = {int(body): model.body(body).name for body in np.flatnonzero(inside)}

    def lines(body: int, indent: str) -> Iterable[str]:
        pose = _attributes(pos=model.body_pos[body], quat=model.body_quat[body])
        yield f"{indent}<body{_plain(names[body])}{pose}>"
        deeper = indent + "  "
        if model.body_mass[body] > 0.0:
            inertial = _attributes(
                pos=model.body_ipos[body],
                quat=model.body_iquat[body],
                mass=heavy[body],
                diaginertia=_physical(model.body_inertia[body]),
            )
            yield f"{deeper}<inertial{inertial}/>"
        if body == root:
            yield f"{deeper}<freejoint/>"
        else:
            first = int(model.body_jntadr[body])
            for joint in range(first, first + int(model.body_jntnum[body])):
                yield f"{deeper}<joint{_joint(model, joint)}/>"
        for name, (carrier, position, quaternion) in sites.items():
            if carrier == names[body]:
                yield f"{deeper}<site{_plain(name)}{_attributes(pos=position, quat=quaternion)}/>"
        for child in np.flatnonzero(inside & (model.body_parentid == body)):
            if child != body:
                yield from lines(int(child), deeper)
        yield f"{indent}</body>"

    gravity = _attributes(gravity=model.opt.gravity)
    head = f'<mujoco>\n  <compiler angle="radian" inertiafromgeom="false"/>\n  <option{gravity}/>\n'
    return head + "  <worldbody>\n" + "\n".join(lines(root, "    ")) + "\n  </worldbody>\n</mujoco>\n"


def _gravcomp_caveat(model: mujoco.MjModel, root: int) -> str:
    """Describe the effect of gravity compensation on a robot's references; empty without any."""
    carried = model.body_gravcomp * model.body_mass * below(model, root)
    if not carried.any():
        return ""
    gravity = float(np.linalg.norm(model.opt.gravity))
    bodies = [model.body(int(body)).name for body in np.flatnonzero(carried)]
    return (
        f"'gravcomp' of the bodies {bodies} carries {gravity * carried.sum():.1f} N of the robot's weight of "
        f"{gravity * model.body_subtreemass[root]:.1f} N from outside, which no foot feels. The robot "
        "assumes that these bodies are lighter by as much, so references lack a part of their inertia. Let "
        "motors hold the bodies up instead, as on a real robot."
    )


def _joint(model: mujoco.MjModel, joint: int) -> str:
    kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
    text = _plain(joint_name(model, joint)) + f' type="{_JOINTS[kind]}"'
    text += _attributes(pos=model.jnt_pos[joint])
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        return text
    ref = model.qpos0[model.jnt_qposadr[joint]]
    return text + _attributes(axis=model.jnt_axis[joint], ref=ref)


def _plain(name: str) -> str:
    return f" name={quoteattr(name)}" if name else ""


def _attributes(**values: Floats | np.float64) -> str:
    parts = {name: " ".join(map(repr, np.ravel(value).tolist())) for name, value in values.items()}
    return "".join(f' {name}="{text}"' for name, text in parts.items())


def _physical(inertia: Floats) -> Floats:
    """Keep rounding from breaking the triangle inequality, which MuJoCo's compiler insists on."""
    physical: Floats = np.minimum(inertia, np.roll(inertia, 1) + np.roll(inertia, 2))
    return physical


def below_sites(model: mujoco.MjModel, sites: list[str]) -> BelowSensor:
    """Measure the bodies that hang on those of the sites, which move with the soles as one."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    position, rotation, mass, com = [], [], [], []
    for name, foot in zip(sites, FEET, strict=True):
        sensor, sole = data.site(name), data.site(f"{foot}_sole")
        body = int(model.site(name).bodyid[0])
        R_sole_world = sole.xmat.reshape(3, 3).T
        position.append(R_sole_world @ (sensor.xpos - sole.xpos))
        rotation.append(R_sole_world @ sensor.xmat.reshape(3, 3))
        mass.append(float(model.body_subtreemass[body]))
        com.append(R_sole_world @ (data.subtree_com[body] - sole.xpos))
    return BelowSensor(np.array(position), np.array(rotation), np.array(mass), np.array(com))
