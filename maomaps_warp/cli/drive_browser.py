"""Driving a robot in a browser: what it sees, the map so far, buttons and keys."""

from __future__ import annotations

import time
from contextlib import redirect_stdout
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np

from maomaps_warp.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from maomaps_warp.jobs.drive import Drive, Glance, Key

#: Size of the live view, pixels.
PICTURE_SIZE = (320, 240)
#: Keys of the browser by what they mean to the robot.
_KEYS: dict[Key, tuple[str, ...]] = {
    "forward": ("W", "arrowup"),
    "back": ("S", "arrowdown"),
    "left": ("A", "arrowleft"),
    "right": ("D", "arrowright"),
    "stop": ("space",),
}
#: Where the map is looked at from, in the camera's frame, metres: behind the robot and above it.
_BEHIND = np.array([0.0, -1.6, -2.4])


class BrowserView:
    """The page, kept up to date.

    Attributes:
        commands: what each key does.

    Args:
        drive: what it shows and steers.
        port: of the page, on this machine alone.

    Raises:
        InputError: viser is not installed.
    """

    def __init__(self, drive: Drive, port: int) -> None:
        try:
            import viser
        except ImportError:
            raise InputError(
                "--drive browser", "viser is not installed", "pip install 'maomaps-warp[browser]'"
            ) from None
        self.drive = drive
        self.commands: dict[str, Callable[[], None]] = {}
        with redirect_stdout(StringIO()):  # its greeting
            self.server = viser.ViserServer(host="127.0.0.1", port=port, label="maomaps-warp", verbose=False)
        self.server.gui.configure_theme(control_width="large")
        self.server.scene.set_up_direction("+z")
        black = np.zeros((*PICTURE_SIZE[::-1], 3), dtype=np.uint8)
        self.picture = self.server.gui.add_image(black, label="What the robot sees")
        self.status = self.server.gui.add_markdown("")
        self.button = self.server.gui.add_button("Start recording (R)", color="red")
        self.button.on_click(lambda _: drive.record())
        self._command("Start or stop recording", "R", drive.record)
        for key, hotkeys in _KEYS.items():
            pressed = self._pressed(key)
            for hotkey in hotkeys:
                self._command(f"Robot: {key} ({hotkey})", hotkey, pressed)
        arrows = self.server.gui.add_button_group("Drive", ("left", "forward", "back", "right", "stop"))
        arrows.on_click(lambda _: drive.press(arrows.value))
        self.leave = self.server.gui.add_button("Leave")
        self.leave.on_click(lambda _: drive.leave())
        self.follow = self.server.gui.add_checkbox("View follows the robot", True)
        self.robot = self.server.scene.add_camera_frustum(
            "/robot", fov=2.0 * np.arctan(0.5 * drive.camera.height / drive.camera.fy), aspect=4.0 / 3.0, scale=0.4
        )

    @property
    def address(self) -> str:
        """Of the page."""
        return f"http://localhost:{self.server.get_port()}"

    def show(self, glance: Glance) -> None:
        """Bring the page up to date."""
        from scipy.spatial.transform import Rotation

        colors = glance.seen.colors
        assert colors is not None
        T = glance.T_world_camera
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        place = self.drive.robot.place
        with self.server.atomic():
            self.picture.image = colors
            self.robot.image = colors
            self.robot.wxyz, self.robot.position = (w, x, y, z), T[:3, 3]
            self.status.content = (
                f"**{glance.state}** {glance.seconds:.1f} s, at ({place[0]:.2f}, {place[1]:.2f}) m\n\n"
                "W A S D or arrows drive, space stops (click the map first)."
            )
            self.button.label = "Stop and save (R)" if glance.state == "recording" else "Start recording (R)"
            if glance.map is not None:
                self.server.scene.add_point_cloud(
                    "/map",
                    glance.map.points.astype(np.float32),
                    glance.map.colors if glance.map.colors is not None else (128, 128, 128),
                    point_size=glance.map.grid.voxel_size,
                )
        if self.follow.value:
            for client in self.server.get_clients().values():
                client.camera.position = T[:3, 3] + T[:3, :3] @ _BEHIND
                client.camera.look_at = T[:3, 3] + T[:3, 2]

    def close(self) -> None:
        """End the page."""
        with redirect_stdout(StringIO()):
            self.server.stop()

    def _command(self, label: str, hotkey: Any, then: Callable[[], None]) -> None:
        self.commands[hotkey] = then
        self.server.gui.add_command(label, hotkey=hotkey).on_trigger(lambda _: then())

    def _pressed(self, key: Key) -> Callable[[], None]:
        return lambda: self.drive.press(key)


def drive_in_browser(drive: Drive, view: BrowserView) -> None:
    """Let the user drive until the run is done or left."""
    due = time.monotonic()
    while drive.state in ("waiting", "recording"):
        view.show(drive.step(with_map=True))
        due = max(due + drive.step_s, time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
