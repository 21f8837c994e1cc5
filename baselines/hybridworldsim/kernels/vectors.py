"""Vectors of sixteen float32 in numba kernels: a block of 4 x 4 pixels."""

from __future__ import annotations

from typing import Any, Final

from llvmlite import ir
from numba import types

from hybridworldsim.kernels import simd
from hybridworldsim.kernels.simd import I32, Vector, elementwise, intrinsic, shuffle, vector_pointer

WIDTH: Final = 16
Float32x16: Final = Vector(types.float32, WIDTH)
Int32x16: Final = Vector(types.int32, WIDTH)
Mask16: Final = Vector(types.boolean, WIDTH)


@intrinsic
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Compute ``a * b + c``, rounded once."""
    return elementwise((Float32x16,) * 3, Float32x16, simd.call_llvm("fma", Float32x16))(a, b, c)


@intrinsic
def fnma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Compute ``c - a * b``, rounded once."""

    def emit(builder: Any, a: Any, b: Any, c: Any) -> Any:
        return simd.call_llvm("fma", Float32x16)(builder, builder.fneg(a), b, c)

    return elementwise((Float32x16,) * 3, Float32x16, emit)(a, b, c)


@intrinsic
def min_or_b(typing_context: Any, a: Any, b: Any) -> Any:
    """Compute the minimum of ``a`` and ``b``; ``b`` where one is NaN."""

    def emit(builder: Any, a: Any, b: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", a, b), a, b)

    return elementwise((Float32x16,) * 2, Float32x16, emit)(a, b)


@intrinsic
def abs_(typing_context: Any, a: Any) -> Any:
    """Compute absolute values."""
    return elementwise((Float32x16,), Float32x16, simd.call_llvm("fabs", Float32x16))(a)


@intrinsic
def scale_by_power(typing_context: Any, number: Any, shifted: Any) -> Any:
    """Compute ``number * 2 ** power`` by adding exponents; ``shifted`` is ``power`` (small) plus 1.5 * 2 ** 23."""

    def emit(builder: Any, number: Any, shifted: Any) -> Any:
        integers = ir.VectorType(I32, WIDTH)
        moved = builder.shl(builder.bitcast(shifted, integers), ir.Constant(integers, [23] * WIDTH))
        return builder.bitcast(builder.add(builder.bitcast(number, integers), moved), number.type)

    return elementwise((Float32x16,) * 2, Float32x16, emit)(number, shifted)


@intrinsic
def select(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """Select ``a`` where the mask is set, else ``b``; floats."""
    kinds = (Mask16, Float32x16, Float32x16)
    return elementwise(kinds, Float32x16, lambda builder, *args: builder.select(*args))(mask, a, b)


@intrinsic
def select_int(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """Select ``a`` where the mask is set, else ``b``; integers."""
    kinds = (Mask16, Int32x16, Int32x16)
    return elementwise(kinds, Int32x16, lambda builder, *args: builder.select(*args))(mask, a, b)


@intrinsic
def greater_int(typing_context: Any, a: Any, b: Any) -> Any:
    """Compare integers: mask of ``a > b``."""
    kinds = (Int32x16, Int32x16)
    return elementwise(kinds, Mask16, lambda builder, a, b: builder.icmp_signed(">", a, b))(a, b)


@intrinsic
def has_bits(typing_context: Any, a: Any, b: Any) -> Any:
    """Test integers: mask of ``a & b != 0``."""

    def emit(builder: Any, a: Any, b: Any) -> Any:
        return builder.icmp_unsigned("!=", builder.and_(a, b), ir.Constant(a.type, [0] * WIDTH))

    return elementwise((Int32x16, Int32x16), Mask16, emit)(a, b)


@intrinsic
def trailing_zeros(typing_context: Any, number: Any) -> Any:
    """Find the index of the lowest set bit of an unsigned 64-bit integer other than 0."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), lower


@intrinsic
def prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """Prefetch an element of a contiguous array into the cache."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = simd.data_pointer(context, builder, sig.args[0], args[0])
        place = builder.bitcast(builder.gep(data, [args[1]]), ir.PointerType(ir.IntType(8)))
        kinds = [place.type, I32, I32, I32]
        function = builder.module.declare_intrinsic("llvm.prefetch.p0", fnty=ir.FunctionType(ir.VoidType(), kinds))
        builder.call(function, [place] + [ir.Constant(I32, value) for value in (0, 3, 1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), lower


@intrinsic
def to_bits(typing_context: Any, mask: Any) -> Any:
    """Convert a mask to an integer; the lowest bit is the first element."""
    emit = lambda builder, mask: builder.zext(builder.bitcast(mask, ir.IntType(WIDTH)), I32)  # noqa: E731
    return elementwise((Mask16,), types.int32, emit)(mask)


@intrinsic
def from_bits(typing_context: Any, number: Any) -> Any:
    """Convert the lowest bits of an integer to a mask."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        integers = context.cast(builder, args[0], sig.args[0], types.int32)
        return builder.bitcast(builder.trunc(integers, ir.IntType(WIDTH)), Mask16.llvm)

    return Mask16(number), lower


@intrinsic
def broadcast(typing_context: Any, number: Any) -> Any:
    """Broadcast a number to a vector."""
    return elementwise((Float32x16,), Float32x16, lambda builder, vector: vector)(number)


@intrinsic
def sum_elements(typing_context: Any, vector: Any) -> Any:
    """Sum the elements of a vector pairwise, by halves."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(_sum_rows(builder, [args[0]]), ir.Constant(I32, 0))

    return types.float32(Float32x16), lower


@intrinsic
def sum_each(typing_context: Any, vectors: Any) -> Any:
    """Sum the elements of each of up to 16 vectors by halves; element i of the result is sum i, the rest is 0."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _sum_rows(builder, [builder.extract_value(args[0], place) for place in range(sig.args[0].count)])

    return Float32x16(vectors), lower


def _sum_rows(builder: Any, rows: list[Any]) -> Any:
    """Sum the elements of each vector by halves; the sums are the elements of the result."""
    half = WIDTH // 2
    while half:
        rows += [ir.Constant(Float32x16.llvm, None)] * (len(rows) % 2)
        low = [lane for lane in range(2 * WIDTH) if lane // half % 2 == 0]
        rows = [
            builder.fadd(*(shuffle(builder, a, b, [lane + up for lane in low]) for up in (0, half)))
            for a, b in zip(rows[::2], rows[1::2])
        ]
        half //= 2
    return rows[0]


@intrinsic
def transpose_channels(typing_context: Any, channels: Any) -> Any:
    """Transpose four vectors of 16 pixels, one channel each, to four vectors of 4 pixels with their channels."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b, c, d = (builder.extract_value(args[0], place) for place in range(4))
        low = [lane // 2 + WIDTH * (lane % 2) for lane in range(WIDTH)]
        high = [lane + WIDTH // 2 for lane in low]
        rows = [
            shuffle(builder, shuffle(builder, a, c, part), shuffle(builder, b, d, part), half)
            for part in (low, high)
            for half in (low, high)
        ]
        return context.make_tuple(builder, sig.return_type, rows)

    return types.UniTuple(Float32x16, 4)(channels), lower


@intrinsic
def store_rgb(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Store the first three of every four elements, from an index on, in a contiguous one-dimensional array."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        lanes = [lane for lane in range(WIDTH) if lane % 4 < 3]
        packed = shuffle(builder, args[2], args[2], lanes + [0] * (WIDTH - len(lanes)))
        pointer = vector_pointer(context, builder, sig.args[0], args[0], args[1], sig.args[2])
        mask = ir.Constant(Mask16.llvm, [1] * len(lanes) + [0] * (WIDTH - len(lanes)))
        kinds = [packed.type, pointer.type, I32, mask.type]
        name = f"llvm.masked.store.v{WIDTH}f32.p0"
        function = builder.module.declare_intrinsic(name, fnty=ir.FunctionType(ir.VoidType(), kinds))
        builder.call(function, [packed, pointer, ir.Constant(I32, 4), mask])
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), lower


@intrinsic
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """Load the elements from an index of a contiguous one-dimensional array on; there is no bounds check."""
    vector = Vector(array.dtype, WIDTH)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(vector_pointer(context, builder, sig.args[0], args[0], args[1], vector), align=4)

    return vector(array, types.intp), lower


@intrinsic
def load_one(typing_context: Any, array: Any, index: Any) -> Any:
    """Load one element of a contiguous one-dimensional array and broadcast it; there is no bounds check."""
    vector = Vector(array.dtype, WIDTH)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = simd.data_pointer(context, builder, sig.args[0], args[0])
        scalar = builder.load(builder.gep(data, [args[1]]))
        return simd.broadcast(context, builder, scalar, vector.element, vector)

    return vector(array, types.intp), lower


@intrinsic
def store(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Store the elements from an index of a contiguous one-dimensional array on; there is no bounds check."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], vector_pointer(context, builder, sig.args[0], args[0], args[1], sig.args[2]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), lower


@intrinsic
def store_nontemporal(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Store a full cache line in an aligned one-dimensional array, bypassing the caches, for data not read soon.

    Call `fence` before another thread reads the line.
    """

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointer = vector_pointer(context, builder, sig.args[0], args[0], args[1], sig.args[2])
        written = builder.store(args[2], pointer, align=64)
        written.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(I32, 1)]))
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), lower


@intrinsic
def fence(typing_context: Any) -> Any:
    """Wait until all stores are visible to other threads."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), lower
