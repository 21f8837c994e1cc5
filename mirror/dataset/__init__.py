"""Datasets on disk: opening, queries, loading, splits and statistics.

The names below are imported on first use, so that ``import mirror.dataset.layout`` stays quick.
"""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset as Dataset
    from mirror.dataset.dataset import open as open

__all__ = ["Dataset", "open"]

__getattr__, __dir__ = lazy_names(__name__, {"Dataset": "mirror.dataset.dataset", "open": "mirror.dataset.dataset"})
