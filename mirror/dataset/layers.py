"""Which of a traversal's layers are read."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LayerChoice:
    """Which layers stand behind poses, calibrations, boxes, depth maps and points.

    Attributes:
        poses: ``recorded``, or a pose layer ``source@version`` (its table: ``ego_poses.parquet``).
        calibrations: ``recorded``, or a calibration layer (its table: ``calibrations.parquet``).
        stage: the calibration stage to take; None: refined before online before factory.
        boxes: a box layer; None: the only one a traversal has.
        depth: a layer of depth maps; None: the only one a traversal has.
        points: a layer of points; None: the only one a traversal has.
    """

    poses: str = "recorded"
    calibrations: str = "recorded"
    stage: str | None = None
    boxes: str | None = None
    depth: str | None = None
    points: str | None = None
