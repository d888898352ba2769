"""What the page draws: the robot, the soles with their cells, centres of pressure, numbers and a chart.

The soles are drawn larger than they are, with one bar per cell and way to read it. Importing this module is
quick, so that a browser can load the page while a robot is being prepared.
"""

import errno
import socket
from collections import deque
from contextlib import redirect_stdout
from html import escape
from io import StringIO
from typing import Any

import numpy as np
import viser
from viser import uplot

from surefoot.arrays import Floats
from surefoot.calibration.estimate import Flag
from surefoot.calibration.layout import FeetLayout
from surefoot.experiments.view.shown import WAYS, Shown

FRAMES_PER_SECOND = 30
MAGNIFIED = 5.0  # magnification of the soles
WITHIN = 2.448  # standard deviations that contain 95 % of a normal distribution in a plane
SPAN, EVERY = 10.0, 3  # time in s that the chart shows; it takes one sample in this many frames
BESIDE = np.array([0.0, -0.95, 0.0])  # place of the soles beside the robot in leg lengths
TALLEST, BAR = 0.7, 0.035  # height in leg lengths of a bar that carries the weight, and its width
COLOURS = {"true": (0, 0, 0), "raw": (213, 94, 0), "calibrated": (0, 114, 178)}  # those of all figures
SOLE, BROKEN = (203, 211, 220), (214, 64, 69)
HARMLESS = Flag.STANDING | Flag.REFERENCE | Flag.NO_CONTACT  # flags without a label at the cell
_SIDES = 40  # of the polygon that approximates the ellipse


