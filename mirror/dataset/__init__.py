"""Datasets on disk: open, query, load, split, statistics, integrity rules.

The names below are imported on first use, so that ``import mirror.dataset.layout`` stays light.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mirror.dataset.dataset import Dataset as Dataset
    from mirror.dataset.dataset import open as open

__all__ = ["Dataset", "open"]


def __getattr__(name: str) -> Any:
    """Import ``open`` and ``Dataset`` when they are first asked for."""
    if name in __all__:
        from mirror.dataset import dataset

        return getattr(dataset, name)
    raise AttributeError(f"module 'mirror.dataset' has no attribute {name!r}")
