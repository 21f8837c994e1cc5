"""Casts of Arrow columns that keep every digit, or fail.

Arrow's own cast takes a float64 for an integer although integers beyond 2^53 are rounded in it: stamps in nanoseconds
since 1970 are then up to 128 ns off. It takes timestamps in the unit that they happen to have, whatever unit the
integers are meant in.
"""

from __future__ import annotations

from typing import Final

import pyarrow as pa
import pyarrow.compute as pc

EXACT_FLOAT64: Final = 2**53
"""Larger whole numbers are rounded in float64."""


def cast_exactly(column: pa.ChunkedArray, field: pa.Field) -> pa.ChunkedArray:
    """Cast a column to a field's type; timestamps become nanoseconds if the column's name ends in ``_ns``.

    Args:
        column: (N,) the values.
        field: name and type that are asked for.

    Raises:
        pa.ArrowInvalid: a value does not fit the type, or has lost digits.
        pa.ArrowNotImplementedError: values of this type cannot be cast.
    """
    if column.type == field.type:
        return column
    if pa.types.is_integer(field.type) and pa.types.is_floating(column.type):
        largest = pc.max(pc.abs(column)).as_py()
        if largest is not None and largest > EXACT_FLOAT64:
            raise pa.ArrowInvalid(f"{largest:.0f} is a float beyond 2^53, which has lost digits: store integers")
    if pa.types.is_timestamp(column.type) and pa.types.is_integer(field.type):
        if not field.name.endswith("_ns"):
            raise pa.ArrowInvalid(f"timestamps ({column.type}) in a column of integers of another unit")
        column = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64())
    return column.cast(field.type)
