"""Operators and encoding: what is left of a region, and what becomes of the other pixels."""

from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageOps, JpegImagePlugin

from mirror.dataset.images.decoding import decode_rgb
from mirror.dataset.images.metadata import list_metadata
from mirror.errors import DatasetError, UsageError
from mirror.privacy.encoding import apply_orientation, redact_encoded, redact_frame, to_stored, turn_upright
from mirror.privacy.operators import Redaction, redact
from mirror.privacy.regions import covered_share, grown_box, merged, region_at, region_mask
from tests.draws import draws
from tests.privacy.images import jpeg, pixels

boxes = st.lists(st.integers(0, 20), min_size=4, max_size=4).map(
    lambda v: (min(v[0], v[2]), min(v[1], v[3]), max(v[0], v[2]) + 1, max(v[1], v[3]) + 1)
)


@given(box=boxes, others=st.lists(boxes, max_size=5))
@settings(max_examples=draws(60), deadline=None)
def test_coverage_is_that_of_counted_pixels(box: tuple[int, ...], others: list[tuple[int, ...]]) -> None:
    mask = np.zeros((21, 21), bool)
    for left, top, right, bottom in others:
        mask[top:bottom, left:right] = True
    left, top, right, bottom = box
    assert covered_share(box, others) == pytest.approx(mask[top:bottom, left:right].mean())


def test_a_region_grows_by_its_share_and_stays_in_the_raster() -> None:
    assert grown_box(region_at((10, 10, 30, 20), "plate"), 0.3, 100, 100) == (7, 8, 33, 22)
    assert grown_box(region_at((90, 90, 130, 130), "face"), 0.2, 100, 100) == (86, 86, 100, 100)
    assert grown_box(region_at((200, 10, 210, 20), "face"), 0.2, 100, 100) is None
    assert region_mask([region_at((200, 10, 210, 20), "face")], 0.2, 100, 100).sum() == 0


def test_several_detectors_are_joined() -> None:
    one, same = region_at((0, 0, 10, 10), "face", score=0.9), region_at((1, 1, 9, 9), "face", score=0.5)
    other, plate = region_at((5, 0, 15, 10), "face", score=0.4), region_at((1, 1, 9, 9), "plate", score=0.3)
    assert merged([same, plate, other, one]) == [one, other, plate]


@pytest.mark.parametrize("kind", ["face", "plate"])
def test_what_is_left_depends_on_the_means_of_at_most_sixteen_cells(kind: str) -> None:
    image = pixels(64, 64)
    region = region_at((16, 16, 48, 48), kind)
    how = Redaction(grow=0.5, feather_px=0)
    left, top, right, bottom = grown_box(region, how.grow, 64, 64) or ()
    cells = 4 if kind == "face" else 1
    shuffled = image.copy()
    rng = np.random.default_rng(1)
    size = (right - left) // cells
    for row in range(cells):
        for column in range(cells):
            part = shuffled[top + row * size :, left + column * size :][:size, :size]
            part[...] = rng.permutation(part.reshape(-1, 3)).reshape(part.shape)
    assert not np.array_equal(image, shuffled)
    assert np.array_equal(redact(image, [region], how)[0], redact(shuffled, [region], how)[0])
    inside = redact(image, [region], how)[0][top:bottom, left:right]
    assert len(np.unique(inside.reshape(-1, 3), axis=0)) == 1 if kind == "plate" else True


def test_the_transition_lies_outside() -> None:
    image = pixels(64, 64)
    region, how = region_at((20, 20, 40, 40), "plate"), Redaction(grow=0.2, feather_px=4)
    result, mask = redact(image, [region], how)
    left, top, right, bottom = grown_box(region, 0.2, 64, 64) or ()
    assert np.ptp(result[top:bottom, left:right].reshape(-1, 3), axis=0).tolist() == [0, 0, 0]
    assert mask[top - 4 : bottom + 4, left - 4 : right + 4].all()
    assert np.array_equal(result[~mask], image[~mask])
    assert mask.sum() == (bottom - top + 8) * (right - left + 8)


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (64, 64)])
@pytest.mark.parametrize("values", [0, 255, None])
def test_flat_saturated_and_tiny_images(size: tuple[int, int], values: int | None) -> None:
    image = pixels(*size) if values is None else np.full((*size, 3), values, np.uint8)
    result, mask = redact(image, [region_at((-5, -5, 200, 200), kind) for kind in ("face", "plate")], Redaction())
    assert mask.all() and result.shape == image.shape
    if values is not None:
        assert np.array_equal(result, image)


