"""The model that a robot has of itself: the designer's drawing with masses that are a little off."""

import warnings
from copy import copy
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.robot.beliefs.errors import USUAL, BeliefErrors

if TYPE_CHECKING:
    from surefoot.envs.instrumentation.drawing import RobotDrawing


LEAST_MOVED: Final = 0.01
"""Share of the mass on joints without encoders above which a warning is given: moved by 10 cm, one per cent
of the mass displaces the centre of mass by 1 mm. Hands and grippers have less."""


class Masses(NamedTuple):
    """A robot's beliefs of its bodies."""

    mass: Floats  # masses in kg, shape (B,)
    inertia: Floats  # principal moments of inertia in kg m^2, shape (B, 3)
    com: Floats  # centres of mass in the bodies' frames in m, shape (B, 3)


class _Shared:
    """MuJoCo's model and data of a drawing, for all robots that were drawn so: one of them at a time.

    Attributes:
        masses: Those of the robot whose turn it is.
    """

    def __init__(self, model: mujoco.MjModel, torso: int) -> None:
        self.model, self.data, self._torso = model, mujoco.MjData(model), torso
        # Otherwise MuJoCo ignores a centre of mass that has moved away from the origin of its body.
        model.body_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self.masses = Masses(model.body_mass.copy(), model.body_inertia.copy(), model.body_ipos.copy())
        self._stand()
        mujoco.mj_kinematics(model, self.data)
        self.R_torso_body = self.data.xmat.reshape(-1, 3, 3).copy()  # in the zero pose, shape (B, 3, 3)
        self._view()

    def __setstate__(self, kept: dict[str, Any]) -> None:
        # In a copy what were views are arrays that MuJoCo does not know.
        self.__dict__.update(kept)
        self._view()

    def turn_to(self, masses: Masses) -> None:
        """Be the robot with these masses."""
        if masses is self.masses:
            return
        model, self.masses = self.model, masses
        model.body_mass[:], model.body_inertia[:], model.body_ipos[:] = masses
        mujoco.mj_setConst(model, self.data)
        self._stand()

    def _stand(self) -> None:
        self.data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self.data.qvel[:] = 0.0

    def _view(self) -> None:
        """Keep views of MuJoCo's own arrays: making one costs as much as the kinematics."""
        data = self.data
        self.qpos, self.qvel, self.spin = data.qpos[7:], data.qvel[6:], data.qvel[3:6]
        self.com, self.momentum = data.subtree_com[self._torso], data.subtree_angmom[self._torso]
        self.site_position = data.site_xpos
        # MuJoCo hands out rotations by rows; transposed they are the axes one by one.
        self.site_axes = data.site_xmat.reshape(-1, 3, 3).swapaxes(1, 2)


