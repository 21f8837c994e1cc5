"""Files of per-pixel ground truth: the kinds, and the encoding of each.

Masks and normals are PNGs, which any viewer shows; distances and flow are float32 arrays in ``.npz`` archives.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from mirror.arrays import AnyArray, Float32
from mirror.errors import RecordingError

Kind = Literal["depth", "normals", "semantic", "instance", "flow"]

# Compression level 1 is four times as fast as level 6; its files are a tenth larger.
_LEVEL: Final = 1
_STEPS: Final = 32767.0


@dataclass(frozen=True)
class Encoding:
    """The file encoding of one kind of truth.

    Attributes:
        suffix: suffix of the files.
        encode: encodes an array as the bytes of a file.
        decode: decodes the bytes of a file; returns None for a broken file.
    """

    suffix: str
    encode: Callable[[AnyArray], bytes]
    decode: Callable[[bytes], AnyArray | None]


def _archive_encoding(name: str) -> Encoding:
    def encode(values: AnyArray) -> bytes:
        array, archive = io.BytesIO(), io.BytesIO()
        np.save(array, np.ascontiguousarray(values, np.float32), allow_pickle=False)
        # The entry has a fixed date, so equal arrays give equal files.
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=_LEVEL) as file:
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_DEFLATED
            file.writestr(entry, array.getvalue(), compresslevel=_LEVEL)
        return archive.getvalue()

    def decode(data: bytes) -> AnyArray | None:
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as file:
                return np.asarray(file[name])
        except (ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    return Encoding(".npz", encode, decode)


def _encode_png(data: AnyArray) -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", data)[1])


def _png_decoder(kind: type[np.uint8] | type[np.uint16], channels: int) -> Callable[[bytes], AnyArray | None]:
    def decode(data: bytes) -> AnyArray | None:
        import cv2

        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
        if image is None or image.dtype != kind or image.ndim != (2 if channels == 1 else 3):
            return None
        return np.asarray(image)

    return decode


def _encode_normals(normals: AnyArray) -> bytes:
    steps = np.where(np.isfinite(normals), np.round((normals + 1.0) * _STEPS), 0.0).astype(np.uint16)
    return _encode_png(steps[..., ::-1])


def _decode_normals(data: bytes) -> Float32 | None:
    steps = _png_decoder(np.uint16, 3)(data)
    if steps is None:
        return None
    normals = steps[..., ::-1].astype(np.float32) / np.float32(_STEPS) - 1
    normals[(steps == 0).all(axis=2)] = np.nan
    return normals


KINDS: Final[Mapping[Kind, Encoding]] = {
    "depth": _archive_encoding("distance_m"),
    "normals": Encoding(".png", _encode_normals, _decode_normals),
    "semantic": Encoding(".png", lambda labels: _encode_png(labels.astype(np.uint8)), _png_decoder(np.uint8, 1)),
    "instance": Encoding(".png", lambda objects: _encode_png(objects.astype(np.uint16)), _png_decoder(np.uint16, 1)),
    "flow": _archive_encoding("flow_px"),
}
"""The encoding of each kind of truth.

- ``depth``: (H, W) metres along the ray through the pixel centre, infinite for the sky.
- ``normals``: (H, W, 3) unit vectors in the camera frame, NaN for the sky; the file holds 32767 (n + 1), and 0 0 0 for
  the sky.
- ``semantic``: (H, W) values of `mirror.synth.model.Label`.
- ``instance``: (H, W) k for the k-th of the objects in ``truth.json``, counted from 1; 0 without a road user.
- ``flow``: (H, W, 2) pixels right and down to the same static point in the camera's next image; NaN where that image
  does not show the point.
"""


def truth_file(folder: Path, kind: Kind, camera: str, timestamp_ns: int) -> Path:
    """Return the path of the truth of one image within a folder ``truth``."""
    return folder / kind / camera / f"{timestamp_ns}{KINDS[kind].suffix}"


def read_truth_image(folder: Path, kind: Kind, camera: str, timestamp_ns: int) -> AnyArray:
    """Read the truth of one image; `KINDS` describes the arrays.

    Raises:
        RecordingError: the file is missing or broken.
    """
    file = truth_file(folder, kind, camera, timestamp_ns)
    expected = f"the {kind} of an image that `mirror synth --truth {kind}` has written"
    try:
        data = file.read_bytes()
    except FileNotFoundError as error:
        raise RecordingError("missing", file=file, expected=expected) from error
    values = KINDS[kind].decode(data)
    if values is None:
        raise RecordingError("broken", file=file, expected=expected, remedy="write the recordings again")
    return values
