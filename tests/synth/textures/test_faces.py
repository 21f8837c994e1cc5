"""Tests of faces: reproducible, distinct, and found by a face detector."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.synth.textures.catalogue import FACES
from mirror.synth.textures.faces import HEAD_ASPECT, draw_features, face_image


def test_faces_are_reproducible() -> None:
    for number in (FACES.start, FACES.stop - 1):
        one = face_image(number)
        assert one.shape == (128, 128, 3)
        assert one.dtype == np.float32
        assert one.tobytes() == face_image(number).tobytes()
        assert 0.0 <= one.min() < one.max() <= 1.0


def test_all_faces_differ() -> None:
    small = np.array([face_image(number, 32) for number in FACES]).reshape(len(FACES), -1)
    apart = np.abs(small[:, None] - small[None]).mean(axis=2)
    assert apart[~np.eye(len(FACES), dtype=bool)].min() > 0.005


def test_small_face_images_match_reduced_large_ones() -> None:
    large, small = face_image(FACES[9], 256), face_image(FACES[9], 64)
    reduced = large.reshape(64, 4, 64, 4, 3).mean(axis=(1, 3))
    assert np.sqrt(((reduced - small) ** 2).mean()) < 0.03


def test_unknown_images_and_small_sizes_are_refused() -> None:
    for number in (FACES.start - 1, FACES.stop):
        with pytest.raises(UsageError, match="156 to 187"):
            draw_features(number)
    with pytest.raises(UsageError, match="16"):
        face_image(FACES.start, 8)


@pytest.mark.parametrize("size_px", [30, 60])
def test_face_detector_finds_the_faces(real_data: Path, size_px: int) -> None:
    cv2 = pytest.importorskip("cv2")
    edge = 4 * size_px // 32 * 32 + 32
    weights = str(real_data / "weights" / "yunet" / "yunet_n_dynamic.onnx")
    detector = cv2.FaceDetectorYN.create(weights, "", (edge, edge), 0.6)
    count = 0
    for number in FACES:
        face = cv2.resize(
            face_image(number), (round(size_px * HEAD_ASPECT), size_px), interpolation=cv2.INTER_AREA
        )  # fmt: skip
        high, wide = face.shape[:2]
        x, y = (np.arange(wide) + 0.5) / wide * 2 - 1, (np.arange(high) + 0.5) / high * 2 - 1
        skull = (x[None, :] ** 2 + y[:, None] ** 2 < 1.0)[..., None]
        image = np.full((edge, edge, 3), 0.3, np.float32)
        top, left = (edge - high) // 2, (edge - wide) // 2
        body = slice(top + high - high // 6, None), slice(max(left - wide // 2, 0), left + wide + wide // 2)
        image[body] = 0.08
        part = image[top : top + high, left : left + wide]
        part[:] = np.where(skull, face, part)
        grey = np.where(image < 0.0031308, 12.92 * image, 1.055 * np.maximum(image, 1e-6) ** (1 / 2.4) - 0.055)
        boxes = detector.detect((255 * np.clip(grey[..., ::-1], 0.0, 1.0)).astype(np.uint8))[1]
        middles = np.empty((0, 2)) if boxes is None else boxes[:, :2] + 0.5 * boxes[:, 2:4]
        count += bool((np.abs(middles - 0.5 * edge).max(axis=1) < 0.5 * size_px).any()) if len(middles) else 0
    assert count >= 0.9 * len(FACES)
