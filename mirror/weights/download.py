"""Downloads one file under a temporary name, verifies it and renames it; a failed download leaves no file."""

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
        target: path of the downloaded file; its folder is created.
        sha256: required SHA-256; None: not known.
        size: required size in bytes; None: not known. The download stops at a larger size.

    Raises:
        WeightsUnavailableError: the file cannot be downloaded, or has another size or hash.
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
            raise WeightsUnavailableError(
                f"the size of {url} is not {size} bytes",
                file=target,
                remedy="download it again; if that is no cure, copy the file here from another machine",
            )
        if sha256 not in (None, digest.hexdigest()):
            raise WeightsUnavailableError(
                f"{url} is another file: its sha256 is {digest.hexdigest()}",
                file=target,
                expected=f"sha256 {sha256}",
                remedy="download it again; if that is no cure, name a file that you have",
            )
        part.replace(target)
    except (urllib.error.URLError, OSError) as error:
        raise WeightsUnavailableError(
            f"{url} could not be downloaded: {error}", file=target, remedy="download it by other means"
        ) from error
    finally:
        part.unlink(missing_ok=True)
