"""The model that a robot has of itself: the designer's drawing with masses that are a little off."""

import mujoco
import numpy as np
from numpy.typing import NDArray


class NominalModel:
    """Kinematics, centre of mass and angular momentum of a robot as it believes itself to be.

    Everything is computed in the torso's frame, so that nothing depends on where the robot believes to be.

    Args:
        spec: The robot's drawing; what only a simulation needs is taken out of it.
        mass_error: Relative error of the total mass; its sign is drawn, and each link's mass is drawn with
            this relative spread besides.
        com_offset: Distance in m by which the whole robot's centre of mass is off, in a direction that is
            drawn: the torso's own centre of mass is misplaced.
        sites: Names of the sites of the IMU, of the left and of the right sole.
        torso: Name of the floating body, which carries the IMU with its axes along the body's.

    Raises:
        ValueError: If a name is not in the drawing, the message lists what is, or an error is negative.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        *,
        mass_error: float = 0.005,
        com_offset: float = 0.003,
        sites: tuple[str, str, str] = ("imu", "left_sole", "right_sole"),
        torso: str = "torso",
    ) -> None:
        for name, value in {"mass_error": mass_error, "com_offset": com_offset}.items():
            if not 0.0 <= value < 1.0:
                raise ValueError(f"'{name}' must lie in 0 to 1, got {value}.")
        self._mass_error, self._com_offset = mass_error, com_offset
        self._model = _strip(spec, sites).compile()
        self._data = mujoco.MjData(self._model)
        self._torso = self._model.body(torso).id
        self._mass = self._model.body_mass.copy()
        self._inertia = self._model.body_inertia.copy()
        self._torso_com = self._model.body_ipos[self._torso].copy()
        joints = [self._model.joint(i) for i in range(self._model.njnt)]
        hinges = [joint for joint in joints if joint.type[0] == mujoco.mjtJoint.mjJNT_HINGE]
        self.joint_names = tuple(joint.name for joint in hinges)
        if self._model.nq != len(hinges) + 7 or self._model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
            raise ValueError("The robot must hang on one free joint and have hinge joints otherwise.")
        if [self._model.site(name).id for name in sites] != [0, 1, 2]:
            raise ValueError(f"The sites {sites} must be ordered (IMU, left, right) in the drawing.")
        # Views of MuJoCo's own arrays: making one anew costs as much as the kinematics.
        data = self._data
        self._qpos, self._qvel = data.qpos[7:], data.qvel[6:]
        self._spin = data.qvel[3:6]
        self._com, self._momentum = data.subtree_com[self._torso], data.subtree_angmom[self._torso]
        # MuJoCo hands out rotations by rows; transposed they are the axes one by one.
        self._site_position = data.site_xpos
        self._sole_axes = data.site_xmat.reshape(3, 3, 3)[1:].swapaxes(1, 2)
        data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

    @property
    def mass(self) -> float:
        """The robot's mass as it believes it in kg."""
        return float(self._model.body_mass.sum())

    def draw(self, rng: np.random.Generator) -> None:
        """Draw the errors of the masses and of the centre of mass anew, from the drawing's own values."""
        model = self._model
        factor = 1.0 + self._mass_error * rng.standard_normal(len(self._mass))
        total = 1.0 + self._mass_error * rng.choice([-1.0, 1.0])
        factor *= total * self._mass.sum() / (self._mass @ factor)
        model.body_mass[:] = self._mass * factor
        model.body_inertia[:] = self._inertia * factor[:, None]
        direction = rng.standard_normal(3)
        direction *= self._com_offset / np.linalg.norm(direction)
        share = model.body_mass[self._torso] / model.body_mass.sum()
        model.body_ipos[self._torso] = self._torso_com + direction / share
        mujoco.mj_setConst(model, self._data)
        self._data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        self._data.qvel[:] = 0.0

    def evaluate(
        self, position: NDArray[np.float64], velocity: NDArray[np.float64], spin: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Compute the posture.

        Args:
            position: Joint positions in rad, shape (J,).
            velocity: Joint velocities in rad/s, shape (J,).
            spin: Angular velocity of the torso in its own axes in rad/s, shape (3,).

        Returns:
            In the torso's frame: the centre of mass in m, shape (3,); the angular momentum about it in
            kg m^2/s, shape (3,); positions of the IMU and both soles in m, shape (3, 3); and the x, y and z
            axes of the left and the right sole, shape (6, 3).
        """
        model, data = self._model, self._data
        self._qpos[:] = position
        self._qvel[:] = velocity
        self._spin[:] = spin
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_subtreeVel(model, data)
        return self._com, self._momentum, self._site_position, self._sole_axes.reshape(6, 3)


def _strip(spec: mujoco.MjSpec, sites: tuple[str, ...]) -> mujoco.MjSpec:
    """Leave the bodies, the joints and some sites only."""
    names = [site.name for site in spec.sites]
    for name in sites:
        if name not in names:
            raise ValueError(f"The robot has no site '{name}'; it has {names}.")
    parts = ("geoms", "actuators", "sensors", "equalities", "pairs", "keys", "cameras", "lights")
    for part in parts:
        for element in list(getattr(spec, part)):
            spec.delete(element)
    for site in list(spec.sites):
        if site.name not in sites:
            spec.delete(site)
    return spec
