"""The folder in which a run makes drives, from which they get into the dataset, each whole, at the end.

Until then nobody reads it, so that a reader of the dataset, a failed recording and a killed run leave the dataset as it
was. What is complete in the folder of a run that is dead is taken over by the next one.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from mirror.dataset.destination import Destination, FolderDestination
from mirror.dataset.generation import supersede
from mirror.dataset.layout import MANIFEST, Layout, complete_manifest
from mirror.dataset.owned_folder import OwnedFolder, abandoned_folders
from mirror.dataset.unfinished_work import drop_work
from mirror.schema.files import unmovable_error

FOLDER: Final = ".staging"
RUN: Final = "run"
_TRAVERSAL: Final = "traversal:"


class Staging:
    """The folder of one run, laid out like a dataset, with the drives and traversals that are complete.

    Args:
        dataset: that they will be part of.
        name: first part of the folder's name. A run takes over what dead runs left; under another name nothing is
            taken over.

    Attributes:
        dataset: it.
        layout: of the folder.

    Raises:
        DatasetError: the dataset's folder cannot be written.
    """

    def __init__(self, dataset: Layout, name: str = RUN) -> None:
        self.dataset = dataset
        self.own_folder = OwnedFolder(dataset.root / FOLDER, name)
        self.layout = Layout(self.own_folder.path)
        if name != RUN:
            return
        for left in abandoned_folders(dataset.root / FOLDER, RUN):
            if left != self.own_folder.path:
                self._take_over(left)

    def _take_over(self, left: Path) -> None:
        for traversal in sorted((left / "traversals").glob("*")):
            there = self.layout.traversal(traversal.name).exists()
            if not there and complete_manifest(traversal / "recorded") is not None:
                _rename(traversal, self.layout.traversal(traversal.name))
        shutil.rmtree(left, ignore_errors=True)

    @contextmanager
    def attempt(self) -> Iterator[Layout]:
        """Open a folder that one attempt alone writes, laid out as a dataset.

        Its remains are removed at the end.
        """
        attempts = self.layout.root / "attempts"
        attempts.mkdir(exist_ok=True)
        folder = Path(tempfile.mkdtemp(dir=attempts))
        try:
            yield Layout(folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def complete(self, attempt: Layout, traversal_id: str) -> None:
        """Move a sealed traversal to its place, unless an equal one of another attempt is already there.

        Raises:
            DatasetError: it cannot be moved.
        """
        made, target = attempt.traversal(traversal_id), self.layout.traversal(traversal_id)
        while True:
            there = complete_manifest(target / "recorded")
            mine = complete_manifest(made / "recorded")
            if there is not None and mine is not None and there.derived_from == mine.derived_from:
                return
            try:
                target.parent.mkdir(exist_ok=True)
                if target.exists():
                    # Taken over from a dead run, of another recording or of other options.
                    target.rename(attempt.root / f"other.{traversal_id}")
                made.rename(target)
            except FileNotFoundError:
                # Another attempt did the same at this moment.
                continue
            except OSError as error:
                if target.exists():
                    continue
                raise unmovable_error(target, error) from error
            return

    def recorded(self, traversal_id: str) -> Path:
        """Return the recorded part of a traversal, from this run if it has one, else from the dataset."""
        own = self.layout.recorded(traversal_id)
        return own if (own / MANIFEST).is_file() else self.dataset.recorded(traversal_id)

    def forget(self, drive_id: str) -> None:
        """Remove the output of a drive that failed."""
        for folder in (self.layout.drive(drive_id), *(self.layout.root / "traversals").glob(f"*.{drive_id}.*")):
            shutil.rmtree(folder, ignore_errors=True)

    def find_present(self) -> list[str]:
        """Return the ids of the complete drives that the dataset has too: it has them damaged."""
        return [name for name in self.layout.drive_ids() if (self.dataset.drive(name) / MANIFEST).exists()]

    def commit(self, destination: Destination | None = None) -> list[str]:
        """Give the files of every complete drive their names in the dataset; each manifest comes last.

        Nothing of the dataset is moved or removed. What another run committed with the same bytes is done.

        Args:
            destination: the dataset, if it is not the one in the folder.

        Returns:
            The ids of the drives.

        Raises:
            ConflictError: a file is there with other bytes.
            DatasetError: the dataset cannot be written.
        """
        drives = self.layout.drive_ids()
        for drive_id in drives:
            commit_drive(self.layout, drive_id, destination or FolderDestination(self.dataset.root))
        return drives

    def take(self, drive_id: str) -> None:
        """Take a sealed drive; it stays in the folder until all are committed."""

    def publish(self) -> None:
        """Move every complete drive into the dataset, with its traversals and its rig; the drive comes last.

        What a drive replaces is superseded: readers of the generation before go on reading it. `recover` undoes what is
        interrupted between. The caller holds the dataset's writer lock and the lock of replacements.

        Raises:
            DatasetError: the dataset cannot be written.
        """
        for rig in sorted((self.layout.root / "rigs").glob("*"), key=lambda path: path.suffix == ".json"):
            if not (self.dataset.root / "rigs" / rig.name).exists():
                _rename(rig, self.dataset.root / "rigs" / rig.name)
        for drive_id in self.layout.drive_ids():
            self._publish(drive_id)

    def _publish(self, drive_id: str) -> None:
        folder, target = self.layout.drive(drive_id), self.dataset.drive(drive_id)
        manifest, before = complete_manifest(folder), complete_manifest(target)
        named = _traversals({} if manifest is None else manifest.derived_from)
        made = {name for name in named if self.layout.traversal(name).exists()}
        # The drive goes first: without it its traversals do not count, whatever happens next.
        supersede(self.dataset, target)
        for name in made | (_traversals({} if before is None else before.derived_from) - named):
            # Its layers go with it, and so does what an interrupted run would make layers of.
            drop_work(self.dataset, name)
            supersede(self.dataset, self.dataset.traversal(name))
        for name in sorted(made):
            _rename(self.layout.traversal(name), self.dataset.traversal(name))
        _rename(folder, target)

    def close(self, *, done: bool) -> None:
        """Remove the folder; if the run is not done and something in it is complete, leave it to the next run.

        Args:
            done: everything that is complete was published.
        """
        whole = any(one.is_file() for one in (self.layout.root / "traversals").glob(f"*/recorded/{MANIFEST}"))
        if done or not whole:
            self.own_folder.remove()
        else:
            self.own_folder.release()
        with suppress(OSError):
            (self.dataset.root / FOLDER).rmdir()


def commit_drive(layout: Layout, drive_id: str, destination: Destination) -> None:
    """Give the files of a complete drive their names in a dataset: rigs, traversals, and its manifest last.

    Args:
        layout: the folder with the drive, laid out like a dataset.
        drive_id: the drive.
        destination: the dataset.

    Raises:
        ConflictError: a file is there with other bytes.
        DatasetError: the dataset cannot be written.
    """
    root = layout.root
    for rig in sorted((root / "rigs").glob("*"), key=lambda path: path.suffix == ".json"):
        destination.commit_file(rig, rig.relative_to(root).as_posix())

    def commit(folder: Path) -> None:
        destination.commit_folder(folder, folder.relative_to(root).as_posix(), MANIFEST)

    manifest = complete_manifest(layout.drive(drive_id))
    for name in sorted(_traversals({} if manifest is None else manifest.derived_from)):
        if layout.traversal(name).exists():
            # Its layers come first: a complete traversal is not written again.
            for layer in layout.layers(name):
                commit(layout.layer(name, *layer))
            commit(layout.recorded(name))
    commit(layout.drive(drive_id))


def _traversals(derived_from: Mapping[str, str]) -> set[str]:
    return {key.removeprefix(_TRAVERSAL) for key in derived_from if key.startswith(_TRAVERSAL)}


def _rename(path: Path, target: Path) -> None:
    try:
        target.parent.mkdir(exist_ok=True)
        path.rename(target)
    except OSError as error:
        raise unmovable_error(target, error) from error
