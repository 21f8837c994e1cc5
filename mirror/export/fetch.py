"""Fetching of a published dataset: every file is verified, and an interrupted call continues when it is repeated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.dataset.store import Store
from mirror.errors import DatasetError, MirrorError
from mirror.pools import thread_pool
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.bundle import BUNDLE, Bundle
from mirror.schema.documents import FileEntry
from mirror.schema.files import parse_json, sha256_bytes, write_bytes
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.links import require_inside

_THREADS: Final = 8
_ATTEMPTS: Final = 3
_LAST: Final = "dataset.json"
"""Written after all other files: a folder without it is not a dataset."""


@dataclass(frozen=True)
class FetchReport:
    """The result of `fetch`.

    Attributes:
        bundle: the bundle's document.
        fetched: number of files that were fetched.
        kept: number of files that an earlier call had fetched.
        failed: files that could not be fetched, with the reasons.
    """

    bundle: Bundle
    fetched: int
    kept: int
    failed: tuple[tuple[str, str], ...]


def fetch(url: str, out: Path, *, progress: ProgressReporter | None = None) -> FetchReport:
    """Fetch a bundle and verify the size and the SHA-256 of every file.

    Args:
        url: folder or URL of the bundle, of any file system of fsspec (``https://``, ``s3://``, ``hf://datasets/``).
        out: new folder, or the folder of an interrupted call.
        progress: receives the progress.

    Raises:
        UsageError: `out` is a folder of another kind, or a package for the URL is missing.
        DatasetError: there is no bundle at the URL, or `out` has files of another bundle, has a link that leads out of
            it, or cannot be written.
        SchemaError: ``bundle.json`` is invalid.
    """
    reporter = progress or NullProgress()
    require_output_folder(out, FolderKind.BUNDLE)
    store = Store(url)
    text = _read_with_retries(store, BUNDLE)
    bundle = parse_json(text, Bundle, store.full_path(BUNDLE))
    if (out / BUNDLE).is_file() and (out / BUNDLE).read_bytes() != text:
        raise DatasetError(
            "the folder has files of another bundle, or of another version of it",
            file=out / BUNDLE,
            expected=f"the bundle.json of {url}",
            remedy="fetch into a new folder",
        )
    write_bytes(out / BUNDLE, text)
    names = [name for name in bundle.files if name != _LAST]
    reporter.start("fetching", len(bundle.files))

    def get(name: str) -> bool | str:
        try:
            return _get(store, name, bundle.files[name], require_inside(out, name))
        except MirrorError as error:
            return str(error)
        finally:
            reporter.advance(1)

    with thread_pool(_THREADS) as pool:
        results = dict(zip(names, pool.map(get, names)))
    if all(isinstance(result, bool) for result in results.values()) and _LAST in bundle.files:
        results[_LAST] = get(_LAST)
    return FetchReport(
        bundle,
        fetched=sum(result is True for result in results.values()),
        kept=sum(result is False for result in results.values()),
        failed=tuple((name, result) for name, result in results.items() if isinstance(result, str)),
    )


def _get(store: Store, name: str, entry: FileEntry, path: Path) -> bool:
    """Fetch a file; returns whether it was fetched, and not there already."""
    if path.is_file() and path.stat().st_size == entry.bytes and sha256_bytes(path.read_bytes()) == entry.sha256:
        return False
    data = _read_with_retries(store, name, lambda data: sha256_bytes(data) == entry.sha256)
    write_bytes(path, data)
    return True


def _read_with_retries(store: Store, name: str, is_right: Callable[[bytes], bool] = lambda data: True) -> bytes:
    problem = "the bytes differ from the hash in bundle.json"
    for _ in range(_ATTEMPTS):
        data = store.read_or_error(name)
        if isinstance(data, FileNotFoundError | NotADirectoryError):
            if name == BUNDLE:
                raise DatasetError(
                    f"not a published dataset: {BUNDLE} is missing",
                    file=store.root,
                    expected="the folder or URL of a bundle that `mirror dataset publish` wrote",
                    remedy="check the address",
                )
            raise DatasetError(
                "missing", file=store.full_path(name), expected="a file of a bundle that `mirror dataset publish` wrote"
            )
        if isinstance(data, Exception):
            problem = f"cannot be read: {data}"
        elif is_right(data):
            return data
    raise DatasetError(
        problem, file=store.full_path(name), remedy="run the same command again: it resumes where it stopped"
    )
