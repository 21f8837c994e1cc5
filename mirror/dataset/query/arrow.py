"""Arrow arrays to numpy and back, by their buffers.

Arrow's own conversions (``pa.array``, ``to_numpy``, ``pa.scalar``) import pandas on first use, which would make the
first query five times slower and its process 50 MB larger.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pyarrow as pa

from mirror.arrays import AnyArray, Bool, Float64, Int64


def numbers(array: pa.Array | pa.ChunkedArray) -> AnyArray:
    """Integers or floats without nulls, (N,); one chunk is not copied."""
    if isinstance(array, pa.ChunkedArray):
        chunks = [numbers(chunk) for chunk in array.chunks]
        return chunks[0] if len(chunks) == 1 else np.concatenate([*chunks, np.empty(0, _numpy_type(array.type))])
    kind = _numpy_type(array.type)
    if not len(array):
        return np.empty(0, kind)
    return np.frombuffer(array.buffers()[1], kind, count=len(array), offset=array.offset * kind.itemsize)


def degrees(array: pa.Array | pa.ChunkedArray) -> Float64:
    """Floats (N,) with NaN where there is a null."""
    values = numbers(array)
    return np.where(valid(array), values, np.nan) if array.null_count else values


def stamps(array: pa.Array | pa.ChunkedArray) -> Int64:
    """Integers (N,) with 0 where there is a null."""
    values = numbers(array)
    return np.where(valid(array), values, 0) if array.null_count else values


def valid(array: pa.Array | pa.ChunkedArray) -> Bool:
    """Which values (N,) are not null."""
    if isinstance(array, pa.ChunkedArray):
        return np.concatenate([*(valid(chunk) for chunk in array.chunks), np.empty(0, np.bool_)])
    bits = array.buffers()[0]
    if bits is None:
        return np.ones(len(array), np.bool_)
    flags = np.unpackbits(np.frombuffer(bits, np.uint8), bitorder="little", count=array.offset + len(array))
    return flags[array.offset :].astype(np.bool_)


def mask(values: Bool) -> pa.BooleanArray:
    """An Arrow mask (N,) of a numpy one."""
    bits = np.packbits(values, bitorder="little")
    return pa.BooleanArray.from_buffers(pa.bool_(), len(values), [None, pa.py_buffer(bits)])


def rows(values: Int64) -> pa.Int64Array:
    """Row numbers (N,) for ``take``."""
    return pa.Array.from_buffers(pa.int64(), len(values), [None, pa.py_buffer(np.ascontiguousarray(values, np.int64))])


def strings(values: Iterable[str]) -> pa.StringArray:
    """Strings in order."""
    encoded = [value.encode() for value in values]
    offsets = np.cumsum([0, *(len(value) for value in encoded)], dtype=np.int32)
    return pa.StringArray.from_buffers(len(encoded), pa.py_buffer(offsets), pa.py_buffer(b"".join(encoded)))


def member(array: pa.Array | pa.ChunkedArray, values: frozenset[str]) -> Bool:
    """Which rows (N,) of a column of strings or dictionaries hold one of some values."""
    if isinstance(array, pa.ChunkedArray):
        return np.concatenate([*(member(chunk, values) for chunk in array.chunks), np.empty(0, np.bool_)])
    if not pa.types.is_dictionary(array.type):
        array = array.dictionary_encode()
    # Codes are compared, not strings: a column has far fewer values than rows.
    hit = np.array([value in values for value in array.dictionary.to_pylist()] or [False], np.bool_)
    return hit[stamps(array.indices)] & valid(array)


def _numpy_type(kind: pa.DataType) -> np.dtype[Any]:
    return np.dtype(kind.to_pandas_dtype())
