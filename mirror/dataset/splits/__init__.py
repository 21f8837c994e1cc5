"""Splits: which traversals to train on and which to test on, drawn by seed, frozen, and without a leak."""

from __future__ import annotations

from mirror.dataset.splits.split import SplitReport as SplitReport
from mirror.dataset.splits.split import extend_split as extend_split
from mirror.dataset.splits.split import make_split as make_split
