"""Both soles, larger than they are: cells as bars, centres of pressure with their trails, and an ellipse."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser
from numpy.typing import NDArray
from PIL import ImageColor

from surefoot.arrays import Floats
from surefoot.calibration.estimate import Flag
from surefoot.calibration.layout import FeetLayout
from surefoot.experiments.study.figures import look_of
from surefoot.experiments.view.server import PLACE
from surefoot.experiments.view.shown import WAYS, Shown

MAGNIFIED = 5.0  # how much larger than life the soles are drawn
TRAIL = 60  # frames that a trail is long: two seconds
WITHIN = 2.448  # standard deviations within which 95 % of a plane's normal distribution lies
_BAR, _TALLEST = 0.035, 0.7  # width of a bar, and height of one that bears the whole robot
_SIDES = 40  # of the polygon that stands for the ellipse
_SOLE, _BROKEN = (203, 211, 220), (214, 64, 69)


def colours(method: str) -> dict[str, str]:
    """Return the colour of each way to read the feet, as in all figures: ``"#rrggbb"``."""
    names = {"true": "true", "raw": "none", "calibrated": "moment" if method == "none" else method}
    return {way: look_of(name).colour for way, name in names.items()}


class FeetBoard:
    """Draws the feet of one sample beside the robot.

    The unit of the bars is the robot's weight in N; ``size``, about a leg, in m scales all.
    """

    def __init__(self, server: viser.ViserServer, layout: FeetLayout, weight: float, size: float) -> None:
        self._scene, self._size, self._weight = server.scene, size, weight
        self._cells = [np.asarray(foot.position_cell_sole)[:, :2] for foot in layout.feet]
        self._names = layout.channel_names
        self._trails: dict[str, deque[Floats]] = {way: deque(maxlen=TRAIL) for way in WAYS}
        scene = server.scene
        self._soles = [
            scene.add_mesh_simple(f"/feet/{foot.name}", *_plate(cells), color=_SOLE, flat_shading=True)
            for foot, cells in zip(layout.feet, self._cells, strict=True)
        ]
        still = np.tile((1.0, 0.0, 0.0, 0.0), (len(self._names), 1))
        corners, faces = _box()
        self._bars: dict[str, Any] = {}
        self._dots: dict[str, Any] = {}
        self._lines: dict[str, Any] = {}
        for way in WAYS:
            self._bars[way] = scene.add_batched_meshes_simple(
                f"/feet/bars/{way}", corners, faces, still, still[:, :3], lod="off", side="double"
            )
            self._dots[way] = scene.add_icosphere(f"/feet/cop/{way}", radius=0.01 * size, visible=False)
            self._lines[way] = self._line(f"/feet/trail/{way}", TRAIL - 1)
        self._ellipse = self._line("/feet/ellipse", _SIDES)
        self._labels = [
            scene.add_label(f"/feet/flag/{i}", "", anchor="bottom-center", visible=False)
            for i in range(len(self._names))
        ]
        for foot in layout.feet:
            scene.add_label(f"/feet/{foot.name}/name", foot.name, anchor="top-center", font_screen_scale=0.9)

    def paint(self, chosen: Mapping[str, str]) -> None:
        """Give each way to read the feet its colour, ``"#rrggbb"``."""
        fresh = np.linspace(0.3, 1.0, TRAIL)[:, None]
        for way, colour in chosen.items():
            rgb = ImageColor.getrgb(colour)[:3]
            self._bars[way].batched_colors = np.tile(_linear(rgb), (len(self._names), 1))
            self._dots[way].color = rgb
            shades = fresh * np.array(rgb) + (1.0 - fresh) * np.array(_SOLE)
            self._lines[way].colors = _linear(_segments(shades))
            if way == "calibrated":
                self._ellipse.colors = np.tile(_linear(rgb), (_SIDES, 2, 1))

    def forget(self) -> None:
        """Drop the trails, at an episode start."""
        for trail in self._trails.values():
            trail.clear()

    def draw(self, now: Shown) -> None:
        """Draw one sample."""
        x, y = now.heading
        # Forward is up on the board, wherever the robot heads.
        self._R = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])
        self._middle = now.position_sole.mean(axis=0) * (1.0, 1.0, 0.0)
        tops = np.concatenate([self._draw_sole(now, i) for i in range(len(self._cells))])
        side = _BAR * self._size
        for k, way in enumerate(WAYS):
            there = way in now.readings
            self._bars[way].visible = there
            if there:
                self._draw_bars(
                    way, now.readings[way].force, tops + np.array([0.0, (1 - k) * 1.15 * side, 0.0])
                )
            self._draw_cop(way, now.readings[way].cop_world if there else np.full(2, np.nan), k)
        self._draw_ellipse(now)
        for i, label in enumerate(self._labels):
            flag = Flag(int(now.flags[i]))
            # A channel that stands is none to worry about.
            wrong = flag & ~(Flag.STANDING | Flag.REFERENCE | Flag.NO_CONTACT)
            label.visible = bool(wrong)
            if wrong:
                text = f"{self._names[i]}: {words(wrong)}"
                if label.text != text:
                    label.text = text
                label.position = tops[i] + _up(0.25 * self._size)

    def _on_board(self, points: Floats) -> Floats:
        """Return where points of the world in m, shape (..., 3), are drawn."""
        where: Floats = MAGNIFIED * (points - self._middle) @ self._R.T + PLACE * self._size
        return where

    def _draw_sole(self, now: Shown, foot: int) -> Floats:
        """Draw one sole and return where its cells are drawn, shape (k, 3)."""
        R = self._R @ now.R_world_sole[foot]
        handle, cells = self._soles[foot], self._cells[foot]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R).ravel())
        # Straight down: what lies higher than the other foot is in the air.
        where = self._on_board(now.position_sole[foot])
        where[2] = MAGNIFIED * (now.position_sole[foot, 2] - now.position_sole[:, 2].min())
        handle.position, handle.wxyz = where, quaternion
        flags = now.flags[foot * len(cells) : (foot + 1) * len(cells)]
        out = any(int(flag) & (Flag.DEAD | Flag.STUCK | Flag.LOST) for flag in flags)
        handle.color = _BROKEN if out else _SOLE
        places: Floats = where + MAGNIFIED * cells @ R[:, :2].T
        return places

    def _draw_bars(self, way: str, force: Floats, places: Floats) -> None:
        handle, side = self._bars[way], _BAR * self._size
        height = np.clip(force / self._weight, -0.3, 1.5) * _TALLEST * self._size
        # A flat box has no normals to light it by.
        height = np.where(np.abs(height) < 1e-3, 1e-3, height)
        handle.batched_positions = places.astype(np.float32)
        handle.batched_scales = np.column_stack([np.full((len(height), 2), side), height]).astype(np.float32)

    def _draw_cop(self, way: str, cop: Floats, layer: int) -> None:
        known, dot, trail = bool(np.isfinite(cop).all()), self._dots[way], self._trails[way]
        dot.visible = known
        if known:
            trail.append(np.append(cop, 0.0))
            dot.position = self._on_board(trail[-1]) + _up((0.03 + 0.004 * layer) * self._size)
        line = self._lines[way]
        line.visible = len(trail) > 2
        if len(trail) > 2:
            points = self._on_board(np.array(trail)) + _up((0.02 + 0.003 * layer) * self._size)
            # Always as many as there are colours: a page that has the ones before the others draws grey.
            points = np.pad(points, ((TRAIL - len(points), 0), (0, 0)), mode="edge")
            line.points = _segments(points).astype(np.float32)

    def _draw_ellipse(self, now: Shown) -> None:
        reading = now.readings["calibrated"]
        covariance = np.full((2, 2), np.nan) if reading.cop_covariance is None else reading.cop_covariance
        self._ellipse.visible = bool(np.isfinite(covariance).all() and np.isfinite(reading.cop_world).all())
        if not self._ellipse.visible:
            return
        variance, axes = np.linalg.eigh(covariance)
        turn = np.linspace(0.0, 2.0 * np.pi, _SIDES + 1)
        circle = np.stack([np.cos(turn), np.sin(turn)]) * WITHIN * np.sqrt(np.maximum(variance, 0.0))[:, None]
        around = reading.cop_world + (axes @ circle).T
        points = self._on_board(np.pad(around, ((0, 0), (0, 1)))) + _up(0.032 * self._size)
        self._ellipse.points = _segments(points).astype(np.float32)

    def _line(self, name: str, segments: int) -> Any:
        nothing = np.zeros((segments, 2, 3))
        black, thickness = nothing.astype(np.uint8), 0.008 * self._size
        return self._scene.add_line_segments(name, nothing, black, thickness=thickness, visible=False)


def _segments(points: Floats) -> Floats:
    """Return the ends of the lines between points, shape (n - 1, 2, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


def words(flag: Flag) -> str:
    """Return flags in words.

    >>> words(Flag.DEAD | Flag.LOST)
    'dead, lost'
    """
    return ", ".join(str(part.name).lower().replace("_", " ") for part in flag)


def _linear(rgb: Any) -> NDArray[np.uint8]:
    """Return colours from sRGB as linear ones, which the library wants of lines and batches alone."""
    linear: NDArray[np.uint8] = np.rint(255.0 * (np.asarray(rgb) / 255.0) ** 2.2).astype(np.uint8)
    return linear


def _up(height: float) -> Floats:
    return np.array([0.0, 0.0, height])


def _plate(cells: Floats) -> tuple[Floats, Any]:
    """Return a plate under four cells, FL, FR, RL, RR, as vertices, in drawn m, and faces."""
    corners, faces = _box()
    low, high = cells.min(axis=0), cells.max(axis=0)
    margin = 0.15 * (high - low).min()
    middle, span = 0.5 * (low + high), high - low + 2.0 * margin
    flat = np.column_stack([middle + corners[:, :2] * span, (corners[:, 2] - 1.0) * 0.004])
    return MAGNIFIED * flat, faces


def _box() -> tuple[Floats, Any]:
    """Return a box from 0 to 1 in z with sides of 1 around it, as vertices and faces."""
    box = trimesh.creation.box()
    return np.asarray(box.vertices + _up(0.5)), box.faces
