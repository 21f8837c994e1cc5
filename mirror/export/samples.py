"""One frame of an export as plain numbers and texts, for formats that hold JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mirror.dataset.frames import Frame
from mirror.dataset.traversal import FrameBoxes
from mirror.export.lenses import ForeignLens
from mirror.export.scene import ExportImage, ExportScene
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import to_pose_numbers


def own_lens(camera: Camera) -> ForeignLens:
    """Return the lens in MIRROR's own camera model, for formats that can hold any lens."""
    return ForeignLens(camera.model, {})


def describe_frame(scene: ExportScene, frame: Frame, images: Sequence[ExportImage]) -> dict[str, Any]:
    """Return a frame's ids, conditions, pose, cameras and boxes.

    Poses are seven numbers ``qw qx qy qz tx ty tz`` in the scene's world frame; pixels have the corner of the image at
    (0, 0).
    """
    traversal = scene.traversals[frame.traversal_id]
    return {
        "scene_id": frame.scene_id,
        "traversal_id": frame.traversal_id,
        "drive_id": traversal["drive_id"],
        "frame_index": frame.frame_index,
        "timestamp_ns": frame.timestamp_ns,
        "role": images[0].role,
        "light": traversal["light"],
        "weather": traversal["weather"],
        "world_SE3_ego": to_pose_numbers(frame.world_SE3_ego),
        "cameras": {item.image.camera: describe_camera(item) for item in images},
        "boxes": describe_boxes(frame.boxes("world")),
    }


def describe_camera(item: ExportImage) -> dict[str, Any]:
    """Return the lens, mounting, pose and exposure of one image."""
    image, lens, calibration = item.image, item.lens, item.image.calibration
    return {
        "timestamp_ns": image.timestamp_ns,
        "exposure_start_ns": image.exposure_start_ns,
        "exposure_end_ns": image.exposure_end_ns,
        "shutter_direction": calibration.row["shutter_direction"],
        "readout_ns": calibration.row["readout_ns"],
        **lens.to_row(),
        "ego_SE3_camera": to_pose_numbers(calibration.ego_SE3_camera),
        "world_SE3_camera": to_pose_numbers(item.world_SE3_camera),
        "privacy": image.privacy,
    }


def describe_boxes(boxes: FrameBoxes) -> list[dict[str, Any]]:
    """Return the boxes in their frame; velocity and score are null where unknown."""
    return [
        {
            "timestamp_ns": boxes.timestamp_ns,
            "track_id": boxes.track_id[row],
            "category": boxes.category[row],
            "attributes": list(boxes.attributes[row]),
            "world_SE3_box": to_pose_numbers(boxes.pose[row]),
            "size_m": boxes.size_m[row].tolist(),
            "velocity_mps": None if np.isnan(boxes.velocity_mps[row]).any() else boxes.velocity_mps[row].tolist(),
            "score": None if np.isnan(boxes.score[row]) else float(boxes.score[row]),
            "source": boxes.source[row],
        }
        for row in range(len(boxes))
    ]
