"""A robot's feet before anything runs: in words, and drawn with its instrumented soles."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.envs.instrumentation.drawing import RobotDrawing
from surefoot.envs.instrumentation.env import InstrumentedEnv
from surefoot.envs.instrumentation.feet import pose_name, standing_pose
from surefoot.envs.instrumentation.robot import MeasuredRobot, measure_robot
from surefoot.envs.robots.library import ROBOTS, load_robot_spec, read_robot_spec
from surefoot.files import atomic_path

SIZE = 640, 480  # width and height of each of two pictures in pixels: what every model has room for
MARGIN = 0.005  # how far cells are drawn in from the soles' edges in m, as wrappers do
ABOVE = 0.004  # height in m above the soles in which their marks are drawn

EDGE, AXIS, CELL = (0.1, 0.4, 1.0, 1.0), (1.0, 0.2, 0.1, 1.0), (1.0, 0.8, 0.1, 1.0)
"""Colours of a sole's edge, of its x axis and of its cells."""


class FeetDrawing:
    """A robot whose feet are looked at in the pose in which they are measured.

    ``name`` is a robot that :func:`~surefoot.envs.load_robot_spec` knows, an MJCF file, or an environment;
    ``feet`` names their bodies, the left one first, which are guessed by default; ``soles`` gives flat soles
    to feet without area. ``cells`` are places in each sole's frame in m, (4, 2), ``None`` without area.
    Raises ModuleNotFoundError if a robot's package is missing, TypeError if an environment does not run on
    MuJoCo, ValueError if the feet cannot be found, gymnasium.error.Error if there is no such environment.
    """

    def __init__(self, name: str, feet: Sequence[str] | None = None, *, soles: bool = False) -> None:
        self.name, self._guessed = name, feet is None
        self.model, cells = _model(name, feet, soles)
        self._data = standing_pose(self.model)
        self.layout: MeasuredRobot = measure_robot(self.model, self._data, feet, None, MARGIN)
        self.cells = self.layout.cells if cells is None else tuple(cells[..., :2])

    def words(self) -> list[str]:
        """Return lines that tell which bodies are the feet, and which parts are under them."""
        bodies = ", ".join(f"'{foot.body}'" for foot in self.layout.feet)
        how = "guessed" if self._guessed else "as named"
        lines = [
            f"{self.name}: feet {bodies} ({how}, left first), torso '{self.layout.torso}', "
            f"seen in its {pose_name(self.model)}"
        ]
        for foot, cells in zip(self.layout.feet, self.cells, strict=True):
            if cells is None:
                lines.append(foot.flaw)
                continue
            length, width = 1e3 * np.ptp(foot.polygon, axis=0)
            places = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in 1e3 * cells)
            lines.append(f"'{foot.body}': sole {length:.0f} x {width:.0f} mm, cells at {places} mm")
        return lines

    def draw(self, path: Path) -> None:
        """Write a picture: the whole robot, and its feet from near.

        Edges of soles are blue, their x axes, to the toes, red, and cells yellow. Raises RuntimeError if
        nothing here can draw.
        """
        from PIL import Image  # comes with Gymnasium's imageio

        width, height = SIZE
        try:
            light = self.model.vis.headlight  # at least that of the Menagerie's scenes; MuJoCo's own is dim
            light.ambient[:] = np.maximum(light.ambient, 0.3)
            light.diffuse[:] = np.maximum(light.diffuse, 0.6)
            renderer = mujoco.Renderer(self.model, height, width)
        except (mujoco.FatalError, RuntimeError, AttributeError, ImportError) as error:
            raise RuntimeError(f"No picture can be drawn: {error}. Set MUJOCO_GL=egl.") from error
        with renderer:
            soles = np.concatenate([self._corners(i) for i in range(len(self.layout.feet))])
            middle = soles.mean(axis=0)
            tall = max(float(np.ptp(self._data.xpos[1:, 2])), 0.1)
            apart = float(np.linalg.norm(np.ptp(soles, axis=0))) + 0.1 * tall
            chest = middle + np.array([0.0, 0.0, 0.5 * tall])
            views = ((chest, 2.2 * tall, -10.0), (middle, 1.5 * apart, -30.0))
            pictures = [self._picture(renderer, *view) for view in views]
        with atomic_path(path) as part:
            Image.fromarray(np.concatenate(pictures, axis=1)).save(part)

    def _picture(self, renderer: Any, lookat: Floats, distance: float, elevation: float) -> NDArray[np.uint8]:
        camera, option = mujoco.MjvCamera(), mujoco.MjvOption()
        camera.lookat[:], camera.distance = lookat, distance
        camera.azimuth, camera.elevation = 145.0, elevation
        option.flags[mujoco.mjtVisFlag.mjVIS_TRANSPARENT] = True
        renderer.update_scene(self._data, camera, option)
        for i, (foot, cells) in enumerate(zip(self.layout.feet, self.cells, strict=True)):
            origin, R_world_sole = self._sole(i)
            # Not in the floor, on which the sole lies.
            origin = origin + ABOVE * R_world_sole[:, 2]
            if len(foot.polygon):
                corners = self._corners(i) + ABOVE * R_world_sole[:, 2]
                for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                    _line(renderer.scene, start, end, EDGE)
            reach = 0.5 * float(np.ptp(foot.polygon[:, 0])) if len(foot.polygon) else 0.1
            _line(renderer.scene, origin, origin + reach * R_world_sole[:, 0], AXIS)
            for place in () if cells is None else cells:
                ball = _new_geom(renderer.scene, mujoco.mjtGeom.mjGEOM_SPHERE, CELL)
                ball.pos[:] = origin + R_world_sole[:, :2] @ place
        picture: NDArray[np.uint8] = renderer.render()
        return picture

    def _corners(self, i: int) -> Floats:
        """Return the corners of a sole in the world in m, or its origin if it has no area, shape (n, 3)."""
        origin, R_world_sole = self._sole(i)
        polygon = self.layout.feet[i].polygon
        corners: Floats = origin + np.pad(polygon, ((0, 0), (0, 1))) @ R_world_sole.T
        return corners if len(polygon) else origin[None]

    def _sole(self, i: int) -> tuple[Floats, Floats]:
        """Return a sole's origin in the world in m and its axes."""
        foot = self.layout.feet[i]
        body = self._data.body(foot.body)
        R_world_foot = body.xmat.reshape(3, 3)
        return body.xpos + R_world_foot @ foot.position_sole_foot, R_world_foot @ foot.R_foot_sole


