"""Destinations of files that are written once: a folder of a disk, or a place in a bucket of S3.

In a bucket a name gets its bytes by a conditional request: ``If-None-Match: *`` on PutObject and on
CompleteMultipartUpload. The server answers 412 where the name is taken, which ends the attempt: the bytes that are
there are then compared. It answers 409 while another writer is putting the same name, or has just removed it: such an
attempt is repeated.
"""

from __future__ import annotations

import hashlib
import random
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

from mirror.dataset.store import Store
from mirror.dataset.uris import S3_OPTIONS
from mirror.errors import DatasetError, UnwritableError, UsageError
from mirror.installation import install_command
from mirror.schema.commit import commit_bytes, commit_file, commit_folder, conflict_error, files_below

_SCHEME: Final = "s3://"
_TAKEN: Final = 412
_BUSY: Final = 409
_ATTEMPTS: Final = 12
_FIRST_PAUSE_S: Final = 0.05
_LONGEST_PAUSE_S: Final = 5.0
_PIECE: Final = 16 << 20
_REMOVED_AT_A_TIME: Final = 1000
_CONFLICT_REMEDY: Final = (
    "let the other run end. If none is running, an interrupted one of other input or options left it: remove what lies "
    "below the drive and its traversals in the bucket, and run the same command again"
)
PART_BYTES: Final = 50 << 20
"""A file of at least twice this size is put in parts."""


class Destination(Protocol):
    """A place below which names get their bytes once; names are relative, with ``/``."""

    @property
    def store(self) -> Store:
        """The same place for reading."""

    def commit_bytes(self, name: str, data: bytes) -> bool:
        """Create a file with its bytes, unless it exists with the same bytes; see `mirror.schema.commit`."""

    def commit_file(self, source: Path, name: str) -> bool:
        """Give the bytes of a complete file a name, unless that exists with the same bytes."""

    def commit_folder(self, source: Path, name: str, last: str) -> None:
        """Commit every file of a complete folder, the one that makes the folder complete at the end."""


