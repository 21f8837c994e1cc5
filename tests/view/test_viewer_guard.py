"""Who can reach the viewers: foreign pages, other names, missing tokens and hostile messages, sent by real clients."""

from __future__ import annotations

import http.client
import math
import shutil
import socket
import sysconfig
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from mirror.errors import UsageError
from mirror.view.client_messages import find_problem
from mirror.view.rerun_program import open_viewer
from mirror.view.street_path import StreetPath, read_path
from tests.builders.street import make_street
from tests.view.flat import DAY, Flat

viser = pytest.importorskip("viser", reason="the extra view is not installed")
msgspec = pytest.importorskip("msgspec")
client = pytest.importorskip("websockets.sync.client")

from websockets.exceptions import ConnectionClosedError, InvalidStatus  # noqa: E402

from mirror.view.street_viewer import StreetViewer, ViewerOptions  # noqa: E402

CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage", "wxyz": [1.0, 0.0, 0.0, 0.0], "position": [0.0, 0.0, 2.0], "fov": 0.9, "near": 0.01,
    "far": 1000.0, "image_height": 270, "image_width": 480, "look_at": [0.0, 0.0, 5.0], "up_direction": [0.0, 0.0, 1.0],
}  # fmt: skip
HOSTILE: list[dict[str, Any]] = [
    *({**CAMERA, "fov": fov} for fov in (0.0, -1.0, math.nan, math.inf, 3.5, "0.9", None)),
    *({**CAMERA, "wxyz": wxyz} for wxyz in ([0.0] * 4, [math.nan] * 4, [1.0, 0.0, 0.0], [1.0] * 5, "1234", 1)),
    *({**CAMERA, "position": place} for place in ([1e300, 0.0, 0.0], [0.0, 0.0], [math.nan] * 3, [None] * 3)),
    *({**CAMERA, "image_height": size} for size in (0, -5, 10**9, math.nan, True)),
    {**CAMERA, "image_width": 16_000, "image_height": 1},
    {key: value for key, value in CAMERA.items() if key != "look_at"},
    {"type": "ShareUrlRequest"},
    {"type": "FileTransferStartUpload", "source_component_uuid": "x", "transfer_uuid": "x", "filename": "x",
     "mime_type": "x", "part_count": 1, "size_bytes": 1 << 60},
]  # fmt: skip


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> StreetPath:
    return read_path(make_street(tmp_path_factory.mktemp("guarded") / "dataset", ("front_wide",)), DAY)


@pytest.fixture
def renderer() -> Flat:
    return Flat()


@pytest.fixture
def viewer(path: StreetPath, renderer: Flat) -> Iterator[StreetViewer]:
    opened = StreetViewer(renderer, path, ViewerOptions(port=0))
    yield opened
    opened.close()


def port_of(viewer: StreetViewer) -> int:
    return int(viewer.server.get_port())


def get(viewer: StreetViewer, path: str, **headers: str) -> tuple[int, dict[str, str]]:
    """Status and headers of a plain request; ``Host`` may be another one."""
    connection = http.client.HTTPConnection("127.0.0.1", port_of(viewer), timeout=10.0)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    answer.read()
    return answer.status, {name.lower(): value for name, value in answer.getheaders()}


def cookie_of(viewer: StreetViewer) -> str:
    status, headers = get(viewer, viewer.url.partition(str(port_of(viewer)))[2])
    assert status == 303 and headers["location"] == "/"
    assert {"HttpOnly", "SameSite=Strict"} <= set(headers["set-cookie"].split("; "))
    return headers["set-cookie"].split(";")[0]


def connect(viewer: StreetViewer, *, origin: str | None = "own", cookie: str | None = "own", host: str = "") -> Any:
    port = port_of(viewer)
    own = f"http://127.0.0.1:{port}"
    given = {"Cookie": cookie_of(viewer) if cookie == "own" else cookie}
    reached = socket.create_connection(("127.0.0.1", port), timeout=10.0)
    reached.settimeout(None)
    return client.connect(
        f"ws://{host or '127.0.0.1'}:{port}/",
        origin=own if origin == "own" else origin,
        additional_headers={name: value for name, value in given.items() if value is not None},
        subprotocols=[f"viser-v{viser.__version__}"],
        sock=reached,
        max_size=None,
    )


