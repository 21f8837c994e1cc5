"""Sixteen float32 at once in numba kernels: a block of pixels."""

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
    """``a * b + c``, rounded once."""
    return elementwise((Float32x16,) * 3, Float32x16, simd.call_llvm("fma", Float32x16))(a, b, c)


@intrinsic
def fnma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """``c - a * b``, rounded once."""

    def emit(builder: Any, a: Any, b: Any, c: Any) -> Any:
        return simd.call_llvm("fma", Float32x16)(builder, builder.fneg(a), b, c)

    return elementwise((Float32x16,) * 3, Float32x16, emit)(a, b, c)


@intrinsic
def min_or_b(typing_context: Any, a: Any, b: Any) -> Any:
    """The lesser of each two; ``b`` where one is not a number."""

    def emit(builder: Any, a: Any, b: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", a, b), a, b)

    return elementwise((Float32x16,) * 2, Float32x16, emit)(a, b)


@intrinsic
def abs_(typing_context: Any, a: Any) -> Any:
    """Without signs."""
    return elementwise((Float32x16,), Float32x16, simd.call_llvm("fabs", Float32x16))(a)


@intrinsic
def scale_by_power(typing_context: Any, number: Any, shifted: Any) -> Any:
    """``number * 2 ** whole``, where ``shifted`` is the small whole number plus 1.5 * 2 ** 23: exponents are added."""

    def emit(builder: Any, number: Any, shifted: Any) -> Any:
        whole = ir.VectorType(I32, WIDTH)
        moved = builder.shl(builder.bitcast(shifted, whole), ir.Constant(whole, [23] * WIDTH))
        return builder.bitcast(builder.add(builder.bitcast(number, whole), moved), number.type)

    return elementwise((Float32x16,) * 2, Float32x16, emit)(number, shifted)


@intrinsic
def select(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where the mask is set, else ``b``; floats."""
    kinds = (Mask16, Float32x16, Float32x16)
    return elementwise(kinds, Float32x16, lambda builder, *args: builder.select(*args))(mask, a, b)


@intrinsic
def select_int(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where the mask is set, else ``b``; whole numbers."""
    kinds = (Mask16, Int32x16, Int32x16)
    return elementwise(kinds, Int32x16, lambda builder, *args: builder.select(*args))(mask, a, b)


@intrinsic
def greater_int(typing_context: Any, a: Any, b: Any) -> Any:
    """Where whole ``a`` is above whole ``b``."""
    kinds = (Int32x16, Int32x16)
    return elementwise(kinds, Mask16, lambda builder, a, b: builder.icmp_signed(">", a, b))(a, b)


@intrinsic
def has_bits(typing_context: Any, a: Any, b: Any) -> Any:
    """Where whole ``a`` has one of the bits of whole ``b``."""

    def emit(builder: Any, a: Any, b: Any) -> Any:
        return builder.icmp_unsigned("!=", builder.and_(a, b), ir.Constant(a.type, [0] * WIDTH))

    return elementwise((Int32x16, Int32x16), Mask16, emit)(a, b)


@intrinsic
def trailing_zeros(typing_context: Any, number: Any) -> Any:
    """The place of the lowest bit that is set in an unsigned number of 64 bits, which is not 0."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), lower


@intrinsic
def prefetch(typing_context: Any, array: Any, index: Any) -> Any:
    """Bring an element of a contiguous array near that is read soon."""

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
    """The mask as a number, whose lowest bit is the first element's."""
    emit = lambda builder, mask: builder.zext(builder.bitcast(mask, ir.IntType(WIDTH)), I32)  # noqa: E731
    return elementwise((Mask16,), types.int32, emit)(mask)


@intrinsic
def from_bits(typing_context: Any, number: Any) -> Any:
    """The mask that has a number's lowest bits."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = context.cast(builder, args[0], sig.args[0], types.int32)
        return builder.bitcast(builder.trunc(whole, ir.IntType(WIDTH)), Mask16.llvm)

    return Mask16(number), lower


@intrinsic
def broadcast(typing_context: Any, number: Any) -> Any:
    """A vector of one number."""
    return elementwise((Float32x16,), Float32x16, lambda builder, vector: vector)(number)


@intrinsic
def sum_elements(typing_context: Any, vector: Any) -> Any:
    """The sum of a vector's elements, added by halves."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(_sum_rows(builder, [args[0]]), ir.Constant(I32, 0))

    return types.float32(Float32x16), lower


@intrinsic
def sum_each(typing_context: Any, vectors: Any) -> Any:
    """The sums of each of up to 16 vectors' elements, as a vector; they are added by halves, 0 beyond the last."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _sum_rows(builder, [builder.extract_value(args[0], place) for place in range(sig.args[0].count)])

    return Float32x16(vectors), lower


def _sum_rows(builder: Any, rows: list[Any]) -> Any:
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
    """Four vectors of 16 pixels, a channel each, as four vectors of 4 pixels, all channels of a pixel side by side."""

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
    """Write the first three of each four elements from an index on, into a contiguous array of one dimension."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        lanes = [lane for lane in range(WIDTH) if lane % 4 < 3]
        packed = shuffle(builder, args[2], args[2], lanes + [0] * (WIDTH - len(lanes)))
        there = vector_pointer(context, builder, sig.args[0], args[0], args[1], sig.args[2])
        mask = ir.Constant(Mask16.llvm, [1] * len(lanes) + [0] * (WIDTH - len(lanes)))
        kinds = [packed.type, there.type, I32, mask.type]
        name = f"llvm.masked.store.v{WIDTH}f32.p0"
        function = builder.module.declare_intrinsic(name, fnty=ir.FunctionType(ir.VoidType(), kinds))
        builder.call(function, [packed, there, ir.Constant(I32, 4), mask])
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), lower


@intrinsic
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """The elements from an index on, of a contiguous array of one dimension; nothing checks that they are there."""
    vector = Vector(array.dtype, WIDTH)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(vector_pointer(context, builder, sig.args[0], args[0], args[1], vector), align=4)

    return vector(array, types.intp), lower


@intrinsic
def load_one(typing_context: Any, array: Any, index: Any) -> Any:
    """A vector of the one element at an index of a contiguous array of one dimension; nothing checks the index."""
    vector = Vector(array.dtype, WIDTH)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = simd.data_pointer(context, builder, sig.args[0], args[0])
        scalar = builder.load(builder.gep(data, [args[1]]))
        return simd.broadcast(context, builder, scalar, vector.element, vector)

    return vector(array, types.intp), lower


@intrinsic
def store(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write the elements from an index on, into a contiguous array of one dimension; nothing checks that it fits."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], vector_pointer(context, builder, sig.args[0], args[0], args[1], sig.args[2]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), lower


@intrinsic
def store_nontemporal(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write a whole cache line past the caches, into an aligned array of one dimension: it is not read soon.

    `fence` has to follow before another thread reads it.
    """

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        there = vector_pointer(context, builder, sig.args[0], args[0], args[1], sig.args[2])
        written = builder.store(args[2], there, align=64)
        written.set_metadata("nontemporal", builder.module.add_metadata([ir.Constant(I32, 1)]))
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), lower


@intrinsic
def fence(typing_context: Any) -> Any:
    """Wait until all that was written can be read."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), lower
