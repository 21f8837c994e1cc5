"""The annotator ``file``: the boxes of a results file, made by any detector or reviewed by a person."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from mirror.annotation.detections import AnnotationError, Detections
from mirror.annotation.nuscenes import frame_token, read_results, sample_token, to_detections
from mirror.annotation.protocol import Annotator, require_settings
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.errors import UsageError
from mirror.schema.files import sha256_bytes


class FileAnnotator:
    """An annotator that reads boxes from a file, by sample token."""

    reads_images = False

    def __init__(self, path: Path, results: Mapping[str, list[dict[str, Any]]]) -> None:
        self.name, self.version = "file", "1"
        self.fingerprint = f"file {sha256_bytes(path.read_bytes())}"
        self._path, self._results = path, results

    def annotate(self, frame: Frame) -> Detections:
        """Return the boxes of the frame's sample."""
        token = frame_token(frame)
        boxes = self._results.get(token)
        if boxes is None:
            raise AnnotationError(
                "the file has no results of this sample",
                file=self._path,
                place=f"results.{token}",
                remedy="add its boxes to the file, an empty list for none",
            )
        try:
            return to_detections(boxes, frame.timestamp_ns, frame.world_SE3_ego)
        except AnnotationError as error:
            raise AnnotationError(
                error.problem, file=self._path, place=f"results.{token}: {error.place}", expected=error.expected
            ) from error

    def close(self) -> None:
        """Do nothing: nothing is held."""


class _Installed:
    takes_device = False
    settings: Mapping[str, str] = {"path": "results in the format of the nuScenes detection task (JSON)"}

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Annotator:
        """Read the file and compare its samples with the dataset."""
        require_settings("file", settings, self.settings)
        if "path" not in settings:
            raise UsageError("no file of results", place="--set", expected="path=FILE")
        path = Path(settings["path"])
        results = read_results(path)
        table = dataset.table("frames", ["traversal_id", "timestamp_ns"])
        tokens = {sample_token(*row) for row in zip(*(column.to_pylist() for column in table.columns))}
        if results and tokens.isdisjoint(results):
            raise UsageError(
                f"none of its {len(results)} samples is a frame of this dataset, such as {next(iter(results))!r}",
                file=path,
                expected=f"tokens such as {min(tokens, default='<traversal_id>.<timestamp_ns>')!r}",
                remedy="take the results of this dataset: `mirror annotate export` writes its sample tokens",
            )
        return FileAnnotator(path, results)


ANNOTATOR: Final = _Installed()
