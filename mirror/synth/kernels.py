"""Numba options for functions that run for every pixel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def per_pixel(*, inline: Literal["never", "always"] = "never") -> Callable[[_Function], _Function]:
    """Return a decorator that compiles a function without allocations and without reference counts.

    Reference counts would take a fifth of the time of an image.

    Args:
        inline: ``always`` inlines the function into the kernels that call it.
    """
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "inline": inline, "_nrt": False}
    decorator: Callable[[_Function], _Function] = numba.njit(**options)
    return decorator
