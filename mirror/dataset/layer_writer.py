"""Writing a layer of a traversal: first its files, then its table, then its manifest. No layer is overwritten."""

from __future__ import annotations

import hashlib
import re
import shutil
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from mirror.dataset.generation import supersede
from mirror.dataset.images.shards import pack_images
from mirror.dataset.layout import MANIFEST, Layout, seal
from mirror.dataset.owned_folder import OwnedFolder, abandoned_folders
from mirror.dataset.redaction import REDACTION, current_redaction
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import Manifest
from mirror.schema.files import encode_table, read_json, unwritable_error, write_bytes
from mirror.schema.tables import Table

RECORDED: Final = "recorded"
"""The key under which layers record the hash of the recorded traversal."""


def require_layer_name(source: str, version: str) -> None:
    """Refuse a source or version that cannot be part of a folder's name; verbs call it before their work.

    Raises:
        UsageError: one of them has other characters than letters, digits, `_`, `-` and `.`, or begins with a sign.
    """
    for name in (source, version):
        if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.\-]*", name) is None:
            raise UsageError(f"{name!r} cannot name a layer", expected="letters, digits, `_`, `-` and `.`")


@dataclass
class LayerWriter:
    """A writer of one layer; the caller holds the dataset's writer lock.

    It writes to a work folder, which is renamed to the layer when it is complete. The next writer of the same layer
    removes the work folder of an interrupted run (see `mirror.dataset.owned_folder`).

    Attributes:
        layout: the dataset.
        traversal_id: the traversal.
        kind: kind of the layer: the name of its parent folder.
        source: program that makes the layer.
        version: version of the source.
        inputs: hashes of the inputs of the layer, by name (see `mirror.dataset.derived_layer`).

    Raises:
        UsageError: the source or version is not valid in a folder's name.
        DatasetError: the traversal does not exist, or the layer exists already.
    """

    layout: Layout
    traversal_id: str
    kind: str
    source: str
    version: str
    inputs: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.folder = self.layout.layer(self.traversal_id, self.kind, self.source, self.version)
        require_layer_name(self.source, self.version)
        recorded = self.layout.recorded(self.traversal_id)
        if not (recorded / MANIFEST).is_file():
            raise DatasetError("there is no such traversal", file=recorded, remedy="check the id: `mirror info`")
        if (self.folder / MANIFEST).is_file():
            raise self._exists_error()
        work_name = f".{self.folder.name}"
        for abandoned in abandoned_folders(self.folder.parent, work_name):
            shutil.rmtree(abandoned, ignore_errors=True)
        self._work = OwnedFolder(self.folder.parent, work_name)
        self._documents: dict[str, bytes] = {}
        # Removes the work folder of a writer that is dropped before `finish`.
        weakref.finalize(self, self._work.remove)

    def file(self, name: str, data: bytes) -> dict[str, object]:
        """Write a file of the layer.

        Args:
            name: relative to the layer's folder.
            data: its bytes.

        Returns:
            The columns uri, byte_length and sha256 of the file's row.
        """
        write_bytes(self._work.path / name, data)
        return {
            "uri": (self.folder / name).relative_to(self.layout.root).as_posix(),
            "byte_length": len(data),
            "sha256": hashlib.sha256(data).digest(),
        }

    def document(self, name: str, data: bytes) -> None:
        """Write a file that the layer's manifest lists, such as a log.

        Args:
            name: relative to the layer's folder.
            data: its bytes.
        """
        write_bytes(self._work.path / name, data)
        self._documents[name] = data

    def pack(self, images: pa.Table) -> pa.Table:
        """Move the written images of the layer side by side into tar archives, frame by frame.

        Args:
            images: rows of the table IMAGES, whose files this writer has written.

        Returns:
            The rows, with the images' places in the archives.

        Raises:
            DatasetError: a file cannot be read or written.
        """
        final, work = (folder.relative_to(self.layout.root).as_posix() for folder in (self.folder, self._work.path))
        packed = pack_images(_moved(images, final, work), self.layout.root, work)
        return _moved(packed, work, final)

    def finish(
        self, table: Table, data: pa.Table | Sequence[Mapping[str, Any]], derived_from: Mapping[str, str] | None = None
    ) -> None:
        """Write the layer's table, then its manifest, with which the layer begins to exist.

        Args:
            table: specification of the table.
            data: its rows in the table's order; source and version are added.
            derived_from: hashes that the layer records besides its inputs. The hash of the recorded traversal is added,
                and that of the redaction layer that replaces the recorded images, if there is one.
        """
        schema = pa.schema([field for field in table.schema if field.name not in ("source", "source_version")])
        rows = data if isinstance(data, pa.Table) else pa.Table.from_pylist(list(data), schema=schema)
        for name, value in (("source", self.source), ("source_version", self.version)):
            if name in table.schema.names:
                rows = rows.append_column(name, pa.repeat(pa.scalar(value), rows.num_rows))
        name, encoded = f"{table.name}.parquet", encode_table(rows.select(table.schema.names), table)
        write_bytes(self._work.path / name, encoded)
        recorded = read_json(self.layout.recorded(self.traversal_id) / MANIFEST, Manifest).content
        derived = {**self.inputs, **(derived_from or {}), RECORDED: recorded}
        redaction = None if self.kind == REDACTION else current_redaction(self.layout, self.traversal_id)
        if redaction is not None:
            derived[REDACTION] = redaction
        seal(self._work.path, {**self._documents, name: encoded}, derived_from=derived)
        self._move_to_place()

    def _move_to_place(self) -> None:
        try:
            self._work.path.rename(self.folder)
        except OSError as error:
            if (self.folder / MANIFEST).is_file():
                raise self._exists_error() from error
            if not self.folder.exists():
                raise unwritable_error(self.folder, error) from error
            # A folder without a manifest is not a layer: move it away and try again.
            supersede(self.layout, self.folder)
            self._move_to_place()
        else:
            self._work.release()

    def _exists_error(self) -> DatasetError:
        return DatasetError(
            "the layer exists already", file=self.folder, remedy="write it under another version, side by side"
        )


def _moved(images: pa.Table, before: str, after: str) -> pa.Table:
    """Rows whose files lie in another folder."""
    uris = [f"{after}{uri.removeprefix(before)}" for uri in images.column("uri").to_pylist()]
    return images.set_column(images.column_names.index("uri"), images.schema.field("uri"), pa.array(uris, pa.string()))


def remove_layer(folder: Path) -> None:
    """Remove a layer that an interrupted run left; its manifest goes first, so that it no longer counts as a layer.

    The caller holds the dataset's writer lock.

    Raises:
        DatasetError: the folder cannot be written.
    """
    try:
        (folder / MANIFEST).unlink(missing_ok=True)
        shutil.rmtree(folder)
    except OSError as error:
        raise unwritable_error(folder, error) from error
