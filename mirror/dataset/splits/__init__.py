"""Splits: frozen assignments of traversals to training and test roles, chosen by seed and without leaks."""

from __future__ import annotations

from mirror.dataset.splits.split import SplitReport as SplitReport
from mirror.dataset.splits.split import extend_split as extend_split
from mirror.dataset.splits.split import make_split as make_split
