"""IMG002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Bool, Int64
from mirror.dataset.check.rows import Rows
from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "IMG002",
    Severity.ERROR,
    cost=Cost.FILES,
    remedy="restore the file from the recording, or `mirror ingest RECORDING... --replace`",
)
def byte_length(view: SceneView) -> Iterator[Finding]:
    """A picture's file is shorter than its bytes, or, where it holds nothing else, longer."""
    images, size = view.all_images, view.picture_files.size
    offset, length = images.integers("byte_offset"), images.integers("byte_length")
    short = (size >= 0) & (size < offset + length)
    long = np.flatnonzero((size >= 0) & (offset == 0) & (size > length))
    # A shard holds several pictures one behind the other, the frames of a video are one file.
    shared = _repeated(images, long)
    video = [images.word("codec", int(row)) == "video" for row in long]
    short[long] |= np.array(video, np.bool_) | ~shared
    yield from images.findings(
        short, lambda row: f"{images.word('uri', row)} has {size[row]} bytes; expected {offset[row] + length[row]}"
    )


def _repeated(images: Rows, rows: Int64) -> Bool:
    """Which of some rows have a uri that other rows of the table have too."""
    uri = images.data.column("uri")
    asked = uri.take(pa.array(rows))
    found = pc.value_counts(uri.filter(pc.is_in(uri, value_set=asked.combine_chunks())))
    count = {item["values"]: item["counts"] for item in found.to_pylist()}
    return np.array([count[value] > 1 for value in asked.to_pylist()], np.bool_)
