"""The folders in a dataset with the results of interrupted runs: their names, and what is dropped with a traversal.

A verb keeps the finished items of a run in ``<folder>/<version and hash of the settings>/``, in files and folders whose
names begin with the id of the traversal. The items are keyed by the content of their inputs (`FinishedWork`).
"""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from typing import Final

from mirror.dataset.layout import Layout
from mirror.schema.files import remove_path

ANNOTATION: Final = ".annotate"
DEIDENTIFICATION: Final = ".deidentify"
"""It also holds what reviewers said; those lines name redacted images by their hashes."""
REFINEMENT: Final = ".refine"
DEPTH: Final = ".mvs"
_FOLDERS: Final = (ANNOTATION, DEIDENTIFICATION, REFINEMENT, DEPTH)


def work_folder(layout: Layout, verb: str, layer: str, inputs: str) -> Path:
    """Return the folder of one run's unfinished work.

    Args:
        layout: the dataset.
        verb: one of the constants of this module.
        layer: version, or ``source@version``, of what the run writes.
        inputs: hash of the settings, in hexadecimal; other settings get another folder.
    """
    return layout.root / verb / f"{layer}.{inputs[:16]}"


def remove_work(folder: Path) -> None:
    """Remove the folder of a run whose layers are complete, and the verb's folder if it holds no other work.

    What cannot be removed stays: another run that found all layers complete may remove the folder at the same time.

    Args:
        folder: what `work_folder` returned.
    """
    shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        folder.parent.rmdir()


def drop_work(layout: Layout, traversal_id: str) -> None:
    """Remove all unfinished work on a traversal, such as one that another recording replaces.

    Raises:
        DatasetError: it cannot be removed.
    """
    for folder in _FOLDERS:
        for path in (layout.root / folder).glob(f"*/{traversal_id}*"):
            remove_path(path)
