"""Reads and writes tables and JSON files; writes are atomic, and errors name their place.

A file is written under a temporary name in the same folder and then renamed: a reader never reads a partial file, and
a failed write leaves the previous file as it was.
"""

from __future__ import annotations

import errno
import hashlib
import io
import itertools
import json
import os
import platform
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TypeVar

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import BaseModel, ValidationError

from mirror.errors import ANOTHER_PLACE, DatasetError, SchemaError, UnwritableError
from mirror.schema.casting import cast_exactly
from mirror.schema.parquet_memory import require_memory
from mirror.schema.problems import describe_problem_and_value
from mirror.schema.strict_json import JsonError, decode_json
from mirror.schema.tables import ADDED, Table
from mirror.schema.version import SCHEMA_VERSION, require_migrated, require_readable

Model = TypeVar("Model", bound=BaseModel)

TEMPORARY = ".tmp"
"""Suffix of the names of unfinished files."""

_FORBIDDEN = (errno.EROFS, errno.EACCES, errno.EPERM)
_UNFINISHED = re.compile(r"\..+\.(?:[0-9a-f]{8}-)?[0-9]+(?:-[0-9]+)?\.tmp", re.DOTALL)
_attempts = itertools.count()
_VERSION_KEY = b"mirror_schema_version"
_TABLE_KEY = b"mirror_table"


