"""Real cameras, poses and boxes through the loader: boxes must fall where the labellers drew them in the pictures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import mirror
from mirror.geometry.boxes import corners
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest
from mirror.recordings.dgp import DgpReader
from mirror.schema.documents import Roi


def overlap(low: np.ndarray, high: np.ndarray, drawn: dict[str, float]) -> float:
    """Intersection over union of two rectangles."""
    other_low = np.array([drawn["x"], drawn["y"]])
    other_high = other_low + np.array([drawn["w"], drawn["h"]])
    shared = np.prod(np.clip(np.minimum(high, other_high) - np.maximum(low, other_low), 0, None))
    return float(shared / (np.prod(high - low) + np.prod(other_high - other_low) - shared))


def test_boxes_project_onto_what_was_drawn(real_data: Path, tmp_path: Path) -> None:
    scene = real_data / "dgp_scene_02"
    recording = DgpReader().open(scene, {})
    track = recording.track()
    roi = Roi(scene_id="s", frame=recording.info.frame, x_m=float(track.x_m[0]), y_m=float(track.y_m[0]))
    ingest([scene], [roi], tmp_path, IngestOptions(trigger={"min_duration_s": 0.0, "min_path_m": 0.0}, fail_fast=True))
    frames = mirror.open(tmp_path).frames()
    assert [len(frame.images) for frame in frames] == [6, 6, 6]
    overlaps = []
    for frame in frames:
        for camera, image in frame.images.items():
            files = sorted((scene / "bounding_box_2d" / camera).glob("*.json"))
            drawn = json.loads(files[frame.frame_index].read_text())["annotations"]
            by_object = {str(item["instance_id"]): item["box"] for item in drawn}
            boxes = frame.boxes(f"camera:{camera}")
            pixels = image.camera_model.project(corners(boxes.pose, boxes.size_m)).uv_px
            for track_id, uv in zip(boxes.track_id, pixels):
                if track_id in by_object and np.isfinite(uv).all():
                    raster = [image.width_px, image.height_px]
                    low, high = uv.min(axis=0).clip(0, raster), uv.max(axis=0).clip(0, raster)
                    overlaps.append(overlap(low, high, by_object[track_id]))
    assert len(overlaps) == 39
    assert min(overlaps) > 0.65 and np.median(overlaps) > 0.9
    planes = frames[0].decode(verify=True)
    assert planes.shape == (6, 3, 1216, 1936) and planes.std() > 20
