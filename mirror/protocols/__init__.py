"""Protocols of the benchmark as data, the views that a protocol requests, and the truth of these views."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.protocols.document import load_protocol as load_protocol
    from mirror.protocols.png import decode_render as decode_render
    from mirror.protocols.truth.source import GroundTruth as GroundTruth
    from mirror.protocols.views.plan import plan_views as plan_views
    from mirror.protocols.views.view import RenderView as RenderView

__all__ = [
    "GroundTruth",
    "RenderView",
    "decode_render",
    "load_protocol",
    "plan_views",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "GroundTruth": "mirror.protocols.truth.source",
        "RenderView": "mirror.protocols.views.view",
        "decode_render": "mirror.protocols.png",
        "load_protocol": "mirror.protocols.document",
        "plan_views": "mirror.protocols.views.plan",
    },
)