@cache
def _host() -> str:
    """A short name of this machine: those that share a disk must not write under one temporary name."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def temporary_path(path: Path) -> Path:
    """Return a path beside a file for its unfinished bytes; its name has machine, process and attempt."""
    return path.with_name(f".{path.name}.{_host()}-{os.getpid()}-{next(_attempts)}{TEMPORARY}")


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file under a temporary name, then rename it.

    Raises:
        DatasetError: the folder is not writable or the disk is full; a previous file is unchanged.
    """
    temporary = temporary_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable_error(path, error) from error
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        raise unwritable_error(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def remove_temporaries(folder: Path) -> None:
    """Remove temporary files that killed writers (`write_bytes`) left in a folder and below.

    Links to folders are not followed. No other process may be writing there.
    """
    for place, _, names in os.walk(folder):
        for name in names:
            if _UNFINISHED.fullmatch(name):
                Path(place, name).unlink(missing_ok=True)


def unwritable_error(path: Path, error: OSError) -> UnwritableError:
    """Make the error for an unwritable file; it names the obstacle in the path, or the system's reason.

    `mirror` adds the option that names the place, where the verb has one.
    """
    blocked = next((folder for folder in path.parents if folder.exists() and not folder.is_dir()), None)
    if blocked is not None or path.is_dir():
        return UnwritableError(
            f"cannot be written: {blocked} is a file" if blocked is not None else "cannot be written: it is a folder",
            file=path,
            expected="the path of a file, in a folder or in folders that do not exist yet",
            remedy=ANOTHER_PLACE,
        )
    first = "make the folder writable" if error.errno in _FORBIDDEN else "free space"
    return UnwritableError(
        f"cannot be written: {error.strerror or error}",
        file=path,
        expected="a writable folder with room for the file",
        remedy=f"{first} or {ANOTHER_PLACE}, then run the same command again: it resumes where it stopped",
    )


def unmovable_error(folder: Path, error: OSError) -> DatasetError:
    """Make the error for a folder that could not be moved into or out of its place."""
    return DatasetError(
        f"cannot be moved: {error.strerror or error}",
        file=folder,
        expected="a writable parent folder",
        remedy="free space and check the permissions, then run the same command again: it resumes where it stopped",
    )


def remove_path(path: Path) -> None:
    """Remove a file, or a folder with all that it holds; nothing if it is gone.

    Raises:
        DatasetError: it cannot be removed.
    """
    try:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable_error(path, error) from error


def write_json(path: Path, document: BaseModel | dict[str, object]) -> None:
    """Write a JSON document atomically, with the keys in the order of the model."""
    write_bytes(path, encode_json(document))


def encode_json(document: BaseModel | dict[str, object]) -> bytes:
    """Encode a JSON document, with the keys in the order of the model."""
    plain = document.model_dump(mode="json") if isinstance(document, BaseModel) else document
    return (json.dumps(plain, indent=1, ensure_ascii=False) + "\n").encode()


def read_json(path: Path, model: type[Model]) -> Model:
    """Read and validate a JSON document.

    Raises:
        DatasetError: the file is missing.
        SchemaError: the file is not JSON (line and column are named), repeats a key, does not follow the model (the key
            is named), or has another schema version.
    """
    try:
        text = path.read_bytes()
    except FileNotFoundError as error:
        raise DatasetError("missing", file=path, expected=f"a {model.__name__} document") from error
    return parse_json(text, model, path)


def parse_json(text: bytes, model: type[Model], path: str | Path) -> Model:
    """Validate a JSON document from bytes; see `read_json`. ``path`` is used in messages."""
    try:
        raw = decode_json(text)
    except JsonError as error:
        raise SchemaError(
            str(error),
            file=path,
            place=error.place,
            remedy="restore the file; a truncated file ends before its last brace",
        ) from error
    if isinstance(raw, dict) and "schema_version" in model.model_fields:
        require_readable(raw.get("schema_version"), str(path), model.model_fields["schema_version"].default)
        if getattr(model, "needs_migration", False):
            require_migrated(str(raw["schema_version"]), str(path))
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        raise SchemaError(
            describe_problem_and_value(first),
            file=path,
            place=".".join(str(part) for part in first["loc"]) or "the whole document",
            expected=f"a {model.__name__} document",
            remedy="correct the key, or restore the file",
        ) from error


def encode_table(data: pa.Table, table: Table, *, row_groups: Sequence[int] | None = None) -> bytes:
    """Encode one table as a Parquet file: zstd, with statistics, equal bytes for equal data.

    Args:
        data: rows that can be cast to ``table.schema``; the order of columns does not matter.
        table: the specification.
        row_groups: number of rows of each row group, in order; default: one row group.

    Raises:
        SchemaError: a column is missing, unknown, of another type, or has nulls that are not allowed.
    """
    data = conform(data, table, file=table.place)
    metadata = {**(data.schema.metadata or {}), _VERSION_KEY: SCHEMA_VERSION.encode(), _TABLE_KEY: table.name.encode()}
    data = data.replace_schema_metadata(metadata)
    sink = io.BytesIO()
    with pq.ParquetWriter(sink, data.schema, compression="zstd", version="2.6", data_page_version="1.0") as writer:
        start = 0
        for rows in row_groups if row_groups is not None else [data.num_rows]:
            writer.write_table(data.slice(start, rows), row_group_size=max(rows, 1))
            start += rows
        if start != data.num_rows:
            raise SchemaError(f"row groups cover {start} of {data.num_rows} rows", file=table.place)
    return sink.getvalue()


class TableWriter:
    """Writes a Parquet file of one table row group by row group, so that the table need not fit into memory.

    The file has a temporary name until the caller renames it. Its bytes equal those of `encode_table` with the same row
    groups, except that each row group has its own dictionaries.

    Args:
        path: the final path of the file.
        table: the specification.
        metadata: metadata of the file in addition to that of every table.
    """

    def __init__(self, path: Path, table: Table, metadata: Mapping[bytes, bytes] | None = None) -> None:
        self.path = path
        self._table = table
        self._temporary = temporary_path(path)
        own = {_VERSION_KEY: SCHEMA_VERSION.encode(), _TABLE_KEY: table.name.encode()}
        self._metadata = {**(metadata or {}), **own}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(
                self._temporary,
                table.schema.with_metadata(self._metadata),
                compression="zstd",
                version="2.6",
                data_page_version="1.0",
            )
        except OSError as error:
            raise unwritable_error(path, error) from error

    def write(self, data: pa.Table) -> None:
        """Append a row group.

        Raises:
            SchemaError: the rows do not follow the table's schema.
            DatasetError: the disk is full.
        """
        rows = conform(data, self._table, file=self._table.place).replace_schema_metadata(self._metadata)
        try:
            self._writer.write_table(rows, row_group_size=max(rows.num_rows, 1))
        except OSError as error:
            raise unwritable_error(self.path, error) from error

    def finish(self) -> Path:
        """Complete the file and return its temporary path.

        Raises:
            DatasetError: the disk is full.
        """
        try:
            self._writer.close()
        except OSError as error:
            raise unwritable_error(self.path, error) from error
        return self._temporary

    def abandon(self) -> None:
        """Remove the temporary file, and its folder if that is then empty."""
        with suppress(OSError):
            self._writer.close()
        self._temporary.unlink(missing_ok=True)
        with suppress(OSError):
            self.path.parent.rmdir()


def write_table(path: Path, data: pa.Table, table: Table, *, row_groups: Sequence[int] | None = None) -> None:
    """Write one table as Parquet, atomically; see `encode_table`."""
    write_bytes(path, encode_table(data, table, row_groups=row_groups))


def read_table(
    path: Path, table: Table, columns: Sequence[str] | None = None, *, data: bytes | None = None
) -> pa.Table:
    """Read one table and check it against its specification.

    Args:
        path: a Parquet file.
        table: the specification.
        columns: read only these columns; None: read all.
        data: bytes of the file; None: it is opened.

    Raises:
        DatasetError: the file is missing.
        SchemaError: the file is not Parquet, has another schema version, or has a wrong column; for nulls the row is
            named.
        NotEnoughMemoryError: the rows do not fit into memory.
    """
    try:
        with pq.ParquetFile(path if data is None else pa.BufferReader(data)) as file:
            schema = file.schema_arrow
            metadata = schema.metadata or {}
            if _VERSION_KEY in metadata:
                require_readable(metadata[_VERSION_KEY].decode(), path)
            names = list(columns) if columns is not None else table.schema.names
            present = set(schema.names)
            missing = [name for name in names if name not in present and name not in ADDED]
            if missing:
                raise SchemaError(
                    f"table {table.name} has no column {missing[0]!r}",
                    file=path,
                    place=f"column {missing[0]}",
                    expected=f"the columns of {table.name} in docs/schema.md",
                    remedy="run `mirror index` if the file lies in index/, else restore it",
                )
            require_memory(file, path, set(names))
            rows = file.read(columns=[name for name in names if name in present], use_threads=False)
    except FileNotFoundError as error:
        raise DatasetError("missing", file=path, expected=f"the table {table.name}") from error
    except (pa.ArrowInvalid, OSError) as error:
        raise SchemaError(
            f"table {table.name} cannot be read ({str(error).splitlines()[0]})",
            file=path,
            expected="a complete Parquet file",
            remedy="run `mirror index` if the file lies in index/, else restore it or ingest the recording again",
        ) from error
    return conform(rows, table, file=path, columns=names)


def conform(data: pa.Table, table: Table, *, file: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Cast rows to a table's schema; an absent column that a later version added becomes null.

    Raises:
        SchemaError: a column is missing, unknown, of another type, or has a null that is not allowed; file, table,
            column and row are named.
    """
    fields = [table.schema.field(name) for name in columns] if columns is not None else list(table.schema)
    present = set(data.column_names)
    extra = present - {field.name for field in fields}
    if extra:
        raise SchemaError(
            f"table {table.name} has an unknown column",
            file=file,
            place=f"column {min(extra)}",
            expected=f"no columns but {', '.join(field.name for field in fields)}",
        )
    arrays = []
    for field in fields:
        if field.name not in present and field.name in ADDED:
            arrays.append(pa.chunked_array([pa.nulls(data.num_rows, field.type)]))
            continue
        if field.name not in present:
            raise SchemaError(f"table {table.name} has no such column", file=file, place=f"column {field.name}")
        column = data.column(field.name)
        if column.type != field.type:
            try:
                column = cast_exactly(column, field)
            except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
                raise SchemaError(
                    f"table {table.name}: {error}", file=file, place=f"column {field.name}", expected=str(field.type)
                ) from error
        if not field.nullable and column.null_count:
            row = pc.index(pc.is_null(column), True).as_py()
            raise SchemaError(
                f"table {table.name} has a null", file=file, place=f"column {field.name}, row {row}", expected="a value"
            )
        arrays.append(column)
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=data.schema.metadata))


def sha256_bytes(data: bytes) -> str:
    """Return the SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()
