"""How kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(*, inline: Literal["never", "always"] = "never") -> Callable[[_Function], _Function]:
    """Compile a function that allocates nothing and lets go of Python's lock.

    Args:
        inline: ``always``: into the kernels that call it.
    """
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "inline": inline, "_nrt": False}
    compiled: Callable[[_Function], _Function] = numba.njit(**options)
    return compiled
