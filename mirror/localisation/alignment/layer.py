"""The layer of the aligned poses of one pass."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from mirror.arrays import Int64
from mirror.dataset.dataset import Dataset
from mirror.dataset.derived_layer import DerivedLayer
from mirror.geometry import Poses, interpolate, quaternion_inverse, quaternion_multiply
from mirror.geometry.geodesy import TangentFrame
from mirror.localisation.alignment.report import PassReport
from mirror.schema.tables import EGO_POSES

SOURCE: Final = "aligned"
DOCUMENT: Final = "alignment.json"


def aligned_layer(view: Dataset, traversal_id: str, version: str, inputs: Mapping[str, str]) -> DerivedLayer:
    """Return the layer ``aligned@VERSION`` of a traversal's poses; the layer may be missing.

    Args:
        view: the dataset.
        traversal_id: the traversal.
        version: version of the layer.
        inputs: hashes of what the result depends on.
    """
    described = "the same traversals, layers and settings"
    return DerivedLayer(view.layout, traversal_id, "poses", SOURCE, version, inputs, described)


def correct_track(stamps: Int64, track: Poses, times: Int64, found: Poses) -> tuple[Int64, Poses]:
    """Correct a whole track by the poses that are known at some times.

    Between these times the corrections of position and rotation are interpolated, beyond them they stay; at them the
    poses are those given. The two are apart, because a wrong heading does not turn the way that a receiver records.

    Args:
        stamps: (N,) ascending times of the recorded poses, which cover the others.
        track: N recorded poses.
        times: (M,) ascending times.
        found: M poses at these times.

    Returns:
        Ascending times (K,) of both, and K poses.
    """
    recorded = interpolate(stamps, track, times)
    turn = quaternion_multiply(found.rotation, quaternion_inverse(recorded.rotation))
    correction = Poses(turn, found.translation - recorded.translation)
    others = stamps[~np.isin(stamps, times)]
    kept = interpolate(stamps, track, others)
    change = interpolate(times, correction, np.clip(others, times[0], times[-1]))
    moved = Poses(quaternion_multiply(change.rotation, kept.rotation), kept.translation + change.translation)
    both = np.concatenate([times, others])
    order = np.argsort(both, kind="stable")
    joined = Poses(
        np.concatenate([found.rotation, moved.rotation]), np.concatenate([found.translation, moved.translation])
    )
    return both[order], joined[order]


def write_aligned(
    layer: DerivedLayer, stamps: Int64, poses: Poses, frame: TangentFrame | None, said: PassReport
) -> None:
    """Write the layer of one traversal.

    Args:
        layer: the layer, which is missing.
        stamps: (N,) ascending times.
        poses: N poses ``world_SE3_ego``.
        frame: the world; None: it has a metric frame of its own.
        said: what is known of the pass, which becomes `DOCUMENT`.
    """
    columns: dict[str, Any] = {name: values.tolist() for name, values in poses.to_columns().items()}
    places: list[list[float | None]] = [[None] * len(stamps) for _ in range(3)]
    if frame is not None:
        places = [values.tolist() for values in frame.to_geodetic(poses.translation)]
    columns |= dict(zip(("longitude_deg", "latitude_deg", "height_m"), places))
    columns |= {"timestamp_ns": stamps.tolist(), "sigma_m": [said.sigma_m] * len(stamps)}
    columns["orientation"] = ["recorded"] * len(stamps)
    rows = [dict(zip(columns, values)) for values in zip(*columns.values())]
    writer = layer.open()
    writer.document(DOCUMENT, (json.dumps(asdict(said), indent=1) + "\n").encode())
    writer.finish(EGO_POSES, rows)
