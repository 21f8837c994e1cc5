"""The results of a run that is not finished: one file a traversal, one line of JSON a frame."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mirror.annotation.detections import Detections
from mirror.schema.json_lines import append_line, decode_object, read_lines


class Journal:
    """Finished frames of one traversal.

    Args:
        path: the file.

    Raises:
        DatasetError: a line is broken.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.rows: dict[int, list[dict[str, Any]]] = dict(read_lines(path, _decode_boxes))

    def add(self, detections: Detections) -> None:
        """Append a frame.

        Raises:
            DatasetError: the file cannot be written.
        """
        entry: Mapping[str, Any] = {"timestamp_ns": detections.timestamp_ns, "boxes": detections.to_rows()}
        append_line(self._path, json.dumps(entry))
        self.rows[detections.timestamp_ns] = list(entry["boxes"])


def _decode_boxes(line: bytes) -> tuple[int, list[dict[str, Any]]]:
    entry = decode_object(line)
    return entry["timestamp_ns"], entry["boxes"]
