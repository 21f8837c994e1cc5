"""Conversion between Arrow arrays and numpy arrays through their buffers.

Arrow's own conversions (``pa.array``, ``to_numpy``, ``pa.scalar``) import pandas on first use, which would make the
first query five times slower and its process 50 MB larger.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pyarrow as pa

from mirror.arrays import AnyArray, Bool, Float64, Int64


def to_numpy(array: pa.Array | pa.ChunkedArray) -> AnyArray:
    """Convert integers or floats without nulls to a numpy array (N,); a single chunk is not copied."""
    if isinstance(array, pa.ChunkedArray):
        chunks = [to_numpy(chunk) for chunk in array.chunks]
        return chunks[0] if len(chunks) == 1 else np.concatenate([*chunks, np.empty(0, _numpy_type(array.type))])
    kind = _numpy_type(array.type)
    if not len(array):
        return np.empty(0, kind)
    return np.frombuffer(array.buffers()[1], kind, count=len(array), offset=array.offset * kind.itemsize)


def floats_or_nan(array: pa.Array | pa.ChunkedArray) -> Float64:
    """Convert floats to a numpy array (N,) with NaN in place of nulls."""
    values = to_numpy(array)
    return np.where(is_valid(array), values, np.nan) if array.null_count else values


def integers_or_zero(array: pa.Array | pa.ChunkedArray) -> Int64:
    """Convert integers to a numpy array (N,) with 0 in place of nulls."""
    values = to_numpy(array)
    return np.where(is_valid(array), values, 0) if array.null_count else values


def is_valid(array: pa.Array | pa.ChunkedArray) -> Bool:
    """Mark the values (N,) that are not null."""
    if isinstance(array, pa.ChunkedArray):
        return np.concatenate([*(is_valid(chunk) for chunk in array.chunks), np.empty(0, np.bool_)])
    bits = array.buffers()[0]
    if bits is None:
        return np.ones(len(array), np.bool_)
    flags = np.unpackbits(np.frombuffer(bits, np.uint8), bitorder="little", count=array.offset + len(array))
    return flags[array.offset :].astype(np.bool_)


def to_arrow_mask(values: Bool) -> pa.BooleanArray:
    """Convert a numpy mask (N,) to Arrow."""
    bits = np.packbits(values, bitorder="little")
    return pa.BooleanArray.from_buffers(pa.bool_(), len(values), [None, pa.py_buffer(bits)])


def to_arrow_rows(values: Int64) -> pa.Int64Array:
    """Convert row numbers (N,) to Arrow, for ``take``."""
    return pa.Array.from_buffers(pa.int64(), len(values), [None, pa.py_buffer(np.ascontiguousarray(values, np.int64))])


def to_arrow_strings(values: Iterable[str]) -> pa.StringArray:
    """Convert strings to Arrow."""
    encoded = [value.encode() for value in values]
    offsets = np.cumsum([0, *(len(value) for value in encoded)], dtype=np.int32)
    return pa.StringArray.from_buffers(len(encoded), pa.py_buffer(offsets), pa.py_buffer(b"".join(encoded)))


def is_member(array: pa.Array | pa.ChunkedArray, values: frozenset[str]) -> Bool:
    """Mark the rows (N,) of a column of strings or dictionaries that hold one of the given values."""
    if isinstance(array, pa.ChunkedArray):
        return np.concatenate([*(is_member(chunk, values) for chunk in array.chunks), np.empty(0, np.bool_)])
    if not pa.types.is_dictionary(array.type):
        array = array.dictionary_encode()
    # Codes are compared instead of strings: a column has far fewer values than rows.
    is_hit = np.array([value in values for value in array.dictionary.to_pylist()] or [False], np.bool_)
    return is_hit[integers_or_zero(array.indices)] & is_valid(array)


def _numpy_type(kind: pa.DataType) -> np.dtype[Any]:
    return np.dtype(kind.to_pandas_dtype())
