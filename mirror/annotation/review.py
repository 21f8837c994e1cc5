"""Exports a layer of boxes for review in a person's own tool; `file_annotator` imports what comes back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mirror.annotation.box_layer import choose_box_layer, ego_poses_at, read_box_layer
from mirror.annotation.nuscenes import sample_token, to_boxes, write_results
from mirror.dataset.dataset import Dataset


@dataclass(frozen=True)
class ExportReport:
    """The counts of an export of boxes for review.

    Attributes:
        path: the file.
        layer: ``source@version``.
        samples: number of samples.
        boxes: number of boxes.
    """

    path: str
    layer: str
    samples: int
    boxes: int


def export_results(dataset: Dataset, path: Path, layer: str | None = None) -> ExportReport:
    """Write a layer of boxes as results of the nuScenes detection task, in the world frames of the scenes.

    Args:
        dataset: a dataset or a view.
        path: the JSON file; replaced if it exists.
        layer: ``source@version``; None: the only layer of boxes.

    Raises:
        UsageError: there is no such layer, or there are several and none is named.
        DatasetError: the file cannot be written.
    """
    layer = choose_box_layer(dataset, layer)
    results = {}
    boxes = 0
    for traversal_id, frames in read_box_layer(dataset, layer).items():
        poses = ego_poses_at(dataset, traversal_id, frames)
        for row, frame in enumerate(frames):
            token = sample_token(traversal_id, frame.timestamp_ns)
            results[token] = to_boxes(frame, token, poses[row])
            boxes += len(frame)
    write_results(path, results, {"mirror_layer": layer, "mirror_poses": dataset.layers.poses})
    return ExportReport(str(path), layer, len(results), boxes)
