"""Masks of road users against rays that are tested with the boxes one by one."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.annotation import annotate
from mirror.annotation.masks import MaskOptions, draw_hulls, mask_layer
from mirror.cli.main import main
from mirror.dataset.index.build import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.errors import UsageError
from mirror.geometry import Camera, Poses, matrix_from_quaternion
from mirror.schema.tables import MASKS
from tests.annotation.known import Known

CAMERAS = (
    Camera("pinhole", 60, 40, 30.0, 30.0, 30.0, 20.0),
    Camera("kannala_brandt", 60, 40, 20.0, 20.0, 30.0, 20.0, (0.02, -0.004, 0.0, 0.0)),
)


def hits(camera: Camera, pose: Poses, size: np.ndarray) -> np.ndarray:
    """Pixels (H, W) whose central ray meets a box."""
    rays = camera.rays()
    found = np.zeros(rays.valid.shape, np.bool_)
    for row in range(len(pose)):
        turn = matrix_from_quaternion(pose.rotation[row : row + 1])[0]
        origin, direction = -turn.T @ pose.translation[row], rays.direction @ turn
        with np.errstate(all="ignore"):
            one, other = (-size[row] / 2 - origin) / direction, (size[row] / 2 - origin) / direction
        enter, leave = np.minimum(one, other).max(-1), np.maximum(one, other).min(-1)
        found |= (leave >= np.maximum(enter, 0.1)) & rays.valid
    return found


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda camera: camera.model)
def test_masks_cover_the_rays_that_meet_a_box(camera: Camera) -> None:
    rng = np.random.default_rng(0)
    rotation = rng.normal(size=(4, 4))
    place = np.array([[0.5, 0.2, 9.0], [-3.0, 1.0, 6.0], [0.0, 0.0, -8.0], [2.5, 0.0, 1.5]])
    pose, size = Poses(rotation, place), rng.uniform(0.8, 2.5, (4, 3))
    mask, exact = draw_hulls(camera, pose, size) > 0, hits(camera, pose, size)
    assert exact.any() and not exact.all()
    assert not (exact & ~mask).any()
    # The hull has the border's pixels too, and nothing beyond a pixel.
    grown = np.zeros_like(exact)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            grown |= np.roll(np.roll(np.pad(exact, 1), dv, 0), du, 1)[1:-1, 1:-1]
    # A hull of a distorted edge is straight, so a few pixels may be beyond it.
    assert (mask & ~grown).sum() <= 0.02 * mask.sum()


def test_no_boxes_and_wrong_options() -> None:
    nothing = Poses.unchecked(np.empty((0, 4)), np.empty((0, 3)))
    assert not draw_hulls(CAMERAS[0], nothing, np.empty((0, 3))).any()
    for options in ({"margin": -1.0}, {"min_score": float("nan")}):
        with pytest.raises(UsageError):
            MaskOptions(**options)


def test_masks_become_a_layer_that_images_have(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    annotate(mirror.open(root), Known())
    words = ["annotate", "masks", str(root), "--boxes", "known@1", "--json"]
    assert main(words) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (report["layer"], len(report["written"]), report["images"]) == ("known-hulls@1", 2, 14)
    dataset = mirror.open(root)
    drawn = 0
    for frame in dataset.frames():
        for image in frame.images.values():
            (mask,) = image.masks()
            pixels = mask.decode()
            assert (mask.kind, pixels.shape) == ("dynamic", (image.height_px, image.width_px))
            drawn += bool(pixels.any())
    assert drawn > 0
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["kept"] == report["written"]
    assert main([*words, "--margin", "0.5"]) == 2


def test_instance_masks_replace_hulls_where_they_are_given(root: Path) -> None:
    annotate(mirror.open(root), Known())
    dataset = mirror.open(root)
    name = dataset.traversals()[0]
    images = [frame.images["front_wide"] for frame in dataset.where(traversal=name).frames()]
    writer = LayerWriter(dataset.layout, name, MASKS.name, "seen", "1")
    rows = []
    for number, image in enumerate(images[:2]):
        pixels = np.zeros((image.height_px, image.width_px), np.uint8)
        pixels[3:9, 5 : 10 + number] = 7
        file = writer.file(f"front_wide/{image.timestamp_ns}.png", cv2.imencode(".png", pixels)[1].tobytes())
        rows.append({"camera": "front_wide", "timestamp_ns": image.timestamp_ns, "kind": "instance", **file})
    writer.finish(MASKS, rows, {})
    build_index(root)
    mask_layer(mirror.open(root), "known@1")
    masks = {}
    for frame in mirror.open(root).where(traversal=name).frames():
        for camera, image in frame.images.items():
            (dynamic,) = [mask.decode() for mask in image.masks() if mask.kind == "dynamic"]
            masks[frame.frame_index, camera] = dynamic
    for number in range(2):
        expected = np.zeros_like(masks[number, "front_wide"])
        expected[3:9, 5 : 10 + number] = 255
        np.testing.assert_array_equal(masks[number, "front_wide"], expected)
    # The other images have hulls, which are not that rectangle.
    assert masks[2, "front_wide"].any()
    assert masks[2, "front_wide"][3:9, 5:10].sum() != 255 * 30


def test_statistics_count_categories_by_layer(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    annotate(mirror.open(root), Known())
    main(["stats", str(root), "--json"])
    statistics = json.loads(capsys.readouterr().out.splitlines()[-1])
    rows = {row["category"]: (row["layer"], row["boxes"], row["objects"]) for row in statistics["categories"]}
    assert rows == {"car": ("known@1", 7, 7), "pedestrian": ("known@1", 7, 7)}
    main(["stats", str(root)])
    assert "pedestrian" in capsys.readouterr().out
