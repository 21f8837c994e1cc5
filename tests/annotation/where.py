"""An annotator for tests of executors: its boxes are `truth`, and it says where it ran and can end its process.

``--annotator tests/annotation/where.py:ANNOTATOR --set folder=FOLDER [--set crash=TRAVERSAL]`` leaves one file a
traversal in the folder: the Ray node that annotated it, if it was one.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping
from pathlib import Path

from mirror.annotation import Detections
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from tests.annotation.known import Known, truth


class Where(Known):
    """`Known` boxes, and the place where they were found."""

    def __init__(self, folder: Path, crash: str) -> None:
        super().__init__()
        self._folder, self._crash = folder, crash

    def annotate(self, frame: Frame) -> Detections:
        ray = sys.modules.get("ray")
        node = "" if ray is None else ray.get_runtime_context().get_node_id()
        (self._folder / frame.traversal_id).write_text(node)
        if frame.traversal_id == self._crash:
            os.kill(os.getpid(), signal.SIGSEGV)
        return truth(frame)


class _Installed:
    settings = {"folder": "where files are left", "crash": "traversal on which the process ends"}  # noqa: RUF012

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Where:
        return Where(Path(settings["folder"]), settings.get("crash", ""))


ANNOTATOR = _Installed()
