"""Eight Gaussians at once in numba kernels, in float64.

Projection needs float64, because a needle's covariance cancels, and it has no rows of pixels, so each lane is one
Gaussian. The result of a lane does not depend on the other lanes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba import types

from hybridworldsim.kernels import simd
from hybridworldsim.kernels.simd import I32, Vector, elementwise, intrinsic, shuffle

LANES: Final = 8
Float64x8: Final = Vector(types.float64, LANES)
Mask8: Final = Vector(types.boolean, LANES)

_DOUBLE, _LONG = ir.DoubleType(), ir.IntType(64)
_DOUBLES, _LONGS = ir.VectorType(_DOUBLE, LANES), ir.VectorType(_LONG, LANES)


def _elementwise(result: Any, emit: Callable[..., Any], *kinds: Any) -> Any:
    """Return the typing of an elementwise intrinsic of `Float64x8` vectors."""
    return elementwise((Float64x8,) * len(kinds), result, emit)(*kinds)


@intrinsic
def broadcast(context: Any, number: Any) -> Any:
    """Broadcast a number to all lanes."""
    return _elementwise(Float64x8, lambda builder, vector: vector, number)


@intrinsic
def sqrt(context: Any, a: Any) -> Any:
    """Compute square roots."""
    return _elementwise(Float64x8, simd.call_llvm("sqrt", Float64x8), a)


@intrinsic
def abs_(context: Any, a: Any) -> Any:
    """Compute absolute values."""
    return _elementwise(Float64x8, simd.call_llvm("fabs", Float64x8), a)


@intrinsic
def ceil(context: Any, a: Any) -> Any:
    """Round up to integers."""
    return _elementwise(Float64x8, simd.call_llvm("ceil", Float64x8), a)


@intrinsic
def min_or_b(context: Any, a: Any, b: Any) -> Any:
    """Compute the minimum of ``a`` and ``b``; ``b`` where one is NaN."""
    return _elementwise(Float64x8, lambda builder, a, b: builder.select(builder.fcmp_ordered("<", a, b), a, b), a, b)


@intrinsic
def max_or_b(context: Any, a: Any, b: Any) -> Any:
    """Compute the maximum of ``a`` and ``b``; ``b`` where one is NaN."""
    return _elementwise(Float64x8, lambda builder, a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b), a, b)


@intrinsic
def select(context: Any, mask: Any, a: Any, b: Any) -> Any:
    """Select ``a`` where the mask is set, else ``b``."""
    return _elementwise(Float64x8, lambda builder, *args: builder.select(*args), mask, a, b)


@intrinsic
def round_to_float32(context: Any, a: Any) -> Any:
    """Round to the nearest float32."""
    singles = ir.VectorType(ir.FloatType(), LANES)
    return _elementwise(Float64x8, lambda builder, a: builder.fpext(builder.fptrunc(a, singles), _DOUBLES), a)


@intrinsic
def mantissa(context: Any, a: Any) -> Any:
    """Extract the mantissa, in [1, 2), of positive normal numbers."""

    def emit(builder: Any, a: Any) -> Any:
        low = builder.and_(builder.bitcast(a, _LONGS), ir.Constant(_LONGS, [(1 << 52) - 1] * LANES))
        return builder.bitcast(builder.or_(low, ir.Constant(_LONGS, [1023 << 52] * LANES)), _DOUBLES)

    return _elementwise(Float64x8, emit, a)


@intrinsic
def exponent(context: Any, a: Any) -> Any:
    """Extract the exponent of positive normal numbers: a number is its mantissa times 2 to this power."""

    def emit(builder: Any, a: Any) -> Any:
        high = builder.lshr(builder.bitcast(a, _LONGS), ir.Constant(_LONGS, [52] * LANES))
        return builder.sitofp(builder.sub(high, ir.Constant(_LONGS, [1023] * LANES)), _DOUBLES)

    return _elementwise(Float64x8, emit, a)


@intrinsic
def to_bits(context: Any, mask: Any) -> Any:
    """Convert a mask to an integer; the lowest bit is the first lane."""
    return _elementwise(types.int64, lambda b, mask: b.zext(b.bitcast(mask, ir.IntType(LANES)), _LONG), mask)


@intrinsic
def from_bits(context: Any, number: Any) -> Any:
    """Convert the lowest bits of an integer to a mask."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.bitcast(builder.trunc(args[0], ir.IntType(LANES)), Mask8.llvm)

    return Mask8(types.int64), lower


