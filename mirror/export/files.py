"""Placing of images and other files in an export: hard links where possible, else copies; never opened for writing."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import cv2

from mirror.arrays import UInt8
from mirror.dataset.images.metadata import states_orientation, strip_metadata
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.export.scene import ExportImage
from mirror.schema.files import write_bytes

_JPEG_QUALITY: Final = 95


def place_image(store: Store, item: ExportImage, target: Path, *, copy: bool) -> None:
    """Place an image in an export; an earlier call's file is kept only if its bytes are the dataset's.

    The bytes are those of the dataset where the format allows it. An image that states an orientation is copied without
    its metadata: calibrations refer to the stored raster, and other tools would turn it. A frame of a video becomes a
    PNG file; an undistorted JPEG file is encoded again with quality 95, so that the names in all tables stay the same.

    Args:
        store: the dataset's files.
        item: the image.
        target: file to write; PNG if it ends in ``.png``, whatever the recorded codec.
        copy: never make a hard link.

    Raises:
        DatasetError: the image cannot be read, or the file cannot be written.
    """
    may_link = _keeps_bytes(item, target.suffix) and not copy
    if may_link and not states_orientation(item.image.read()) and _link(store, item, target):
        return
    data = image_bytes(item, target.suffix)
    if not (target.is_file() and target.read_bytes() == data):
        write_bytes(target, data)


def image_bytes(item: ExportImage, suffix: str) -> bytes:
    """Return the encoded image of an export: the dataset's bytes, or a new encoding; see `place_image`."""
    image = item.image
    if _keeps_bytes(item, suffix):
        data = image.read()
        return strip_metadata(data, image.uri) if states_orientation(data) else data
    return encode_image(item.raster.image(image.decode()) if item.is_resampled else image.decode(), suffix)


def _keeps_bytes(item: ExportImage, suffix: str) -> bool:
    encoded = item.image.codec in ("jpeg", "png") and item.image.video_pts is None
    return encoded and not item.is_resampled and suffix == item.suffix


def encode_image(pixels: UInt8, suffix: str) -> bytes:
    """Encode pixels (H, W, 3) RGB or (H, W) grey as ``.jpg`` (quality 95) or ``.png``."""
    ordered = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    done, data = cv2.imencode(suffix, ordered, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if suffix == ".jpg" else [])
    if not done:
        raise DatasetError("the image cannot be encoded", expected="pixels (H, W, 3) or (H, W)")
    return data.tobytes()


def _link(store: Store, item: ExportImage, target: Path) -> bool:
    """Link to an image that is a whole local file; returns whether that was possible."""
    image = item.image
    if store.folder is None or "://" in image.uri or image.uri.startswith("/") or image.byte_offset != 0:
        return False

    def make(source: Path) -> bool:
        if source.stat().st_size != image.byte_length:
            return False
        if target.is_file() and target.samefile(source):
            return True
        temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary.unlink(missing_ok=True)
            os.link(source, temporary)
            temporary.replace(target)
        except FileNotFoundError:
            raise
        except OSError:
            return False
        finally:
            # Renaming a link to another link of the same file leaves both.
            temporary.unlink(missing_ok=True)
        return True

    try:
        return store.read_stable(image.uri, make)
    except FileNotFoundError:
        # `Image.read` raises the error that names camera and time.
        return False
