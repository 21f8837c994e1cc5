"""One encoded image in, one without its regions and metadata out.

An image without regions keeps its entropy-coded data byte by byte. One with regions is decoded to the colour space that
it is stored in, and encoded with the quantisation tables and the subsampling of the source, so that its other pixels
change by rounding only.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, Final, Literal

import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.dataset.images.metadata import read_orientation, strip_metadata
from mirror.errors import DatasetError
from mirror.installation import install_command
from mirror.privacy.operators import Redaction, redact
from mirror.privacy.regions import Region

Codec = Literal["jpeg", "png"]
_MODES: Final = {"jpeg": ("L", "YCbCr"), "png": ("L", "RGB", "RGBA", "P", "LA")}
_QUALITY: Final = 95


@dataclass(frozen=True, eq=False)
class RedactedImage:
    """The result for one image.

    Attributes:
        data: encoded bytes without metadata.
        mask: (H, W) pixels that were replaced; None: the image has no regions, and its scan data is that of the source.
    """

    data: bytes
    mask: Bool | None


def redact_encoded(data: bytes, codec: Codec, regions: Sequence[Region], how: Redaction, file: str) -> RedactedImage:
    """Remove regions and metadata from an encoded image, without turning its stored raster.

    An EXIF orientation is removed and not applied, as calibrations refer to the stored raster: `turn_upright` and
    `to_stored` map images and regions between the two.

    Args:
        data: a JPEG or PNG.
        codec: which of them.
        regions: regions in the stored raster.
        how: operators and margins.
        file: for messages.

    Raises:
        DatasetError: the image cannot be decoded, or has a colour space that is not supported.
    """
    if not regions:
        return RedactedImage(strip_metadata(data, file), None)
    image = _open(data, codec, file)
    pixels, mask = redact(_pixels(image), regions, how)
    buffer = io.BytesIO()
    if codec == "png":
        _image(pixels, image.mode).save(buffer, "PNG")
    else:
        options = {"qtables": image.quantization, "subsampling": _subsampling(image), "optimize": True}
        _image(pixels, image.mode).save(buffer, "JPEG", **options)
    return RedactedImage(strip_metadata(buffer.getvalue(), file), mask)


def redact_frame(pixels: UInt8, regions: Sequence[Region], how: Redaction, file: str) -> RedactedImage:
    """Remove regions from a decoded frame of a video, and encode it as a JPEG of quality 95.

    Args:
        pixels: (H, W, 3), RGB.
        regions: regions in its raster.
        how: operators and margins.
        file: for messages.
    """
    changed, mask = redact(pixels, regions, how)
    buffer = io.BytesIO()
    _image(changed, "RGB").save(buffer, "JPEG", quality=_QUALITY, subsampling=0, optimize=True)
    return RedactedImage(strip_metadata(buffer.getvalue(), file), mask if regions else None)


def apply_orientation(data: bytes, codec: Codec, file: str) -> bytes:
    """Turn the raster of an image by its EXIF orientation and remove the tag, to prevent a second turn.

    For images outside of a dataset, whose raster no calibration refers to. An image that stands upright is returned
    without metadata and with its scan data untouched.

    Raises:
        DatasetError: the image cannot be decoded.
    """
    orientation = read_orientation(data) if codec == "jpeg" else 1
    if orientation == 1:
        return strip_metadata(data, file)
    image = _open(data, codec, file)
    buffer = io.BytesIO()
    turned = _image(turn_upright(_pixels(image), orientation), image.mode)
    # Subsampled chroma is turned with the image: 4:2:2 is no longer horizontal then.
    turned.save(buffer, "JPEG", qtables=image.quantization, subsampling=_subsampling(image), optimize=True)
    return strip_metadata(buffer.getvalue(), file)


def turn_upright(pixels: UInt8, orientation: int) -> UInt8:
    """Turn a stored raster (H, W, ...) upright by its EXIF orientation, 1 to 8."""
    turned = pixels.swapaxes(0, 1) if orientation >= 5 else pixels
    vertical, horizontal = orientation in (3, 4, 7, 8), orientation in (2, 3, 6, 7)
    return np.ascontiguousarray(turned[:: -1 if vertical else 1, :: -1 if horizontal else 1])


def to_stored(region: Region, orientation: int, width_px: int, height_px: int) -> Region:
    """Map a region of an upright image to the stored raster.

    Args:
        region: region in the upright image.
        orientation: EXIF orientation of the stored image, 1 to 8.
        width_px: width of the stored raster.
        height_px: height of the stored raster.
    """
    left, top, right, bottom = region.box_px
    upright = (height_px, width_px) if orientation >= 5 else (width_px, height_px)
    if orientation in (2, 3, 6, 7):
        left, right = upright[0] - right, upright[0] - left
    if orientation in (3, 4, 7, 8):
        top, bottom = upright[1] - bottom, upright[1] - top
    box = (top, left, bottom, right) if orientation >= 5 else (left, top, right, bottom)
    return region.moved_to(box, region.origin)


def _open(data: bytes, codec: Codec, file: str | PurePath) -> Any:
    try:
        from PIL import Image
    except ImportError as error:
        raise DatasetError("Pillow is not installed", file=file, remedy=install_command("privacy")) from error
    try:
        image = Image.open(io.BytesIO(data), formats=[codec.upper()])
        if codec == "jpeg" and image.mode == "RGB":
            # Without a conversion of colours, what is not redacted keeps its values.
            image.draft("YCbCr", image.size)
        image.load()
    except (OSError, SyntaxError, ValueError) as error:
        raise DatasetError(
            f"the image cannot be decoded: {error}", file=file, expected=f"a complete {codec}", remedy="drop the image"
        ) from error
    if image.mode not in _MODES[codec]:
        raise DatasetError(
            f"colour space {image.mode} of a {codec}", file=file, expected=" or ".join(_MODES[codec]),
            remedy="convert the image in the recording to RGB or grey",
        )  # fmt: skip
    return image.convert("RGB") if image.mode == "P" else image


def _pixels(image: Any) -> UInt8:
    return np.asarray(image, np.uint8)


def _image(pixels: UInt8, mode: str) -> Any:
    from PIL import Image

    height, width = pixels.shape[:2]
    return Image.frombytes(mode, (width, height), np.ascontiguousarray(pixels).tobytes())


def _subsampling(image: Any) -> int:
    from PIL import JpegImagePlugin

    found = JpegImagePlugin.get_sampling(image)
    # -1: grey, or factors that have no name; chroma is then stored at full resolution.
    return found if found in (0, 1, 2) else 0