@intrinsic
def count_set(context: Any, mask: Any) -> Any:
    """Count the lanes that are set."""
    return _elementwise(types.int64, lambda b, mask: b.zext(b.ctpop(b.bitcast(mask, ir.IntType(LANES))), _LONG), mask)


@intrinsic
def first_lanes(context: Any, count: Any) -> Any:
    """Make a mask of the first ``count`` lanes; all lanes if ``count`` is LANES or more."""
    emit = lambda b, count: b.fcmp_ordered("<", ir.Constant(_DOUBLES, list(range(LANES))), count)  # noqa: E731
    return _elementwise(Mask8, emit, count)


@intrinsic
def sum_lanes(context: Any, a: Any) -> Any:
    """Sum the lanes pairwise, by halves."""

    def emit(builder: Any, value: Any) -> Any:
        half = LANES // 2
        while half:
            other = shuffle(builder, value, value, [(lane + half) % LANES for lane in range(LANES)])
            value = builder.fadd(value, other)
            half //= 2
        return builder.extract_element(value, ir.Constant(I32, 0))

    return _elementwise(types.float64, emit, a)


@intrinsic
def load(context: Any, array: Any, start: Any) -> Any:
    """Load the lanes from an index of a flat array on; there is no bounds check."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = _load_vector(builder, simd.data_pointer(context, builder, sig.args[0], args[0]), args[1], LANES)
        return vector if vector.type == _DOUBLES else builder.fpext(vector, _DOUBLES)

    return Float64x8(array, types.intp), lower


@intrinsic
def gather(context: Any, array: Any, rows: Any, start: Any, stride: Any, column: Any) -> Any:
    """Load ``array[rows[start + j] * stride + column]`` of a flat array into lane j; there is no bounds check."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data, rows = (simd.data_pointer(context, builder, kind, arg) for kind, arg in zip(sig.args[:2], args[:2]))
        start, stride, column = args[2:]
        vector = ir.Constant(ir.VectorType(data.type.pointee, LANES), ir.Undefined)
        for lane in range(LANES):
            row = builder.load(builder.gep(rows, [builder.add(start, ir.Constant(_LONG, lane))]))
            value = builder.load(builder.gep(data, [builder.add(builder.mul(row, stride), column)]))
            vector = builder.insert_element(vector, value, ir.Constant(I32, lane))
        return vector if data.type.pointee == _DOUBLE else builder.fpext(vector, _DOUBLES)

    return Float64x8(array, rows, types.intp, types.intp, types.intp), lower


def _concatenate(builder: Any, parts: list[Any]) -> Any:
    """Concatenate vectors of one size; their number is a power of two."""
    while len(parts) > 1:
        order = list(range(2 * parts[0].type.count))
        parts = [shuffle(builder, a, b, order) for a, b in zip(parts[::2], parts[1::2])]
    return parts[0]


def _load_vector(builder: Any, data: Any, index: Any, count: int) -> Any:
    """Load a vector of ``count`` elements from an index on."""
    element = data.type.pointee
    place = builder.bitcast(builder.gep(data, [index]), ir.PointerType(ir.VectorType(element, count)))
    return builder.load(place, align=8 if element == _DOUBLE else 4)


