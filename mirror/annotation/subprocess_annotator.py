"""The annotator ``subprocess``: a program in another environment, which answers JSON (docs/annotation/detectors.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from mirror.annotation.detections import AnnotationError, Detections
from mirror.annotation.frame_program import FrameProgram, program_settings
from mirror.annotation.protocol import Annotator, require_settings
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.schema.hashing import hash_document

FORMAT: Final = "mirror-annotate/1"
_SETTINGS: Final = {
    "command": "the program and its arguments, as a shell would split them",
    "limit_s": "seconds that a frame may take, 60 by default; the first also counts the program's start",
    "name": "source of the layers, `subprocess` by default",
}


class SubprocessAnnotator:
    """An annotator that runs a program, which is started at the first frame.

    Args:
        command: words of the command.
        limit_s: seconds that one answer may take.
        name: source of the layers.
    """

    def __init__(self, command: list[str], limit_s: float, name: str) -> None:
        self.name, self.version = name, "1"
        self.fingerprint = f"subprocess {hash_document(command)}"
        self._program = FrameProgram(command, limit_s, FORMAT)

    @property
    def restarts(self) -> int:
        """The number of times that the program was killed."""
        return self._program.restarts

    def annotate(self, frame: Frame) -> Detections:
        """Ask the program; a program that fails is restarted and asked once more."""
        return _read_answer(self._program.ask(frame), frame)

    def close(self) -> None:
        """End the program and remove the images."""
        self._program.close()


def _read_answer(answer: Mapping[str, Any], frame: Frame) -> Detections:
    boxes = answer.get("boxes")
    if not isinstance(boxes, list) or not all(isinstance(box, dict) for box in boxes):
        raise AnnotationError("no list `boxes`", place="subprocess", expected="boxes, or an error")
    return Detections.from_arrays(
        frame.timestamp_ns,
        _numbers(boxes, "centre_m", 3),
        _numbers(boxes, "rotation", 4),
        _numbers(boxes, "size_m", 3),
        _numbers(boxes, "velocity_mps", 3, optional=True),
        [str(box.get("category") or "") for box in boxes],
        _numbers(boxes, "score", 1, optional=True)[:, 0],
    )


def _numbers(boxes: list[dict[str, Any]], key: str, count: int, *, optional: bool = False) -> Any:
    rows = np.full((len(boxes), count), np.nan)
    for number, box in enumerate(boxes):
        value = box.get(key)
        if value is None and optional:
            continue
        values = value if isinstance(value, list) else [value]
        if len(values) != count or any(isinstance(item, bool) or not isinstance(item, int | float) for item in values):
            raise AnnotationError(f"{value!r}", place=f"box {number}: {key}", expected=f"{count} numbers")
        rows[number] = values
    return rows


class _Installed:
    takes_device = False
    settings: Mapping[str, str] = _SETTINGS

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Annotator:
        """Check the settings."""
        require_settings("subprocess", settings, self.settings)
        words, limit_s = program_settings(settings)
        return SubprocessAnnotator(words, limit_s, settings.get("name", "subprocess"))


ANNOTATOR: Final = _Installed()