class NominalModel:
    """Kinematics, centre of mass and angular momentum of a robot as it believes itself to be.

    Everything is computed in the torso's frame, so that nothing depends on where the robot believes to be.

    Args:
        spec: The robot's drawing; parts for a simulation alone are taken out.
        errors: How far :meth:`draw` puts masses and centres of mass off.
        sites: Names of the sites of the IMU and of the F soles, the left one first.
        torso: Name of the floating body, which carries the IMU with its axes along the body's.

    Attributes:
        gravity: Acceleration of free fall in its world in m/s^2.
        revision: How often the masses have changed.

    Raises:
        ValueError: If a name is not in the drawing; the message lists those that are.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        errors: BeliefErrors = USUAL,
        *,
        sites: tuple[str, ...] = ("imu", "left_sole", "right_sole"),
        torso: str = "torso",
    ) -> None:
        self._errors = errors
        unmeasured = _strip(spec, sites)
        model = spec.compile()
        if warning := _warning_of_unmeasured(model, *unmeasured):
            warnings.warn(warning, stacklevel=2)
        self.gravity = float(np.linalg.norm(model.opt.gravity))
        self._torso = model.body(torso).id
        self._shared = _Shared(model, self._torso)
        self._masses = self._drawn = self._shared.masses
        joints = [model.joint(i) for i in range(model.njnt)]
        hinges = [joint for joint in joints if joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE]
        self.joint_names = tuple(joint.name for joint in hinges)
        others = [joint.name for joint in joints[1:] if joint.type[0] != mujoco.mjtJoint.mjJNT_HINGE]
        if others or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
            raise ValueError(
                "A nominal model needs a robot that floats on one free joint, with hinge joints, which have "
                f"encoders, between it and its feet; got {others or joints[0].name}, of another kind."
            )
        self._sites = np.array([model.site(name).id for name in sites])
        self._soles = self._sites[1:]
        self.revision = 0

    def another(self) -> "NominalModel":
        """Return the model of another robot of this drawing, as drawn."""
        other = copy(self)
        other._masses, other.revision = self._drawn, 0
        return other

    @classmethod
    def of_drawing(cls, drawing: "RobotDrawing", errors: BeliefErrors) -> "NominalModel":
        """Make it of the drawing of a robot with feet."""
        return cls(drawing.spec(), errors, sites=(drawing.imu, *drawing.soles), torso=drawing.torso)

    @property
    def feet(self) -> int:
        """Number of the feet, F."""
        return len(self._soles)

    @property
    def mass(self) -> float:
        """The robot's mass as it believes it in kg."""
        return float(self._masses.mass.sum())

    def draw(self, rng: np.random.Generator) -> None:
        """Draw fresh errors of the masses and of the centre of mass, from the drawing's own values.

        Each body's centre of mass is displaced by the same vector, given in the torso's frame in the zero
        pose. The error of the whole robot is then that vector, however the masses are distributed.
        """
        drawn = self._drawn
        factor = 1.0 + self._errors.mass * rng.standard_normal(len(drawn.mass))
        total = 1.0 + self._errors.mass * rng.choice([-1.0, 1.0])
        factor *= total * drawn.mass.sum() / (drawn.mass @ factor)
        mass = drawn.mass * factor
        direction = rng.standard_normal(3)
        direction *= self._errors.com / np.linalg.norm(direction)
        displaced = drawn.com + direction @ self._shared.R_torso_body
        self.masses = Masses(mass, drawn.inertia * factor[:, None], displaced)

    @property
    def masses(self) -> Masses:
        """The masses that it believes, as a copy."""
        return Masses(*(part.copy() for part in self._masses))

    @masses.setter
    def masses(self, believed: Masses) -> None:
        self.revision += 1
        self._masses = Masses(*(np.array(part) for part in believed))
        self._shared.turn_to(self._masses)

    def evaluate(
        self, position: Floats, velocity: Floats, spin: Floats
    ) -> tuple[Floats, Floats, Floats, Floats]:
        """Compute the posture.

        Args:
            position: Joint positions in rad, shape (J,).
            velocity: Joint velocities in rad/s, shape (J,).
            spin: Angular velocity of the torso in its own axes in rad/s, shape (3,).

        Returns:
            In the torso's frame: the centre of mass in m, shape (3,); the angular momentum about it in
            kg m^2/s, shape (3,); positions of the IMU and the soles in m, shape (1 + F, 3); and the x, y
            and z axes of each sole, shape (3 F, 3).
        """
        shared = self._shared
        shared.turn_to(self._masses)
        shared.qpos[:] = position
        shared.qvel[:] = velocity
        shared.spin[:] = spin
        # Places, centres of mass and angular momenta of positions and velocities.
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel, mujoco.mj_subtreeVel):
            compute(shared.model, shared.data)
        axes = shared.site_axes[self._soles].reshape(-1, 3)
        return shared.com, shared.momentum, shared.site_position[self._sites], axes

    def velocities(self) -> tuple[Floats, Floats]:
        """Return velocities relative to the torso's origin in its axes, right after :meth:`evaluate`.

        Returns:
            Velocity of the centre of mass in m/s, shape (3,); and angular velocities in rad/s and velocities
            in m/s of the IMU and the soles, (w, v), shape (1 + F, 6).
        """
        model, data, twist = self._shared.model, self._shared.data, np.zeros((len(self._sites), 6))
        for site, row in zip(self._sites, twist, strict=True):
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, row, 0)
        return data.subtree_linvel[self._torso].copy(), twist

    def tree(self) -> dict[str, NDArray[Any]] | None:
        """Return the torso and the bodies on it, B, under the names that they have in ``sf_model``.

        ``None`` if hinges or sites are elsewhere.
        """
        self._shared.turn_to(self._masses)
        model, place = self._shared.model, {self._torso: 0}
        for body in range(self._torso + 1, model.nbody):
            if model.body_parentid[body] in place:
                place[body] = len(place)
        bodies, hinges = list(place), np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
        turned, seen_from = model.jnt_bodyid[hinges].tolist(), model.site_bodyid[self._sites].tolist()
        if model.jnt_bodyid[0] != self._torso or not {*turned, *seen_from} <= place.keys():
            return None
        principal, axis = _rotations(model.body_iquat[bodies]), model.jnt_axis[hinges]
        R_parent_body, anchor = _rotations(model.body_quat[bodies]), model.jnt_pos[hinges]
        straight = (np.abs(axis).sum(axis=1) == 1.0) & (axis.max(axis=1, initial=0.0) == 1.0)
        return {
            "parent": np.array([0] + [place[model.body_parentid[body]] for body in bodies[1:]]),
            "hinge_body": np.array([place[body] for body in turned], dtype=int),
            "site_body": np.array([place[body] for body in seen_from]),
            "turned": (R_parent_body != np.eye(3)).any(axis=(1, 2)),
            "along": np.where(straight, axis.argmax(axis=1), -1),
            "away": anchor.any(axis=1),
            "place": model.body_pos[bodies],
            "R_parent_body": R_parent_body,
            "anchor": anchor,
            "axis": axis,
            "zero": model.qpos0[model.jnt_qposadr[hinges]],
            "mass": model.body_mass[bodies],
            "com": model.body_ipos[bodies],
            "inertia": (principal * model.body_inertia[bodies, None]) @ principal.swapaxes(1, 2),
            "position_site": model.site_pos[self._sites],
            "R_body_site": _rotations(model.site_quat[self._sites]),
        }


