"""The door of exports: nothing is sealed that shows a recorded image which a redaction replaced."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from mirror.dataset.dataset import Dataset
from mirror.dataset.door.files import list_dataset_files
from mirror.dataset.door.inspection import inspect_files, read_below
from mirror.dataset.door.placing import dataset_state, require_unchanged
from mirror.dataset.door.plan import plan_departure
from mirror.dataset.door.secrets import Secrets
from mirror.errors import DatasetError
from mirror.progress import ProgressReporter


class ExportDoor:
    """The check of an export's images against the dataset that the export was made from.

    A remote dataset is not walked: its images are those of its index, and no recorded image of a traversal with a
    redaction layer is among them.

    Args:
        dataset: the view that is exported.
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._is_local = dataset.store.folder is not None
        self._before = dataset_state(dataset.layout) if self._is_local else {}

    def require_clean(self, out: Path, progress: ProgressReporter) -> None:
        """Require that an export may be sealed.

        Raises:
            DatasetError: a file shows an image that must not leave, or the dataset changed since the door was made.
        """
        if not self._is_local:
            return
        layout, traversals = self._dataset.layout, frozenset(self._dataset.traversals())
        files = list_dataset_files(layout)
        files = replace(files, images=[one for one in files.images if one.key[0] in traversals])
        departure = plan_departure(files, lambda _: False)
        if departure.kept:
            secrets = Secrets(self._dataset.store, departure, progress)
            names = [Path(at, name).relative_to(out).as_posix() for at, _, found in os.walk(out) for name in found]
            for leak in inspect_files(read_below(out), names, departure, secrets, progress).leaks:
                raise DatasetError(
                    f"{leak.problem}: the export was not sealed",
                    file=out / leak.file,
                    expected="files without recorded images that a redaction replaced",
                    remedy="remove the file, and run the same command again",
                )
        require_unchanged(layout, self._before)
