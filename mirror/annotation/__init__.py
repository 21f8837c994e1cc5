"""Annotation: 3D boxes of road users as layers, from files, from other programs and from installed annotators."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.annotation.box_layer import read_box_layer as read_box_layer
    from mirror.annotation.detections import Detections as Detections
    from mirror.annotation.protocol import Annotator as Annotator
    from mirror.annotation.registry import installed_annotator as installed_annotator
    from mirror.annotation.run import annotate as annotate
    from mirror.annotation.tracking.options import BoxTrackingOptions as BoxTrackingOptions
    from mirror.annotation.tracking.options import TrackingOptions as TrackingOptions
    from mirror.annotation.tracking.tracker import track as track

__all__ = [
    "Annotator",
    "BoxTrackingOptions",
    "Detections",
    "TrackingOptions",
    "annotate",
    "installed_annotator",
    "read_box_layer",
    "track",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Annotator": "mirror.annotation.protocol",
        "Detections": "mirror.annotation.detections",
        "BoxTrackingOptions": "mirror.annotation.tracking.options",
        "TrackingOptions": "mirror.annotation.tracking.options",
        "annotate": "mirror.annotation.run",
        "installed_annotator": "mirror.annotation.registry",
        "read_box_layer": "mirror.annotation.box_layer",
        "track": "mirror.annotation.tracking.tracker",
    },
)
