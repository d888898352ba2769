"""The page: feet in the browser, and a robot that can be changed while it walks."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue
from time import perf_counter, sleep
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, METHODS
from surefoot.experiments.logs.format import write_log
from surefoot.experiments.view.rows import RowFeet
from surefoot.experiments.view.scene import FRAMES_PER_SECOND, Meters, Scene
from surefoot.experiments.view.session import Session

REFUSALS = (ValueError, TypeError, IndexError, KeyError, OverflowError, OSError)
TORSO = 0.32  # height in m of the torso of a robot whose scene has size 1: that of the NAO
LONGEST_FRAME = 0.1  # simulated time in s per frame at most; a slower computer shows the robot more slowly
HURRY = 0.25  # time in s per frame for which a standing robot is stepped, so that it soon walks
LYING = 2.0  # time in s that a fallen robot lies before it is reset
VISIBLE_GROUPS = 3  # geoms of higher groups are not drawn, as in MuJoCo's viewer

SLIDERS = {  # name, least and largest value, step, help
    "severity": ("severity", 0.0, 5.0, 0.1, "Factor of all errors of the cells."),
    "drift": ("drift", 0.0, 20.0, 0.5, "Factor of the speed of their drift."),
    "temperature": ("temperature, K", -20.0, 40.0, 1.0, "Above the temperature at power-up."),
    "payload": ("payload, kg", 0.0, 1.5, 0.05, "A mass in front of the chest."),
    "slope": ("slope, °", -5.0, 5.0, 0.25, "The ground rises in front."),
    "speed": ("speed, m/s (next reset)", -0.06, 0.1, 0.01, "Takes effect at the next reset."),
}
FAULTS = ("dies", "sticks", "flips", "swaps with", "spikes", "drops", "saturates")
PUSHES = {"forward": (1.0, 0.0), "back": (-1.0, 0.0), "left": (0.0, 1.0), "right": (0.0, -1.0)}


class Page:
    """The feet of a log or stream in the browser, with a choice of the method.

    Requests of browsers arrive in other threads. They wait in a queue until :meth:`run` handles them.
    """

    def __init__(
        self, server: viser.ViserServer, feet: Any, *, size: float = 1.0, aside: float = 0.0
    ) -> None:
        self.server, self.feet, self.message = server, feet, ""
        server.gui.reset()
        self._requests: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        self._stopped = False
        self._scene = Scene(server, feet.layout, feet.weight, size, aside)
        self.meters = Meters(server, feet.layout)
        self._add_controls()

    def request(self, what: str, value: Any = None) -> None:
        """Ask for a change, such as a browser's; any thread may call this."""
        self._requests.put((what, value))

    def run(self, seconds: float = float("inf")) -> None:
        """Continue and draw for some time in s, until interrupted or stopped."""
        last = due = perf_counter()
        until, self._stopped = last + seconds, False
        while last < until and not self._stopped:
            self._handle_requests()
            now = perf_counter()
            self._advance(now - last)
            last = now
            with self.server.atomic():
                self._draw()
            # A sleep that was too long makes the next one shorter.
            due = max(due + 1.0 / FRAMES_PER_SECOND, perf_counter())
            sleep(max(due - perf_counter(), 0.0))

    def stop(self) -> None:
        """Let :meth:`run` return; any thread may call this."""
        self._stopped = True

    def _add_controls(self) -> None:
        self._choice("calibrator", "method", tuple(METHODS), self.feet.method)

    def _advance(self, passed: float) -> None:
        feet: RowFeet = self.feet
        feet.advance(passed)
        self.message = feet.message or self.message

    def _draw(self) -> None:
        if self.feet.shown is not None:
            self._scene.draw(self.feet.shown)
            self.meters.draw(self.feet.shown, self.feet.status, self.message)

    def _do(self, what: str, value: Any) -> str:
        """Handle one request, and return the message about it."""
        if what != "method":
            raise ValueError(f"There is no change '{what}' of a log or stream.")
        self.feet.choose(str(value))
        self.meters.forget()
        return ""

    def _handle_requests(self) -> None:
        latest: dict[Any, tuple[str, Any]] = {}
        while True:
            try:
                what, value = self._requests.get_nowait()
            except Empty:
                break
            # While a slider moves, only its last value counts.
            channel = value[0] if what in ("scale", "offset") and isinstance(value, tuple) else 0
            slider = what in SLIDERS or what in ("scale", "offset", "pace")
            key = (what, str(channel)) if slider else len(latest)
            latest.pop(key, None)
            latest[key] = what, value
        for what, value in latest.values():
            try:
                self.message = self._do(what, value)
            except REFUSALS as error:
                self.message = str(error)

    def _choice(self, label: str, what: str, options: tuple[str, ...], value: str, **more: Any) -> Any:
        handle = self.server.gui.add_dropdown(label, options, initial_value=value, **more)
        return self._send(handle, what)

    def _send(self, handle: Any, what: str, convert: Callable[[Any], Any] = lambda value: value) -> Any:
        """Request a change whenever a browser, and not this program, changes a control."""

        def on_update(event: Any) -> None:
            if event.client_id is not None:
                self.request(what, convert(handle.value))

        handle.on_update(on_update)
        return handle


