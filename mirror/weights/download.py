"""Download one file: to a part beside it, verified, flushed, then named; a broken download leaves nothing behind."""

from __future__ import annotations

import hashlib
import os
import tempfile
import urllib.error
import urllib.request
from pathlib import Path

from mirror.weights.errors import WeightsUnavailableError

_BLOCK = 1 << 20
_TIMEOUT_S = 60.0


def download(url: str, target: Path, *, sha256: str | None, size: int | None = None) -> None:
    """Download a file that has a known hash.

    Args:
        url: http, https or file.
        target: what the file shall be called; its folder is created.
        sha256: that it must have; None: not known.
        size: bytes that it must have; None: not known. More are not read.

    Raises:
        WeightsUnavailableError: it cannot be had, or is not what it should be.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, count = hashlib.sha256(), 0
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
    part = Path(name)
    try:
        with os.fdopen(handle, "wb") as file, urllib.request.urlopen(url, timeout=_TIMEOUT_S) as source:
            while block := source.read(_BLOCK):
                count += len(block)
                if size is not None and count > size:
                    break
                digest.update(block)
                file.write(block)
            file.flush()
            os.fsync(file.fileno())
        if size is not None and count != size:
            raise WeightsUnavailableError(f"{url} has another size than {size} bytes", file=target)
        if sha256 not in (None, digest.hexdigest()):
            raise WeightsUnavailableError(
                f"{url} is another file: its sha256 is {digest.hexdigest()}", file=target, expected=f"sha256 {sha256}"
            )
        part.replace(target)
    except (urllib.error.URLError, OSError) as error:
        raise WeightsUnavailableError(
            f"{url} could not be downloaded: {error}", file=target, remedy="download it by other means"
        ) from error
    finally:
        part.unlink(missing_ok=True)
