"""The index: tables that are derived from the rest of the dataset by a pure function."""

from __future__ import annotations

from mirror.dataset.index.build import IndexReport as IndexReport
from mirror.dataset.index.build import append_drives as append_drives
from mirror.dataset.index.build import build_bucket_index as build_bucket_index
from mirror.dataset.index.build import build_index as build_index
