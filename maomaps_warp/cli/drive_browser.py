"""Driving a robot in a browser: what it sees, the map so far, buttons and keys."""

from __future__ import annotations

import errno
import socket
import time
from contextlib import redirect_stdout, suppress
from io import StringIO
from typing import TYPE_CHECKING, Any

import numpy as np

from maomaps_warp.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from maomaps_warp.jobs.drive import Drive, Glance, Key

#: Width of the live view, pixels.
_WIDTH = 320
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
#: Nearer to there than this nothing is shown, metres: no wall hides the robot. And where the view is free.
_NEAR_M, _NEAR_FREE_M = 2.5, 0.01


def picture_size(aspect: float) -> tuple[int, int]:
    """Columns and rows of the live view.

    Args:
        aspect: width over height.
    """
    return _WIDTH, max(1, round(_WIDTH / aspect))


class BrowserView:
    """The page, kept up to date.

    Attributes:
        commands: what each key does.

    Args:
        drive: what it shows and steers.
        port: of the page, on this machine alone.

    Raises:
        InputError: viser is not installed, or the port is not allowed.
    """

    def __init__(self, drive: Drive, port: int) -> None:
        try:
            import viser
        except ImportError:
            raise InputError(
                "--drive browser", "viser is not installed", "pip install 'maomaps-warp[browser]'"
            ) from None
        _check_port(port)
        self.drive = drive
        self.commands: dict[str, Callable[[], None]] = {}
        with redirect_stdout(StringIO()):  # its greeting
            self.server = viser.ViserServer(host="127.0.0.1", port=port, label="maomaps-warp", verbose=False)
        self.server.gui.configure_theme(control_width="large")
        self.server.scene.set_up_direction("+z")
        black = np.zeros((drive.camera.height, drive.camera.width, 3), dtype=np.uint8)
        self.picture = self.server.gui.add_image(black, label="What the robot sees")
        self.status = self.server.gui.add_markdown("")
        self.button = self.server.gui.add_button("Start recording (R)", color="red")
        self.button.on_click(lambda _: drive.toggle())
        self._command("Start or stop recording", "R", drive.toggle)
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
            "/robot",
            fov=2.0 * np.arctan(0.5 * drive.camera.height / drive.camera.fy),
            aspect=(drive.camera.width / drive.camera.fx) / (drive.camera.height / drive.camera.fy),
            scale=0.4,
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
                "W A S D or arrows drive, space stops (click the map first). "
                "Where the view does not follow the robot, the same keys move both."
            )
            self.button.label = "Stop and save (R)" if glance.state == "recording" else "Start recording (R)"
            if glance.map is not None:
                self.server.scene.add_point_cloud(
                    "/map",
                    glance.map.points.astype(np.float32),
                    glance.map.colors if glance.map.colors is not None else (128, 128, 128),
                    point_size=glance.map.grid.voxel_size,
                )
        for client in self.server.get_clients().values():
            with client.atomic():
                client.camera.near = _NEAR_M if self.follow.value else _NEAR_FREE_M
                if self.follow.value:
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
    """Let the user drive until the run is done or left; Ctrl-C leaves."""
    with suppress(KeyboardInterrupt):
        due = time.monotonic()
        while drive.state in ("waiting", "recording"):
            view.show(drive.step(with_map=True))
            due = max(due + drive.step_s, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
    drive.leave()


def _check_port(port: int) -> None:
    """Refuse what the server would hang on. A port that is taken is none: it takes the next."""
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise InputError(
                    f"--port {port}", f"cannot be used: {error.strerror}", "choose one above 1023"
                ) from None
