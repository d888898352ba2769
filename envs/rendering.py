"""Frames and windows of a robot, with markers."""

import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import glfw
import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
from numpy.typing import NDArray

from surefoot.envs.options import number_of

Marker = tuple[Sequence[float], Sequence[float], float]
"""A sphere: its position in the world in m, its RGBA and its radius in m."""

VIEW = {"azimuth": 140.0, "elevation": -15.0}  # from where a free camera looks, in degrees
WINDOW = {"distance": 1.6, **VIEW}  # the camera of a window, in m and degrees


class DrawnEnv(gym.Env[Any, Any]):
    """An environment that draws its robot, and spheres beside it."""

    _renderer: "SceneRenderer"

    def _draw_by(self, renderer: "SceneRenderer", mode: str | None) -> None:
        self._renderer, self.render_mode, self.markers = renderer, mode, list[Marker]()

    def _show(self) -> None:
        """Show a new state in a window, if there is to be one."""
        if self.render_mode == "human":
            self.render()

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the robot and the markers: a frame (height, width, 3), or a window in "human" mode."""
        return self._renderer.render(self.render_mode, self.markers)

    def close(self) -> None:
        """Close the window and give its memory back; the next frame opens another."""
        self._renderer.close()


class SceneRenderer:
    """Gymnasium's MuJoCo renderer, made when the first frame is wanted.

    The camera is one of the model, or where a free one looks: its ``lookat`` in m and ``distance`` in m. A
    window follows the torso in place of a named one, and the mouse turns it. Width and height are in pixels;
    ValueError if the model has no such camera or a size is not positive.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        camera: str | dict[str, Any],
        width: int,
        height: int,
    ) -> None:
        cameras = [model.camera(i).name for i in range(model.ncam)]
        if isinstance(camera, str) and camera not in cameras:
            raise ValueError(f"The robot's model has no camera '{camera}'; choose one of {cameras}.")
        check_size(model, width, height)
        self._scene = model, data
        self._camera, self._width, self._height = camera, width, height
        self._renderer: MujocoRenderer | None = None

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_renderer": None}

    def render(self, mode: str | None, markers: Iterable[Marker]) -> NDArray[np.uint8] | None:
        """Draw the scene with spheres: a frame, (height, width, 3); nothing for a window or without a mode.

        RuntimeError if there is no screen for a window, or nothing that could draw a frame.
        """
        if mode is None:
            gym.logger.warn("render() draws nothing without a render mode, such as 'rgb_array'.")
            return None
        if self._renderer is None:
            if mode == "human":
                _require_screen()
            size = self._width, self._height
            if isinstance(self._camera, str):
                torso = int(self._scene[0].body("torso").id)
                window = WINDOW | {"type": int(mujoco.mjtCamera.mjCAMERA_TRACKING), "trackbodyid": torso}
                renderer = MujocoRenderer(*self._scene, window, *size, 2000, camera_name=self._camera)
            else:
                renderer = MujocoRenderer(*self._scene, VIEW | self._camera, *size, 2000)
            self._renderer = renderer
        try:
            viewer: Any = self._renderer._get_viewer(mode)
        except (mujoco.FatalError, RuntimeError, AttributeError, ImportError) as error:
            self._renderer = None
            raise RuntimeError(
                f"No frame can be drawn: {error}. On a machine without a screen set the environment variable "
                "MUJOCO_GL=egl before Python starts (Debian: packages libegl1 and libgl1-mesa-dri)."
            ) from error
        for position, rgba, radius in markers:
            viewer.add_marker(
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                pos=np.asarray(position, dtype=np.float64),
                rgba=np.asarray(rgba, dtype=np.float32),
                size=np.full(3, radius),
            )
        frame: NDArray[np.uint8] | None = self._renderer.render(mode)
        return frame

    def close(self) -> None:
        """Close it."""
        if self._renderer is not None:
            self._renderer.close()  # type: ignore[no-untyped-call]
            self._renderer = None


def check_size(model: mujoco.MjModel, width: int, height: int) -> None:
    """Raise ValueError if a model has no buffer for frames of this size."""
    most_wide, most_high = int(model.vis.global_.offwidth), int(model.vis.global_.offheight)
    if not (0 < number_of(width) <= most_wide and 0 < number_of(height) <= most_high):
        raise ValueError(
            f"'width' and 'height' must be positive and at most {most_wide} x {most_high} pixels, "
            f"got {width} x {height}."
        )


def _require_screen() -> None:
    """Raise RuntimeError if there is no screen for a window: GLFW would end the whole process."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        screen = glfw.init() and glfw.get_primary_monitor()
    if not screen:
        raise RuntimeError(
            "render_mode='human' opens a window, but this machine has no screen; use render_mode='rgb_array' "
            "with the environment variable MUJOCO_GL=egl."
        )
