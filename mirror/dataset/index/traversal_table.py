"""The table of traversals, written in parts: the driven lines of a large fleet need not fit into memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from mirror.dataset.index.geoparquet import with_geo_metadata
from mirror.dataset.index.scene_tables import canonical_dictionaries, plain_schema
from mirror.dataset.layout import Layout
from mirror.schema.files import TableWriter
from mirror.schema.tables import TRAVERSALS

_MOST_BYTES: Final = 4 * 1024 * 1024
_MOST_ROWS: Final = 128
_ROWS: Final = plain_schema(TRAVERSALS)


class TraversalTable:
    """Collects the rows of the table in its order; where row groups end depends on the rows alone.

    The metadata of GeoParquet holds the bounding box of all rows, and stands before them: so the rows are written to a
    temporary file first.

    Args:
        layout: the dataset.

    Attributes:
        rows: all rows, without their geometries.
    """

    def __init__(self, layout: Layout) -> None:
        self._path = layout.index / f"{TRAVERSALS.name}.parquet"
        self._unordered = TableWriter(self._path.with_suffix(".rows"), TRAVERSALS)
        self._group: list[Mapping[str, Any]] = []
        self._bytes = 0
        self._small: list[pa.Table] = []

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row."""
        self._group.append(row)
        self._bytes += len(row["geometry"] or b"")
        if self._bytes >= _MOST_BYTES or len(self._group) == _MOST_ROWS:
            self._flush()

    @property
    def rows(self) -> pa.Table:
        """All rows, without their geometries."""
        return pa.concat_tables([_ROWS.remove(_ROWS.get_field_index("geometry")).empty_table(), *self._small])

    def finish(self) -> Path:
        """Write the table, and give the temporary name under which it lies."""
        if self._group or not self._small:
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
        """Remove what was written."""
        self._unordered.abandon()

    def _flush(self) -> None:
        rows = pa.Table.from_pylist(self._group, schema=_ROWS)
        self._unordered.write(canonical_dictionaries(rows, TRAVERSALS))
        self._small.append(rows.drop_columns(["geometry"]))
        self._group, self._bytes = [], 0


class PreviousTraversals:
    """The table of the index that is there, of which the rows of scenes that did not change are taken over.

    Args:
        layout: the dataset.
    """

    def __init__(self, layout: Layout) -> None:
        self._path = layout.index / f"{TRAVERSALS.name}.parquet"

    def rows_of(self, scene_id: str) -> Iterator[Mapping[str, Any]]:
        """The rows of a scene in order."""
        with pq.ParquetFile(self._path) as file:
            for group in range(file.num_row_groups):
                ids = file.read_row_group(group, columns=["scene_id"], use_threads=False).column(0)
                own = pc.equal(ids, scene_id)
                if pc.any(own).as_py():
                    yield from file.read_row_group(group, use_threads=False).filter(own).to_pylist()
