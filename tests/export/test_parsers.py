"""A dataset opens in nerfstudio and gsplat's trainer without an export, with the dataset's own numbers."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.dataset.dataset import Dataset
from mirror.dataset.raster import image_raster
from mirror.errors import UsageError
from mirror.export.gsplat_parser import Parser
from mirror.export.mask_files import write_mask_files
from mirror.export.scene import select_scene
from tests.builders.street import LENSES
from tests.export.peers import RESULTS


def test_gsplat_parser_has_the_images_of_the_dataset(street: Dataset) -> None:
    parser = Parser(street.root)
    assert len(parser.image_names) == street.count("images") == 60
    assert parser.num_cameras == len(LENSES)
    for frame in street.frames():
        for camera, image in frame.images.items():
            row = parser.image_names.index(f"{frame.traversal_id}/{camera}/{image.timestamp_ns}.jpg")
            assert Path(parser.image_paths[row]).samefile(Path(street.root) / image.uri)
            np.testing.assert_allclose(parser.camtoworlds[row], image.world_SE3_camera.matrix()[0], atol=1e-12)
            number, lens = parser.camera_ids[row], image.camera_model
            raster = image_raster(lens, True, None)
            np.testing.assert_array_equal(parser.Ks_dict[number], raster.final.intrinsic_matrix())
            if lens.model == "pinhole":
                assert len(parser.params_dict[number]) == 0
                continue
            # As the trainer's dataset does it.
            pixels = cv2.imread(parser.image_paths[row])[..., ::-1]
            seen = cv2.remap(pixels, parser.mapx_dict[number], parser.mapy_dict[number], cv2.INTER_LINEAR)
            x, y, width, height = parser.roi_undist_dict[number]
            np.testing.assert_array_equal(seen[y : y + height, x : x + width], raster.image(image.decode()))
    assert len(parser.points) == len(parser.points_rgb) == 14


def test_normalised_cameras_lie_in_the_unit_ball(street: Dataset) -> None:
    parser, plain = Parser(street.root, normalize=True), Parser(street.root)
    distance = np.linalg.norm(parser.camtoworlds[:, :3, 3], axis=1)
    assert distance.max() == pytest.approx(1.0)
    np.testing.assert_allclose(parser.camtoworlds[:, :3, 3].mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(parser.camtoworlds[:, :3, :3], plain.camtoworlds[:, :3, :3], atol=1e-12)
    moved = np.concatenate([plain.points, np.ones((14, 1))], axis=1) @ parser.transform.T
    np.testing.assert_allclose(parser.points, moved[:, :3], atol=1e-5)


def test_a_split_and_wrong_arguments(street: Dataset) -> None:
    parser = Parser(f"{street.root}#a", split="novel")
    assert len(parser.points) == 7
    assert set(parser.roles) == {"train", "held_out"}
    with pytest.raises(UsageError, match="factor 2"):
        Parser(street.root, factor=2)


def test_nerfstudio_finds_the_dataparser() -> None:
    (entry,) = entry_points(group="nerfstudio.dataparser_configs", name="mirror-data")
    assert entry.value == "mirror.export.nerfstudio_dataparser:MIRROR"


def test_rays_of_the_dataparser_are_those_of_the_dataset(street: Dataset) -> None:
    import json

    read = json.loads((RESULTS / "nerfstudio_export" / "dataset.json").read_text())
    assert read["train"]["points"] == 7
    rays = {**read["train"]["rays"], **read["val"]["rays"]}
    cameras = ("front_wide", "front_narrow", "front_left", "rear")
    assert len(rays) == 10 * len(cameras)
    for frame in street.where(camera=cameras).frames():
        for camera, image in frame.images.items():
            entry = rays[image.uri]
            pose = image.world_SE3_camera
            expected = pose.transform(image.camera_model.unproject(entry["pixels"]).direction)[0] - pose.translation[0]
            np.testing.assert_allclose(entry["origin"], pose.translation[0], atol=1e-5)
            np.testing.assert_allclose(entry["directions"], expected, atol=1e-5, err_msg=camera)


def test_masks_of_road_users_and_ego_reach_toolkits_that_take_files(street: Dataset) -> None:
    images = select_scene(street, None, None, undistort=False).images
    files = write_mask_files(images)
    assert files is not None and len(files) == len(images)
    shown = 0
    for item, file in zip(images, files):
        mask, expected = cv2.imread(str(file), cv2.IMREAD_UNCHANGED), item.valid_pixels()
        assert mask.shape == (item.lens.height_px, item.lens.width_px)
        np.testing.assert_array_equal(mask, np.full(mask.shape, 255) if expected is None else expected)
        shown += int(expected is not None and (expected == 0).any())
    assert shown > 0
    assert write_mask_files([item for item in images if item.valid_pixels() is None]) is None
