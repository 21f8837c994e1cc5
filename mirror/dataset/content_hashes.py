"""Hashes of the inputs of derived data: of images by their bytes, of folders by their manifests."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mirror.dataset.image import Image
from mirror.dataset.layout import Layout, read_manifest
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.schema.documents import Rig
from mirror.schema.finished_work import hash_inputs


class ContentHashes:
    """Hashes of files of one dataset, computed from their bytes; videos and masks of rigs are read once.

    Args:
        store: the dataset.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._kept: dict[tuple[str, int, int], str] = {}

    def image(self, image: Image) -> str:
        """Hash an image: its bytes and, for a frame of a video, its presentation time stamp.

        Raises:
            DatasetError: it cannot be read.
        """
        return hash_inputs(self.image_bytes(vars(image)), image.video_pts)

    def image_bytes(self, row: Mapping[str, Any]) -> str:
        """Hash the bytes of an image; those of a frame of a video are the whole video.

        The bytes of an image outside of the dataset, whose row has their hash, are not read: fetching them again may
        cost as much as the work that is saved.

        Args:
            row: uri, byte_offset, byte_length, codec and sha256 of the image.

        Returns:
            SHA-256 in hexadecimal.

        Raises:
            DatasetError: they cannot be read.
        """
        if row["sha256"] is not None and "://" in row["uri"]:
            return bytes(row["sha256"]).hex()
        place = (str(row["uri"]), int(row["byte_offset"]), int(row["byte_length"]))
        if place in self._kept:
            return self._kept[place]
        try:
            digest = hashlib.sha256(self._store.read_range(*place)).hexdigest()
        except OSError as error:
            raise _unreadable_error(self._store, place[0], error) from error
        if row["codec"] == "video":
            self._kept[place] = digest
        return digest

    def file(self, path: str) -> str:
        """Hash a file of the dataset.

        Raises:
            DatasetError: it cannot be read.
        """
        try:
            return hashlib.sha256(self._store.read(path)).hexdigest()
        except OSError as error:
            raise _unreadable_error(self._store, path, error) from error

    def rig(self, rig_id: str | None) -> str:
        """Hash the document of a rig and its static masks; None: a drive without a rig.

        Raises:
            DatasetError: a file cannot be read.
        """
        if rig_id is None:
            return ""
        place = (rig_id, 0, 0)
        if place not in self._kept:
            rig = self._store.json(f"rigs/{rig_id}.json", Rig)
            masks = [self.file(f"rigs/{one.static_mask}") for one in rig.cameras if one.static_mask is not None]
            self._kept[place] = hash_inputs(rig.model_dump(mode="json"), masks)
        return self._kept[place]


def read_content(folder: Path) -> str:
    """Read the hash of the contents of a complete folder.

    Raises:
        DatasetError: the folder has no manifest.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        raise DatasetError("the folder is not complete", file=folder, remedy="mirror check lists what is missing")
    return manifest.content


def traversal_contents(layout: Layout, traversal_id: str, layers: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Read the hashes of the recorded folder of a traversal and of some of its layers, by name.

    Args:
        layout: the dataset.
        traversal_id: the traversal.
        layers: kind and ``source@version`` of the layers.

    Raises:
        DatasetError: a folder is not complete.
    """
    hashes = {f"traversal:{traversal_id}": read_content(layout.recorded(traversal_id))}
    for kind, name in layers:
        source, _, version = name.partition("@")
        hashes[f"{kind}/{name}:{traversal_id}"] = read_content(layout.layer(traversal_id, kind, source, version))
    return hashes


def _unreadable_error(store: Store, path: str, error: OSError) -> DatasetError:
    return DatasetError(
        f"cannot be read: {error.strerror or error}", file=store.full_path(path), expected="a readable file",
        remedy="restore the file",
    )  # fmt: skip