def _model(name: str, feet: Sequence[str] | None, soles: bool) -> tuple[mujoco.MjModel, Floats | None]:
    """Compile a robot, or take that of an environment, with its own places of cells if it has them."""
    file = Path(name)
    if name in ROBOTS or file.is_file() or file.suffix == ".xml":
        if soles:
            raise ValueError(f"'{name}' is a robot alone; soles are put under the feet of environments.")
        spec = load_robot_spec(name) if name in ROBOTS else read_robot_spec(file)
        return spec.compile(), None
    env = gym.make(name)
    if hasattr(env.unwrapped, "drawing"):
        if feet is not None or soles:
            raise ValueError(
                f"'{name}' has feet with soles of its own: leave 'feet' (--foot) and 'soles' out."
            )
    else:
        env = InstrumentedEnv(env, feet, soles=soles, visuals=True)
    drawing: RobotDrawing = env.get_wrapper_attr("drawing")
    return env.get_wrapper_attr("model"), drawing.position_cell_sole


def _line(scene: Any, start: Floats, end: Floats, rgba: Sequence[float]) -> None:
    geom = _new_geom(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, rgba)
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, 0.002, start, end)


def _new_geom(scene: Any, kind: mujoco.mjtGeom, rgba: Sequence[float]) -> Any:
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom, kind, np.full(3, 0.006), np.zeros(3), np.eye(3).ravel(), np.array(rgba, dtype=np.float32)
    )
    geom.emission = 1.0
    scene.ngeom += 1
    return geom
