"""Fetching of a published dataset: every file is verified, and an interrupted call continues when it is repeated."""

from __future__ import annotations

import errno
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.dataset.store import ReadError, Store
from mirror.errors import DatasetError, MirrorError
from mirror.pools import thread_pool
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.bundle import BUNDLE, Bundle
from mirror.schema.documents import FileEntry
from mirror.schema.files import TEMPORARY, parse_json, remove_temporaries, unwritable_error, write_bytes
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.links import require_inside
from mirror.weights.resolve import file_sha256

_THREADS: Final = 8
_ATTEMPTS: Final = 3
_MAX_BUNDLE: Final = 128 << 20
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
    text = _read_bundle(store)
    bundle = parse_json(text, Bundle, store.full_path(BUNDLE))
    if (out / BUNDLE).is_file() and (out / BUNDLE).read_bytes() != text:
        raise DatasetError(
            "the folder has files of another bundle, or of another version of it",
            file=out / BUNDLE,
            expected=f"the bundle.json of {url}",
            remedy="fetch into a new folder",
        )
    remove_temporaries(out)
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
    if path.is_file() and path.stat().st_size == entry.bytes and file_sha256(path) == entry.sha256:
        return False
    temporary = path.with_name(f".{path.name}.{os.getpid()}{TEMPORARY}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _try_again(store, name, lambda: _stream(store, name, entry, temporary))
        temporary.replace(path)
    except OSError as error:
        raise unwritable_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)
    return True


def _stream(store: Store, name: str, entry: FileEntry, path: Path) -> str | None:
    """Write a file piece by piece; returns what is wrong with it. No more than the stated bytes are read."""
    digest, count = hashlib.sha256(), 0
    with path.open("wb") as file:
        for piece in store.pieces(name, entry.bytes + 1):
            count += len(piece)
            digest.update(piece)
            file.write(piece)
    if count > entry.bytes:
        return f"longer than the {entry.bytes} bytes in bundle.json"
    return None if digest.hexdigest() == entry.sha256 else "the bytes differ from the hash in bundle.json"


def _read_bundle(store: Store) -> bytes:
    pieces: list[bytes] = []

    def read() -> str | None:
        pieces[:] = store.pieces(BUNDLE, _MAX_BUNDLE + 1)
        is_long = sum(map(len, pieces)) > _MAX_BUNDLE
        return f"longer than {_MAX_BUNDLE >> 20} MiB: not a bundle of `mirror dataset publish`" if is_long else None

    _try_again(store, BUNDLE, read)
    return b"".join(pieces)


def _try_again(store: Store, name: str, read: Callable[[], str | None]) -> None:
    """Read a file until nothing is wrong with it.

    Args:
        store: the bundle.
        name: the file.
        read: reads the file, and returns what is wrong with it.

    Raises:
        DatasetError: the file is missing, or each attempt failed.
    """
    problem: str | None = None
    for _ in range(_ATTEMPTS):
        try:
            problem = read()
        except ReadError as error:
            if getattr(error.reason, "errno", None) == errno.ENAMETOOLONG:
                raise error.reason from None
            if not error.is_missing:
                problem = f"cannot be read: {error.reason}"
                continue
            if name == BUNDLE:
                raise DatasetError(
                    f"not a published dataset: {BUNDLE} is missing",
                    file=store.root,
                    expected="the folder or URL of a bundle that `mirror dataset publish` wrote",
                    remedy="check the address",
                ) from error
            raise DatasetError(
                "missing", file=store.full_path(name), expected="a file of a bundle that `mirror dataset publish` wrote"
            ) from error
        if problem is None:
            return
    raise DatasetError(
        str(problem), file=store.full_path(name), remedy="run the same command again: it resumes where it stopped"
    )
