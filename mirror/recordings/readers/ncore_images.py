"""Encoded images and masks of NCore's stores, which are read only where no codec has to decode them.

This module imports the package ``nvidia-ncore``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from ncore.data.v4 import CameraSensorComponent, MasksComponent

from mirror.arrays import UInt8
from mirror.recordings.raster import is_decodable

_FORMATS: Final = {"jpeg": "jpeg", "jpg": "jpeg", "png": "png"}
_EGO: Final = "ego"


class ImageReader(CameraSensorComponent.Reader):
    """A reader of a camera's component that also returns the images' bytes as they are stored."""

    def image_format(self, end_us: int) -> str:
        """Return ``jpeg`` or ``png``.

        Raises:
            ValueError: another format.
        """
        return _format(self._get_frame_group(end_us)["image"])

    def image(self, end_us: int, store: Path) -> bytes:
        """Return the bytes of the frame that ends at a stamp."""
        return _stored_bytes(self._get_frame_group(end_us)["image"], store)


class MaskReader(MasksComponent.Reader):
    """A reader of the masks of cameras, and of the mask ``ego`` of the vehicle itself."""

    def ego_mask(self, camera: str, store: Path) -> UInt8 | None:
        """Return the mask ``ego`` (H, W) of a camera, or None.

        Raises:
            ValueError: its bytes make no image.
        """
        if camera not in self._group["cameras"] or _EGO not in self.get_camera_mask_names(camera):
            return None
        data = _stored_bytes(self._group["cameras"][camera][_EGO], store)
        mask = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if is_decodable(data) else None
        if mask is None:
            raise ValueError(f"the mask {_EGO} of {camera} cannot be decoded")
        return mask  # type: ignore[return-value]


def _format(array: Any) -> str:
    name = str(array.attrs["format"]).lower()
    if name not in _FORMATS:
        raise ValueError(f"images of the format {name!r:.80}, not jpeg or png")
    return _FORMATS[name]


def _stored_bytes(array: Any, store: Path) -> bytes:
    """The bytes of an array that holds one encoded image."""
    plain = array.dtype.kind == "S" and array.shape == () and array.compressor is None and not array.filters
    if not plain:
        raise ValueError(f"an image of type {array.dtype} in the shape {array.shape}, or with a codec")
    size = store.stat().st_size if store.is_file() else None
    if array.dtype.itemsize > (size if size is not None else 1 << 28):
        raise ValueError(f"an image of {array.dtype.itemsize} bytes, more than the store has")
    return bytes(array[()])
