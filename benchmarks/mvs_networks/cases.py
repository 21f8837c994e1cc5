"""Posed images with known depth: synthetic ones with exact depth, real ones with LiDAR."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from hybridworldsim.mvs.estimator import StereoImage
from mirror.arrays import Float64
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.geometry.cameras.camera import camera_from_row
from mirror.recordings.readers.dgp import DgpReader
from mirror.synth.fleet.drives import make_drives
from mirror.synth.render import render

_OFFSETS_M: Final = (0.0, -1.0, 1.0, -2.0, 2.0)
_CAMERAS: Final = ("front_wide", "front_left")
_OWN_M: Final = 5.0
_HIDDEN_PX: Final = 4
_HIDDEN_SHARE: Final = 0.05


@dataclass(frozen=True, eq=False)
class Case:
    """An image, its neighbours, and its depth.

    Attributes:
        name: name of the case.
        reference: the image.
        sources: its neighbours, best first.
        depth_m: (H, W) true camera z, NaN where it is unknown or infinite.
    """

    name: str
    reference: StereoImage
    sources: tuple[StereoImage, ...]
    depth_m: Float64


def street_cases(width_px: int, height_px: int, count: int = 3) -> Iterator[Case]:
    """Yield images along a drive through the synthetic street, forwards and to the left.

    Their sources are 1 and 2 m before and behind.

    Args:
        width_px: width of a pinhole image with a field of view of 80 degrees.
        height_px: its height.
        count: number of places for each camera.
    """
    drive = make_drives("reconstruction", 0, scenes=1, traversals=1)[1][0]
    focal = 0.6 * width_px
    lens = Camera("pinhole", width_px, height_px, focal, focal, width_px / 2.0, height_px / 2.0, ())
    stamps = drive.condition.start_ns + np.arange(0, 60_000_000_000, 50_000_000)
    for camera in _CAMERAS:
        poses = drive.world_SE3_camera(camera, stamps)
        steps = np.linalg.norm(np.diff(poses.translation, axis=0), axis=1)
        way = np.concatenate(([0.0], np.cumsum(steps)))
        inside = way[np.linalg.norm(poses.translation[:, :2], axis=1) < 20.0]
        for at in np.linspace(inside[0], inside[-1], count):
            images, truth = [], None
            for offset in _OFFSETS_M:
                place = int(np.argmin(np.abs(way - at - offset)))
                pose = poses[place : place + 1]
                seen = render(drive.world, pose, lens, 20.0, drive.condition)
                if truth is None:
                    depth = seen.view.distance_m * lens.rays().direction[..., 2]
                    truth = np.where(np.isfinite(depth), depth, np.nan)
                images.append(_posed(seen.bgr, lens, pose))
            if truth is not None:
                yield Case(f"{camera} at {at:.0f} m", images[0], tuple(images[1:]), truth)


def dgp_cases(folder: Path, width_px: int) -> Iterator[Case]:
    """Yield the middle images of six real cameras, with the previous and next images as sources and LiDAR as truth.

    Args:
        folder: folder of the recording.
        width_px: width of the scaled images.
    """
    recording = DgpReader().open(folder, {})
    lenses = {row["camera"]: camera_from_row(row) for row in recording.calibrations().to_pylist()}
    scene = json.loads(recording.scene_file.read_bytes())
    clouds = [entry["datum"]["point_cloud"] for entry in scene["data"] if "point_cloud" in entry["datum"]]
    cloud = clouds[len(clouds) // 2]
    with np.load(folder / cloud["filename"]) as file:
        seen = file["data"][:, :3].astype(np.float64)
    # Nearer points are mostly on the vehicle itself, which moves with the cameras.
    seen = seen[np.linalg.norm(seen, axis=1) > _OWN_M]
    points = _pose(cloud["pose"]).transform(seen).reshape(-1, 3)
    for camera, original in lenses.items():
        lens = original.scaled(width_px / original.width_px)
        images = []
        for entry in scene["data"]:
            if entry["id"]["name"] == camera:
                bgr = cv2.imread(str(folder / entry["datum"]["image"]["filename"]))
                if bgr is None:
                    raise FileNotFoundError(entry["datum"]["image"]["filename"])
                scaled = cv2.resize(bgr, (lens.width_px, lens.height_px), interpolation=cv2.INTER_AREA)
                images.append(_posed(scaled.astype(np.uint8), lens, _pose(entry["datum"]["image"]["pose"])))
        before, middle, after = images
        yield Case(camera, middle, (before, after), _lidar_depth(points, lens, middle.world_SE3_camera))


def _posed(bgr: object, lens: Camera, pose: Poses) -> StereoImage:
    rgb = np.ascontiguousarray(np.asarray(bgr, np.uint8)[..., ::-1])
    return StereoImage(rgb, lens.intrinsic_matrix(), pose, np.ones(rgb.shape[:2], np.bool_))


def _pose(entry: dict[str, dict[str, float]]) -> Poses:
    rotation, translation = entry["rotation"], entry["translation"]
    return Poses(
        np.array([[rotation.get(f"q{axis}", 0.0) for axis in "wxyz"]]),
        np.array([[translation.get(axis, 0.0) for axis in "xyz"]]),
    )


def _lidar_depth(points: Float64, lens: Camera, world_SE3_camera: Poses) -> Float64:
    """Depth of pixels that a LiDAR point falls on, without points beside a nearer surface.

    LiDAR and camera have different positions, so LiDAR also measures surfaces that the camera cannot see. Such points
    lie beside nearer points in the image.
    """
    found = lens.project(world_SE3_camera.inverse().transform(points).reshape(-1, 3))
    column, row = found.uv_px[found.valid].astype(np.int64).T
    depth = np.full((lens.height_px, lens.width_px), np.inf)
    np.minimum.at(depth, (row, column), found.depth_m[found.valid])
    window = np.ones((2 * _HIDDEN_PX + 1, 2 * _HIDDEN_PX + 1), np.uint8)
    nearest = cv2.erode(depth, window, borderType=cv2.BORDER_REPLICATE)
    return np.where(np.isfinite(depth) & (depth < (1.0 + _HIDDEN_SHARE) * nearest), depth, np.nan)
