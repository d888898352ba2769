"""The scene: the ground, the camera, and the common part of controls."""

from collections.abc import Callable
from typing import Any

import viser

from surefoot.experiments.view.server import show_from, view_of

FRAMES_PER_SECOND = 30  # how often everything is drawn


def when_changed(handle: Any, tell: Callable[[Any], None]) -> None:
    """Tell a control's value when a browser, and not this program, has changed it."""

    def on_change(event: Any) -> None:
        if event.client_id is not None:
            tell(handle.value)

    handle.on_update(on_change)


def set_scene(server: viser.ViserServer, size: float, aside: float = 1.0) -> Any:
    """Set the ground and the camera, behind the robot, as :func:`view_of`; return the ground."""
    show_from(server, size, aside)

    def aim(client: viser.ClientHandle) -> None:
        camera = client.camera
        narrow = camera.image_width < camera.image_height
        camera.up_direction = (0.0, 0.0, 1.0)
        camera.position, camera.look_at = view_of(size, aside, narrow)

    # Of clients that came before there was anything to see, too.
    server.on_client_connect(aim)
    return server.scene.add_grid(
        "/ground",
        # A little lower than soles on it, of which it would cover half.
        position=(0.0, 0.0, -0.004 * size),
        infinite_grid=True,
        cell_size=0.25 * size,
        section_size=size,
        cell_color=(222, 222, 222),
        section_color=(190, 190, 190),
        fade_distance=12.0 * size,
        plane_color=(246, 248, 250),
        plane_opacity=1.0,
    )
