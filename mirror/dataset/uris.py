"""Absolute uris of fsspec: their file systems, the tags that stores give to bytes, and reads that require a tag."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from mirror.errors import DatasetError

_READERS: Final = {"s3": "s3fs", "gs": "gcsfs", "gcs": "gcsfs", "abfs": "adlfs", "az": "adlfs", "https": "aiohttp"}
"""Packages that fsspec needs to read URLs, by scheme."""
S3_OPTIONS: Final = {"max_concurrency": 1}
"""Options of the file system for S3: with several ranges at a time, reading an object asks for its size first."""
_CHANGED: Final = 412


def resolve_uri(uri: str) -> tuple[Any, str]:
    """Convert an absolute uri to an fsspec file system and a path in it.

    Raises:
        DatasetError: no installed package reads it.
    """
    import fsspec

    try:
        filesystem, path = fsspec.core.url_to_fs(uri, **uri_options(uri))
    except (ImportError, ValueError) as error:
        raise DatasetError(
            f"this uri cannot be opened: {error}",
            file=uri,
            expected="a uri that fsspec reads with the packages installed here",
            remedy=install_hint(uri),
        ) from error
    return filesystem, path


def uri_etag(entry: Mapping[str, Any]) -> str | None:
    """Return the ETag in what a file system of fsspec says of a file, without quotation marks; None: there is none."""
    etag = entry.get("ETag")
    return None if etag is None else str(etag).strip('"')


def read_tagged(filesystem: Any, path: str, uri: str, length: int, etag: str) -> bytes:
    """Read the first bytes of a file whose tag must be the one that is known.

    Args:
        filesystem: of fsspec.
        path: of the file in it.
        uri: of the file, for messages.
        length: most bytes that are read.
        etag: the tag.

    Raises:
        DatasetError: it has another tag.
        OSError: it cannot be read.
    """
    if not hasattr(filesystem, "_call_s3"):
        # The tag is asked for before; other stores do not compare it with the request.
        found = uri_etag(filesystem.info(path))
        if found != etag:
            raise changed_error(uri, f"has the ETag {found}", f"ETag {etag}")
        return bytes(filesystem.cat_file(path, start=0, end=length))
    from fsspec.asyn import sync

    bucket, key, _ = filesystem.split_path(path)

    async def get() -> bytes:
        answer = await filesystem._call_s3(
            "get_object", Bucket=bucket, Key=key, Range=f"bytes=0-{length - 1}", IfMatch=f'"{etag}"'
        )
        return bytes(await answer["Body"].read())

    try:
        return bytes(sync(filesystem.loop, get))
    except OSError as error:
        if _is_precondition(error):
            raise changed_error(uri, "has another ETag", f"ETag {etag}") from error
        raise


def _is_precondition(error: BaseException | None) -> bool:
    """Return whether S3 refused a request because its condition does not hold."""
    while error is not None:
        response = getattr(error, "response", None)
        if isinstance(response, dict):
            return bool(response.get("ResponseMetadata", {}).get("HTTPStatusCode") == _CHANGED)
        error = error.__cause__
    return False


def changed_error(uri: str, problem: str, expected: str) -> DatasetError:
    """Make the error for a file that is not as it was when it was ingested."""
    return DatasetError(
        f"{problem}: it was changed since it was ingested", file=uri, expected=expected,
        remedy="restore it, or `mirror ingest RECORDING... --replace`",
    )  # fmt: skip


def uri_options(url: str) -> dict[str, Any]:
    """Return the options of the file system of a URL."""
    return S3_OPTIONS if url.startswith("s3://") else {}


def install_hint(url: str) -> str:
    """Return what to install for a URL."""
    scheme = url.partition(":")[0]
    if scheme in _READERS:
        return f"pip install {_READERS[scheme]}"
    return f"install the package with which fsspec reads {scheme}://"
