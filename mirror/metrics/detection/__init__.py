"""Detections against true boxes."""

from __future__ import annotations

from mirror.metrics.detection.boxes import DetectionBoxes, in_range
from mirror.metrics.detection.config import DETECTION_CVPR_2019, TP_ERRORS, DetectionConfig
from mirror.metrics.detection.curves import RECALL, Curve
from mirror.metrics.detection.matching import MatchingTable, matching_tables
from mirror.metrics.detection.nuscenes import (
    ABSENT_CLASSES,
    AbsentClasses,
    NuScenesAccumulator,
    NuScenesDetection,
    nuscenes_detection,
    score_tables,
)

__all__ = [
    "ABSENT_CLASSES",
    "DETECTION_CVPR_2019",
    "RECALL",
    "TP_ERRORS",
    "AbsentClasses",
    "Curve",
    "DetectionBoxes",
    "DetectionConfig",
    "MatchingTable",
    "NuScenesAccumulator",
    "NuScenesDetection",
    "in_range",
    "matching_tables",
    "nuscenes_detection",
    "score_tables",
]
