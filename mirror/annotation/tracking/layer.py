"""Tracks a layer of boxes, and writes the tracks as another layer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from mirror.annotation.box_layer import choose_box_layer, ego_poses_at, read_box_layer
from mirror.annotation.detections import Detections
from mirror.annotation.run import box_table
from mirror.annotation.tracking.options import BoxTrackingOptions
from mirror.annotation.tracking.static import merge_stationary
from mirror.annotation.tracking.tracker import ObjectTrack, find_tracks, to_frames
from mirror.dataset.dataset import Dataset
from mirror.dataset.derived_layer import DerivedLayer, find_missing
from mirror.dataset.layer_writer import require_layer_name
from mirror.dataset.layout import manifest_sha256
from mirror.dataset.writing import writing_layers
from mirror.geometry.poses import Poses
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.hashing import hash_document
from mirror.schema.tables import BOXES

_DESCRIBED = "the same boxes, poses and options"


@dataclass(frozen=True)
class TrackingReport:
    """The counts of a run that made tracks of boxes.

    Attributes:
        layer: ``source@version`` of the tracks.
        written: traversals whose layer was written.
        kept: traversals that had the layer already.
        detections: boxes read.
        boxes: boxes written.
        tracks: objects.
        stationary: objects that do not move.
    """

    layer: str
    written: tuple[str, ...]
    kept: tuple[str, ...]
    detections: int
    boxes: int
    tracks: int
    stationary: int


def track_layer(
    dataset: Dataset,
    layer: str | None = None,
    options: BoxTrackingOptions | None = None,
    *,
    version: str | None = None,
    progress: ProgressReporter | None = None,
) -> TrackingReport:
    """Track a layer of boxes, and write the tracks as the layer ``<source>-tracks@<version>``.

    Stationary objects are merged across the traversals of a scene. Poses are those of the view's pose layer.

    Args:
        dataset: a local dataset, or a view of it.
        layer: ``source@version``; None: the only layer of boxes.
        options: see `BoxTrackingOptions`.
        version: version of the new layers; None: that of the boxes.
        progress: receives the number of traversals.

    Raises:
        UsageError: there is no such layer of boxes, or there are several and none is named.
        DatasetError: a layer of this name was made with other options or of other boxes.
    """
    options, progress = options or BoxTrackingOptions(), progress or NullProgress()
    layer = choose_box_layer(dataset, layer)
    source, _, own_version = layer.partition("@")
    new_source, version = f"{source}-tracks", version or own_version
    require_layer_name(new_source, version)
    digest = hash_document({**asdict(options), "poses": dataset.layers.poses})
    layout = dataset.layout
    counts: dict[str, int] = dict.fromkeys(("detections", "boxes", "tracks", "stationary"), 0)
    with writing_layers(layout):
        frames = read_box_layer(dataset, layer)
        inputs = {
            name: {"tracking": digest, layer: manifest_sha256(layout.layer(name, BOXES.name, source, own_version))}
            for name in frames
        }
        layers = {
            name: DerivedLayer(layout, name, BOXES.name, new_source, version, inputs[name], _DESCRIBED)
            for name in frames
        }
        written, kept = find_missing(layers.values())
        if written:
            progress.start("tracking, traversals", len(frames))
            for scene in dataset.scenes():
                own = [name for name in dataset.where(scene=scene).traversals() if name in frames]
                if not set(own) & set(written):
                    continue
                poses = {name: ego_poses_at(dataset, name, frames[name]) for name in own}
                tracked = _track_scene({name: frames[name] for name in own}, poses, options, progress)
                for name in own:
                    if name in written:
                        writer = layers[name].open()
                        boxes = to_frames(tracked[name], frames[name], poses[name])
                        table = box_table({frame.timestamp_ns: frame.to_rows() for frame in boxes})
                        writer.finish(BOXES, table)
                        counts["detections"] += sum(map(len, frames[name]))
                        counts["boxes"] += table.num_rows
                        counts["tracks"] += len(tracked[name])
                        counts["stationary"] += sum(item.stationary for item in tracked[name])
    return TrackingReport(f"{new_source}@{version}", tuple(written), tuple(kept), **counts)


def _track_scene(
    frames: Mapping[str, list[Detections]],
    poses: Mapping[str, Poses],
    options: BoxTrackingOptions,
    progress: ProgressReporter,
) -> dict[str, list[ObjectTrack]]:
    """Tracks by traversal of one scene."""
    tracks = {}
    for name, detections in frames.items():
        tracks[name] = find_tracks(detections, poses[name], options)
        progress.advance(1)
    return merge_stationary(tracks)
