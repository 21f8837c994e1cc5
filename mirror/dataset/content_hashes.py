"""Hashes of the inputs of derived data: of images by their bytes, of folders by their manifests."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.image import Image
from mirror.dataset.layout import MANIFEST
from mirror.dataset.store import Store
from mirror.errors import DatasetError
from mirror.schema.documents import Manifest, Rig
from mirror.schema.finished_work import hash_values


class ContentHashes:
    """Hashes of the files of one dataset, from their bytes; videos, rigs and manifests are read once.

    Args:
        store: the dataset.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._kept: dict[object, str] = {}

    def image(self, image: Image) -> str:
        """Hash an image: its bytes and, for a frame of a video, its presentation time stamp.

        Raises:
            DatasetError: it cannot be read.
        """
        return hash_values(self.image_bytes(vars(image)), image.video_pts)

    def image_bytes(self, row: Mapping[str, Any]) -> str:
        """Hash the bytes of an image; for a frame of a video, the bytes of the whole video.

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

    def frame(self, frame: Frame, conditions: str, *, images: bool = True) -> str:
        """Hash a frame: its images and the tables that it depends on; an unreadable image has no hash.

        Args:
            frame: the frame.
            conditions: hash of everything else that is read, such as that of `view`.
            images: False: nothing reads the images, and only their cameras and times are hashed.
        """
        found: list[object] = []
        for camera, image in frame.images.items():
            try:
                found.append([camera, image.timestamp_ns, self.image(image) if images else None])
            except DatasetError:
                found.append([camera, image.timestamp_ns, None])
        return hash_values(conditions, found)

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
        """Hash the document of a rig and its static masks; None for a drive without a rig.

        Raises:
            DatasetError: a file cannot be read.
        """
        if rig_id is None:
            return ""
        if rig_id not in self._kept:
            rig = self._store.json(f"rigs/{rig_id}.json", Rig)
            masks = [self.file(f"rigs/{one.static_mask}") for one in rig.cameras if one.static_mask is not None]
            self._kept[rig_id] = hash_values(rig.model_dump(mode="json"), masks)
        return self._kept[rig_id]

    def folder(self, path: str) -> str:
        """Read the hash of the contents of a complete folder.

        Raises:
            DatasetError: the folder has no manifest.
        """
        if path not in self._kept:
            self._kept[path] = self._store.json(f"{path}/{MANIFEST}", Manifest).content
        return self._kept[path]

    def traversal(self, traversal_id: str, layers: Iterable[str]) -> dict[str, str]:
        """Read the hashes of the recorded folder of a traversal and of some of its layers, by name.

        Args:
            traversal_id: the traversal.
            layers: names ``kind/source@version``.

        Raises:
            DatasetError: a folder is not complete.
        """
        folder = f"traversals/{traversal_id}"
        hashes = {f"traversal:{traversal_id}": self.folder(f"{folder}/recorded")}
        return hashes | {f"{name}:{traversal_id}": self.folder(f"{folder}/layers/{name}") for name in layers}

    def view(self, view: Dataset) -> str:
        """Hash the tables that a view of one traversal reads: recorded tables, chosen layers, and the rig.

        Raises:
            DatasetError: a file cannot be read.
        """
        (row,) = view.table("traversals", ["traversal_id", "rig_id", "layers"]).to_pylist()
        chosen = {f"{kind}/{name}" for kind, name in vars(view.layers).items()}
        layers = [name for name in row["layers"] if name in chosen]
        return hash_values(self.traversal(row["traversal_id"], layers), self.rig(row["rig_id"]), view.layers.stage)


def _unreadable_error(store: Store, path: str, error: OSError) -> DatasetError:
    return DatasetError(
        f"cannot be read: {error.strerror or error}", file=store.full_path(path), expected="a readable file",
        remedy="restore the file",
    )  # fmt: skip
