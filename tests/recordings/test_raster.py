"""Structure of encoded images; ingest, decoding and `mirror check` share one rule for end markers."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.dataset.images.decoding import decode_rgb
from mirror.errors import RecordingError
from mirror.recordings.raster import TAIL_BYTES, has_end_marker, read_raster_size, require_complete_image

PIXELS = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
IMAGES = {"jpeg": cv2.imencode(".jpg", PIXELS)[1].tobytes(), "png": cv2.imencode(".png", PIXELS)[1].tobytes()}
MARKER_BYTES = {"jpeg": 2, "png": 8}


@pytest.mark.parametrize("codec", ["jpeg", "png"])
def test_padding_is_accepted_up_to_the_tail(codec: str) -> None:
    room = TAIL_BYTES - MARKER_BYTES[codec]
    for padding in (0, 1, 2000, room):
        data = IMAGES[codec] + bytes(padding)
        assert has_end_marker(data, codec) and has_end_marker(data[-TAIL_BYTES:], codec)
        require_complete_image(data, "p")
        assert decode_rgb(data, codec) is not None
    data = IMAGES[codec] + bytes(room + 1)
    assert not has_end_marker(data, codec) and decode_rgb(data, codec) is None
    with pytest.raises(RecordingError, match="no end marker"):
        require_complete_image(data, "p")


@pytest.mark.parametrize("codec", ["jpeg", "png"])
def test_truncated_image_is_refused_by_every_check(codec: str) -> None:
    data = IMAGES[codec][:-3]
    assert not has_end_marker(data, codec) and decode_rgb(data, codec) is None
    with pytest.raises(RecordingError, match="truncated"):
        require_complete_image(data, "p")


def test_other_codecs_have_no_marker() -> None:
    assert has_end_marker(b"", "video")
    assert not has_end_marker(b"", "png")
    with pytest.raises(RecordingError, match="neither a JPEG nor a PNG"):
        require_complete_image(b"", "p")


def test_every_byte_of_the_structure_counts() -> None:
    """Every lost or changed byte of a JPEG's markers and a PNG's chunks is detected."""
    for codec, data in IMAGES.items():
        assert (
            require_complete_image(data, "p")
            == (32, 24)
            == read_raster_size(data[:200] if codec == "png" else data, "p")
        )
        for length in range(len(data)):
            with pytest.raises(RecordingError):
                require_complete_image(data[:length], "p")
    data = IMAGES["png"]
    for position in range(len(data)):
        with pytest.raises(RecordingError):
            require_complete_image(data[:position] + bytes([data[position] ^ 1]) + data[position + 1 :], "p")


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize(
    "options",
    [
        [],
        [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
        [cv2.IMWRITE_JPEG_RST_INTERVAL, 1],
        [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444],
        [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
    ],
)
def test_images_of_encoders_are_complete(suffix: str, options: list[int]) -> None:
    for pixels in (PIXELS, PIXELS[..., 0], np.zeros((70, 90, 3), np.uint8)):
        data = cv2.imencode(suffix, pixels, options if suffix == ".jpg" else [])[1].tobytes()
        assert require_complete_image(data, "p") == pixels.shape[1::-1]


@pytest.mark.parametrize("quality", [50, 95])
def test_images_of_pillow_are_complete(quality: int) -> None:
    """Another encoder, with EXIF, a profile, a comment, grey, 16 bits and a palette."""
    import io

    from PIL import Image

    colour, grey = Image.fromarray(PIXELS), Image.fromarray(PIXELS[..., 0])
    exif = Image.Exif()
    exif[0x010E] = "x" * 20_000
    written: list[tuple[Image.Image, dict[str, object]]] = [
        (colour, {"format": "JPEG", "exif": exif, "icc_profile": bytes(100_000), "comment": "c" * 300}),
        (grey, {"format": "JPEG", "quality": quality, "progressive": True}),
        (colour.convert("CMYK"), {"format": "JPEG"}),
        (colour.quantize(16), {"format": "PNG"}),
        (grey.convert("I;16"), {"format": "PNG"}),
        (colour.convert("RGBA"), {"format": "PNG"}),
    ]
    for made, options in written:
        sink = io.BytesIO()
        made.save(sink, **options)
        assert require_complete_image(sink.getvalue(), "p") == (32, 24)


def test_foreign_bytes_in_the_image_data_are_detected() -> None:
    data = cv2.imencode(".jpg", np.random.default_rng(1).integers(0, 255, (240, 320, 3), np.uint8))[1].tobytes()
    garbage = np.random.default_rng(2).bytes(4096)
    with pytest.raises(RecordingError, match="broken JPEG"):
        require_complete_image(data[:9000] + garbage + data[9000 + 4096 :], "p")


@pytest.mark.real_data
def test_photos_of_real_cameras_are_complete(real_data: Path) -> None:
    photos = [file for suffix in ("jpg", "png") for file in sorted(real_data.rglob(f"*.{suffix}"))]
    assert len(photos) > 40
    for file in photos:
        height, width = cv2.imread(str(file), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION).shape[:2]
        assert require_complete_image(file.read_bytes(), file) == (width, height)


def png_chunk(kind: bytes, data: bytes, *, checksum: int | None = None) -> bytes:
    """A chunk as the PNG specification (ISO/IEC 15948) defines it; its checksum is right unless stated."""
    right = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", right if checksum is None else checksum)


@pytest.mark.parametrize(("width", "height"), [(0, 24), (32, 0), (2**31, 24), (32, 2**31)])
def test_png_without_pixels_or_beyond_the_format_is_refused(width: int, height: int) -> None:
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    data = IMAGES["png"][:8] + header + IMAGES["png"][8 + len(header) :]
    with pytest.raises(RecordingError, match=f"a PNG of {width} x {height} px"):
        require_complete_image(data, "p")


@pytest.mark.parametrize(("kind", "critical"), [(b"PRVT", True), (b"PrVT", True), (b"prVT", False), (b"pRVT", False)])
def test_checksums_of_critical_png_chunks_count(kind: bytes, critical: bool) -> None:
    """The case of a chunk name's first letter alone states whether the chunk is critical."""
    header_end = 8 + 25
    before, after = IMAGES["png"][:header_end], IMAGES["png"][header_end:]
    assert require_complete_image(before + png_chunk(kind, b"data") + after, "p") == (32, 24)
    broken = before + png_chunk(kind, b"data", checksum=0) + after
    if critical:
        with pytest.raises(RecordingError, match=f"checksum of chunk {kind.decode()}"):
            require_complete_image(broken, "p")
    else:
        assert require_complete_image(broken, "p") == (32, 24)


@pytest.mark.parametrize(("width", "height"), [(2**31 - 1, 24), (32, 2**31 - 1)])
def test_the_largest_png_of_the_format_has_a_size(width: int, height: int) -> None:
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    data = IMAGES["png"][:8] + header + IMAGES["png"][8 + len(header) :]
    assert require_complete_image(data, "p") == (width, height)
