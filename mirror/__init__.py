"""MIRROR: fleet recordings become a multi-traversal camera dataset; simulators are scored against it.

``import mirror`` loads nothing heavy. The names below are imported on first use.
"""

from __future__ import annotations

from mirror.lazy import lazy_names
from mirror.version import __version__ as __version__

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset as Dataset
    from mirror.dataset.dataset import open as open
    from mirror.dataset.frames import Frame as Frame
    from mirror.dataset.image import Image as Image
    from mirror.errors import MirrorError as MirrorError
    from mirror.evaluation.run import evaluate as evaluate
    from mirror.ingest.run import ingest_recordings as ingest_recordings
    from mirror.integrity.run import check as check
    from mirror.protocols.document import load_protocol as load_protocol

__all__ = [
    "Dataset",
    "Frame",
    "Image",
    "MirrorError",
    "__version__",
    "check",
    "evaluate",
    "ingest_recordings",
    "load_protocol",
    "open",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Dataset": "mirror.dataset.dataset",
        "Frame": "mirror.dataset.frames",
        "Image": "mirror.dataset.image",
        "MirrorError": "mirror.errors",
        "__version__": "mirror.version",
        "check": "mirror.integrity.run",
        "evaluate": "mirror.evaluation.run",
        "ingest_recordings": "mirror.ingest.run",
        "load_protocol": "mirror.protocols.document",
        "open": "mirror.dataset.dataset",
    },
)
