"""A numba type for SIMD vectors.

Values of the numba type `Vector` are LLVM vectors in registers. Vectors and scalars can be added, multiplied and
compared with each other. Any processor can run them, because LLVM splits vectors that are wider than its registers.
Kernels take and return arrays, and store vectors in them.
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

intrinsic: Final[Callable[[Callable[..., Any]], Callable[..., Any]]] = _intrinsic

I32: Final = ir.IntType(32)
_ELEMENTS: Final = {
    types.float32: ir.FloatType(),
    types.float64: ir.DoubleType(),
    types.int32: I32,
    types.boolean: ir.IntType(1),
}


class Vector(types.Type):
    """The numba type of a vector.

    Args:
        element: type of the elements.
        width: number of elements.
    """

    def __init__(self, element: Any, width: int) -> None:
        self.element, self.width = element, width
        super().__init__(name=f"{element}x{width}")

    @property
    def llvm(self) -> Any:
        """The LLVM type of the vector."""
        return ir.VectorType(_ELEMENTS[self.element], self.width)


@register_default(Vector)
class _VectorModel(PrimitiveModel):
    def __init__(self, manager: Any, vector: Vector) -> None:
        super().__init__(manager, vector, vector.llvm)


def broadcast(context: Any, builder: Any, value: Any, kind: Any, vector: Vector) -> Any:
    """Broadcast a scalar to a vector; a vector is returned unchanged."""
    if isinstance(kind, Vector):
        return value
    undefined = ir.Constant(vector.llvm, ir.Undefined)
    first = builder.insert_element(undefined, context.cast(builder, value, kind, vector.element), ir.Constant(I32, 0))
    return shuffle(builder, first, first, [0] * vector.width)


def shuffle(builder: Any, a: Any, b: Any, order: list[int]) -> Any:
    """Make a vector from elements of two vectors; ``order`` holds indices into both, concatenated."""
    return builder.shuffle_vector(a, b, ir.Constant(ir.VectorType(I32, len(order)), order))


def elementwise(kinds: tuple[Vector, ...], result: Any, emit: Callable[..., Any]) -> Callable[..., Any]:
    """Make the typing function of an intrinsic on vectors, which broadcasts scalar arguments.

    Args:
        kinds: vector types of the arguments.
        result: type of the result.
        emit: emits the instructions from a builder and vectors.
    """

    def typed(*given: Any) -> Any:
        def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            return emit(
                builder,
                *(
                    broadcast(context, builder, arg, given_kind, kind)
                    for arg, given_kind, kind in zip(args, sig.args, kinds)
                ),
            )

        return result(*given), lower

    return typed


def call_llvm(name: str, vector: Vector) -> Callable[..., Any]:
    """Make a function that emits a call of an LLVM intrinsic from vectors to a vector."""
    letter = {types.float32: "f32", types.float64: "f64"}[vector.element]

    def emit(builder: Any, *args: Any) -> Any:
        kind = ir.FunctionType(vector.llvm, [arg.type for arg in args])
        return builder.call(builder.module.declare_intrinsic(f"llvm.{name}.v{vector.width}{letter}", fnty=kind), args)

    return emit


def data_pointer(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """Get the pointer to an array's elements."""
    return context.make_array(kind)(context, builder, array).data


def vector_pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any, vector: Vector) -> Any:
    """Get the pointer to a vector that begins at an index of an array."""
    start = builder.gep(data_pointer(context, builder, kind, array), [index])
    return builder.bitcast(start, ir.PointerType(vector.llvm))


def _operator(symbol: Callable[..., object], elements: tuple[Any, ...], masks: bool, emit: Callable[..., Any]) -> None:
    """Register an operator of two vectors, or of a vector and a scalar, with numba.

    Args:
        symbol: the operator.
        elements: element types of the vectors that it supports.
        masks: whether the result is a mask; otherwise it has the type of the vector.
        emit: emits the instruction from a builder and two vectors.
    """

    @infer_global(symbol)
    class _Template(AbstractTemplate):
        def generic(self, kinds: Any, keywords: Any) -> Any:
            vectors = {kind for kind in kinds if isinstance(kind, Vector)}
            known = all(isinstance(kind, Vector | types.Number) for kind in kinds)
            if len(kinds) != 2 or len(vectors) != 1 or not known or (vector := vectors.pop()).element not in elements:
                return None
            return signature(Vector(types.boolean, vector.width) if masks else vector, *kinds)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = next(kind for kind in sig.args if isinstance(kind, Vector))
        return emit(builder, *(broadcast(context, builder, arg, kind, vector) for arg, kind in zip(args, sig.args)))

    for kinds in ((Vector, Vector), (Vector, types.Number), (types.Number, Vector)):
        lower_builtin(symbol, *kinds)(lower)


def _arithmetic(name: str) -> Callable[..., Any]:
    """Emit an arithmetic instruction; float64 may be contracted to fused operations, which are at least as exact."""
    return lambda builder, a, b: getattr(builder, name)(
        a, b, flags=("contract",) if a.type.element == ir.DoubleType() else ()
    )


_FLOATS, _MASKS = (types.float32, types.float64), (types.boolean,)
for _symbol, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _operator(_symbol, _FLOATS, False, _arithmetic(_name))
for _symbol, _name in ((operator.and_, "and_"), (operator.or_, "or_"), (operator.xor, "xor")):
    _operator(_symbol, _MASKS, False, lambda builder, a, b, name=_name: getattr(builder, name)(a, b))
for _symbol, _name in ((operator.ge, ">="), (operator.gt, ">"), (operator.le, "<="), (operator.lt, "<")):
    _operator(_symbol, _FLOATS, True, lambda builder, a, b, name=_name: builder.fcmp_ordered(name, a, b))