class FolderDestination:
    """A folder of a disk.

    Args:
        root: the folder.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    @property
    def store(self) -> Store:
        """The same folder for reading."""
        return Store(self.root)

    def commit_bytes(self, name: str, data: bytes) -> bool:
        """Create a file with its bytes, unless it exists with the same bytes.

        Raises:
            ConflictError: it exists with other bytes.
            UnwritableError: it cannot be written.
        """
        return commit_bytes(self.root / name, data)

    def commit_file(self, source: Path, name: str) -> bool:
        """Give a complete file its final name, unless that exists with the same bytes.

        Raises:
            ConflictError: it exists with other bytes.
            UnwritableError: it cannot be written.
        """
        return commit_file(source, self.root / name)

    def commit_folder(self, source: Path, name: str, last: str) -> None:
        """Commit every file of a complete folder, the one that makes the folder complete at the end.

        Raises:
            ConflictError: a file exists with other bytes.
            UnwritableError: a file cannot be written.
        """
        commit_folder(source, self.root / name, last)


class BucketDestination:
    """A place in a bucket of S3, or of a server that speaks its protocol.

    Keys, region and the address of the server come from the environment and the configuration files of AWS, such as
    ``AWS_ACCESS_KEY_ID`` and ``AWS_ENDPOINT_URL``. It can be pickled.

    Args:
        url: ``s3://BUCKET/PATH``.

    Raises:
        UsageError: the URL has no bucket, or s3fs is not installed.
    """

    def __init__(self, url: str) -> None:
        self._place = url.removeprefix(_SCHEME).rstrip("/")
        self.url = f"{_SCHEME}{self._place}"
        if not self._place.partition("/")[0]:
            raise UsageError(f"{url!r} names no bucket", expected="s3://BUCKET/PATH")
        self._filesystem = _open_s3(self.url)
        from botocore.exceptions import BotoCoreError

        # What s3fs raises as it is: no credentials, no answer from the address, a damaged configuration file.
        self._errors = (OSError, BotoCoreError)

    def __reduce__(self) -> tuple[Callable[..., BucketDestination], tuple[str]]:
        return (BucketDestination, (self.url,))

    @property
    def store(self) -> Store:
        """The same place for reading."""
        return Store(self.url)

    def commit_bytes(self, name: str, data: bytes) -> bool:
        """Create an object with its bytes, unless it exists with the same bytes.

        Raises:
            ConflictError: it exists with other bytes.
            UnwritableError: it cannot be written.
        """

        def put(place: str) -> None:
            self._filesystem.pipe_file(place, data, chunksize=PART_BYTES, mode="create")

        return self._commit(name, put, len(data), lambda: hashlib.sha256(data).hexdigest())

    def commit_file(self, source: Path, name: str) -> bool:
        """Create an object with the bytes of a file, unless it exists with the same bytes.

        Raises:
            ConflictError: it exists with other bytes.
            UnwritableError: it cannot be written, or the file cannot be read.
        """

        def put(place: str) -> None:
            self._filesystem.put_file(str(source), place, chunksize=PART_BYTES, mode="create")

        return self._commit(name, put, source.stat().st_size, lambda: _file_sha256(source))

    def commit_folder(self, source: Path, name: str, last: str) -> None:
        """Commit every file of a complete folder, the one that makes the folder complete at the end.

        Raises:
            ConflictError: an object exists with other bytes.
            UnwritableError: an object cannot be written.
        """
        for path in sorted(files_below(source)):
            if path != last:
                self.commit_file(source / path, f"{name}/{path}")
        self.commit_file(source / last, f"{name}/{last}")

    def remove(self, names: Sequence[str]) -> None:
        """Remove objects, a thousand a request; those that are gone already are done.

        Raises:
            UnwritableError: one cannot be removed.
        """
        for start in range(0, len(names), _REMOVED_AT_A_TIME):
            some = names[start : start + _REMOVED_AT_A_TIME]
            try:
                self._filesystem.rm([f"{self._place}/{name}" for name in some])
            except self._errors as error:
                raise self._unwritable_error(some[0], error) from error

    def require_conditional_puts(self, name: str, data: bytes) -> None:
        """Require that the server refuses to put a name that is taken.

        Args:
            name: of an object that exists.
            data: its bytes.

        Raises:
            UsageError: the server put it again: it ignores ``If-None-Match``.
        """
        try:
            self._filesystem.pipe_file(f"{self._place}/{name}", data, mode="create")
        except self._errors as error:
            if _status(error) == _TAKEN:
                return
            raise self._unwritable_error(name, error) from error
        raise UsageError(
            "the server put a name that was taken: it ignores If-None-Match, so that writers overwrite each other",
            file=self.url,
            expected="S3, or a server with conditional writes",
            remedy="write into a folder, and copy it to the bucket when no run writes it",
        )

    def read_tagged(self, name: str) -> tuple[bytes, str] | None:
        """Read an object with the tag that identifies its bytes; None: there is none.

        Raises:
            UnwritableError: the bucket does not answer, or may not be read.
        """
        from fsspec.asyn import sync

        async def get() -> tuple[bytes, str]:
            bucket, _, key = f"{self._place}/{name}".partition("/")
            answer = await self._filesystem._call_s3("get_object", Bucket=bucket, Key=key)
            return await answer["Body"].read(), str(answer["ETag"])

        try:
            found: tuple[bytes, str] = sync(self._filesystem.loop, get)
        except FileNotFoundError:
            return None
        except self._errors as error:
            raise self._unwritable_error(name, error) from error
        return found

    def put_tagged(self, name: str, data: bytes, tag: str | None) -> str | None:
        """Put an object under the condition that it is as it was read, or that there is none.

        Args:
            name: of the object.
            data: its bytes.
            tag: what `read_tagged` or this method returned; None: there must be no such object.

        Returns:
            The tag of the bytes that were put; None: the condition does not hold, and nothing was put.

        Raises:
            UnwritableError: it cannot be written.
        """
        bucket, _, key = f"{self._place}/{name}".partition("/")
        condition = {"IfNoneMatch": "*"} if tag is None else {"IfMatch": tag}
        try:
            answer = self._filesystem.call_s3("put_object", Bucket=bucket, Key=key, Body=data, **condition)
        except self._errors as error:
            # Another writer was first, or is just putting it; or the object is gone.
            if _status(error) in (_TAKEN, _BUSY) or isinstance(error, FileNotFoundError):
                return None
            raise self._unwritable_error(name, error) from error
        return str(answer["ETag"])

    def _commit(self, name: str, put: Callable[[str], None], size: int, digest: Callable[[], str]) -> bool:
        place = f"{self._place}/{name}"
        left, pause_s = _ATTEMPTS, _FIRST_PAUSE_S
        while True:
            left -= 1
            try:
                put(place)
            except self._errors as error:
                status = _status(error)
                if status == _TAKEN:
                    self._require_equal(name, size, digest())
                    return False
                if status != _BUSY or not left:
                    raise self._unwritable_error(name, error) from error
                # Writers that wait for each other must not come back together.
                time.sleep(pause_s * random.uniform(0.5, 1.0))
                pause_s = min(2.0 * pause_s, _LONGEST_PAUSE_S)
            else:
                return True

    def _require_equal(self, name: str, size: int, mine: str) -> None:
        place, found, count = f"{self._place}/{name}", hashlib.sha256(), 0
        try:
            if size <= _PIECE:
                data = self._filesystem.cat_file(place)
                found.update(data)
                count = len(data)
            while size > _PIECE and count <= size:
                data = self._filesystem.cat_file(place, start=count, end=min(count + _PIECE, size + 1))
                if not data:
                    break
                found.update(data)
                count += len(data)
        except self._errors as error:
            raise self._unwritable_error(name, error) from error
        if count != size or found.hexdigest() != mine:
            raise conflict_error(f"{self.url}/{name}", mine, found.hexdigest(), _CONFLICT_REMEDY)

    def _unwritable_error(self, name: str, error: Exception) -> UnwritableError:
        return UnwritableError(
            f"cannot be written: {getattr(error, 'strerror', None) or error}",
            file=f"{self.url}/{name}",
            expected="a bucket that exists, and keys that may read, list and write it",
            remedy="correct the address, or AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT_URL "
            "in the environment, then run the same command again: it resumes where it stopped",
        )


def bucket_at(url: str) -> BucketDestination:
    """Return the place in a bucket that a URL names.

    Args:
        url: ``s3://BUCKET/PATH``.

    Raises:
        UsageError: it is a URL of another store, or a package is missing.
    """
    if not url.startswith(_SCHEME):
        raise UsageError(
            "nothing is written to this store: it is not known to refuse a name that is taken",
            file=url,
            expected="a folder, or s3://BUCKET/PATH",
            remedy="write into a folder, and copy it when no run writes it",
        )
    return BucketDestination(url)


def _open_s3(url: str) -> Any:
    try:
        import s3fs
    except ImportError as error:
        raise UsageError(f"{error}", file=url, expected="the package s3fs", remedy=install_command("s3")) from error
    return s3fs.S3FileSystem(**S3_OPTIONS)


def _status(error: BaseException) -> int | None:
    """The HTTP status of an answer that refused a request; None: there was no answer."""
    cause: BaseException | None = error
    while cause is not None:
        response = getattr(cause, "response", None)
        if isinstance(response, dict):
            status = response.get("ResponseMetadata", {}).get("HTTPStatusCode")
            return None if status is None else int(status)
        cause = cause.__cause__
    return None


def _file_sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror or error}", file=path) from error
