"""Reads a layer of boxes: the detections of each frame of a traversal, in order of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.annotation.detections import Detections
from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses

_NUMBERS: Final = (
    "qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m",
    "length_m", "width_m", "height_m", "vx_mps", "vy_mps", "vz_mps", "score",
)  # fmt: skip


def box_layers(dataset: Dataset) -> list[str]:
    """Return the names ``source@version`` of the layers of boxes in a view, sorted."""
    names = {name for names in dataset.table("traversals", ["layers"]).column(0).to_pylist() for name in names}
    return sorted(name.partition("/")[2] for name in names if name.startswith("boxes/"))


def choose_box_layer(dataset: Dataset, requested: str | None) -> str:
    """Return the requested layer of boxes, or the only one.

    Raises:
        UsageError: there is no such layer, or there are several and none was requested.
    """
    layers = box_layers(dataset)
    if requested is None and len(layers) == 1:
        return layers[0]
    if requested not in layers:
        problem = f"{len(layers)} layers of boxes" if requested is None else f"no layer of boxes {requested!r}"
        raise UsageError(problem, place="--boxes", expected=f"one of {', '.join(layers) or 'none'}")
    return requested


def with_box_layer(dataset: Dataset, requested: str | None) -> Dataset:
    """Return a view that reads the requested layer of boxes, or the only one; unchanged if there are no boxes.

    Raises:
        UsageError: there is no such layer, or there are several and none was requested.
    """
    if requested is None and not box_layers(dataset):
        return dataset
    return dataset.with_layers(boxes=choose_box_layer(dataset, requested))


def read_box_layer(dataset: Dataset, layer: str) -> dict[str, list[Detections]]:
    """Read the boxes of a layer by traversal: one entry for each frame, by time, even for frames without boxes.

    Args:
        dataset: a view; traversals without the layer are left out.
        layer: ``source@version``.

    Raises:
        UsageError: no traversal of the view has the layer.
    """
    choose_box_layer(dataset, layer)
    source, _, version = layer.partition("@")
    table = dataset.table("boxes")
    chosen = np.array(
        [
            one == source and other == version
            for one, other in zip(*(table.column(name).to_pylist() for name in ("source", "source_version")))
        ],
        np.bool_,
    )
    table = table.filter(pa.array(chosen))
    rows = dataset.table("traversals", ["traversal_id", "layers"]).to_pylist()
    having = [row["traversal_id"] for row in rows if f"boxes/{layer}" in row["layers"]]
    frames = dataset.table("frames", ["traversal_id", "timestamp_ns"])
    stamps: Mapping[str, list[int]] = {name: [] for name in having}
    for traversal_id, stamp in zip(*(column.to_pylist() for column in frames.columns)):
        if traversal_id in stamps:
            stamps[traversal_id].append(stamp)
    of_traversal = np.array(table.column("traversal_id").to_pylist(), object)
    return {name: _frames(table.filter(pa.array(of_traversal == name)), stamps[name]) for name in having}


def ego_poses_at(dataset: Dataset, traversal_id: str, frames: Sequence[Detections]) -> Poses:
    """Return the poses of the vehicle in the world at the times of frames; no frames give no poses.

    Raises:
        DatasetError: there are boxes but no images.
    """
    if not frames:
        return Poses.identity(0)
    with_images = dataset.where(traversal=traversal_id).frames()
    if not len(with_images):
        raise DatasetError(
            "boxes but no images", file=f"traversals/{traversal_id}", expected="boxes at the times of images",
            remedy="restore the images: `mirror ingest RECORDING... --replace`; or remove its layer of boxes",
        )  # fmt: skip
    stamps, poses = with_images[0].track
    return interpolate(stamps, poses, [frame.timestamp_ns for frame in frames])


def _frames(table: pa.Table, stamps: Sequence[int]) -> list[Detections]:
    times = table.column("timestamp_ns").to_numpy()
    numbers: Mapping[str, Float64] = {
        name: np.asarray(table.column(name).to_numpy(zero_copy_only=False), np.float64) for name in _NUMBERS
    }
    categories, tracks = table.column("category").to_pylist(), table.column("track_id").to_pylist()

    def values(names: Sequence[str], rows: np.ndarray) -> Float64:
        return np.stack([numbers[name][rows] for name in names], axis=-1)

    frames = []
    for stamp in sorted({*stamps, *times.tolist()}):
        rows = np.flatnonzero(times == stamp)
        if not len(rows):
            frames.append(Detections.empty(stamp))
            continue
        frames.append(
            Detections(
                stamp,
                Poses(values(_NUMBERS[:4], rows), values(_NUMBERS[4:7], rows)),
                values(_NUMBERS[7:10], rows),
                values(_NUMBERS[10:13], rows),
                tuple(categories[row] for row in rows),
                numbers["score"][rows],
                tuple(tracks[row] for row in rows),
            )
        )
    return frames
