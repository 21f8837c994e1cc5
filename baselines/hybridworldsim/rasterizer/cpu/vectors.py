"""Sixteen numbers at once in numba kernels: a vector is a value like any other, and lives in registers.

`Float32x16` and `Mask16` are numba types whose values are LLVM vectors. They are added, multiplied and compared like
scalars, among each other and with scalars, and need no particular processor: LLVM splits them where registers are
narrower. What leaves a kernel is stored in arrays.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.core.datamodel.models import PrimitiveModel
from numba.core.datamodel.registry import register_default
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic as _intrinsic

WIDTH: Final = 16

intrinsic: Any = _intrinsic


class Vector(types.Type):
    """The numba type of WIDTH elements.

    Args:
        element: their type.
    """

    def __init__(self, element: Any) -> None:
        self.element = element
        super().__init__(name=f"{element}x{WIDTH}")


Float32x16: Final = Vector(types.float32)
Int32x16: Final = Vector(types.int32)
Mask16: Final = Vector(types.boolean)

_ELEMENT: Final = {types.float32: ir.FloatType(), types.int32: ir.IntType(32), types.boolean: ir.IntType(1)}
_I32: Final = ir.IntType(32)


def _llvm(vector: Vector) -> Any:
    return ir.VectorType(_ELEMENT[vector.element], WIDTH)


@register_default(Vector)
class _VectorModel(PrimitiveModel):
    def __init__(self, manager: Any, vector: Vector) -> None:
        super().__init__(manager, vector, _llvm(vector))


def _spread(context: Any, builder: Any, value: Any, kind: Any, vector: Vector) -> Any:
    """The value as a vector, whether it is one or a scalar."""
    if isinstance(kind, Vector):
        return value
    kind_of_vector = _llvm(vector)
    nothing = ir.Constant(kind_of_vector, ir.Undefined)
    scalar = context.cast(builder, value, kind, vector.element)
    first = builder.insert_element(nothing, scalar, ir.Constant(_I32, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(_I32, WIDTH), [0] * WIDTH))


def _vector_of(kinds: Any) -> Vector | None:
    """The vector type that kinds, of which others are scalars, have in common."""
    vectors = {kind for kind in kinds if isinstance(kind, Vector)}
    scalars = all(isinstance(kind, Vector | types.Number) for kind in kinds)
    return vectors.pop() if len(vectors) == 1 and scalars else None


def _operator(
    symbol: Callable[..., object], elements: tuple[Any, ...], result: Vector | None, emit: Callable[..., Any]
) -> None:
    """Teach numba an operator of two vectors, or of a vector and a scalar.

    Args:
        symbol: the operator.
        elements: of which vectors it is one.
        result: the type of what it gives; None: the vectors' own.
        emit: makes its instruction from a builder and two vectors.
    """

    @infer_global(symbol)
    class _Template(AbstractTemplate):
        def generic(self, kinds: Any, keywords: Any) -> Any:
            vector = _vector_of(kinds)
            if len(kinds) != 2 or vector is None or vector.element not in elements:
                return None
            return signature(result or vector, *kinds)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = next(kind for kind in sig.args if isinstance(kind, Vector))
        return emit(builder, *(_spread(context, builder, arg, kind, vector) for arg, kind in zip(args, sig.args)))

    for kinds in ((Vector, Vector), (Vector, types.Number), (types.Number, Vector)):
        lower_builtin(symbol, *kinds)(lower)


_FLOAT, _MASK = (types.float32,), (types.boolean,)
_operator(operator.add, _FLOAT, None, lambda builder, a, b: builder.fadd(a, b))
_operator(operator.sub, _FLOAT, None, lambda builder, a, b: builder.fsub(a, b))
_operator(operator.mul, _FLOAT, None, lambda builder, a, b: builder.fmul(a, b))
_operator(operator.truediv, _FLOAT, None, lambda builder, a, b: builder.fdiv(a, b))
_operator(operator.and_, _MASK, None, lambda builder, a, b: builder.and_(a, b))
_operator(operator.or_, _MASK, None, lambda builder, a, b: builder.or_(a, b))
_operator(operator.xor, _MASK, None, lambda builder, a, b: builder.xor(a, b))
for _symbol, _name in ((operator.ge, ">="), (operator.gt, ">"), (operator.le, "<="), (operator.lt, "<")):
    _operator(_symbol, _FLOAT, Mask16, lambda builder, a, b, name=_name: builder.fcmp_ordered(name, a, b))


def _function(kinds: tuple[Vector, ...], result: Any, emit: Callable[..., Any]) -> Callable[..., Any]:
    """A function of vectors, for whose vectors scalars may stand; ``emit`` makes it from a builder and vectors."""

    def typed(typing_context: Any, *given: Any) -> Any:
        def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return emit(builder, *(_spread(context, builder, *one) for one in zip(args, sig.args, kinds)))

        return result(*given), lower

    return typed


def _call(builder: Any, name: str, result: Any, args: Any) -> Any:
    function = builder.module.declare_intrinsic(name, fnty=ir.FunctionType(result, [arg.type for arg in args]))
    return builder.call(function, args)


def _float_call(name: str) -> Callable[..., Any]:
    kind = _llvm(Float32x16)
    return lambda builder, *args: _call(builder, f"llvm.{name}.v{WIDTH}f32", kind, args)


@intrinsic
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """``a * b + c``, rounded once."""
    return _function((Float32x16,) * 3, Float32x16, _float_call("fma"))(typing_context, a, b, c)


@intrinsic
def take(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """``c - a * b``, rounded once."""

    def emit(builder: Any, a: Any, b: Any, c: Any) -> Any:
        return _float_call("fma")(builder, builder.fneg(a), b, c)

    return _function((Float32x16,) * 3, Float32x16, emit)(typing_context, a, b, c)


@intrinsic
def least(typing_context: Any, a: Any, b: Any) -> Any:
    """The lesser of each two; ``b`` where one is not a number."""

    def emit(builder: Any, a: Any, b: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", a, b), a, b)

    return _function((Float32x16,) * 2, Float32x16, emit)(typing_context, a, b)


@intrinsic
def magnitude(typing_context: Any, a: Any) -> Any:
    """Without signs."""
    return _function((Float32x16,), Float32x16, _float_call("fabs"))(typing_context, a)


@intrinsic
def times_power(typing_context: Any, number: Any, shifted: Any) -> Any:
    """``number * 2 ** whole``, where ``shifted`` is the small whole number plus 1.5 * 2 ** 23: exponents are added."""

    def emit(builder: Any, number: Any, shifted: Any) -> Any:
        whole = ir.VectorType(_I32, WIDTH)
        moved = builder.shl(builder.bitcast(shifted, whole), ir.Constant(whole, [23] * WIDTH))
        return builder.bitcast(builder.add(builder.bitcast(number, whole), moved), number.type)

    return _function((Float32x16,) * 2, Float32x16, emit)(typing_context, number, shifted)


@intrinsic
def choose(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where the mask is set, else ``b``; floats."""
    kinds = (Mask16, Float32x16, Float32x16)
    return _function(kinds, Float32x16, lambda builder, *args: builder.select(*args))(typing_context, mask, a, b)


