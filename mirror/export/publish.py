"""Publishing of a dataset: a bundle of files without held-out images, with datasheet, licence and hashes."""

from __future__ import annotations

import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final

from mirror.dataset import open as open_dataset
from mirror.dataset.dataset import Dataset
from mirror.dataset.door.files import ImageKey, list_dataset_files
from mirror.dataset.door.inspection import Leak, SameBytes, inspect_files, read_below
from mirror.dataset.door.placing import dataset_state, hash_file, place_file, require_unchanged
from mirror.dataset.door.plan import Departure, plan_departure, require_own_files
from mirror.dataset.door.secrets import Secrets
from mirror.dataset.images.binary_mask import rewrite_mask
from mirror.dataset.index.build import build_index
from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.lock import writer_lock
from mirror.dataset.split_document import read_split
from mirror.dataset.store import Store
from mirror.dataset.taken_down import encode_public_take_downs, read_take_downs
from mirror.errors import DatasetError, UsageError
from mirror.export.croissant import Publication, write_croissant
from mirror.export.datasheet import write_datasheet
from mirror.methods.training_images import list_scored_images
from mirror.pools import thread_pool
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.views import plan_views
from mirror.schema.bundle import BUNDLE, PUBLISHING, Bundle
from mirror.schema.documents import FileEntry, SplitDocument
from mirror.schema.files import remove_temporaries, sha256_bytes, write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.links import require_inside
from mirror.schema.take_downs import TAKE_DOWNS

LICENCE: Final = "LICENSE"
DATASHEET: Final = "README.md"
CROISSANT: Final = "croissant.json"
DATASET_FOLDERS: Final = ("drives", "index", "maps", "rigs", "splits", "traversals")
"""Folders of a dataset, in which a repeated call removes files."""

_MAX_FILES_PER_FOLDER: Final = 10_000
"""Limit of the Hugging Face hub, which serves larger folders badly."""

_THREADS: Final = 8


@dataclass(frozen=True)
class PublishOptions:
    """Options of publishing a dataset.

    Attributes:
        split: the split whose held-out traversals are withheld.
        protocols: protocols whose truth is withheld.
        name: title of the dataset.
        licence: licence of the data; None: that of the dataset.
        contact: where to ask for the removal of data.
        publication: what ``croissant.json`` states besides.
    """

    split: str
    protocols: tuple[Protocol, ...]
    name: str
    licence: str | None = None
    contact: str | None = None
    publication: Publication = field(default_factory=Publication)


@dataclass(frozen=True, eq=False)
class PublishReport:
    """The result of publishing a dataset.

    Attributes:
        bundle: the bundle's document, which was written last; None: files must not leave, and nothing was sealed.
        leaks: the files that must not leave, and why.
        same_bytes: published images with the bytes of images that stay.
        as_recorded: number of published images whose faces and plates were removed neither here nor at the source.
        altered: published images with other bytes than their table states: they were replaced since.
    """

    bundle: Bundle | None
    leaks: Sequence[Leak]
    same_bytes: Sequence[SameBytes]
    as_recorded: int
    altered: Sequence[str]


def publish(
    root: Path, out: str, options: PublishOptions, *, progress: ProgressReporter | None = None
) -> PublishReport:
    """Write a bundle of a dataset without the images by which submissions are scored.

    Only files that the dataset's documents and tables name are copied, and no recorded image of a traversal that has a
    redaction layer. Tables, splits, calibrations, boxes and masks are complete, so that hashes of splits and plans are
    those of the dataset. Every published file is hashed, and held against all images that stay, before the bundle's
    document is written. An interrupted call to a local folder continues when it is repeated; files of an earlier call
    that this one does not publish are removed.

    Args:
        root: folder of the dataset.
        out: folder of the bundle, or a URL that fsspec can write (``s3://bucket/name``).
        options: see `PublishOptions`.
        progress: receives the progress.

    Raises:
        UsageError: `out` is a folder of another kind, or no licence is stated.
        DatasetError: the dataset or the split does not exist, images lie outside of the dataset, a folder has too many
            files, a link leads out of the dataset or of the bundle, the dataset changed meanwhile, or a file cannot be
            written.
    """
    reporter = progress or NullProgress()
    layout = Layout(root)
    require_dataset(layout)
    if "://" not in out:
        require_output_folder(Path(out), FolderKind.BUNDLE)
        return _publish(layout, Path(out), options, reporter)
    upload = _Upload(out)
    with tempfile.TemporaryDirectory() as folder:
        report = _publish(layout, Path(folder), options, reporter)
        if report.bundle is not None:
            upload.write(Path(folder), report.bundle, reporter)
    return report


