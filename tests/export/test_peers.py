"""What other toolkits read of our exports: the numbers that their own readers made, from ``tests/peers``."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.export.nuscenes import channel_name
from mirror.geometry.boxes import corners as box_corners
from mirror.geometry.cameras import undistorted
from tests.export.peers import PERSPECTIVE, result


def images_of(street: Dataset) -> Iterator[tuple[Frame, str, Image]]:
    for frame in street.frames():
        for camera, image in frame.images.items():
            yield frame, camera, image


def test_boxes_land_where_the_devkit_of_nuscenes_has_them(street: Dataset) -> None:
    read = result("nuscenes_export")
    assert {scene["name"] for scene in read["scenes"]} == set(street.traversals())
    assert {scene["samples"] for scene in read["scenes"]} == {5}
    assert {scene["log"] for scene in read["scenes"]} == set(street.drives())
    compared = 0
    for frame, camera, image in images_of(street):
        channel = channel_name(camera)
        microseconds = round(image.timestamp_ns / 1000)
        entry = read["images"][f"samples/{channel}/{frame.traversal_id}__{channel}__{microseconds}.jpg"]
        boxes = frame.boxes(f"camera:{camera}")
        corners = box_corners(boxes.pose, boxes.size_m)
        lens = image.camera_model
        pinhole = lens if lens.model == "pinhole" else undistorted(lens)
        assert len(entry["boxes"]) == len(boxes) == 2
        assert {box["category"] for box in entry["boxes"].values()} == {"van", "vehicle.car"}
        for row, category in enumerate(boxes.category):
            name = {"van": "van", "car": "vehicle.car"}[category]
            (box,) = [box for box in entry["boxes"].values() if box["category"] == name]
            ours, theirs = corners[row], np.array(box["depth_m"])
            # The devkit lists the corners in another order: compare as sets, by depth.
            np.testing.assert_allclose(np.sort(theirs), np.sort(ours[:, 2]), atol=1e-9)
            if (ours[:, 2] > 0.5).all():
                # OpenCV's pixels, as nuScenes has them: the first centre is at 0.
                expected = pinhole.project(ours).uv_px - 0.5
                found = np.array(box["corners_px"])
                distance = np.linalg.norm(found[:, None] - expected[None], axis=-1)
                assert max(distance.min(axis=0).max(), distance.min(axis=1).max()) < 1e-6
                compared += 1
    assert compared >= 40


def test_rays_of_nerfstudio_are_those_of_the_dataset(street: Dataset) -> None:
    read = result("nerfstudio_export")
    train, val = read["train"]["rays"], read["val"]["rays"]
    assert not set(train) & set(val)
    assert len(read["train"]["masks"]) == len(train)
    seen = 0
    roles = {key: role for role in ("train", "held_out") for key in street.where(split="novel", role=role).traversals()}
    for frame, camera, image in images_of(street.where(camera=PERSPECTIVE)):
        name = f"images/{frame.traversal_id}/{camera}/{image.timestamp_ns}.jpg"
        rays = (train if roles[frame.traversal_id] == "train" else val)[name]
        pose = image.world_SE3_camera
        expected = image.camera_model.unproject(rays["pixels"])
        assert expected.valid.all()
        in_world = pose.transform(expected.direction)[0] - pose.translation[0]
        # Its tensors are float32; ten Newton steps leave nothing beside that.
        np.testing.assert_allclose(rays["origin"], pose.translation[0], atol=1e-5)
        np.testing.assert_allclose(rays["directions"], in_world, atol=2e-6)
        seen += 1
    assert seen == len(train) + len(val) == 10 * len(PERSPECTIVE)


def test_gsplat_reads_cameras_and_points(street: Dataset) -> None:
    read = result("gsplat_export")
    for frame, camera, image in images_of(street):
        name = f"{frame.traversal_id}/{camera}/{image.timestamp_ns}.jpg"
        entry = read["images"][name]
        assert Path(entry["path"]) == Path("images", name)
        lens = image.camera_model
        pinhole = lens if lens.model == "pinhole" else undistorted(lens)
        np.testing.assert_allclose(entry["matrix"], pinhole.intrinsic_matrix(), atol=1e-9)
        assert entry["size"] == [pinhole.width_px, pinhole.height_px]
        np.testing.assert_allclose(entry["camera_to_world"], image.world_SE3_camera.matrix()[0], atol=1e-9)
    assert len(read["images"]) == street.count("images")
    points = street.points()
    order = np.lexsort(points.position_m.T)
    found = np.array(read["points"]["xyz"])
    same = np.lexsort(found.T)
    np.testing.assert_allclose(found[same], points.position_m[order], atol=1e-5)
    np.testing.assert_array_equal(np.array(read["points"]["rgb"])[same], points.rgb[order])


def test_webdataset_reads_the_samples(street: Dataset) -> None:
    read = result("webdataset_export")
    assert set(read) == {"train-000000.tar", "held_out-000000.tar"}
    samples = {sample["key"]: sample for shard in read.values() for sample in shard}
    masks = 0
    for frame in street.frames():
        sample = samples.pop(f"{frame.traversal_id.replace('.', '_')}-{frame.frame_index:06}")
        assert sample["json"]["timestamp_ns"] == frame.timestamp_ns
        for camera, image in frame.images.items():
            entry = sample["images"][f"{camera}.jpg"]
            assert entry["sha256"] == hashlib.sha256(image.read()).hexdigest()
            assert entry["shape"] == [image.height_px, image.width_px, 3]
            assert abs(entry["mean"] - image.decode().mean()) < 1.0
            masks += f"{camera}.mask.png" in sample["images"]
            stated = sample["json"]["cameras"][camera]["world_SE3_camera"]
            assert stated[4:] == image.world_SE3_camera.translation[0].tolist()
    assert not samples and masks > 0


def test_lerobot_reads_the_rows(street: Dataset) -> None:
    read = result("lerobot_export")
    assert read["episodes"] == 2 and read["episode_of"] == list(street.traversals())
    assert read["cameras"] == sorted(f"observation.images.{camera}" for camera in street.cameras())
    frames = {(frame.traversal_id, frame.timestamp_ns): frame for frame in street.frames()}
    for row in read["rows"]:
        traversal = read["episode_of"][row["episode_index"]]
        frame = frames.pop((traversal, row["timestamp_ns"]))
        light = {"d0": "day", "d1": "night"}[traversal.split(".")[1]]
        assert row["task"].startswith(f"drive, {light}")
        # Its tensors are float32.
        np.testing.assert_allclose(row["observation.state"][4:], frame.world_SE3_ego.translation[0], rtol=1e-7)
        for camera, image in frame.images.items():
            entry = row[f"observation.images.{camera}"]
            assert entry["shape"] == [3, image.height_px, image.width_px]
            assert abs(255 * entry["mean"] - image.decode().mean()) < 1.0
            pose = row[f"observation.camera_poses.{camera}"]
            np.testing.assert_allclose(pose[4:], image.world_SE3_camera.translation[0], rtol=1e-7)
    assert not frames
