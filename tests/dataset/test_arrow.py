"""Arrow arrays by their buffers, against what Arrow itself gives."""

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
    """A slice, whose buffers begin before it does."""
    return array.slice(min(first, len(array)), length)


def split(array: pa.Array, at: int) -> pa.ChunkedArray:
    return pa.chunked_array([array.slice(0, at), array.slice(at)], type=array.type)


@settings(deadline=None)
@given(NUMBERS, CUTS, st.sampled_from([pa.int64(), pa.float64(), pa.int32()]))
def test_numbers_and_their_nulls(values: list[int | None], where: tuple[int, int], kind: pa.DataType) -> None:
    for array in (cut(pa.array(values, kind), *where), split(cut(pa.array(values, kind), *where), where[0])):
        wanted = array.to_pylist()
        assert arrow.valid(array).tolist() == [value is not None for value in wanted]
        known = array.drop_null()
        assert arrow.numbers(known).tolist() == known.to_pylist()
        assert arrow.numbers(known).dtype == np.dtype(kind.to_pandas_dtype())
        if kind == pa.float64():
            np.testing.assert_array_equal(arrow.degrees(array), [np.nan if v is None else v for v in wanted])
        if kind == pa.int64():
            assert arrow.stamps(array).tolist() == [0 if value is None else value for value in wanted]


def test_one_chunk_is_not_copied() -> None:
    array = pa.array([1, 2, 3], pa.int64())
    assert np.shares_memory(arrow.numbers(pa.chunked_array([array])), arrow.numbers(array))
    assert arrow.numbers(pa.chunked_array([], pa.int32())).dtype == np.int32


@settings(deadline=None)
@given(st.lists(st.booleans(), max_size=40))
def test_masks_and_rows(values: list[bool]) -> None:
    assert arrow.mask(np.array(values, np.bool_)).to_pylist() == values
    chosen = np.flatnonzero(values)
    assert arrow.rows(chosen[::-1]).to_pylist() == chosen[::-1].tolist()


@settings(deadline=None)
@given(st.lists(st.text(max_size=5), max_size=20))
def test_strings(values: list[str]) -> None:
    assert arrow.strings(values).to_pylist() == values


@pytest.mark.parametrize("encoded", [False, True])
@settings(deadline=None)
@given(
    values=st.lists(st.sampled_from([None, "a", "b", "long name"]), max_size=30),
    where=CUTS,
    wanted=st.frozensets(st.sampled_from(["a", "b", "c", "long name"])),
)
def test_members(encoded: bool, values: Sequence[str | None], where: tuple[int, int], wanted: frozenset[str]) -> None:
    array = pa.array(values, pa.string())
    if encoded:
        array = array.dictionary_encode()
    for one in (cut(array, *where), split(cut(array, *where), where[0])):
        assert arrow.member(one, wanted).tolist() == [value in wanted for value in one.to_pylist()]
