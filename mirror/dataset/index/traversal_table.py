"""The table of traversals, written in parts, because the driven lines of a large fleet may not fit into memory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from mirror.dataset.index.geoparquet import with_geo_metadata
from mirror.dataset.index.scene_tables import canonical_dictionaries, plain_schema
from mirror.schema.files import TableWriter
from mirror.schema.index_tables import TRAVERSALS

_MAX_BYTES: Final = 4 * 1024 * 1024
_MAX_ROWS: Final = 128
_PLAIN_SCHEMA: Final = plain_schema(TRAVERSALS)


class TraversalTable:
    """A writer of the table of traversals, row by row; the bounds of row groups depend only on the rows.

    The GeoParquet metadata holds the bounding box of all rows and comes before the rows, so the rows
    are first written to a temporary file.

    Args:
        folder: of the index's tables.

    Attributes:
        rows: all rows, without their geometries.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / f"{TRAVERSALS.name}.parquet"
        self._unordered = TableWriter(self._path.with_suffix(".rows"), TRAVERSALS)
        self._group: list[Mapping[str, Any]] = []
        self._bytes = 0
        self._without_geometry: list[pa.Table] = []

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row; rows come in the table's order."""
        self._group.append(row)
        self._bytes += len(row["geometry"] or b"")
        if self._bytes >= _MAX_BYTES or len(self._group) == _MAX_ROWS:
            self._flush()

    @property
    def rows(self) -> pa.Table:
        """All rows, without their geometries."""
        return pa.concat_tables(
            [_PLAIN_SCHEMA.remove(_PLAIN_SCHEMA.get_field_index("geometry")).empty_table(), *self._without_geometry]
        )

    def finish(self) -> Path:
        """Write the table to a file with a temporary name, and return its path."""
        if self._group or not self._without_geometry:
            self._flush()
        unordered = self._unordered.finish()
        metadata = with_geo_metadata(self.rows, "LineString").schema.metadata
        final = TableWriter(self._path, TRAVERSALS, metadata)
        try:
            with pq.ParquetFile(unordered) as file:
                for group in range(file.num_row_groups):
                    final.write(file.read_row_group(group, use_threads=False))
            return final.finish()
        except BaseException:
            final.abandon()
            raise
        finally:
            unordered.unlink()

    def abandon(self) -> None:
        """Remove the temporary file."""
        self._unordered.abandon()

    def _flush(self) -> None:
        rows = pa.Table.from_pylist(self._group, schema=_PLAIN_SCHEMA)
        self._unordered.write(canonical_dictionaries(rows, TRAVERSALS))
        self._without_geometry.append(rows.drop_columns(["geometry"]))
        self._group, self._bytes = [], 0