@pytest.mark.parametrize(
    "options", [{"plate": "cells"}, {"face": "blur"}, {"grow": 0.05}, {"grow": float("nan")}, {"levels": 1}]
)
def test_weak_operators_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(UsageError):
        Redaction(**options)


@pytest.mark.parametrize("options", [{}, {"subsampling": 2}, {"subsampling": 0, "quality": 75}, {"quality": 97}])
def test_a_jpeg_is_encoded_with_the_tables_of_its_source(options: dict[str, object]) -> None:
    data = jpeg(pixels(192, 256), exif=True, thumbnail=True, **options)
    done = redact_encoded(data, "jpeg", [region_at((60, 50, 90, 70), "face")], Redaction(), "x.jpg")
    source, result = Image.open(io.BytesIO(data)), Image.open(io.BytesIO(done.data))
    assert result.quantization == source.quantization
    assert JpegImagePlugin.get_sampling(result) == JpegImagePlugin.get_sampling(source)
    assert list_metadata(done.data, "x.jpg") == []
    before, after = (decode_rgb(one, "jpeg").astype(np.float64) for one in (data, done.data))
    # Blocks of the mask hold replaced pixels too: 16 px with subsampled chroma.
    far = ~(cv2.dilate(done.mask.astype(np.uint8), np.ones((33, 33), np.uint8)) > 0)
    psnr = 10.0 * np.log10(255.0**2 / np.mean((before[~done.mask] - after[~done.mask]) ** 2))
    assert psnr >= 42.0
    assert 10.0 * np.log10(255.0**2 / max(np.mean((before[far] - after[far]) ** 2), 1e-9)) >= psnr


def test_a_png_and_a_grey_jpeg_keep_their_other_pixels() -> None:
    image = pixels()
    encoded = cv2.imencode(".png", image[..., ::-1])[1].tobytes()
    done = redact_encoded(encoded, "png", [region_at((10, 10, 30, 30), "plate")], Redaction(), "x.png")
    assert np.array_equal(decode_rgb(done.data, "png")[~done.mask], image[~done.mask])
    grey = cv2.imencode(".jpg", image[..., 0])[1].tobytes()
    done = redact_encoded(grey, "jpeg", [region_at((10, 10, 30, 30), "plate")], Redaction(), "x.jpg")
    assert Image.open(io.BytesIO(done.data)).mode == "L"


def test_an_image_without_regions_keeps_its_scan_and_a_frame_becomes_a_jpeg() -> None:
    data = jpeg(pixels(), gps=True)
    done = redact_encoded(data, "jpeg", [], Redaction(), "x.jpg")
    assert done.mask is None and np.array_equal(decode_rgb(done.data, "jpeg"), decode_rgb(data, "jpeg"))
    frame = redact_frame(pixels(), [region_at((10, 10, 30, 30), "plate")], Redaction(), "x.mp4")
    assert decode_rgb(frame.data, "jpeg").shape == pixels().shape and frame.mask is not None


@pytest.mark.parametrize(("data", "codec"), [(b"", "jpeg"), (jpeg(pixels())[:200], "jpeg"), (jpeg(pixels()), "png")])
def test_an_unreadable_image_is_a_named_error(data: bytes, codec: str) -> None:
    with pytest.raises(DatasetError, match="name"):
        redact_encoded(data, codec, [region_at((0, 0, 9, 9), "face")], Redaction(), "name")


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_agrees_with_pillow_and_regions_follow(orientation: int) -> None:
    stored = pixels(48, 80)
    data = jpeg(stored, orientation=orientation, quality=95, subsampling=0)
    upright = np.asarray(ImageOps.exif_transpose(Image.open(io.BytesIO(data))))
    decoded = decode_rgb(data, "jpeg")
    assert np.array_equal(turn_upright(decoded, orientation), upright)
    height, width = upright.shape[:2]
    region = region_at((3, 5, 13, 25), "face")
    mark = np.zeros((height, width), np.uint8)
    mark[5:25, 3:13] = 1
    left, top, right, bottom = map(int, to_stored(region, orientation, 80, 48).box_px)
    stored_mark = np.zeros((48, 80), np.uint8)
    stored_mark[top:bottom, left:right] = 1
    assert np.array_equal(turn_upright(stored_mark, orientation), mark)
    once = apply_orientation(data, "jpeg", "x.jpg")
    assert list_metadata(once, "x.jpg") == []
    assert np.abs(decode_rgb(once, "jpeg").astype(int) - upright).max() <= 12
