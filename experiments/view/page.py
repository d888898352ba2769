"""The page in the browser: a robot that walks, its feet, numbers, and controls."""

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser

from surefoot.arrays import Floats
from surefoot.experiments.logs.format import write_log
from surefoot.experiments.view.panel import Panel
from surefoot.experiments.view.served import Served
from surefoot.experiments.view.session import Session

VISIBLE_GROUPS = 3  # geoms of groups below this one are drawn, as MuJoCo's viewers do

_GEOM = mujoco.mjtGeom


class RobotMeshes:
    """The bodies of a model, without planes and height fields: the page has a ground of its own."""

    def __init__(self, server: viser.ViserServer, model: mujoco.MjModel) -> None:
        self._handles: list[tuple[int, Any]] = []
        for body in range(model.nbody):
            start = int(model.body_geomadr[body])
            geoms = range(start, start + int(model.body_geomnum[body]))
            meshes = [mesh for geom in geoms if (mesh := _mesh(model, geom)) is not None]
            if meshes:
                handle = server.scene.add_mesh_trimesh(f"/robot/{body}", trimesh.util.concatenate(meshes))
                self._handles.append((body, handle))

    def move(self, data: mujoco.MjData, origin: Floats) -> None:
        """Move the bodies to where they are, seen from an origin on the ground in m, shape (3,)."""
        for body, handle in self._handles:
            handle.position = data.xpos[body] - origin
            handle.wxyz = data.xquat[body]


def _mesh(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    """Return a geom in its body's frame, in its colour; ``None`` if it is not drawn."""
    colour = _colour(model, geom)
    if model.geom_group[geom] >= VISIBLE_GROUPS or colour[3] == 0.0:
        return None
    shape = _shape(model, geom)
    if shape is None:
        return None
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.geom_quat[geom])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = axes.reshape(3, 3), model.geom_pos[geom]
    shape.apply_transform(pose)
    rgba = np.tile((255 * colour).astype(np.uint8), (len(shape.vertices), 1))
    shape.visual = trimesh.visual.ColorVisuals(shape, vertex_colors=rgba)
    return shape


def _shape(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh | None:
    size = model.geom_size[geom]
    match int(model.geom_type[geom]):
        case _GEOM.mjGEOM_SPHERE:
            return trimesh.creation.icosphere(subdivisions=2, radius=size[0])
        case _GEOM.mjGEOM_ELLIPSOID:
            ball = trimesh.creation.icosphere(subdivisions=2)
            ball.apply_scale(size)
            return ball
        case _GEOM.mjGEOM_CAPSULE:
            return trimesh.creation.capsule(height=2.0 * size[1], radius=size[0], count=(16, 16))
        case _GEOM.mjGEOM_CYLINDER:
            return trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=24)
        case _GEOM.mjGEOM_BOX:
            return trimesh.creation.box(extents=2.0 * size)
        case _GEOM.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
            vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
            faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
            return trimesh.Trimesh(vertices.copy(), faces.copy(), process=False)
    return None


def _colour(model: mujoco.MjModel, geom: int) -> Floats:
    """Return RGBA from 0 to 1: a material's, unless the geom has a colour of its own."""
    material, own = int(model.geom_matid[geom]), np.asarray(model.geom_rgba[geom], dtype=np.float64)
    if material < 0 or not np.allclose(own, (0.5, 0.5, 0.5, 1.0)):
        return own
    return np.asarray(model.mat_rgba[material], dtype=np.float64)


TORSO = 0.32  # height in m of the torso of a robot whose scene has size 1: the NAO's
LONGEST_FRAME = 0.1  # simulated s that one frame makes up for at most: a slower computer shows it more slowly
HURRY = 0.25  # s that a robot that stands is stepped between two frames: nobody wants to wait until it walks
LYING = 2.0  # s that a robot lies where it fell before it gets up again

LATEST = ("severity", "drift", "temperature", "scale", "offset", "payload", "slope", "speed", "pace")
"""What is asked for many times while a slider is drawn: only the last counts."""


