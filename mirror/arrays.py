"""Array aliases used in every signature: what the numbers are stands in the name, what they mean in the docstring."""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

Float64: TypeAlias = npt.NDArray[np.float64]
Float32: TypeAlias = npt.NDArray[np.float32]
Int64: TypeAlias = npt.NDArray[np.int64]
Int32: TypeAlias = npt.NDArray[np.int32]
UInt8: TypeAlias = npt.NDArray[np.uint8]
Bool: TypeAlias = npt.NDArray[np.bool_]
AnyArray: TypeAlias = npt.NDArray[Any]

_Array = TypeVar("_Array", bound=AnyArray)

Records: TypeAlias = Any
"""A structured array, or one record of it; compiled kernels read its fields as attributes, which numpy's types lack."""


def read_only(array: _Array) -> _Array:
    """Return a read-only view of an array.

    Numba compiles a kernel once more for arrays that cannot be written to, such as those of a Parquet file, than for
    others; kernels that get views of one kind are compiled once.
    """
    view = array.view()
    view.flags.writeable = False
    return view
