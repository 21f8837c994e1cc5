"""A reconstructed street in the browser (viser): drive along a traversal or fly, with any appearance.

The image in the browser is rendered here, on the CPU: small while something moves, and in full resolution when nothing
has moved for `_STILL_S`.
"""

from __future__ import annotations

import io
import threading
import time
from contextlib import redirect_stdout
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import Float64, UInt8
from mirror.errors import MirrorError, UsageError
from mirror.geometry.poses import Poses
from mirror.installation import install_command
from mirror.methods.interactive import InteractiveRenderer
from mirror.protocols.views.view import RenderView
from mirror.view.street_path import StreetPath, blend, by_light, recorded_pixels
from mirror.view.viewer_guard import ViewerGuard, guarded_sockets

if TYPE_CHECKING:
    import viser

MOVING_PX: Final = 270
"""Height of images while something moves."""

STILL_PX: Final = 720
"""Largest height of images when nothing moves."""

_STILL_S: Final = 0.4
_RECORDED_PX: Final = 480
_FRUSTUMS: Final = 60
_FAR_M: Final = 10.0
_BESIDE_M: Final = 6.0
_SHOWN_S: Final = 10.0


@dataclass(frozen=True)
class ViewerOptions:
    """Settings of the viewer of a street.

    Attributes:
        host: address that the server listens on.
        port: port; 0: a free one.
        still_px: largest height of images when nothing moves.
    """

    host: str = "127.0.0.1"
    port: int = 8080
    still_px: int = STILL_PX


