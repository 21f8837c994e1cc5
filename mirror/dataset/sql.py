"""SQL over the index with DuckDB. A query reads the dataset's tables and nothing else, and writes nothing.

Four things hold a query in: it must be one SELECT statement; external access is off, with the index's own files as the
only exception; extensions are neither installed nor loaded; the configuration is locked before the query is run.

Source: https://duckdb.org/docs/operations_manual/securing_duckdb/overview
"""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

import pyarrow as pa

from mirror.dataset.query.catalog import GLOBAL, TABLES, Catalog
from mirror.dataset.query.filters import Filters
from mirror.errors import UsageError
from mirror.installation import install_command
from mirror.schema.tables import ADDED

if TYPE_CHECKING:
    import duckdb

_EXPECTED: Final = "one SELECT statement (WITH, DESCRIBE, SUMMARIZE and EXPLAIN count as one)"
_UNKNOWN_TABLE: Final = re.compile(r"Table with name (\S+) does not exist")
_WORDS: Final = {"LOAD": "INSTALL or LOAD"}
"""Words of statements to which DuckDB gives one type."""


class QueriedTables(Protocol):
    """The tables of a dataset or a part of it, as `mirror.dataset.dataset.Dataset` gives them."""

    @property
    def filters(self) -> Filters:
        """The part of the dataset."""
        ...

    @property
    def catalog(self) -> Catalog:
        """The index, with the files of its tables."""
        ...

    def table(self, name: str) -> pa.Table:
        """Read a table."""
        ...


def run_sql(tables: QueriedTables, query: str) -> pa.Table:
    """Run an SQL query; see `mirror.dataset.dataset.Dataset.sql`."""
    try:
        import duckdb
    except ImportError as error:
        raise UsageError("SQL needs DuckDB", remedy=install_command("sql")) from error
    connection = duckdb.connect(":memory:", config={"autoinstall_known_extensions": "false"})
    try:
        try:
            _require_select(connection, query)
            files = _make_views(connection, tables, _named_tables(query))
            _lock(connection, files)
            return connection.sql(query).to_arrow_table()
        except duckdb.Error as error:
            raise UsageError(
                _describe_error(str(error).strip()), place="the query",
                expected=f"a query of {', '.join(sorted(TABLES))}",
                remedy="docs/schema.md lists the columns of each table",
            ) from error  # fmt: skip
    finally:
        connection.close()


def _describe_error(text: str) -> str:
    """DuckDB's message; for an unknown table with MIRROR's most similar table, as DuckDB proposes its own tables."""
    unknown = _UNKNOWN_TABLE.search(text)
    if unknown is None:
        return text
    similar = difflib.get_close_matches(unknown[1], TABLES, n=1, cutoff=0.5)
    return unknown[0] + (f": did you mean {similar[0]}?" if similar else "")


def has_spatial_functions() -> bool:
    """Return whether DuckDB's extension ``spatial`` is installed here; it is never downloaded."""
    import duckdb

    connection = duckdb.connect(":memory:", config={"autoinstall_known_extensions": "false"})
    try:
        return _load_spatial(connection)
    finally:
        connection.close()


def _require_select(connection: duckdb.DuckDBPyConnection, query: str) -> None:
    kinds = [str(statement.type).rpartition(".")[2] for statement in connection.extract_statements(query)]
    if kinds not in (["SELECT"], ["EXPLAIN"]):
        raise UsageError(
            f"the query has {' and '.join(_WORDS.get(kind, kind) for kind in kinds) or 'no statement'}",
            place="the query",
            expected=_EXPECTED,
            remedy="write one SELECT; tables are read only",
        )


def _named_tables(query: str) -> list[str]:
    """The tables of the dataset whose names are words of a query."""
    words = {word.lower() for word in re.findall(r"\w+", query)}
    return sorted(words & set(TABLES))


def _make_views(connection: duckdb.DuckDBPyConnection, tables: QueriedTables, names: list[str]) -> list[str]:
    """Make a view of each table; returns the files that they read.

    A whole local dataset is read from its Parquet files, so that only the needed columns and row groups are. Of a
    part of a dataset, or of a remote one, the named tables are read into memory first.
    """
    spatial = _load_spatial(connection)
    if not spatial:
        connection.execute("SET enable_geoparquet_conversion = false")
    files: list[str] = []
    is_whole_and_local = tables.filters == Filters() and tables.catalog.store.folder is not None
    for name in names:
        # Rows of several segments are put in order, and some of them may be left out.
        is_in_files = tables.catalog.is_compact if name in GLOBAL else tables.catalog.is_whole
        paths = _files(tables, name) if is_whole_and_local and is_in_files else None
        if paths:
            listed = ", ".join(_quoted(path) for path in paths)
            # Scenes that were indexed by an earlier version may lack columns.
            by_name = ", union_by_name = true" if set(ADDED) & set(TABLES[name].schema.names) else ""
            connection.execute(f'CREATE VIEW "{name}" AS SELECT * FROM read_parquet([{listed}]{by_name})')
            files += paths
        else:
            connection.register(name, _plain(tables.table(name)))
    return files


def _files(tables: QueriedTables, name: str) -> list[str]:
    """The Parquet files of a table in the state that the view opened."""
    catalog = tables.catalog
    relative = (
        [f"index/{segment.name}/{name}.parquet" for segment in catalog.snapshot.segments]
        if name in GLOBAL
        else dict.fromkeys(catalog.row_groups(name).path)
    )
    return [str(tables.catalog.store.read_stable(path, Path.resolve)) for path in relative]


def _plain(table: pa.Table) -> pa.Table:
    """A table with strings in place of dictionaries, as DuckDB reads them from Parquet."""
    fields = [
        field.with_type(field.type.value_type) if pa.types.is_dictionary(field.type) else field
        for field in table.schema
    ]
    return table.cast(pa.schema(fields))


def _lock(connection: duckdb.DuckDBPyConnection, files: list[str]) -> None:
    connection.execute("SET temp_directory = ''")
    # Else names of tables would also be looked up among the variables of this program.
    connection.execute("SET python_enable_replacements = false")
    connection.execute(f"SET allowed_paths = [{', '.join(_quoted(path) for path in files)}]")
    for setting in ("enable_external_access", "autoload_known_extensions", "allow_community_extensions"):
        connection.execute(f"SET {setting} = false")
    connection.execute("SET lock_configuration = true")


def _load_spatial(connection: duckdb.DuckDBPyConnection) -> bool:
    import duckdb

    try:
        connection.execute("LOAD spatial")
    except duckdb.Error:
        return False
    return True


def _quoted(path: str) -> str:
    return "'" + path.replace("'", "''") + "'"
