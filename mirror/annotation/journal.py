"""The results of a run that is not finished: one file a traversal, one line of JSON a frame."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from mirror.annotation.detections import Detections
from mirror.schema.files import unwritable_error
from mirror.schema.strict_json import decode_json


class Journal:
    """Finished frames of one traversal.

    Args:
        path: the file; a line that a killed process left incomplete is dropped.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[str] | None = None
        self.rows: dict[int, list[dict[str, Any]]] = {}
        if path.exists():
            text = path.read_text()
            complete = text[: text.rfind("\n") + 1]
            for line in complete.splitlines():
                entry = decode_json(line)
                self.rows[entry["timestamp_ns"]] = entry["boxes"]
            if complete != text:
                path.write_text(complete)

    def add(self, detections: Detections) -> None:
        """Append a frame.

        Raises:
            DatasetError: the file cannot be written.
        """
        entry: Mapping[str, Any] = {"timestamp_ns": detections.timestamp_ns, "boxes": detections.to_rows()}
        try:
            if self._file is None:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._file = self._path.open("a")
            self._file.write(json.dumps(entry) + "\n")
            self._file.flush()
        except OSError as error:
            raise unwritable_error(self._path, error) from error
        self.rows[detections.timestamp_ns] = list(entry["boxes"])

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
