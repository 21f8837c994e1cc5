"""Creates, replaces and removes the file of a lease, in a folder or a bucket, under conditions only.

In a folder it is created by a hard link. Its holder writes to the file that it created, never to the name; whoever
takes it over renames it away, reads it again, and puts it back if its holder has renewed it meanwhile. In a bucket,
``If-None-Match: *`` creates it and ``If-Match`` replaces it. No lock of a file system is needed.
"""

from __future__ import annotations

import errno
import os
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple, Protocol

from mirror.dataset.destination import BucketDestination, Destination, FolderDestination
from mirror.errors import UsageError
from mirror.schema.files import temporary_path, unwritable_error

NAME: Final = ".lease.json"
_NO_LINKS: Final = (errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EMLINK, errno.ENOSYS)
_NO_ETAG: Final = '"0"'


class SeenLease(NamedTuple):
    """The bytes of a lease file as somebody read them.

    Attributes:
        data: the bytes.
        tag: identifies them in a bucket; empty in a folder.
    """

    data: bytes
    tag: str


class LeaseFile(Protocol):
    """A file that is changed only under the conditions of its methods."""

    @property
    def place(self) -> str:
        """Its path or URL, for messages."""

    def read(self) -> SeenLease | None:
        """Read it; None: there is none."""

    def create(self, data: bytes) -> bool:
        """Create it; False: there is one."""

    def take(self, seen: SeenLease, data: bytes) -> bool:
        """Replace what was read; False: it is another one by now."""

    def renew(self, data: bytes) -> bool:
        """Replace what this object created or took; False: it is another's by now."""

    def remove(self) -> None:
        """Give up what this object created or took; another's stays."""


class FolderLeaseFile:
    """The file of a lease in a folder; all its contents have the same length.

    Args:
        folder: the dataset's folder.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / NAME
        self._handle: int | None = None

    @property
    def place(self) -> str:
        """Its path, for messages."""
        return str(self._path)

    def read(self) -> SeenLease | None:
        """Read it; None: there is none.

        Raises:
            OSError: it cannot be read.
        """
        try:
            return SeenLease(self._path.read_bytes(), "")
        except FileNotFoundError:
            return None

    def create(self, data: bytes) -> bool:
        """Create it; False: there is one.

        Raises:
            UnwritableError: the folder cannot be written.
        """
        temporary = temporary_path(self._path)
        try:
            handle = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
            try:
                _write(handle, data)
                os.link(temporary, self._path)
            except FileExistsError:
                os.close(handle)
                return False
            except OSError as error:
                os.close(handle)
                if error.errno not in _NO_LINKS:
                    raise
                try:
                    handle = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
                except FileExistsError:
                    return False
                _write(handle, data)
        except OSError as error:
            raise unwritable_error(self._path, error) from error
        finally:
            temporary.unlink(missing_ok=True)
        self._handle = handle
        return True

    def take(self, seen: SeenLease, data: bytes) -> bool:
        """Replace what was read; False: it is another one by now.

        Raises:
            UnwritableError: the folder cannot be written.
        """
        aside = temporary_path(self._path)
        try:
            self._path.rename(aside)
            if aside.read_bytes() == seen.data:
                return self.create(data)
            # Its holder renewed it: it goes back, unless a third one has a lease now.
            with suppress(FileExistsError):
                os.link(aside, self._path)
            return False
        except FileNotFoundError:
            return False
        except OSError as error:
            raise unwritable_error(self._path, error) from error
        finally:
            aside.unlink(missing_ok=True)

    def renew(self, data: bytes) -> bool:
        """Write to the file that this object created; False: the name is another's by now.

        Raises:
            OSError: it cannot be written.
        """
        if self._handle is None:
            return False
        _write(self._handle, data)
        return self._is_own()

    def remove(self) -> None:
        """Remove the file if it is the one that this object created."""
        if self._handle is None:
            return
        try:
            if self._is_own():
                self._path.unlink(missing_ok=True)
        finally:
            os.close(self._handle)
            self._handle = None

    def _is_own(self) -> bool:
        try:
            return self._handle is not None and os.path.samestat(os.fstat(self._handle), self._path.stat())
        except FileNotFoundError:
            return False


class BucketLeaseFile:
    """The object of a lease in a bucket. It stays when it is given up, with content that says so.

    Args:
        bucket: the dataset's place.
        given_up: that content.
    """

    def __init__(self, bucket: BucketDestination, given_up: bytes) -> None:
        self._bucket = bucket
        self._given_up = given_up
        self._tag: str | None = None

    @property
    def place(self) -> str:
        """Its URL, for messages."""
        return f"{self._bucket.url}/{NAME}"

    def read(self) -> SeenLease | None:
        """Read it; None: there is none.

        Raises:
            UnwritableError: the bucket does not answer.
        """
        found = self._bucket.read_tagged(NAME)
        return None if found is None else SeenLease(*found)

    def create(self, data: bytes) -> bool:
        """Create it; False: there is one.

        Raises:
            UnwritableError: the bucket cannot be written.
            UsageError: the server ignores ``If-Match``.
        """
        self._tag = self._bucket.put_tagged(NAME, data, None)
        return self._is_conditional(data)

    def take(self, seen: SeenLease, data: bytes) -> bool:
        """Replace what was read; False: it is another one by now.

        Raises:
            UnwritableError: the bucket cannot be written.
            UsageError: the server ignores ``If-Match``.
        """
        self._tag = self._bucket.put_tagged(NAME, data, seen.tag)
        return self._is_conditional(data)

    def renew(self, data: bytes) -> bool:
        """Replace what this object created or took; False: it is another's by now.

        Raises:
            UnwritableError: the bucket cannot be written.
        """
        if self._tag is not None:
            self._tag = self._bucket.put_tagged(NAME, data, self._tag)
        return self._tag is not None

    def remove(self) -> None:
        """Put the content that says that nobody has the lease, unless it is another's by now.

        Raises:
            UnwritableError: the bucket cannot be written.
        """
        self.renew(self._given_up)
        self._tag = None

    def _is_conditional(self, data: bytes) -> bool:
        """Return whether the object is this one's; a put that must fail shows that the server keeps the condition."""
        if self._tag is None:
            return False
        if self._bucket.put_tagged(NAME, data, _NO_ETAG) is None:
            return True
        raise UsageError(
            "the server replaced an object in spite of If-Match: it cannot hold a lease", file=self.place,
            expected="S3, or a server with conditional writes",
            remedy="copy the dataset into a folder, and run the command there",
        )  # fmt: skip


def lease_file(destination: Destination, given_up: bytes) -> LeaseFile:
    """Return the file of a dataset's lease.

    Args:
        destination: the dataset.
        given_up: content that says that nobody has the lease, for buckets.

    Raises:
        UsageError: the destination is neither a folder nor a bucket.
    """
    if isinstance(destination, FolderDestination):
        return FolderLeaseFile(destination.root)
    if isinstance(destination, BucketDestination):
        return BucketLeaseFile(destination, given_up)
    raise UsageError(f"a {type(destination).__name__} has no lease", expected="a folder or a bucket of S3")


def _write(handle: int, data: bytes) -> None:
    os.pwrite(handle, data, 0)
    os.fsync(handle)
