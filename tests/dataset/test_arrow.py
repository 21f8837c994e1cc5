"""Arrow arrays read through their buffers equal what Arrow's own conversions give."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.dataset.query import arrow

NUMBERS = st.lists(st.one_of(st.none(), st.integers(-(2**31), 2**31 - 1)), max_size=40)
CUTS = st.tuples(st.integers(0, 12), st.integers(0, 40))


def cut(array: pa.Array, first: int, length: int) -> pa.Array:
    """A slice of an array; its buffers begin before the slice."""
    return array.slice(min(first, len(array)), length)


def split(array: pa.Array, at: int) -> pa.ChunkedArray:
    return pa.chunked_array([array.slice(0, at), array.slice(at)], type=array.type)


@settings(deadline=None)
@given(NUMBERS, CUTS, st.sampled_from([pa.int64(), pa.float64(), pa.int32()]))
def test_numbers_and_nulls_equal_those_of_arrow(
    values: list[int | None], where: tuple[int, int], kind: pa.DataType
) -> None:
    for array in (cut(pa.array(values, kind), *where), split(cut(pa.array(values, kind), *where), where[0])):
        expected = array.to_pylist()
        assert arrow.is_valid(array).tolist() == [value is not None for value in expected]
        known = array.drop_null()
        assert arrow.to_numpy(known).tolist() == known.to_pylist()
        assert arrow.to_numpy(known).dtype == np.dtype(kind.to_pandas_dtype())
        if kind == pa.float64():
            np.testing.assert_array_equal(arrow.floats_or_nan(array), [np.nan if v is None else v for v in expected])
        if kind == pa.int64():
            assert arrow.integers_or_zero(array).tolist() == [0 if value is None else value for value in expected]


def test_one_chunk_is_not_copied() -> None:
    array = pa.array([1, 2, 3], pa.int64())
    assert np.shares_memory(arrow.to_numpy(pa.chunked_array([array])), arrow.to_numpy(array))
    assert arrow.to_numpy(pa.chunked_array([], pa.int32())).dtype == np.int32


@settings(deadline=None)
@given(st.lists(st.booleans(), max_size=40))
def test_masks_and_row_numbers_become_arrow_arrays(values: list[bool]) -> None:
    assert arrow.to_arrow_mask(np.array(values, np.bool_)).to_pylist() == values
    chosen = np.flatnonzero(values)
    assert arrow.to_arrow_rows(chosen[::-1]).to_pylist() == chosen[::-1].tolist()


@settings(deadline=None)
@given(st.lists(st.text(max_size=5), max_size=20))
def test_strings_become_arrow_arrays(values: list[str]) -> None:
    assert arrow.to_arrow_strings(values).to_pylist() == values


@pytest.mark.parametrize("encoded", [False, True])
@settings(deadline=None)
@given(
    values=st.lists(st.sampled_from([None, "a", "b", "long name"]), max_size=30),
    where=CUTS,
    members=st.frozensets(st.sampled_from(["a", "b", "c", "long name"])),
)
def test_is_member_marks_the_rows_that_hold_one_of_the_values(
    encoded: bool, values: Sequence[str | None], where: tuple[int, int], members: frozenset[str]
) -> None:
    array = pa.array(values, pa.string())
    if encoded:
        array = array.dictionary_encode()
    for part in (cut(array, *where), split(cut(array, *where), where[0])):
        assert arrow.is_member(part, members).tolist() == [value in members for value in part.to_pylist()]