def open_server(host: str, port: int, label: str) -> viser.ViserServer:
    """Return a server of an empty page; OSError if the port is in use or the host does not exist."""
    # The library would silently use the next free port.
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES):
                raise OSError(
                    f"port {port} of {host} is in use or not yours; choose another with --port {port + 1}."
                ) from None
            raise OSError(f"nothing can be served at {host}: {error.strerror or error}.") from None
    with redirect_stdout(StringIO()):  # hides a banner with addresses
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    # Browsers could ask the library to open a tunnel to the internet.
    server.request_share_url = lambda verbose=True: None
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    # Shadows and reflections cost 9 of 10 frames without a graphics card.
    server.scene.configure_default_lights(cast_shadow=False)
    server.scene.configure_environment_map(None)
    server.scene.add_light_ambient("/light", intensity=1.5)
    server.gui.add_markdown("The robot gets ready …")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop serving."""
    with redirect_stdout(StringIO()):
        server.stop()


class Scene:
    """Draws the ground and the feet of one sample, seen by a camera behind the robot.

    The unit of the bars is the robot's ``weight`` in N. ``size`` in m, about the length of a leg, scales
    everything. ``aside`` is 1 if the robot is drawn too, 0 if only the feet are.
    """

    def __init__(
        self, server: viser.ViserServer, layout: FeetLayout, weight: float, size: float, aside: float
    ) -> None:
        self._size, self._weight, self._names = size, weight, layout.channel_names
        self._cells = [np.asarray(foot.position_cell_sole)[:, :2] for foot in layout.feet]
        scene, (corners, faces) = server.scene, _box()
        server.on_client_connect(lambda client: _aim(client, size, aside))
        self._ground = _add_ground(server, size)
        self._soles = [
            scene.add_mesh_simple(f"/feet/{foot.name}", _plate(cells), faces, color=SOLE, flat_shading=True)
            for foot, cells in zip(layout.feet, self._cells, strict=True)
        ]
        upright = np.tile((1.0, 0.0, 0.0, 0.0), (layout.channels, 1))
        self._bars: dict[str, Any] = {}
        self._dots: dict[str, Any] = {}
        for way, colour in COLOURS.items():
            self._bars[way] = scene.add_batched_meshes_simple(
                f"/feet/bars/{way}",
                corners,
                faces,
                upright,
                upright[:, :3],
                batched_colors=_linear(np.tile(colour, (layout.channels, 1))),
                lod="off",
                side="double",
            )
            self._dots[way] = scene.add_icosphere(
                f"/feet/cop/{way}", radius=0.01 * size, color=colour, visible=False
            )
        blue = np.tile(COLOURS["calibrated"], (_SIDES, 2, 1))
        self._ellipse = scene.add_line_segments(
            "/feet/ellipse", np.zeros(blue.shape), _linear(blue), thickness=0.008 * size, visible=False
        )
        self._labels = [
            scene.add_label(f"/feet/flag/{i}", "", anchor="bottom-center", visible=False)
            for i in range(layout.channels)
        ]
        for foot in layout.feet:
            scene.add_label(f"/feet/{foot.name}/name", foot.name, anchor="top-center", font_screen_scale=0.9)

    def draw(self, now: Shown) -> None:
        """Draw one sample. Forward is up, whichever way the robot heads."""
        x, y = now.heading
        self._R = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])
        self._middle = now.position_sole.mean(axis=0) * (1.0, 1.0, 0.0)
        tops = np.concatenate([self._draw_sole(now, i) for i in range(len(self._cells))])
        for layer, way in enumerate(WAYS):
            reading = now.readings.get(way)
            self._bars[way].visible = reading is not None
            if reading is not None:
                beside = np.array([0.0, (1 - layer) * 1.15 * BAR * self._size, 0.0])
                self._draw_bars(way, reading.force, tops + beside)
            self._dots[way].visible = reading is not None and bool(np.isfinite(reading.cop_world).all())
            if reading is not None and self._dots[way].visible:
                self._dots[way].position = self._on_board(
                    np.append(reading.cop_world, 0.0), 0.03 + 0.004 * layer
                )
        self._draw_ellipse(now)
        for i, label in enumerate(self._labels):
            wrong = Flag(int(now.flags[i])) & ~HARMLESS
            label.visible = bool(wrong)
            text = f"{self._names[i]}: {wrong.label}"
            if wrong and label.text != text:
                label.text = text
            label.position = tops[i] + _up(0.25 * self._size)

    def follow(self, origin: Floats) -> None:
        """Keep the ground still under a robot that is drawn at the middle; its pattern repeats itself."""
        self._ground.position = (*-np.fmod(origin[:2], self._size), self._ground.position[2])

    def _on_board(self, points: Floats, height: float = 0.0) -> Floats:
        """Return where points of the world in m, shape (..., 3), are drawn, higher by a share of the size."""
        where: Floats = MAGNIFIED * (points - self._middle) @ self._R.T + BESIDE * self._size
        return where + _up(height * self._size)

    def _draw_sole(self, now: Shown, foot: int) -> Floats:
        """Draw one sole and return where its cells are drawn, shape (k, 3)."""
        R = self._R @ now.R_world_sole[foot]
        handle, cells = self._soles[foot], self._cells[foot]
        where = self._on_board(now.position_sole[foot])
        # A sole that is higher than the other one is in the air.
        where[2] = MAGNIFIED * (now.position_sole[foot, 2] - now.position_sole[:, 2].min())
        handle.position, handle.wxyz = where, viser.transforms.SO3.from_matrix(R).wxyz
        flags = now.flags[foot * len(cells) : (foot + 1) * len(cells)]
        out = any(int(flag) & (Flag.DEAD | Flag.STUCK | Flag.LOST) for flag in flags)
        handle.color = BROKEN if out else SOLE
        places: Floats = where + MAGNIFIED * cells @ R[:, :2].T
        return places

    def _draw_bars(self, way: str, force: Floats, places: Floats) -> None:
        handle, side = self._bars[way], BAR * self._size
        height = np.clip(force / self._weight, -0.3, 1.5) * TALLEST * self._size
        # A flat box has no normals, so it would not be lit.
        height = np.where(np.abs(height) < 1e-3, 1e-3, height)
        handle.batched_positions = places.astype(np.float32)
        handle.batched_scales = np.column_stack([np.full((len(height), 2), side), height]).astype(np.float32)

    def _draw_ellipse(self, now: Shown) -> None:
        reading = now.readings["calibrated"]
        covariance = np.full((2, 2), np.nan) if reading.cop_covariance is None else reading.cop_covariance
        self._ellipse.visible = bool(np.isfinite(covariance).all() and np.isfinite(reading.cop_world).all())
        if not self._ellipse.visible:
            return
        variance, axes = np.linalg.eigh(covariance)
        angle = np.linspace(0.0, 2.0 * np.pi, _SIDES + 1)
        spread = WITHIN * np.sqrt(np.maximum(variance, 0.0))[:, None]
        around = reading.cop_world + (axes @ (np.stack([np.cos(angle), np.sin(angle)]) * spread)).T
        points = self._on_board(np.pad(around, ((0, 0), (0, 1))), 0.032)
        self._ellipse.points = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


class Meters:
    """A table of forces, errors and flags, and a chart of the forces of the last seconds."""

    def __init__(self, server: viser.ViserServer, layout: FeetLayout) -> None:
        self._feet, self._channels = tuple(foot.name for foot in layout.feet), layout.channel_names
        self._rows: deque[list[float]] = deque(maxlen=round(SPAN * FRAMES_PER_SECOND / EVERY))
        self._count = 0
        self._table = server.gui.add_html("")
        series: list[Any] = [uplot.Series(label="time in s")]
        for i, foot in enumerate(self._feet):
            for way in WAYS:
                dash = (5.0, 4.0) if i else ()
                series.append(uplot.Series(label=f"{foot} {way}", stroke=_css(way), width=1.5, dash=dash))
        with server.gui.add_folder("Vertical force: left solid, right dashed"):
            self._chart: Any = server.gui.add_uplot(
                self.columns(),
                tuple(series),
                scales={"x": uplot.Scale(time=False), "y": uplot.Scale(auto=True)},
                axes=tuple(
                    uplot.Axis(label=label, size=30, labelSize=18) for label in ("time in s", "force in N")
                ),
                legend=uplot.Legend(show=False),
                aspect=1.5,
            )

    def forget(self) -> None:
        """Empty the chart, because time jumps."""
        self._rows.clear()

    def draw(self, now: Shown, *lines: str) -> None:
        """Add one sample, and show it under lines of plain text."""
        self._count += 1
        if self._count % EVERY:
            return
        unknown = np.full(len(self._feet), np.nan)
        forces = [now.readings[way].vgrf if way in now.readings else unknown for way in WAYS]
        self._rows.append([now.time, *np.array(forces).T.ravel().tolist()])
        self._chart.data = self.columns()
        self._table.content = self._html(now, np.array(forces), lines)

    def columns(self) -> tuple[Any, ...]:
        """Return the data of the chart: times in s, then forces in N by foot and way."""
        rows = np.array(self._rows) if len(self._rows) > 1 else np.zeros((2, 1 + len(WAYS) * len(self._feet)))
        return tuple(np.ascontiguousarray(column) for column in rows.T)

    def _html(self, now: Shown, forces: Floats, lines: tuple[str, ...]) -> str:
        covariance = now.readings["calibrated"].cop_covariance
        spread = float("nan") if covariance is None else float(np.sqrt(max(np.trace(covariance), 0.0)))
        rows = [[f"{foot}, N", *map(_short, forces[:, i])] for i, foot in enumerate(self._feet)]
        rows.append(["CoP error, mm", "", *(_short(1e3 * now.cop_error(way)) for way in WAYS[1:])])
        rows.append(["CoP std, mm", "", "", _short(1e3 * spread)])
        cells = "".join(f"<tr>{''.join(f'<td>{escape(part)}</td>' for part in row)}</tr>" for row in rows)
        heads = "".join(f'<th style="color:{_css(way)}">■ {way}</th>' for way in WAYS)
        named = zip(self._channels, now.flags, strict=True)
        wrong = "; ".join(f"{name} {Flag(int(flag)).label}" for name, flag in named if flag)
        flagged = f'<b style="color:#c92a2a">{escape(wrong)}</b>' if wrong else "nothing"
        above = "".join(f"<div>{escape(line)}</div>" for line in lines if line)
        return (
            f'<div style="padding:0.4em 1em;font-size:13px;line-height:1.5">{above}'
            f'<table style="width:100%;font-size:13px"><tr align="left"><th></th>{heads}</tr>{cells}</table>'
            f"<div>flagged: {flagged}</div></div>"
        )


def _short(number: float) -> str:
    return f"{number:.1f}" if np.isfinite(number) else "–"


def _css(way: str) -> str:
    return "#{:02x}{:02x}{:02x}".format(*COLOURS[way])


def _aim(client: Any, size: float, aside: float) -> None:
    """Place a browser's camera so that the panel leaves the scene visible."""
    camera, (x, y, z) = client.camera, BESIDE
    if camera.image_width < camera.image_height:  # the panel covers the lower right
        y *= 1.0 - 0.18 * aside
        position, look_at = (x - 2.1, y, z + 2.2), (x - 1.2, y, z)
    else:  # it covers the right
        y *= 1.3 - 0.4 * aside
        position, look_at = (x - 1.05, y, z + 1.2), (x + 0.1, y, z + 0.1)
    camera.up_direction = (0.0, 0.0, 1.0)
    camera.position = tuple(size * part for part in position)
    camera.look_at = tuple(size * part for part in look_at)