def _publish(layout: Layout, out: Path, options: PublishOptions, progress: ProgressReporter) -> PublishReport:
    before = dataset_state(layout)
    dataset = open_dataset(layout.root)
    licence = options.licence or dataset.document.licence
    if not licence:
        raise UsageError(
            "the dataset states no licence", file=layout.document, place="--licence",
            expected="the SPDX identifier or the name of a licence, such as CC-BY-4.0",
        )  # fmt: skip
    split = read_split(dataset.store, options.split)
    departure = plan_departure(list_dataset_files(layout), withheld_images(dataset, split, options.protocols))
    require_own_files(departure)
    _refuse_large_folders(layout, departure.files)
    # The folder counts as a bundle again once its new document is written.
    write_bytes(out / PUBLISHING, b"")
    remove_temporaries(out)
    require_inside(out, BUNDLE).unlink(missing_ok=True)
    _remove_others(out, frozenset(departure.files))
    stated = _copy(layout, out, departure, progress)
    with writer_lock(Layout(out), wait=False):
        build_index(out)
    write_bytes(out / LICENCE, f"The data of this dataset is licensed under: {licence}\n".encode())
    secrets = Secrets(dataset.store, departure, progress)
    present = {name for name in _walk(out) if name not in (CROISSANT, DATASHEET, PUBLISHING)}
    inspection = inspect_files(read_below(out), present, departure, secrets, progress, stated=stated)
    require_unchanged(layout, before)
    as_recorded = sum(not one.is_redacted for one in departure.shown.values())
    altered = tuple(sorted(name for name, sha256 in stated.items() if departure.files[name] not in (None, sha256)))
    if inspection.leaks:
        return PublishReport(None, inspection.leaks, inspection.same_bytes, as_recorded, altered)
    names = {*stated, LICENCE, *(name for name in present if name.startswith("index/"))}
    bundle = Bundle(
        split=options.split,
        protocols=tuple(protocol.name for protocol in options.protocols),
        dataset_hash=split.dataset_hash,
        licence=licence,
        files={name: inspection.entries[name] for name in sorted(names)},
        withheld=departure.withheld,
    )
    published = sorted({one.name for one in departure.shown.values()})
    text = write_croissant(dataset, bundle, published, name=options.name, publication=options.publication)
    bundle = add_file(out, bundle, CROISSANT, text)
    text = write_datasheet(dataset, bundle, name=options.name, contact=options.contact, images=published)
    bundle = add_file(out, bundle, DATASHEET, text)
    write_json(out / BUNDLE, bundle)
    (out / PUBLISHING).unlink()
    return PublishReport(bundle, (), inspection.same_bytes, as_recorded, altered)


def add_file(out: Path, bundle: Bundle, name: str, text: str) -> Bundle:
    """Write a file that describes a bundle; returns the bundle with it."""
    data = text.encode()
    write_bytes(out / name, data)
    entry = FileEntry(bytes=len(data), sha256=sha256_bytes(data))
    return bundle.model_copy(update={"files": dict(sorted({**bundle.files, name: entry}.items()))})


def withheld_images(
    dataset: Dataset, split: SplitDocument, protocols: Sequence[Protocol]
) -> Callable[[ImageKey], bool]:
    """Return a function that tells whether an image is of a held-out traversal or scored by a protocol."""
    hidden = {key for key, role in split.assignments.items() if role not in ("train", "unused")}
    scored = {key for protocol in protocols for key in list_scored_images(plan_views(dataset, protocol, split.name))}
    return lambda key: key[0] in hidden or key in scored


def _copy(layout: Layout, out: Path, departure: Departure, progress: ProgressReporter) -> dict[str, str]:
    """Place the files that leave; returns the SHA-256 that each must have.

    An image may have been replaced since its table was written, for instance because it was taken down: it leaves as it
    is now.
    """
    images = {one.name for one in departure.shown.values()}
    progress.start("copying", len(departure.files))

    def place(name: str) -> str:
        progress.advance(1)
        if name in departure.static_masks:
            # A photo may be saved as a mask.
            source = require_inside(layout.root, name)
            mask = rewrite_mask(_read_mask(source), source)
            write_bytes(require_inside(out, name), mask)
            return sha256_bytes(mask)
        if name == TAKE_DOWNS:
            data = encode_public_take_downs(read_take_downs(Store(layout.root)))
            write_bytes(require_inside(out, name), data)
            return sha256_bytes(data)
        place_file(layout.root, name, out)
        stated = None if name in images else departure.files[name]
        return stated or hash_file(require_inside(layout.root, name))

    with thread_pool(_THREADS) as pool:
        return dict(zip(departure.files, pool.map(place, departure.files)))