def _load_columns(columns: int) -> Callable[..., Any]:
    """Make the code of `load_triples` and `load_quadruples`; consecutive rows are loaded at once."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data, rows = (simd.data_pointer(context, builder, kind, arg) for kind, arg in zip(sig.args[:2], args[:2]))
        kind, width = ir.VectorType(data.type.pointee, LANES), ir.Constant(_LONG, columns)
        numbers = [
            builder.load(builder.gep(rows, [builder.add(args[2], ir.Constant(_LONG, lane))])) for lane in range(LANES)
        ]
        is_consecutive = builder.icmp_signed("==", builder.sub(numbers[-1], numbers[0]), ir.Constant(_LONG, LANES - 1))
        branches: list[list[Any]] = []
        with builder.if_else(is_consecutive) as (then, otherwise):
            with then:
                joined_rows = _load_vector(builder, data, builder.mul(numbers[0], width), LANES * columns)
                undefined = ir.Constant(joined_rows.type, ir.Undefined)
                branches.append(
                    [
                        shuffle(builder, joined_rows, undefined, [columns * lane + column for lane in range(LANES)])
                        for column in range(columns)
                    ]
                )
                blocks = [builder.block]
            with otherwise:
                parts = []
                for number in numbers:
                    at = builder.mul(number, width)
                    if columns == 4:
                        parts.append(_load_vector(builder, data, at, 4))
                    else:  # elements 0 1 1 2: a load of four would read past the end of the array
                        second = builder.add(at, ir.Constant(_LONG, 1))
                        parts.append(
                            _concatenate(builder, [_load_vector(builder, data, place, 2) for place in (at, second)])
                        )
                joined_rows = _concatenate(builder, parts)
                undefined = ir.Constant(joined_rows.type, ir.Undefined)
                branches.append(
                    [
                        shuffle(builder, joined_rows, undefined, [4 * lane + column for lane in range(LANES)])
                        for column in ((0, 1, 2, 3) if columns == 4 else (0, 1, 3))
                    ]
                )
                blocks.append(builder.block)
        vectors = []
        for values in zip(*branches):
            vector = builder.phi(kind)
            for value, block in zip(values, blocks):
                vector.add_incoming(value, block)
            vectors.append(vector)
        if kind != _DOUBLES:
            vectors = [builder.fpext(vector, _DOUBLES) for vector in vectors]
        return context.make_tuple(builder, sig.return_type, vectors)

    return lower


@intrinsic
def load_triples(context: Any, array: Any, rows: Any, start: Any) -> Any:
    """Load the three columns of the rows ``rows[start : start + LANES]`` of a (N, 3) array, passed flat.

    Rows ascend, so that the first and the last row show whether the rows are consecutive. Spare lanes at the end repeat
    the first row.
    """
    return types.UniTuple(Float64x8, 3)(array, rows, types.intp), _load_columns(3)


@intrinsic
def load_quadruples(context: Any, array: Any, rows: Any, start: Any) -> Any:
    """Load the four columns of rows of a (N, 4) array, like `load_triples`."""
    return types.UniTuple(Float64x8, 4)(array, rows, types.intp), _load_columns(4)


def _store(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Store vectors as the columns of an array's rows."""
    vectors = args[2:]
    data = simd.data_pointer(context, builder, sig.args[0], args[0])
    place = builder.gep(data, [builder.mul(args[1], ir.Constant(_LONG, len(vectors)))])
    element = data.type.pointee
    kind = ir.VectorType(element, LANES)
    if isinstance(element, ir.FloatType):
        vectors = [builder.fptrunc(vector, kind) for vector in vectors]
    elif element != _DOUBLE:
        vectors = [builder.fptosi(vector, kind) for vector in vectors]
    order = [column * LANES + lane for lane in range(LANES) for column in range(len(vectors))]
    vectors = [*vectors, ir.Constant(kind, ir.Undefined)] if len(vectors) == 3 else vectors
    joined_rows = shuffle(
        builder, joined := _concatenate(builder, list(vectors)), ir.Constant(joined.type, ir.Undefined), order
    )
    builder.store(joined_rows, builder.bitcast(place, ir.PointerType(joined_rows.type)), align=4)
    return context.get_dummy_value()


@intrinsic
def store(context: Any, array: Any, row: Any, a: Any) -> Any:
    """Store the lanes from a row of a (N,) array on, in its type; there is no bounds check."""
    return types.void(array, types.intp, a), _store


@intrinsic
def store_pairs(context: Any, array: Any, row: Any, a: Any, b: Any) -> Any:
    """Store lanes as columns from a row of a contiguous (N, 2) array on, like `store`."""
    return types.void(array, types.intp, a, b), _store


@intrinsic
def store_triples(context: Any, array: Any, row: Any, a: Any, b: Any, c: Any) -> Any:
    """Store lanes as columns from a row of a contiguous (N, 3) array on, like `store`."""
    return types.void(array, types.intp, a, b, c), _store
