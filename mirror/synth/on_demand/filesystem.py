"""An fsspec file system of images on demand: reading a file renders it."""

from __future__ import annotations

import io
import threading
from collections import OrderedDict
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

from fsspec import AbstractFileSystem

from mirror.errors import UsageError
from mirror.synth.on_demand.png import TAIL, encode_stored_png, stored_png_length
from mirror.synth.on_demand.uri import SCHEME, ImageName, parse_image_name

if TYPE_CHECKING:
    from mirror.synth.fleet.drive import SynthDrive
    from mirror.synth.render.scene import Instant

_DRIVES_HELD: Final = 3
_INSTANTS_HELD: Final = 2


class SynthFileSystem(AbstractFileSystem):
    """A read-only file system, which knows the size and last bytes of an image without rendering it."""

    protocol = SCHEME
    root_marker = ""

    @classmethod
    def _strip_protocol(cls, path: str) -> str:
        return str(path).removeprefix(f"{SCHEME}://").rstrip("/")

    def info(self, path: str, **kwargs: Any) -> dict[str, Any]:
        """Return the name, size and type of an image.

        Raises:
            DatasetError: the name is malformed, or belongs to another version of the street.
            FileNotFoundError: the drive or the camera does not exist.
        """
        name = self._strip_protocol(path)
        return {"name": name, "size": _length(parse_image_name(name)), "type": "file"}

    def ls(self, path: str, detail: bool = True, **kwargs: Any) -> list[Any]:
        """List the image itself, as there are no folders."""
        info = self.info(path)
        return [info if detail else info["name"]]

    def cat_file(self, path: str, start: int | None = None, end: int | None = None, **kwargs: Any) -> bytes:
        """Return a range of the bytes of an image, rendered unless the range lies in the constant end of the file.

        Raises:
            DatasetError: the name is malformed, or belongs to another version of the street.
            FileNotFoundError: the drive or the camera does not exist, or the time is outside the drive.
        """
        name = parse_image_name(self._strip_protocol(path))
        length = _length(name)
        first, last, _ = slice(start, end).indices(length)
        before = length - len(TAIL)
        if first >= before:
            return TAIL[first - before : max(last, first) - before]
        return _drive(name.preset, name.seed, name.drive_id).encode(name)[first:last]

    def _open(self, path: str, mode: str = "rb", **kwargs: Any) -> io.BytesIO:
        if mode != "rb":
            raise UsageError(f"mode {mode!r}", file=path, expected="rb: images on demand are read only")
        return io.BytesIO(self.cat_file(path))


class _OpenDrive:
    """Renders images of one drive for several threads."""

    def __init__(self, drive: SynthDrive) -> None:
        self.drive = drive
        self._instants: OrderedDict[int, Instant] = OrderedDict()
        self._lock = threading.Lock()

    def encode(self, name: ImageName) -> bytes:
        # One thread builds the scene and the instant, which all cameras share. All threads render in parallel.
        with self._lock:
            drive = self.drive
            seconds = 1e-9 * (name.true_ns - drive.condition.start_ns)
            if not 0.0 <= seconds <= drive.truth.duration_s:
                raise FileNotFoundError(f"{name.uri()}: {seconds:.3f} s after the drive's start")
            if name.true_ns not in self._instants:
                self._instants[name.true_ns] = drive.at(name.true_ns)
                if len(self._instants) > _INSTANTS_HELD:
                    self._instants.popitem(last=False)
            instant = self._instants[name.true_ns]
            drive.prepare()
        return encode_stored_png(drive.render(name.camera, name.true_ns, instant).bgr)


_OPENING = threading.Lock()


def _drive(preset: str, seed: int, drive_id: str) -> _OpenDrive:
    with _OPENING:
        return _open_drive(preset, seed, drive_id)


@lru_cache(_DRIVES_HELD)
def _open_drive(preset: str, seed: int, drive_id: str) -> _OpenDrive:
    return _OpenDrive(_make_drive(preset, seed, drive_id))


def _make_drive(preset: str, seed: int, drive_id: str) -> SynthDrive:
    from mirror.synth.fleet.drives import make_drive

    try:
        return make_drive(preset, seed, drive_id)
    except UsageError as error:
        raise FileNotFoundError(str(error)) from error


# Sizes are requested of many drives; a cache of their own keeps the open drives in memory.
@lru_cache(4096)
def _raster(preset: str, seed: int, drive_id: str) -> dict[str, tuple[int, int]]:
    cameras = _make_drive(preset, seed, drive_id).vehicle.cameras
    return {name: (camera.width_px, camera.height_px) for name, camera in cameras.items()}


def _length(name: ImageName) -> int:
    rasters = _raster(name.preset, name.seed, name.drive_id)
    if name.camera not in rasters:
        raise FileNotFoundError(f"{name.uri()}: no camera {name.camera!r}")
    return stored_png_length(*rasters[name.camera])