def _read_mask(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetError(
            f"cannot be read: {error.strerror or error}", file=path, expected="the static mask that its rig names",
            remedy="`mirror check` lists all that is missing",
        ) from error  # fmt: skip


def _remove_others(out: Path, names: frozenset[str]) -> None:
    """Remove what an earlier call left in the dataset's folders and this one does not publish; other files stay."""
    for top in DATASET_FOLDERS:
        for folder, folders, files in os.walk(require_inside(out, top), topdown=False):
            for file in files:
                path = Path(folder, file)
                if path.relative_to(out).as_posix() not in names:
                    path.unlink()
            for name in folders:
                with suppress(OSError):
                    Path(folder, name).rmdir()


def _walk(out: Path) -> Iterable[str]:
    """Paths of all files in a folder, also hidden ones."""
    return (Path(folder, name).relative_to(out).as_posix() for folder, _, names in os.walk(out) for name in names)


def _refuse_large_folders(layout: Layout, names: Iterable[str]) -> None:
    for folder, count in Counter(str(PurePosixPath(name).parent) for name in names).items():
        if count > _MAX_FILES_PER_FOLDER:
            raise DatasetError(
                f"the folder has {count:,} files", file=layout.root / folder,
                expected=f"at most {_MAX_FILES_PER_FOLDER:,} files, which dataset hosts serve",
                remedy="publish a dataset of shorter traversals",
            )  # fmt: skip


class _Upload:
    """Writes a bundle to a URL, and removes there what it does not have.

    Args:
        url: address of the bundle.

    Raises:
        UsageError: the URL cannot be opened, or has a dataset that is no bundle.
    """

    def __init__(self, url: str) -> None:
        import fsspec

        self._url = url
        try:
            self._filesystem, self._base = fsspec.core.url_to_fs(url)
        except (ImportError, ValueError) as error:
            raise UsageError(
                f"this URL cannot be opened: {error}", file=url, place="--out", expected="a folder, or a URL of fsspec"
            ) from error
        self._present = self._list()
        tops = {name.partition("/")[0] for name in self._present}
        if tops & {*DATASET_FOLDERS, "dataset.json"} and not tops & {BUNDLE, PUBLISHING}:
            raise UsageError(
                "it has a dataset that is not a published one: nothing was written", file=url, place="--out",
                expected="a new place, or that of an earlier bundle", remedy="name another place with --out",
            )  # fmt: skip

    def write(self, folder: Path, bundle: Bundle, progress: ProgressReporter) -> None:
        """Write the files; those of an earlier bundle that this one does not have are removed first."""
        progress.start("uploading", len(bundle.files) + 1)
        self._put_bytes(PUBLISHING, b"")
        others = [
            name
            for name in self._present
            if name == BUNDLE or (name.partition("/")[0] in DATASET_FOLDERS and name not in bundle.files)
        ]
        for name in others:
            self._do(name, self._filesystem.rm_file)

        def put(name: str) -> None:
            self._do(name, lambda place: self._put(folder / name, place))
            progress.advance(1)

        with thread_pool(_THREADS) as pool:
            list(pool.map(put, bundle.files))
        put(BUNDLE)
        self._do(PUBLISHING, self._filesystem.rm_file)

    def _list(self) -> list[str]:
        """Files below the URL, relative to it."""
        base = self._base.rstrip("/")
        try:
            found = self._filesystem.find(base)
        except FileNotFoundError:
            return []
        except (OSError, NotImplementedError) as error:
            raise UsageError(
                f"its files cannot be listed: {error}", file=self._url, place="--out",
                expected="a URL of a file system that lists, writes and removes files",
                remedy="publish to a folder, and upload that",
            ) from error  # fmt: skip
        return [str(path).removeprefix(base).lstrip("/") for path in found]

    def _put(self, path: Path, place: str) -> None:
        self._filesystem.makedirs(place.rpartition("/")[0], exist_ok=True)
        self._filesystem.put_file(str(path), place)

    def _put_bytes(self, name: str, data: bytes) -> None:
        def write(place: str) -> None:
            self._filesystem.makedirs(place.rpartition("/")[0], exist_ok=True)
            self._filesystem.pipe_file(place, data)

        self._do(name, write)

    def _do(self, name: str, action: Callable[[str], Any]) -> None:
        try:
            action(f"{self._base}/{name}")
        except OSError as error:
            raise DatasetError(f"cannot be written: {error}", file=f"{self._url}/{name}") from error
