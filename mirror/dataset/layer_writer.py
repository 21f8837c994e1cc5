"""Writing a layer of a traversal: its files one by one, its table and its manifest last, and never over another."""

from __future__ import annotations

import hashlib
import re
import shutil
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from mirror.dataset.generation import supersede
from mirror.dataset.layout import MANIFEST, Layout, seal
from mirror.dataset.owned_folder import OwnedFolder, abandoned_folders
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import Manifest
from mirror.schema.files import encode_table, read_json, unwritable_error, write_bytes
from mirror.schema.tables import Table


@dataclass
class LayerWriter:
    """Writes one layer; the caller holds the dataset's writer lock.

    It is written in a folder of its own, which becomes the layer when it is complete. What an interrupted run left is
    removed by the next writer of the same layer, once its owner is known to be dead: `mirror.dataset.owned_folder`.

    Attributes:
        layout: the dataset.
        traversal_id: the traversal.
        kind: of the layer: its folder.
        source: who makes it.
        version: of the source.

    Raises:
        UsageError: the source or version cannot be part of a folder's name.
        DatasetError: the traversal does not exist, or the layer is there already.
    """

    layout: Layout
    traversal_id: str
    kind: str
    source: str
    version: str

    def __post_init__(self) -> None:
        self.folder = self.layout.layer(self.traversal_id, self.kind, self.source, self.version)
        for name in (self.source, self.version):
            if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.\-]*", name) is None:
                raise UsageError(f"{name!r} cannot name a layer", expected="letters, digits, `_`, `-` and `.`")
        recorded = self.layout.recorded(self.traversal_id)
        if not (recorded / MANIFEST).is_file():
            raise DatasetError("there is no such traversal", file=recorded, remedy="check the id: `mirror info`")
        if (self.folder / MANIFEST).is_file():
            raise self._taken()
        begun = f".{self.folder.name}"
        for left in abandoned_folders(self.folder.parent, begun):
            shutil.rmtree(left, ignore_errors=True)
        self._own = OwnedFolder(self.folder.parent, begun)
        # Where the writer is given up without an end, nobody else would remove it so soon.
        weakref.finalize(self, self._own.remove)

    def file(self, name: str, data: bytes) -> dict[str, object]:
        """Write a file of the layer.

        Args:
            name: relative to the layer's folder.
            data: its bytes.

        Returns:
            What its row says of it: uri, byte_length, sha256.
        """
        write_bytes(self._own.path / name, data)
        return {
            "uri": (self.folder / name).relative_to(self.layout.root).as_posix(),
            "byte_length": len(data),
            "sha256": hashlib.sha256(data).digest(),
        }

    def finish(
        self, table: Table, data: pa.Table | Sequence[Mapping[str, Any]], derived_from: Mapping[str, str]
    ) -> None:
        """Write the layer's table, then its manifest: from then on the layer exists.

        Args:
            table: which.
            data: its rows in the table's order; source and version are added.
            derived_from: hashes of what the layer was made from; that of the recorded traversal is added.
        """
        schema = pa.schema([one for one in table.schema if one.name not in ("source", "source_version")])
        rows = data if isinstance(data, pa.Table) else pa.Table.from_pylist(list(data), schema=schema)
        for name, word in (("source", self.source), ("source_version", self.version)):
            if name in table.schema.names:
                rows = rows.append_column(name, pa.repeat(pa.scalar(word), rows.num_rows))
        name, encoded = f"{table.name}.parquet", encode_table(rows.select(table.schema.names), table)
        write_bytes(self._own.path / name, encoded)
        recorded = read_json(self.layout.recorded(self.traversal_id) / MANIFEST, Manifest).content
        seal(self._own.path, {name: encoded}, derived_from={**derived_from, "recorded": recorded})
        self._take_place()

    def _take_place(self) -> None:
        try:
            self._own.path.rename(self.folder)
        except OSError as error:
            if (self.folder / MANIFEST).is_file():
                raise self._taken() from error
            if not self.folder.exists():
                raise unwritable_error(self.folder, error) from error
            # Without its manifest it does not exist.
            supersede(self.layout, self.folder)
            self._take_place()
        else:
            self._own.release()

    def _taken(self) -> DatasetError:
        return DatasetError(
            "the layer is there already", file=self.folder, remedy="write it under another version, side by side"
        )