def _add_ground(server: viser.ViserServer, size: float) -> Any:
    return server.scene.add_grid(
        "/ground",
        position=(0.0, 0.0, -0.004 * size),  # a little lower than the soles, which it would hide
        infinite_grid=True,
        cell_size=0.25 * size,
        section_size=size,
        cell_color=(222, 222, 222),
        section_color=(190, 190, 190),
        fade_distance=12.0 * size,
        plane_color=(246, 248, 250),
        plane_opacity=1.0,
    )


def _linear(rgb: Any) -> Any:
    """Convert colours from sRGB to linear, which the library expects of lines and batches only."""
    return np.rint(255.0 * (np.asarray(rgb) / 255.0) ** 2.2).astype(np.uint8)


def _up(height: float) -> Floats:
    return np.array([0.0, 0.0, height])


def _plate(cells: Floats) -> Floats:
    """Return the corners of a plate under cells, magnified, in m."""
    low, high = cells.min(axis=0), cells.max(axis=0)
    margin = 0.15 * (high - low).min()
    corners, _ = _box()
    flat = 0.5 * (low + high) + corners[:, :2] * (high - low + 2.0 * margin)
    return MAGNIFIED * np.column_stack([flat, (corners[:, 2] - 1.0) * 0.004])


def _box() -> tuple[Floats, Any]:
    """Return the vertices and faces of a box with sides of 1, whose bottom is at the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([[a, b, c] for p, q, r, s in squares for a, b, c in ((p, q, r), (p, r, s))])