def send(connection: Any, message: object) -> None:
    connection.send(msgspec.msgpack.encode(message))


def wait_for(what: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize(
    "asked",
    [
        {"origin": "http://evil.example"},
        {"origin": "http://127.0.0.1:1"},
        {"origin": "null"},
        {"origin": None},
        {"cookie": None},
        {"cookie": "mirror_view=1; mirror_view_80=2"},
        {"host": "evil.example", "origin": "http://evil.example"},
    ],
    ids=str,
)
def test_other_pages_get_no_socket(viewer: StreetViewer, renderer: Flat, asked: dict[str, str | None]) -> None:
    host = asked.get("host")
    if host is not None:
        # A name that an attacker lets point to this machine (DNS rebinding).
        asked = {**asked, "origin": f"http://{host}:{port_of(viewer)}"}
    with pytest.raises(InvalidStatus) as caught:
        connect(viewer, **asked)  # type: ignore[arg-type]
    assert caught.value.response.status_code == 403
    assert not renderer.views


def test_the_page_itself_is_served_with_the_token_only(viewer: StreetViewer) -> None:
    assert get(viewer, "/")[0] == 403
    assert get(viewer, "/?token=")[0] == 403
    assert get(viewer, f"/?token={'x' * 32}")[0] == 403
    assert get(viewer, "/", Cookie=f"{cookie_of(viewer)}x")[0] == 403
    assert get(viewer, "/", Cookie="=;;")[0] == 403
    assert get(viewer, "/", Cookie=cookie_of(viewer))[0] == 200
    assert get(viewer, "/", Cookie=cookie_of(viewer), Host="evil.example")[0] == 403
    assert get(viewer, "/", Cookie=cookie_of(viewer), Host=f"localhost:{port_of(viewer)}")[0] == 200
    assert get(viewer, "/", Cookie=cookie_of(viewer), Host="localhost:x")[0] == 403


def test_two_viewers_have_two_tokens(viewer: StreetViewer, path: StreetPath) -> None:
    other = StreetViewer(Flat(), path, ViewerOptions(port=0))
    try:
        assert viewer.url.rpartition("=")[2] != other.url.rpartition("=")[2]
        with pytest.raises(InvalidStatus):
            connect(other, cookie=cookie_of(viewer))
    finally:
        other.close()


def test_the_viewer_listens_on_this_machine_alone(viewer: StreetViewer) -> None:
    # An address of this machine that only a server on all interfaces answers.
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", port_of(viewer)), timeout=5.0)


def test_the_own_page_gets_images(viewer: StreetViewer, renderer: Flat) -> None:
    with connect(viewer) as page:
        send(page, CAMERA)
        wait_for(lambda: bool(renderer.views))
    assert renderer.views[-1][0].width_px == 480


def test_hostile_messages_stay_with_their_page(viewer: StreetViewer, renderer: Flat) -> None:
    controls = [{"uuid": handle._impl.uuid, "updates": updates} for handle, updates in (
        (viewer.time, {"value": math.nan}), (viewer.time, {"value": -1e9}), (viewer.time, {"value": 1e30}),
        (viewer.time, {"value": [1, 2]}), (viewer.time, {"update_cb": 3}), (viewer.left, {"value": math.inf}),
        (viewer.time, {"value": -7}), (viewer.time, {"value": 1000}), (viewer.left, {"value": 900.0}),
        (viewer.appearance, {"value": -900.0}), (viewer.appearance, {"value": "x"}), (viewer.time, 3),
    )]  # fmt: skip
    with connect(viewer) as page, connect(viewer) as hostile:
        send(page, CAMERA)
        wait_for(lambda: bool(renderer.views))
        send(hostile, CAMERA)
        for message in [*HOSTILE, *({"type": "GuiUpdateMessage", **control} for control in controls)]:
            send(hostile, message)
        for data in (b"", b"\xc1", b"x" * 1000, msgspec.msgpack.encode([1]), msgspec.msgpack.encode({"type": 3})):
            with pytest.raises(ConnectionClosedError) as caught, connect(viewer) as broken:
                broken.send(data)
                while True:
                    broken.recv(timeout=10.0)
            assert caught.value.rcvd is not None and caught.value.rcvd.code == 1008
        with pytest.raises(ConnectionClosedError), connect(viewer) as large:
            large.send(b"\0" * (2 << 20))
            while True:
                large.recv(timeout=10.0)
        before = len(renderer.views)
        send(page, {**CAMERA, "position": [1.0, 2.0, 3.0]})
        wait_for(lambda: any(view.pose.translation[0, 2] == 3.0 for view, _ in renderer.views[before:]))
    for view, _ in renderer.views:
        assert 0 < view.width_px <= 7200 and 0.0 < view.fy_px < 1e5


def test_a_place_that_cannot_be_rendered_is_told_to_its_page(path: StreetPath) -> None:
    class Fragile(Flat):
        def render(self, view: Any, weights: Any, *, moving: bool) -> Any:
            if view.pose.translation[0, 0] > 100.0:
                raise ValueError("nothing here")
            return super().render(view, weights, moving=moving)

    renderer = Fragile()
    viewer = StreetViewer(renderer, path, ViewerOptions(port=0))
    try:
        with connect(viewer) as page, connect(viewer) as far:
            # The viewer places a new page at the start of the path.
            send(far, CAMERA)
            wait_for(lambda: bool(renderer.views))
            send(far, {**CAMERA, "position": [500.0, 0.0, 0.0]})
            data = b""
            while b"nothing here" not in data:
                data = unpacked(far.recv(timeout=20.0))
            before = len(renderer.views)
            send(page, CAMERA)
            wait_for(lambda: len(renderer.views) > before)
    finally:
        viewer.close()


def unpacked(message: bytes) -> bytes:
    """The messages of one packet of viser: two lengths, then zstd."""
    import zstandard

    length = int.from_bytes(message[8:16], "little")
    return zstandard.ZstdDecompressor().decompress(message[16 : 16 + length])


def test_valid_messages_pass() -> None:
    for message in (
        CAMERA,
        {**CAMERA, "fov": 1, "image_width": 480.0},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": True}},
        {"type": "GuiUpdateMessage", "uuid": "a", "updates": {"value": 0.5}},
        {"type": "FileTransferPartAck", "source_component_uuid": None, "transfer_uuid": "a", "transferred_bytes": 1,
         "total_bytes": 2},
    ):  # fmt: skip
        assert find_problem(msgspec.msgpack.encode(message)) is None
    for message in HOSTILE:
        assert find_problem(msgspec.msgpack.encode(message)) is not None
    nested: list[Any] = []
    for _ in range(400):
        nested = [nested]
    assert find_problem(b"\x91" * 100_000) is not None
    assert find_problem("text") is not None


def test_rerun_listens_on_this_machine_alone() -> None:
    if shutil.which("rerun", path=sysconfig.get_path("scripts")) is None:
        pytest.skip("the program rerun is not installed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    # Without a display the program still serves what is logged.
    program = open_viewer(port, ["--serve-grpc"])
    try:
        socket.create_connection(("127.0.0.1", port), timeout=5.0).close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port), timeout=5.0)
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5.0)
        asked = {"Origin": "http://evil.example", "Access-Control-Request-Method": "POST"}
        connection.request("OPTIONS", "/", headers=asked)
        assert connection.getresponse().getheader("access-control-allow-origin") is None
    finally:
        program.terminate()
        program.wait(10.0)


def test_rerun_that_ends_at_once_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    if shutil.which("rerun", path=sysconfig.get_path("scripts")) is None:
        pytest.skip("the program rerun is not installed")
    with pytest.raises(UsageError, match="does not open") as caught:
        open_viewer(1, ["--no-such-option"])
    assert "--save" in str(caught.value)