class LivePage(Page):
    """A session in the browser. Recordings go into ``folder``, None for no recordings."""

    def __init__(self, server: viser.ViserServer, session: Session, *, folder: Path | None = None) -> None:
        self.session, self._folder = session, folder
        size = float(session.source.data.body(session.drawing.torso).xpos[2]) / TORSO
        self._paused, self._pace, self._due, self._lying = False, 1.0, 0.0, 0.0
        super().__init__(server, session, size=size, aside=1.0)
        self._bodies = _draw_robot(server, session.source.model)

    def _draw(self) -> None:
        now, data = self.session.state_to_draw(), self.session.source.data
        origin = data.body(self.session.drawing.torso).xpos * (1.0, 1.0, 0.0)
        for body, handle in self._bodies.items():
            handle.position, handle.wxyz = data.xpos[body] - origin, data.xquat[body]
        self._scene.follow(origin)
        self._scene.draw(now)
        session = self.session
        states = {"fallen": session.fell, "paused": self._paused, "stands": session.standing, "walks": True}
        state = next(word for word, holds in states.items() if holds)
        self.meters.draw(now, f"{state} at {session.time:.1f} s", self.message)

    def _advance(self, passed: float) -> None:
        """Step the robot as far as time has passed."""
        session = self.session
        if session.over:
            self._lying += passed
            if not session.fell or self._lying > LYING:
                self.request("reset")
        elif session.standing and not self._paused:
            end = perf_counter() + HURRY
            while session.standing and perf_counter() < end:
                self._step()
        elif not self._paused:
            self._due = min(self._due + self._pace * passed, LONGEST_FRAME)
            while self._due >= session.dt and not session.over:
                self._step()
                self._due -= session.dt

    def _step(self) -> None:
        if not self.session.over:
            self.session.step()
        if self.session.record_is_full:
            self._save()

    def _do(self, what: str, value: Any) -> str:
        session = self.session
        match what:
            case "pause":
                self._paused = bool(value)
            case "step":
                self._step()
            case "pace":
                self._pace = min(max(float(value), 0.1), 1.0)
            case "record":
                self._record()
            case "power_up" | "reset":
                self._save()
                if what == "reset":
                    session.change("reset")
                else:
                    session.power_up(int(value))
                    self._show_settings()
                self._lying = self._due = 0.0
                self.meters.forget()
            case _:
                session.change(what, value)
        return f"Broken: {'; '.join(session.errors.faults)}" if session.errors.faults else ""

    def _record(self) -> None:
        if self.session.recording is None:
            self.session.record()
            self._record_button.label = "stop recording"
        else:
            self._save()

    def _save(self) -> None:
        """Write the recording, if there is one, into the folder of the command."""
        if self.session.recording is None or self._folder is None:
            return
        self._record_button.label = "record"
        log = self.session.stop_recording()
        task = self.session.env_id.rpartition("/")[2].lower()
        number = 1
        while (path := self._folder / f"{task}-seed{self.session.seed}-{number}.parquet").exists():
            number += 1
        write_log(log, path)
        self.commands.content = f"```\nsurefoot calibrate walk {path}\nsurefoot view --log {path}\n```"

    def _show_settings(self) -> None:
        """Show the present settings, for example after a power-up."""
        for what, handle in self._settings.items():
            handle.value = self.session.settings[what]
        self._seed.value = self.session.seed
        self._show_channel()

    def _show_channel(self, event: Any = None) -> None:
        channel, errors = self._channel(), self.session.errors
        self._scale.value = round(100.0 * float(errors.scale[channel]), 3)
        self._offset.value = round(float(errors.offset[channel]), 3)

    def _channel(self) -> int:
        return self.session.layout.channel_names.index(str(self._cell.value))

    def _add_controls(self) -> None:
        session, gui = self.session, self.server.gui
        settings, names = session.settings, session.layout.channel_names
        feed = self._choice("controller gets", "feed", session.feeds, settings["feed"])
        method = self._choice("calibrator", "method", tuple(METHODS), settings["method"])
        self._settings = {"feed": feed, "method": method}
        with gui.add_folder("Run"):
            self._send(gui.add_checkbox("pause", initial_value=False), "pause")
            self._send(gui.add_slider("pace", 0.1, 1.0, 0.1, 1.0, hint="1 is real time."), "pace")
            self._button("one step", "step")
            self._button("reset", "reset", hint="Another episode with the same feet and their calibration.")
            self._seed = gui.add_number("seed", session.seed, min=0, max=10**6, step=1)
            self._button("power up with this seed", "power_up", lambda: int(self._seed.value))
            if self._folder is not None:
                self._record_button = self._button("record", "record", hint="Until the end of the episode.")
                self.commands = gui.add_markdown("")
        with gui.add_folder("Changes"):
            absent = {"payload": not session.world.carries, "speed": not session.walks}
            for what, (label, low, high, step, hint) in SLIDERS.items():
                if not absent.get(what, False):
                    value = min(max(float(settings[what]), low), high)
                    slider = gui.add_slider(label, low, high, step, value, hint=hint)
                    self._settings[what] = self._send(slider, what)
            mass = session.weight / GRAVITY
            impulse = gui.add_slider("push, N s", 0.0, round(0.3 * mass, 1), 0.05, round(0.06 * mass, 1))
            ways = gui.add_button_group("direction", tuple(PUSHES))
            ways.on_click(
                lambda _: self.request("push", [part * float(impulse.value) for part in PUSHES[ways.value]])
            )
        with gui.add_folder("One cell"):
            self._cell = gui.add_dropdown("cell", names)
            self._cell.on_update(self._show_channel)
            limit = round(0.2 * session.weight, 0)
            self._scale = gui.add_slider("its scale, %", -90.0, 100.0, 1.0, 0.0, hint="Additional error.")
            self._offset = gui.add_slider("its offset, N", -limit, limit, 0.1, 0.0, hint="Additional error.")
            self._send(self._scale, "scale", lambda percent: (self._channel(), 0.01 * float(percent)))
            self._send(self._offset, "offset", lambda force: (self._channel(), float(force)))
            fault, other = gui.add_dropdown("fault", FAULTS), gui.add_dropdown("swaps with", names[::-1])
            self._button("break it", "fault", partial(self._fault, fault, other), color="red")
            self._button("repair all", "repair")

    def _fault(self, fault: Any, other: Any) -> str:
        words = [self._cell.value, fault.value]
        return " ".join([*words, other.value] if fault.value == "swaps with" else words)

    def _button(self, label: str, what: str, value: Callable[[], Any] = lambda: None, **options: Any) -> Any:
        button = self.server.gui.add_button(label, **options)
        button.on_click(lambda event: self.request(what, value()))
        return button