def _rotations(quaternions: Floats) -> Floats:
    """Return the matrices of MuJoCo's quaternions, shape (N, 3, 3)."""
    matrices = np.zeros((len(quaternions), 9))
    for matrix, quaternion in zip(matrices, quaternions, strict=True):
        mujoco.mju_quat2Mat(matrix, quaternion)
    return matrices.reshape(-1, 3, 3)


def _strip(spec: mujoco.MjSpec, sites: tuple[str, ...]) -> tuple[list[str], list[Any]]:
    """Leave the bodies, the hinges and some sites only; return the joints that were taken out.

    Slide and ball joints that carry no site, such as those of grippers, have no encoders: what they move
    stays in its zero position. Their names are returned, and the bodies that they move.
    """
    names = [site.name for site in spec.sites]
    if lacking := [name for name in sites if name not in names]:
        raise ValueError(f"The robot has no site '{lacking[0]}'; it has {names}.")
    parts = ("geoms", "actuators", "sensors", "equalities", "tendons", "pairs", "keys", "cameras", "lights")
    for part in parts:
        for element in list(getattr(spec, part)):
            spec.delete(element)
    for site in list(spec.sites):
        if site.name not in sites:
            spec.delete(site)
    unmeasured: list[str] = []
    moved: list[Any] = []
    for joint in list(spec.joints):
        if joint.type in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_BALL):
            body = joint.parent
            if not body.find_all("site"):
                unmeasured.append(joint.name)
                moved += [body, *body.find_all("body")]
                spec.delete(joint)
    return unmeasured, moved


def _warning_of_unmeasured(model: mujoco.MjModel, joints: list[str], moved: list[Any]) -> str:
    """Return a warning of joints without encoders that move more than a hand; empty if they do not."""
    bodies = list({body.id for body in moved})
    share = model.body_mass[bodies].sum() / model.body_mass.sum()
    if share <= LEAST_MOVED:
        return ""
    return (
        f"The slide and ball joints {joints} have no encoders: the robot believes that what they move, "
        f"{100.0 * share:.0f} % of its mass, stays in its zero position. Use hinges, or lock these joints."
    )
