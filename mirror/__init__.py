"""MIRROR: fleet recordings become a multi-traversal camera dataset; simulators are scored against it.

``import mirror`` loads nothing heavy. The names below are imported on first use.
"""

from __future__ import annotations

from mirror.lazy import lazy
from mirror.version import __version__

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.dataset import Dataset as Dataset
    from mirror.dataset import open as open
    from mirror.errors import MirrorError as MirrorError

__all__ = ["Dataset", "MirrorError", "__version__", "open"]

__getattr__ = lazy(__name__, {"Dataset": "mirror.dataset", "MirrorError": "mirror.errors", "open": "mirror.dataset"})


def __dir__() -> list[str]:
    """What there is, imported yet or not."""
    return sorted(__all__)