def _draw_robot(server: viser.ViserServer, model: mujoco.MjModel) -> dict[int, Any]:
    """Add the meshes of a robot's bodies to the scene, and return their handles by body."""
    bodies: dict[int, list[trimesh.Trimesh]] = {}
    for geom in range(model.ngeom):
        mesh = _mesh(model, geom)
        if mesh is not None:
            bodies.setdefault(int(model.geom_bodyid[geom]), []).append(mesh)
    joined: Any = {body: trimesh.util.concatenate(meshes) for body, meshes in bodies.items() if body}
    return {body: server.scene.add_mesh_trimesh(f"/robot/{body}", mesh) for body, mesh in joined.items()}


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return a geom in the frame of its body, in its colour; None if it is invisible."""
    material, colour = int(model.geom_matid[geom]), np.asarray(model.geom_rgba[geom], dtype=np.float64)
    if material >= 0 and np.allclose(colour, (0.5, 0.5, 0.5, 1.0)):  # MuJoCo's default colour
        colour = np.asarray(model.mat_rgba[material], dtype=np.float64)
    shape = _shape(model, geom, np.asarray(model.geom_size[geom]))
    if shape is None or model.geom_group[geom] >= VISIBLE_GROUPS or colour[3] == 0.0:
        return None
    pose, axes = np.eye(4), np.empty(9)
    mujoco.mju_quat2Mat(axes, model.geom_quat[geom])
    pose[:3, :3], pose[:3, 3] = axes.reshape(3, 3), model.geom_pos[geom]
    shape.apply_transform(pose)
    rgba = np.tile((255 * colour).astype(np.uint8), (len(shape.vertices), 1))
    shape.visual = trimesh.visual.ColorVisuals(shape, vertex_colors=rgba)
    return shape


def _shape(model: mujoco.MjModel, geom: int, size: Floats) -> trimesh.Trimesh | None:
    """Return the shape of a geom at the origin; None for planes and height fields."""
    kind, create = mujoco.mjtGeom, trimesh.creation
    match int(model.geom_type[geom]):
        case kind.mjGEOM_SPHERE | kind.mjGEOM_ELLIPSOID as which:
            ball = create.icosphere(subdivisions=2)
            ball.apply_scale(size if which == kind.mjGEOM_ELLIPSOID else size[0])
            return ball
        case kind.mjGEOM_CAPSULE:
            return create.capsule(height=2.0 * size[1], radius=size[0], count=(16, 16))
        case kind.mjGEOM_CYLINDER:
            return create.cylinder(radius=size[0], height=2.0 * size[1], sections=24)
        case kind.mjGEOM_BOX:
            return create.box(extents=2.0 * size)
        case kind.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
            vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
            faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
            return trimesh.Trimesh(vertices.copy(), faces.copy(), process=False)
    return None
