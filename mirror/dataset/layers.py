"""The choice of the layers that a view reads."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LayerChoice:
    """The layers that a view reads.

    Attributes:
        poses: ``recorded``, or a pose layer ``source@version`` (its table: ``ego_poses.parquet``).
        calibrations: ``recorded``, or a calibration layer (its table: ``calibrations.parquet``).
        stage: the calibration stage to use; None: the best one, in the order refined, online, factory.
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
