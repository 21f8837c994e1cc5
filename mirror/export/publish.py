"""Publishing of a dataset: a bundle of files without held-out images, with datasheet, licence and hashes."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.dataset import open as open_dataset
from mirror.dataset.dataset import Dataset
from mirror.dataset.index.build import build_index
from mirror.dataset.layout import Layout, require_dataset
from mirror.dataset.lock import writer_lock
from mirror.dataset.split_document import read_split
from mirror.errors import DatasetError, UsageError
from mirror.export.datasheet import write_datasheet
from mirror.methods.training_images import list_scored_images
from mirror.pools import thread_pool
from mirror.progress import NullProgress, ProgressReporter
from mirror.protocols.document import Protocol
from mirror.protocols.views import plan_views
from mirror.schema.bundle import BUNDLE, PUBLISHING, Bundle
from mirror.schema.documents import FileEntry, SplitDocument
from mirror.schema.files import sha256_bytes, unwritable_error, write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder

_LAYERS: Final = frozenset({"poses", "calibrations", "boxes", "masks", "redaction"})
"""Kinds of layers that are published; depth and points may contain what held-out images show."""

_FOLDERS: Final = ("drives", "index", "maps", "rigs", "splits", "traversals")
"""Folders of a dataset, in which a repeated call removes files."""

_MAX_FILES_PER_FOLDER: Final = 10_000
"""Limit of the Hugging Face hub, which serves larger folders badly."""

_THREADS: Final = 8


@dataclass(frozen=True)
class PublishOptions:
    """What is published.

    Attributes:
        split: the split whose held-out traversals are withheld.
        protocols: protocols whose truth is withheld.
        name: title of the dataset.
        licence: licence of the data; None: that of the dataset.
        contact: where to ask for the removal of data.
    """

    split: str
    protocols: tuple[Protocol, ...]
    name: str
    licence: str | None = None
    contact: str | None = None


def publish(root: Path, out: str, options: PublishOptions, *, progress: ProgressReporter | None = None) -> Bundle:
    """Write a bundle of a dataset without the images by which submissions are scored.

    Tables, splits, calibrations, boxes and masks are complete, so that hashes of splits and plans are those of the
    dataset. An interrupted call to a local folder continues when it is repeated; files of an earlier call that this one
    does not publish are removed.

    Args:
        root: folder of the dataset.
        out: folder of the bundle, or a URL that fsspec can write (``s3://bucket/name``).
        options: see `PublishOptions`.
        progress: receives the progress.

    Returns:
        The bundle's document, which is written last.

    Raises:
        UsageError: `out` is a folder of another kind, or no licence is stated.
        DatasetError: the dataset or the split does not exist, images lie outside of the dataset, a folder has too many
            files, or a file cannot be written.
    """
    reporter = progress or NullProgress()
    layout = Layout(root)
    require_dataset(layout)
    if "://" not in out:
        require_output_folder(Path(out), FolderKind.BUNDLE)
        return _publish(layout, Path(out), options, reporter)
    with tempfile.TemporaryDirectory() as folder:
        bundle = _publish(layout, Path(folder), options, reporter)
        _upload(Path(folder), out, bundle, reporter)
    return bundle


def _publish(layout: Layout, out: Path, options: PublishOptions, progress: ProgressReporter) -> Bundle:
    dataset = open_dataset(layout.root)
    licence = options.licence or dataset.document.licence
    if not licence:
        raise UsageError(
            "the dataset states no licence", file=layout.document, place="--licence",
            expected="the SPDX identifier or the name of a licence, such as CC-BY-4.0",
        )  # fmt: skip
    split = read_split(dataset.store, options.split)
    withheld = _list_withheld(dataset, split, options.protocols)
    names = [name for name in _list_files(layout.root) if name not in withheld]
    # The folder counts as a bundle again once its new document is written.
    write_bytes(out / PUBLISHING, b"")
    (out / BUNDLE).unlink(missing_ok=True)
    _remove_others(out, frozenset(names))
    progress.start("copying", len(names))

    def copy(name: str) -> None:
        _place(layout.root / name, out / name)
        progress.advance(1)

    with thread_pool(_THREADS) as pool:
        list(pool.map(copy, names))
    with writer_lock(Layout(out), wait=False):
        build_index(out)
    write_bytes(out / "LICENSE", f"The data of this dataset is licensed under: {licence}\n".encode())
    files = _hash_files(out, progress)
    bundle = Bundle(
        split=options.split,
        protocols=tuple(protocol.name for protocol in options.protocols),
        dataset_hash=split.dataset_hash,
        licence=licence,
        files=files,
        withheld=tuple(sorted(withheld)),
    )
    sheet = write_datasheet(dataset, bundle, name=options.name, contact=options.contact).encode()
    write_bytes(out / "README.md", sheet)
    files["README.md"] = FileEntry(bytes=len(sheet), sha256=sha256_bytes(sheet))
    bundle = bundle.model_copy(update={"files": dict(sorted(files.items()))})
    write_json(out / BUNDLE, bundle)
    (out / PUBLISHING).unlink()
    return bundle


def _remove_others(out: Path, names: frozenset[str]) -> None:
    """Remove what an earlier call left in the dataset's folders and this one does not publish; other files stay."""
    for top in _FOLDERS:
        for folder, folders, files in os.walk(out / top, topdown=False):
            for file in files:
                path = Path(folder, file)
                if path.relative_to(out).as_posix() not in names:
                    path.unlink()
            for name in folders:
                with suppress(OSError):
                    Path(folder, name).rmdir()


def _list_withheld(dataset: Dataset, split: SplitDocument, protocols: Sequence[Protocol]) -> frozenset[str]:
    """Paths of the images of held-out traversals, and of those that a protocol scores."""
    hidden = {key for key, role in split.assignments.items() if role not in ("train", "unused")}
    scored = {key for protocol in protocols for key in list_scored_images(plan_views(dataset, protocol, split.name))}
    columns = ["traversal_id", "camera", "timestamp_ns", "uri"]
    rows = dataset.table("images", columns).to_pylist()
    outside = next((row for row in rows if "://" in row["uri"] or row["uri"].startswith("/")), None)
    if outside is not None:
        raise DatasetError(
            f"the image {outside['uri']} lies outside of the dataset",
            file=dataset.root,
            place=f"traversal {outside['traversal_id']}, camera {outside['camera']}",
            expected="images in the dataset's folder",
            remedy="ingest the recordings without references to images elsewhere",
        )
    withheld = {
        row["uri"]
        for row in rows
        if row["traversal_id"] in hidden or (row["traversal_id"], row["camera"], row["timestamp_ns"]) in scored
    }
    kept = {row["uri"] for row in rows} - withheld
    shared = next((row["uri"] for row in rows if row["uri"] in withheld and row["uri"] in kept), None)
    if shared is not None:
        raise DatasetError(f"{shared} holds published and withheld images", file=dataset.root)
    return frozenset(withheld)


def _list_files(root: Path) -> Iterator[str]:
    """Paths of a dataset's files, without the index, temporary files and layers that are not published."""
    for folder, folders, names in os.walk(root):
        relative = Path(folder).relative_to(root)
        parts = relative.parts
        if len(parts) == 3 and parts[0] == "traversals" and parts[2] == "layers":
            folders[:] = [name for name in folders if name in _LAYERS]
        folders[:] = sorted(
            name for name in folders if not name.startswith(".") and not (not parts and name == "index")
        )
        if len(names) > _MAX_FILES_PER_FOLDER:
            raise DatasetError(
                f"the folder has {len(names):,} files", file=root / relative,
                expected=f"at most {_MAX_FILES_PER_FOLDER:,} files, which dataset hosts serve",
                remedy="publish a dataset of shorter traversals",
            )  # fmt: skip
        yield from (str(relative / name) for name in sorted(names) if not name.startswith("."))


def _place(source: Path, target: Path) -> None:
    """Copy a file; a hard link suffices for images, which are never opened for writing."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.suffix in (".jpg", ".jpeg", ".png"):
            if target.exists():
                return
            try:
                os.link(source, target)
                return
            except OSError:
                pass
        temporary = target.with_name(f".{target.name}.tmp")
        shutil.copyfile(source, temporary)
        temporary.replace(target)
    except OSError as error:
        raise unwritable_error(target, error) from error


def _hash_files(out: Path, progress: ProgressReporter) -> dict[str, FileEntry]:
    names = sorted(
        str(path.relative_to(out))
        for path in out.rglob("*")
        if path.is_file() and path.name not in (BUNDLE, "README.md")
        if not any(part.startswith(".") for part in path.relative_to(out).parts)
    )
    progress.start("hashing", len(names))

    def entry(name: str) -> FileEntry:
        data = (out / name).read_bytes()
        progress.advance(1)
        return FileEntry(bytes=len(data), sha256=sha256_bytes(data))

    with thread_pool(_THREADS) as pool:
        return dict(zip(names, pool.map(entry, names)))


def _upload(folder: Path, url: str, bundle: Bundle, progress: ProgressReporter) -> None:
    import fsspec

    try:
        filesystem, base = fsspec.core.url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise UsageError(
            f"this URL cannot be opened: {error}", file=url, place="--out", expected="a folder, or a URL of fsspec"
        ) from error
    progress.start("uploading", len(bundle.files) + 1)

    def put(name: str) -> None:
        try:
            filesystem.makedirs(f"{base}/{Path(name).parent}", exist_ok=True)
            filesystem.put_file(str(folder / name), f"{base}/{name}")
        except OSError as error:
            raise DatasetError(f"cannot be written: {error}", file=f"{url}/{name}") from error
        progress.advance(1)

    with thread_pool(_THREADS) as pool:
        list(pool.map(put, bundle.files))
    put(BUNDLE)
