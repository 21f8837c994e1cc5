"""Reads JSON of datasets: lists of flat objects into Arrow columns, and single entries with errors that name them.

A list is read in pieces: no Python object per value, and no whole file.

The tables of nuScenes have millions of objects. Decoding them with Python's JSON takes about nine times the memory
and the time (docs/recordings/nuscenes.md has the figures).
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Float64
from mirror.errors import RecordingError, UsageError
from mirror.recordings.opening import read_json, unreadable_error

_BLOCK_BYTES: Final = 4 << 20
_SEPARATOR: Final = re.compile(rb"\}\s*,")
_COMMA: Final = re.compile(rb"\s*,")
_NO_COMMA: Final = re.compile(rb"\}\s*\{")
_START: Final = re.compile(rb"\s*\[\s*")
_END: Final = re.compile(rb"\s*\]\s*")
_REMEDY: Final = "download the table again: a truncated file ends before its last bracket"


def read_columns(file: Path, schema: pa.Schema) -> pa.Table:
    """Read some columns of a JSON list of objects without nested objects; other keys are ignored.

    Texts of the objects must not hold ``},`` or ``}{``.

    Args:
        file: the JSON file.
        schema: the columns. A column that is not nullable has a value in every object, and one of lists of a fixed
            size this number of values.

    Raises:
        RecordingError: the file is missing, is not such a list, or an object lacks a column; the object is named.
    """
    import pyarrow.json as arrow_json

    flexible = pa.schema([(field.name, _parsed_type(field.type)) for field in schema])
    options = arrow_json.ParseOptions(
        explicit_schema=flexible, newlines_in_values=True, unexpected_field_behavior="ignore"
    )
    reading = arrow_json.ReadOptions(block_size=_BLOCK_BYTES, use_threads=False)
    try:
        with file.open("rb") as raw:
            stream = _Objects(raw)
            if stream.is_empty():
                return schema.empty_table()
            with arrow_json.open_json(pa.PythonFile(stream, "r"), reading, options) as reader:
                table = reader.read_all()
        table.validate(full=True)
    except OSError as error:
        raise unreadable_error(file, error) from error
    except (pa.ArrowInvalid, ValueError) as error:
        raise _syntax_error(file, error) from error
    columns = [
        table.column(field.name) if field.nullable else _require_values(table.column(field.name), field, file)
        for field in schema
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def matrix_of(column: pa.ChunkedArray) -> Float64:
    """Return the values (N, K) of a column of lists of fixed size K."""
    size = column.type.list_size
    parts = [np.asarray(chunk.flatten(), np.float64) for chunk in column.chunks]
    return (np.concatenate(parts) if parts else np.empty(0)).reshape(-1, size)


def _parsed_type(kind: pa.DataType) -> pa.DataType:
    return pa.list_(kind.value_type) if pa.types.is_fixed_size_list(kind) else kind


def _require_values(column: pa.ChunkedArray, field: pa.Field, file: Path) -> pa.ChunkedArray:
    bad = pc.is_null(column)
    if pa.types.is_fixed_size_list(field.type):
        bad = pc.or_(bad, pc.fill_null(pc.not_equal(pc.list_value_length(column), field.type.list_size), True))
        parts = [pc.is_null(chunk.flatten()) for chunk in column.chunks]
        if any(pc.any(part).as_py() for part in parts):
            bad = pc.or_(bad, pa.chunked_array([_has_null(chunk) for chunk in column.chunks], pa.bool_()))
    if pc.any(bad).as_py():
        row = pc.index(bad, True).as_py()
        raise RecordingError(
            f"the object has no value {field.name!r}, or one of another length",
            file=file,
            place=f"object {row}",
            expected=f"{field.name}: {field.type}",
            remedy="download the table again",
        )
    return column.cast(field.type) if column.type != field.type else column


def _has_null(lists: pa.Array) -> pa.Array:
    return pa.array([value is None or None in value for value in lists.to_pylist()], pa.bool_())


def _syntax_error(file: Path, error: Exception) -> RecordingError:
    """Find the place of a fault with the strict decoder, which names line and column."""
    content = read_json(file)
    if not isinstance(content, list) or not all(isinstance(value, dict) for value in content):
        return RecordingError("not a list of objects", file=file, expected="one JSON list", remedy=_REMEDY)
    reason = str(error).splitlines()[0]
    # The strict decoder has read it to its end: nothing is cut off.
    return RecordingError(
        f"cannot be read: values of other types ({reason})",
        file=file,
        expected="objects of texts, numbers and lists, as in nuScenes v1.0",
        remedy="check which dataset the table comes from; if it is nuScenes, download it again",
    )


class _Objects(io.RawIOBase):
    """A JSON list as a stream of objects: without its brackets and without the commas between its objects."""

    def __init__(self, raw: io.BufferedReader) -> None:
        self._raw = raw
        self._held = raw.read(_BLOCK_BYTES)
        start = _START.match(self._held)
        if start is None:
            raise ValueError("no list")
        self._held = self._held[start.end() :]
        self._ready = b""
        self._has_begun = False
        self._ended = False

    def is_empty(self) -> bool:
        """Return whether the list has no object."""
        return _END.fullmatch(self._held) is not None

    def readable(self) -> bool:
        return True

    def readinto(self, target: Any) -> int:
        view = memoryview(target)
        while not self._ready and not self._ended:
            self._fill()
        count = min(len(view), len(self._ready))
        view[:count] = self._ready[:count]
        self._ready = self._ready[count:]
        return count

    def _fill(self) -> None:
        more = self._raw.read(_BLOCK_BYTES)
        data = self._held + more
        # The text behind the last closing brace may end in the middle of a separator: it waits for the next block.
        end = data.rfind(b"}") + 1
        start = 0
        if end and self._has_begun:
            comma = _COMMA.match(data)
            if comma is None:
                raise ValueError("no comma between two objects")
            start = comma.end()
        if not more:
            self._ended = True
            if _END.fullmatch(data, end) is None:
                raise ValueError("no closing bracket")
        if end:
            self._has_begun = True
            objects = data[start:end]
            if _NO_COMMA.search(objects):
                raise ValueError("no comma between two objects")
            self._ready = _SEPARATOR.sub(b"}\n", objects)
        self._held = data[end:]


@contextmanager
def entry_errors(file: Path, place: str, expected: str) -> Iterator[None]:
    """Turn the errors of a malformed JSON entry into an error that names its place.

    Args:
        file: the JSON file.
        place: where the entry is, for instance ``data[7]``.
        expected: what a right entry is.

    Raises:
        RecordingError: a key is missing, or a value has another type or range.
    """
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, UsageError) as error:
        missing = isinstance(error, KeyError)
        raise RecordingError(
            f"the key {error} is missing" if missing else f"a value cannot be used ({error})",
            file=file,
            place=place,
            expected=expected,
            remedy="correct the entry, or take it out of the file",
        ) from error
