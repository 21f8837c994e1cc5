"""Features of images that were seen before, by what they are: pixels, weights and mode."""

from __future__ import annotations

import hashlib
import io
import tempfile
from pathlib import Path

import numpy as np

from mirror.arrays import AnyArray, Float32


class FeatureCache:
    """A folder of features, one small file each, that several processes may use and that may be deleted at any time.

    Args:
        folder: is created.

    Attributes:
        hits: features that were there.
        misses: features that were not.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hits = self.misses = 0
        folder.mkdir(parents=True, exist_ok=True)

    def get(self, key: str) -> Float32 | None:
        """Return the feature; None if it is missing or its file is damaged."""
        try:
            content = self._path(key).read_bytes()
        except FileNotFoundError:
            content = b""
        digest, stored = content[:32], content[32:]
        if not stored or hashlib.sha256(stored).digest() != digest:
            self.misses += 1
            return None
        self.hits += 1
        feature: Float32 = np.load(io.BytesIO(stored), allow_pickle=False)
        return feature

    def put(self, key: str, feature: Float32) -> None:
        """Store a feature atomically."""
        path = self._path(key)
        path.parent.mkdir(exist_ok=True)
        stored = io.BytesIO()
        np.save(stored, feature, allow_pickle=False)
        content = stored.getvalue()
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", delete=False) as file:
            file.write(hashlib.sha256(content).digest() + content)
        Path(file.name).replace(path)

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}.feature"


def feature_key(pixels: AnyArray, identity: str) -> str:
    """Return the key of an image's or a clip's feature.

    Args:
        pixels: as they go into the network's preparation.
        identity: of weights and mode.
    """
    head = f"{identity}\n{pixels.dtype.str}\n{pixels.shape}\n".encode()
    digest = hashlib.sha256(head)
    digest.update(np.ascontiguousarray(pixels).data)
    return digest.hexdigest()
