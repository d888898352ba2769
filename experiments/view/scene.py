"""An empty page: its server, its ground and its camera."""

import errno
import socket
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import viser

from surefoot.experiments.view.board import PLACE

FRAMES_PER_SECOND = 30
"""How often everything is drawn."""


def open_server(host: str, port: int, label: str) -> viser.ViserServer:
    """Return a server of an empty page.

    Raises:
        OSError: If the port is in use, or there is no such host.
    """
    # The library would take the next free port without a word.
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
    with redirect_stdout(StringIO()):  # A frame with addresses, which the command tells in a line.
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    # A page must not open a tunnel to the world, though the library's pages can ask for one.
    server.request_share_url = lambda verbose=True: None
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop serving; browsers see that nobody answers."""
    with redirect_stdout(StringIO()):
        server.stop()


def when_changed(handle: Any, tell: Callable[[Any], None]) -> None:
    """Tell a control's value when a browser, and not this program, has changed it."""

    def changed(event: Any) -> None:
        if event.client_id is not None:
            tell(handle.value)

    handle.on_update(changed)


def set_scene(server: viser.ViserServer, size: float, aside: float = 1.0) -> Any:
    """Set the ground, the light and the camera, behind the robot; return the ground.

    Args:
        server: The page.
        size: Length in m by which all is scaled.
        aside: 1 has the robot and its feet in view, 0 the feet alone.
    """
    # The panel covers the right of the page.
    x, y, z = (1.3 - 0.4 * aside) * PLACE
    server.initial_camera.position = size * (x - 1.05), size * y, size * (z + 1.2)
    server.initial_camera.look_at = size * (x + 0.1), size * y, size * (z + 0.1)
    server.initial_camera.up = (0.0, 0.0, 1.0)
    return server.scene.add_grid(
        "/ground",
        infinite_grid=True,
        cell_size=0.25 * size,
        section_size=size,
        cell_color=(222, 222, 222),
        section_color=(190, 190, 190),
        fade_distance=12.0 * size,
        plane_color=(246, 248, 250),
        plane_opacity=1.0,
    )