class Page(Served):
    """A session in the browser, on an empty page.

    Recordings go into the folder, ``None`` for none. ``frames`` says how many were drawn.
    """

    def __init__(self, server: viser.ViserServer, session: Session, *, folder: Path | None = None) -> None:
        self.session, self._folder = session, folder
        size = float(session.source.data.body(session.drawing.torso).xpos[2]) / TORSO
        weight = session.drawing.weight
        super().__init__(server, layout=session.layout, weight=weight, size=size)
        self._paused, self._pace, self._due, self._lies = False, 1.0, 0.0, 0.0
        self.frames, self._simulated, self._rate = 0, 0.0, (0.0, 0.0)
        self._counted = perf_counter(), 0, 0.0
        self._robot = RobotMeshes(self.server, session.source.model)
        self._cell = size
        self._panel = Panel(self.server, session, self._ask, bool(folder))
        self._paint(str(session.settings["method"]))

    def draw(self) -> None:
        """Draw the session as it is now."""
        now, source = self.session.state_to_draw(), self.session.source
        torso = source.data.body(self.session.drawing.torso).xpos
        origin = np.array([torso[0], torso[1], 0.0])
        with self.server.atomic():
            self._robot.move(source.data, origin)
            # The grid repeats itself: so it lies still under a robot that stays in the middle.
            self._ground.position = *-np.fmod(origin[:2], self._cell), self._ground.position[2]
            self._board.draw(now)
            self._meters.draw(now, self._line(), self._told)
        self.frames += 1
        passed = perf_counter() - self._counted[0]
        if passed > 1.0:
            _, frames, simulated = self._counted
            self._rate = (self.frames - frames) / passed, (self._simulated - simulated) / passed
            self._counted = perf_counter(), self.frames, self._simulated

    def _line(self) -> str:
        session = self.session
        states = {"fallen": session.fell, "paused": self._paused, "stands": session.standing, "runs": True}
        state = next(word for word, holds in states.items() if holds)
        rate, real = self._rate
        return f"{state} at {session.time:.1f} s, {rate:.0f} frames a second, {real:.2f} of real time"

    def _advance(self, passed: float) -> None:
        """Step as far as time has gone on."""
        session = self.session
        if session.over:
            self._lies += passed
            if not session.fell or self._lies > LYING:
                self._ask("reset", None)
            return
        if self._paused:
            return
        if session.standing:
            end = perf_counter() + HURRY
            while session.standing and perf_counter() < end:
                self._step()
            return
        self._due = min(self._due + self._pace * passed, LONGEST_FRAME)
        while self._due >= session.dt and not session.over:
            self._step()
            self._due -= session.dt

    def _step(self) -> None:
        session = self.session
        session.step()
        self._simulated += session.dt
        if session.record_is_full:
            self._save()

    def _waiting(self) -> list[tuple[str, Any]]:
        """Requests of browsers since the last frame, of each slider the last value alone."""
        asked: list[tuple[str, Any]] = []
        for what, value in super()._waiting():
            if what in LATEST:
                same = what in ("scale", "offset")
                asked = [one for one in asked if one[0] != what or (same and one[1][0] != value[0])]
            asked.append((what, value))
        return asked

    def _do(self, what: str, value: Any) -> str:
        """Do one thing, and return the broken channels."""
        session = self.session
        match what:
            case "pause":
                self._paused = bool(value)
            case "step":
                if not session.over:
                    self._step()
            case "pace":
                self._pace = min(max(float(value), 0.1), 1.0)
            case "record":
                self._record()
            case "power_up":
                self._save()
                session.power_up(int(value))
                self._fresh()
                self._panel.show_settings()
            case "reset":
                self._save()
                session.change("reset")
                self._fresh()
            case _:
                session.change(what, value)
                if what == "method":
                    self._paint(str(session.settings["method"]))
        return f"Broken: {'; '.join(session.errors.faults)}" if session.errors.faults else ""

    def _fresh(self) -> None:
        self._lies = self._due = 0.0
        self._forget()

    def _record(self) -> None:
        if self._folder is None:
            raise ValueError("There is no folder for recordings; give one with --record FOLDER.")
        if self.session.recording is not None:
            self._save()
        else:
            self.session.record()
            self._panel.show_recording(True)

    def _save(self) -> None:
        """Write the recording, if there is one, into the folder that the command was given."""
        if self.session.recording is None or self._folder is None:
            return
        self._panel.show_recording(False)
        log = self.session.stop_recording()
        task = self.session.env_id.rpartition("/")[2].lower()
        number = 1
        while (path := self._folder / f"{task}-seed{self.session.seed}-{number}.parquet").exists():
            number += 1
        write_log(log, path)
        self._panel.show_recording(False, commands(path))


def commands(path: Path) -> Sequence[str]:
    """Return the commands that make something of a recording."""
    return f"surefoot calibrate walk {path}", f"surefoot view --log {path}"
