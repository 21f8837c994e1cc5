"""Tracks of matched features, triangulated by pycolmap from estimated poses."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.synth_matching.features import Features, colmap, colmap_camera
from mirror.arrays import Float64, Int64
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera

Key = tuple[int, str]
"""Index of the frame, and name of the camera."""


@dataclass(frozen=True, eq=False)
class Rig:
    """A moving rig of the synthetic street.

    Attributes:
        cameras: lenses, by name.
        ego_SE3_camera: mountings (C,), in the same order.
        world_SE3_ego: poses (F,) of the frames.
    """

    cameras: dict[str, Camera]
    ego_SE3_camera: Poses
    world_SE3_ego: Poses

    def world_SE3_cameras(self) -> Poses:  # noqa: N802
        """Return the poses (F * C,) of all images, frame by frame."""
        frames, count = len(self.world_SE3_ego), len(self.cameras)
        frame, camera = np.repeat(np.arange(frames), count), np.tile(np.arange(count), frames)
        return self.world_SE3_ego[frame] @ self.ego_SE3_camera[camera]


@dataclass(frozen=True, eq=False)
class Tracks:
    """Points and their observations in several images.

    Attributes:
        points: (P, 3) world points, metres.
        frame: (M,) frame index of each observation.
        camera: (M,) camera index of each observation.
        point: (M,) point index of each observation.
        uv_px: (M, 2) positions in the image.
        scale_px: (M,) sizes of the features.
    """

    points: Float64
    frame: Int64
    camera: Int64
    point: Int64
    uv_px: Float64
    scale_px: Float64


def triangulate_tracks(rig: Rig, features: Mapping[Key, Features], matches: Mapping[tuple[Key, Key], Int64]) -> Tracks:
    """Join matches to tracks and triangulate them.

    Args:
        rig: the estimated rig.
        features: features of all images.
        matches: pairs (M, 2) of features of two images.
    """
    pycolmap = colmap()
    names = list(rig.cameras)
    ids = {key: number for number, key in enumerate(features, start=1)}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "matches.db"
        reconstruction = _to_reconstruction(rig, features, ids)
        with pycolmap.Database.open(path) as database:
            for number, camera in reconstruction.cameras.items():
                database.write_camera(camera, use_camera_id=True)
                database.write_rig(reconstruction.rigs[number], use_rig_id=True)
            for key, number in ids.items():
                database.write_frame(reconstruction.frames[number], use_frame_id=True)
                database.write_image(reconstruction.images[number], use_image_id=True)
                database.write_keypoints(number, features[key].uv_px.astype(np.float32))
            for (one, other), pairs in matches.items():
                database.write_two_view_geometry(ids[one], ids[other], _to_two_view_geometry(pairs))
        options = pycolmap.IncrementalPipelineOptions(extract_colors=False, random_seed=1)
        options.triangulation.random_seed = 1
        triangulated = pycolmap.triangulate_points(reconstruction, path, folder, folder, options=options)
    keys = {number: key for key, number in ids.items()}
    points: list[Float64] = []
    rows: list[tuple[int, int, int, int]] = []
    for number, point in enumerate(triangulated.points3D.values()):
        points.append(point.xyz)
        for observation in point.track.elements:
            frame, name = keys[observation.image_id]
            rows.append((frame, names.index(name), number, observation.point2D_idx))
    frame_of, camera_of, point_of, feature = np.array(rows, np.int64).reshape(-1, 4).T
    features_by_row = [features[frame, names[camera]] for frame, camera in zip(frame_of, camera_of)]
    return Tracks(
        np.reshape(points, (-1, 3)), frame_of, camera_of, point_of,
        np.array([one.uv_px[place] for one, place in zip(features_by_row, feature)]).reshape(-1, 2),
        np.array([one.scale_px[place] for one, place in zip(features_by_row, feature)]),
    )  # fmt: skip


def _to_reconstruction(rig: Rig, features: Mapping[Key, Features], ids: Mapping[Key, int]) -> Any:
    """The rig as a pycolmap reconstruction; every image is its own frame."""
    pycolmap = colmap()
    names, poses = list(rig.cameras), rig.world_SE3_cameras().inverse()
    reconstruction = pycolmap.Reconstruction()
    for number, camera in enumerate(rig.cameras.values(), start=1):
        reconstruction.add_camera_with_trivial_rig(colmap_camera(camera, number))
    for (frame, name), number in ids.items():
        place = names.index(name)
        row = frame * len(names) + place
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.roll(poses.rotation[row], -1)), poses.translation[row])
        image = pycolmap.Image(f"{frame}/{name}", features[frame, name].uv_px, camera_id=place + 1, image_id=number)
        reconstruction.add_image_with_trivial_frame(image, pose)
    return reconstruction


def _to_two_view_geometry(pairs: Int64) -> Any:
    pycolmap = colmap()
    return pycolmap.TwoViewGeometry(
        config=int(pycolmap.TwoViewGeometryConfiguration.CALIBRATED), inlier_matches=pairs.astype(np.uint32)
    )