@intrinsic
def choose_whole(typing_context: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where the mask is set, else ``b``; whole numbers."""
    kinds = (Mask16, Int32x16, Int32x16)
    return _function(kinds, Int32x16, lambda builder, *args: builder.select(*args))(typing_context, mask, a, b)


@intrinsic
def beyond(typing_context: Any, a: Any, b: Any) -> Any:
    """Where whole ``a`` is above whole ``b``."""
    kinds = (Int32x16, Int32x16)
    return _function(kinds, Mask16, lambda builder, a, b: builder.icmp_signed(">", a, b))(typing_context, a, b)


@intrinsic
def having(typing_context: Any, a: Any, b: Any) -> Any:
    """Where whole ``a`` has one of the bits of whole ``b``."""

    def emit(builder: Any, a: Any, b: Any) -> Any:
        return builder.icmp_unsigned("!=", builder.and_(a, b), ir.Constant(a.type, [0] * WIDTH))

    return _function((Int32x16, Int32x16), Mask16, emit)(typing_context, a, b)


@intrinsic
def lowest(typing_context: Any, number: Any) -> Any:
    """The place of the lowest bit that is set in an unsigned number of 64 bits, which is not 0."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.uint64), lower


@intrinsic
def fetch(typing_context: Any, array: Any, index: Any) -> Any:
    """Bring an element of a contiguous array near that is read soon."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), ir.PointerType(ir.IntType(8)))
        kinds = [place.type, _I32, _I32, _I32]
        function = builder.module.declare_intrinsic("llvm.prefetch.p0", fnty=ir.FunctionType(ir.VoidType(), kinds))
        builder.call(function, [place] + [ir.Constant(_I32, value) for value in (0, 3, 1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), lower


@intrinsic
def bits(typing_context: Any, mask: Any) -> Any:
    """The mask as a number, whose lowest bit is the first element's."""
    emit = lambda builder, mask: builder.zext(builder.bitcast(mask, ir.IntType(WIDTH)), _I32)  # noqa: E731
    return _function((Mask16,), types.int32, emit)(typing_context, mask)


@intrinsic
def mask_of(typing_context: Any, number: Any) -> Any:
    """The mask that has a number's lowest bits."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole = context.cast(builder, args[0], sig.args[0], types.int32)
        return builder.bitcast(builder.trunc(whole, ir.IntType(WIDTH)), _llvm(Mask16))

    return Mask16(number), lower


@intrinsic
def spread(typing_context: Any, number: Any) -> Any:
    """A vector of one number."""
    return _function((Float32x16,), Float32x16, lambda builder, vector: vector)(typing_context, number)


@intrinsic
def total(typing_context: Any, vector: Any) -> Any:
    """The sum of a vector's elements, added by halves."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.extract_element(_totals(builder, [args[0]]), ir.Constant(_I32, 0))

    return types.float32(Float32x16), lower


@intrinsic
def totals(typing_context: Any, vectors: Any) -> Any:
    """The sums of each of up to 16 vectors' elements, as a vector; they are added by halves, 0 beyond the last."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _totals(builder, [builder.extract_value(args[0], place) for place in range(sig.args[0].count)])

    return Float32x16(vectors), lower


def _totals(builder: Any, rows: list[Any]) -> Any:
    half = WIDTH // 2
    while half:
        rows += [ir.Constant(_llvm(Float32x16), None)] * (len(rows) % 2)
        low = [lane for lane in range(2 * WIDTH) if lane // half % 2 == 0]
        rows = [
            builder.fadd(*(_picked(builder, a, b, [lane + up for lane in low]) for up in (0, half)))
            for a, b in zip(rows[::2], rows[1::2])
        ]
        half //= 2
    return rows[0]


def _picked(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(_I32, WIDTH), lanes))


@intrinsic
def by_pixel(typing_context: Any, channels: Any) -> Any:
    """Four vectors of 16 pixels, a channel each, as four vectors of 4 pixels, all channels of a pixel side by side."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b, c, d = (builder.extract_value(args[0], place) for place in range(4))
        low = [lane // 2 + WIDTH * (lane % 2) for lane in range(WIDTH)]
        high = [lane + WIDTH // 2 for lane in low]
        rows = [
            _picked(builder, _picked(builder, a, c, part), _picked(builder, b, d, part), half)
            for part in (low, high)
            for half in (low, high)
        ]
        return context.make_tuple(builder, sig.return_type, rows)

    return types.UniTuple(Float32x16, 4)(channels), lower


@intrinsic
def store_threes(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write the first three of each four elements from an index on, into a contiguous array of one dimension."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        lanes = [lane for lane in range(WIDTH) if lane % 4 < 3]
        packed = _picked(builder, args[2], args[2], lanes + [0] * (WIDTH - len(lanes)))
        place = _place(context, builder, sig.args[0], args[0], args[1], sig.args[2])
        mask = ir.Constant(_llvm(Mask16), [1] * len(lanes) + [0] * (WIDTH - len(lanes)))
        kinds = [packed.type, place.type, _I32, mask.type]
        name = f"llvm.masked.store.v{WIDTH}f32.p0"
        function = builder.module.declare_intrinsic(name, fnty=ir.FunctionType(ir.VoidType(), kinds))
        builder.call(function, [packed, place, ir.Constant(_I32, 4), mask])
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), lower


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any, vector: Vector) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), ir.PointerType(_llvm(vector)))


@intrinsic
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """The elements from an index on, of a contiguous array of one dimension; nothing checks that they are there."""
    vector = Vector(array.dtype)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_place(context, builder, sig.args[0], args[0], args[1], vector), align=4)

    return vector(array, types.intp), lower


@intrinsic
def lift(typing_context: Any, array: Any, index: Any) -> Any:
    """A vector of the one element at an index of a contiguous array of one dimension; nothing checks the index."""
    vector = Vector(array.dtype)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        scalar = builder.load(builder.gep(data, [args[1]]))
        return _spread(context, builder, scalar, vector.element, vector)

    return vector(array, types.intp), lower


@intrinsic
def store(typing_context: Any, array: Any, index: Any, vector: Any) -> Any:
    """Write the elements from an index on, into a contiguous array of one dimension; nothing checks that it fits."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], _place(context, builder, sig.args[0], args[0], args[1], sig.args[2]), align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), lower
