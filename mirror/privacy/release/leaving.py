"""The door of releases: their files, and the models that go with them, against what must stay of the dataset."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from mirror.dataset.door.files import list_dataset_files
from mirror.dataset.door.inspection import Leak, inspect_files, read_below
from mirror.dataset.door.plan import plan_departure
from mirror.dataset.door.secrets import Secrets
from mirror.dataset.layout import Layout
from mirror.dataset.store import Store
from mirror.progress import ProgressReporter


def leaving_originals(source: Layout, folders: list[Path], progress: ProgressReporter) -> Iterator[Leak]:
    """Yield the files, including archive members and data in pages, that show a recorded image in its original form.

    Recorded images of a traversal that has a redaction layer must not leave, unless the redaction changed nothing.

    Args:
        source: the dataset.
        folders: the release, and folders that are published with it.
        progress: receives the progress.

    Raises:
        DatasetError: the dataset is broken, or a link leads out of a folder.
    """
    departure = plan_departure(list_dataset_files(source), lambda _: False)
    if not departure.kept:
        return
    secrets = Secrets(Store(source.root), departure, progress)
    for folder in folders:
        names = [
            Path(place, name).relative_to(folder).as_posix() for place, _, found in os.walk(folder) for name in found
        ]
        for leak in inspect_files(read_below(folder), names, departure, secrets, progress).leaks:
            yield Leak(leak.file if folder == folders[0] else str(folder / leak.file), leak.problem)
