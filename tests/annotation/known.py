"""An annotator whose boxes are known."""

from __future__ import annotations

import numpy as np

from mirror.annotation import Detections
from mirror.annotation.detections import AnnotationError
from mirror.dataset.frames import Frame
from mirror.geometry.poses import Poses


def truth(frame: Frame) -> Detections:
    """Two boxes that depend on the frame."""
    centre = np.array([[8.0 + frame.frame_index, 2.0, 0.8], [-12.0, 0.5, 0.9]])
    angle = np.array([0.3, -1.2]) / 2
    rotation = np.stack((np.cos(angle), [0.0, 0.0], [0.0, 0.0], np.sin(angle)), axis=1)
    size = np.array([[4.2, 1.8, 1.5], [0.7, 0.6, 1.7]])
    velocity = np.array([[3.0, 0.4, 0.0], [np.nan] * 3])
    return Detections(
        frame.timestamp_ns, Poses(rotation, centre), size, velocity, ("car", "pedestrian"), np.array([0.9, np.nan])
    )


class Known:
    """An annotator that finds `truth`, and can fail."""

    name, version, fingerprint = "known", "1", "known"

    def __init__(self, failing: tuple[int, ...] = ()) -> None:
        self.calls, self.failing = 0, failing

    def annotate(self, frame: Frame) -> Detections:
        self.calls += 1
        if frame.frame_index in self.failing:
            raise AnnotationError("no result", place=f"frame {frame.frame_index}")
        return truth(frame)

    def close(self) -> None:
        pass
