"""The index: derived tables, a pure function of the rest of the dataset."""

from __future__ import annotations

from mirror.dataset.index.build import IndexReport as IndexReport
from mirror.dataset.index.build import build_index as build_index
