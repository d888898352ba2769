"""A robot's drawing, made ready for joint angles and an IMU.

Any MJCF or URDF file will do that has a floating body which carries the IMU, hinges and two soles. Places are
sites, or bodies where a URDF has only links.
"""

from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.experiments.logs.motion import MotionFacts
from surefoot.experiments.logs.table import LogError
from surefoot.wrappers.belief_errors import NO_ERRORS
from surefoot.wrappers.nominal import NominalModel

__all__ = ["LogModel", "load_model"]

_IMU, _SOLES = "surefoot_imu", ("surefoot_sole_0", "surefoot_sole_1")


class _Posture(Protocol):
    def evaluate(
        self, position: NDArray[np.float64], velocity: NDArray[np.float64], spin: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]: ...


class LogModel:
    """The robot of a log as it believes itself to be; postures are those of :class:`NominalModel`.

    Args:
        nominal: The model.
        right_first: Whether its first sole is the right one.
        R_torso_imu: Rotation from the IMU's axes to the torso's, shape (3, 3).

    Attributes:
        joint_names: Names of the hinges, in the order of joint angles.
        mass: Mass of the drawing in kg.
        R_torso_imu: As given.
    """

    def __init__(self, nominal: NominalModel, right_first: bool, R_torso_imu: NDArray[np.float64]) -> None:
        self._nominal: _Posture = nominal
        self._right_first = right_first
        self.joint_names = nominal.joint_names
        self.mass = nominal.mass
        self.R_torso_imu = R_torso_imu

    def evaluate(
        self, position: NDArray[np.float64], velocity: NDArray[np.float64], spin: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the posture, as :meth:`NominalModel.evaluate` does."""
        com, momentum, sites, axes = self._nominal.evaluate(position, velocity, spin)
        if self._right_first:
            return com, momentum, sites[[0, 2, 1]], axes[[3, 4, 5, 0, 1, 2]]
        return com, momentum, sites, axes


def load_model(facts: MotionFacts, file: str) -> LogModel:
    """Load a drawing.

    Args:
        facts: Which, and what its parts are called.
        file: The log's name in messages.

    Raises:
        LogError: If the drawing is not there, cannot be read, lacks a part, or is no robot on hinges.
    """
    if not facts.model.is_file():
        raise LogError(
            f"{file}: the description's motion.model '{facts.model}' is not there; give its path from the "
            "log's folder."
        )
    try:
        spec = mujoco.MjSpec.from_file(str(facts.model))
        # A URDF's fixed links are places; fused they would be lost, and the base with them.
        spec.compiler.fusestatic = False
        torso = _named(spec, facts.torso, "torso", file)
        _fix_masses(spec)
        _strip(spec)
        if not any(joint.type == mujoco.mjtJoint.mjJNT_FREE for joint in torso.joints):
            torso.add_freejoint()
        R_torso_imu = _place_imu(spec, facts, torso, file)
        soles = [_place_site(spec, *pair, file) for pair in zip(facts.soles, _SOLES, strict=True)]
        order = _tree_order(spec, soles)
        names = (_IMU, _SOLES[order[0]], _SOLES[order[1]])
        nominal = NominalModel(spec, NO_ERRORS, sites=names, torso=facts.torso)
    except LogError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise LogError(f"{file}: the model '{facts.model.name}' cannot be used: {error}") from None
    return LogModel(nominal, order[0] == 1, R_torso_imu)


def _named(spec: Any, name: str, role: str, file: str) -> Any:
    body = spec.body(name)
    if body is None or name == "world":
        bodies = [body.name for body in spec.bodies if body.name != "world"]
        raise LogError(
            f"{file}: the description's motion.{role} '{name}' is no body of the model; it has {bodies}."
        )
    return body


def _fix_masses(spec: Any) -> None:
    """Write down the masses that follow from shapes, before the shapes go."""
    bodies = [body for body in spec.bodies[1:] if not body.explicitinertial and len(body.geoms)]
    if not bodies:
        return
    full = spec.copy().compile()
    for body in bodies:
        row = full.body(body.name).id if body.name else None
        if row is None:
            raise ValueError("a body without a name takes its mass from its shapes; name every body.")
        body.explicitinertial = True
        body.mass = float(full.body_mass[row])
        body.ipos, body.iquat = full.body_ipos[row].copy(), full.body_iquat[row].copy()
        body.inertia = full.body_inertia[row].copy()


def _place_imu(spec: Any, facts: MotionFacts, torso: Any, file: str) -> NDArray[np.float64]:
    """Put a site where the IMU is; return the rotation from its axes to the torso's."""
    source = _source(spec, facts.imu, "imu", file)
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    place = data.site(facts.imu) if spec.site(facts.imu) is not None else data.body(facts.imu)
    R_world_torso = data.body(facts.torso).xmat.reshape(3, 3)
    owner = source if spec.site(facts.imu) is None else source.parent
    while owner.name != facts.torso and not len(owner.joints) and owner.parent.name != "world":
        owner = owner.parent
    if owner.name != facts.torso:
        raise LogError(
            f"{file}: the IMU '{facts.imu}' is not fixed to the torso '{facts.torso}' but to '{owner.name}'; "
            f"name the body that carries the IMU as motion.torso."
        )
    xpos = place.xpos - data.body(facts.torso).xpos
    torso.add_site(name=_IMU, pos=R_world_torso.T @ xpos)
    R: NDArray[np.float64] = R_world_torso.T @ place.xmat.reshape(3, 3)
    return R


def _place_site(spec: Any, name: str, label: str, file: str) -> Any:
    """Add a site under our own name where the drawing has a sole."""
    source = _source(spec, name, "soles", file)
    if spec.site(name) is None:
        return source.add_site(name=label)
    # The alternatives to a quaternion are taken over as well: whatever the drawing used is in one of them.
    return source.parent.add_site(name=label, pos=source.pos, quat=_quaternion(spec, name))


def _quaternion(spec: Any, name: str) -> NDArray[np.float64]:
    quaternion: NDArray[np.float64] = spec.copy().compile().site(name).quat.copy()
    return quaternion


def _source(spec: Any, name: str, role: str, file: str) -> Any:
    for found in (spec.site(name), spec.body(name)):
        if found is not None:
            return found
    sites = [site.name for site in spec.sites]
    bodies = [body.name for body in spec.bodies if body.name != "world"]
    raise LogError(
        f"{file}: the description's motion.{role} '{name}' is neither a site nor a body of the model; "
        f"it has the sites {sites} and the bodies {bodies}."
    )


def _tree_order(spec: Any, soles: list[Any]) -> tuple[int, int]:
    """Return the order in which the compiler meets the soles."""
    model = spec.copy().compile()
    first, second = (model.site(site.name).id for site in soles)
    return (0, 1) if first < second else (1, 0)


def _strip(spec: Any) -> None:
    """Remove what needs files or parts that a posture does not."""
    for part in ("geoms", "tendons", "actuators", "sensors", "equalities", "excludes", "keys"):
        for element in list(getattr(spec, part, ())):
            spec.delete(element)
    for part in ("skins", "meshes", "hfields", "textures", "materials"):
        for element in list(getattr(spec, part, ())):
            spec.delete(element)