class StreetViewer:
    """A server of a street, until it is closed.

    Args:
        renderer: renders the street.
        path: the recorded images that the slider of time moves along.
        options: see `ViewerOptions`.

    Raises:
        UsageError: viser is not installed, or the port is in use.
    """

    def __init__(self, renderer: InteractiveRenderer, path: StreetPath, options: ViewerOptions) -> None:
        try:
            import viser
        except ImportError as error:
            raise UsageError("the viewer needs viser", remedy=install_command("view")) from error
        self._renderer, self._path, self._options = renderer, path, options
        self._appearances = by_light(renderer.appearances)
        self._changed = threading.Condition()
        self._version, self._moved_at, self._closed = 0, time.monotonic(), False
        self._frames: list[float] = []
        self._track: list[dict[str, object]] = []
        self._shown: UInt8 | None = None
        self._told: dict[int, str] = {}
        self._guard = ViewerGuard(options.host)
        # The addresses of its banner lack the token.
        with redirect_stdout(io.StringIO()), guarded_sockets(self._guard):
            self.server = viser.ViserServer(host=options.host, port=options.port, label="MIRROR street", verbose=False)
        self._make_controls()
        self._add_frustums()
        self.server.on_client_connect(self._connected)
        self._thread = threading.Thread(target=self._render_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """The address of the page, with the token that is required to open it."""
        return self._guard.url(self.server.get_host(), self.server.get_port())

    @property
    def rendered(self) -> int:
        """The number of images that were rendered."""
        return len(self._frames)

    def wait(self) -> None:
        """Wait until the server is closed, or the process is interrupted."""
        while not self._closed:
            time.sleep(0.2)

    def close(self) -> None:
        """Stop the server."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(timeout=10.0)
        with redirect_stdout(io.StringIO()):
            self.server.stop()

    def _make_controls(self) -> None:
        gui, path = self.server.gui, self._path
        last = len(path.images) - 1
        self.time = gui.add_slider("time", 0, max(last, 1), 1, 0, hint=f"image of {path.camera} on {path.traversal_id}")
        self.left = gui.add_slider("shift left (m)", -_BESIDE_M, _BESIDE_M, 0.1, 0.0, hint="beside the driven line")
        top = max(len(self._appearances) - 1, 1)
        names = tuple((float(place), item.light) for place, item in enumerate(self._appearances))
        self.appearance = gui.add_slider("appearance", 0.0, float(top), 0.05, self._first_appearance(), marks=names)
        self.named: Any = gui.add_text("from day to night", "", disabled=True)
        self.cameras = gui.add_checkbox("training cameras", initial_value=False)
        self.beside = gui.add_checkbox("recorded image", initial_value=True)
        self.recorded = gui.add_image(recorded_pixels(path.images[0], _RECORDED_PX), label="recorded", format="jpeg")
        screenshot = gui.add_button("screenshot")
        mark = gui.add_button("add this place to the path")
        save = gui.add_button("save the path")
        self.status: Any = gui.add_text("status", "", disabled=True)
        self.time.on_update(lambda _: self._drive())
        self.left.on_update(lambda _: self._drive())
        self.appearance.on_update(lambda _: self._touch())
        self.cameras.on_update(lambda _: self._show_cameras())
        self.beside.on_update(lambda _: self._show_recorded())
        screenshot.on_click(self._save_screenshot)
        mark.on_click(self._add_place)
        save.on_click(self._save_path)

    def _first_appearance(self) -> float:
        names = [item.traversal_id for item in self._appearances]
        return float(names.index(self._path.traversal_id)) if self._path.traversal_id in names else 0.0

    def _add_frustums(self) -> None:
        """Add the cameras of the path, hidden."""
        view = self._path.view(0, 480, MOVING_PX)
        field = 2.0 * float(np.arctan(0.5 * view.height_px / view.fy_px))
        step = max(1, len(self._path.images) // _FRUSTUMS)
        self._frustums = [
            self.server.scene.add_camera_frustum(
                f"/cameras/{number}", fov=field, aspect=16 / 9, scale=0.5, color=(240, 120, 20), visible=False,
                wxyz=self._path.world_SE3_camera[number].rotation[0],
                position=self._path.world_SE3_camera[number].translation[0],
            )
            for number in range(0, len(self._path.images), step)
        ]  # fmt: skip

    def _show_cameras(self) -> None:
        for frustum in self._frustums:
            frustum.visible = self.cameras.value

    def _show_recorded(self) -> None:
        self.recorded.visible = self.beside.value
        if self.beside.value:
            self.recorded.image = recorded_pixels(self._path.images[self._number], _RECORDED_PX)

    def _connected(self, client: viser.ClientHandle) -> None:
        client.camera.on_update(lambda _: self._touch())
        self._place(client)

    def _drive(self) -> None:
        """Move all clients to the place of the sliders."""
        for client in self.server.get_clients().values():
            self._place(client)
        self._show_recorded()
        self._touch()

    @property
    def _number(self) -> int:
        """The image of the slider of time. A page can send values beyond the ends of a slider."""
        return int(np.clip(self.time.value, 0, len(self._path.images) - 1))

    @property
    def _left_m(self) -> float:
        return float(np.clip(self.left.value, -_BESIDE_M, _BESIDE_M))

    def _place(self, client: viser.ClientHandle) -> None:
        view = self._path.view(self._number, 480, MOVING_PX, left_m=self._left_m)
        matrix = view.pose.matrix()[0]
        with client.atomic():
            client.camera.up_direction = (0.0, 0.0, 1.0)
            client.camera.position = matrix[:3, 3]
            client.camera.look_at = matrix[:3, 3] + _FAR_M * matrix[:3, 2]
            client.camera.fov = 2.0 * float(np.arctan(0.5 * view.height_px / view.fy_px))

    def _touch(self) -> None:
        with self._changed:
            self._version += 1
            self._moved_at = time.monotonic()
            self._changed.notify()

    def _render_forever(self) -> None:
        """Render the newest state; in full resolution once nothing has moved for a while."""
        rendered, is_full = -1, False
        while True:
            with self._changed:
                while not self._closed and self._version == rendered:
                    still = time.monotonic() - self._moved_at
                    if not is_full and still >= _STILL_S:
                        break
                    self._changed.wait(timeout=None if is_full else _STILL_S - still)
                if self._closed:
                    return
                version, full = self._version, self._version == rendered
            clients = list(self.server.get_clients().values())
            for client in clients:
                try:
                    self._render_client(client, full=full)
                except (MirrorError, ValueError, ArithmeticError) as error:
                    self._tell(client, f"nothing can be rendered from this place: {error}")
            rendered, is_full = version, full or not clients

    def _render_client(self, client: viser.ClientHandle, *, full: bool) -> None:
        start = time.perf_counter()
        view = self._client_view(client.camera, full=full)
        weights = blend(self._appearances, float(self.appearance.value))
        self._shown = self._renderer.render(view, weights, moving=not full)
        client.scene.set_background_image(self._shown, format="jpeg", jpeg_quality=90 if full else 75)
        taken = time.perf_counter() - start
        if not full:
            self._frames.append(taken)
        self.named.value = ", ".join(f"{weight:.0%} {self._words(name)}" for name, weight in weights.items())
        self.status.value = f"{view.width_px} x {view.height_px}, {1e3 * taken:.0f} ms"

    def _tell(self, client: viser.ClientHandle, problem: str) -> None:
        """Show a problem in the page that has it, once in a row."""
        if self._told.get(client.client_id) != problem:
            self._told[client.client_id] = problem
            client.add_notification("street", problem, color="orange", auto_close_seconds=_SHOWN_S)

    def _words(self, traversal_id: str) -> str:
        item = next(item for item in self._appearances if item.traversal_id == traversal_id)
        return f"{item.light}, {item.weather}"

    def _client_view(self, camera: Any, *, full: bool) -> RenderView:
        """The view of a client's camera, whose field of view is vertical."""
        height = min(int(camera.image_height), self._options.still_px) if full else MOVING_PX
        height = max(height, 16)
        width = max(16, round(height * float(camera.aspect)))
        focal = 0.5 * height / float(np.tan(0.5 * camera.fov))
        pose = Poses(np.asarray(camera.wxyz, np.float64)[None], np.asarray(camera.position, np.float64)[None])
        image = self._path.images[self._number]
        return self._path.make_view(pose, focal, width, height, image.timestamp_ns)

    def _save_screenshot(self, event: Any) -> None:
        import cv2

        if event.client is not None and self._shown is not None:
            data = cv2.imencode(".png", self._shown[..., ::-1])[1].tobytes()
            event.client.send_file_download("screenshot.png", data)

    def _add_place(self, event: Any) -> None:
        if event.client is None:
            return
        camera = event.client.camera
        self._track.append(
            {
                "wxyz": [float(value) for value in camera.wxyz],
                "position_m": [float(value) for value in camera.position],
                "fov_rad": float(camera.fov),
                "appearance": blend(self._appearances, float(self.appearance.value)),
            }
        )
        self.status.value = f"{len(self._track)} places in the path"

    def _save_path(self, event: Any) -> None:
        import json

        if event.client is not None:
            event.client.send_file_download("path.json", json.dumps(self._track, indent=1).encode())


def measure_moves(renderer: InteractiveRenderer, path: StreetPath, moves: int) -> Float64:
    """Measure the seconds that moves of 0.5 m along a path take at 480 x 270, with decoding.

    The seconds (moves, 2) are those that pass, and those of all threads.

    The first ten moves are not counted: they compile kernels.
    """
    weights = blend(by_light(renderer.appearances), 0.0)
    start = path.view(0, 480, MOVING_PX)
    forward = start.pose.matrix()[0, :3, 2] * (1.0, 1.0, 0.0)
    forward /= np.linalg.norm(forward)
    taken = []
    for number in range(moves + 10):
        # Back and forth over 10 m, so that no end of the street is reached.
        along = 0.5 * min(number % 40, 40 - number % 40)
        pose = Poses(start.pose.rotation, start.pose.translation + along * forward)
        view = path.make_view(pose, start.fy_px, 480, MOVING_PX, start.timestamp_ns)
        begun = time.perf_counter(), time.process_time()
        renderer.render(view, weights, moving=True)
        taken.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
    return np.array(taken[10:])
