"""Compilation with numba: functions that only compiled functions call, and functions that run for every pixel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Literal, TypeVar

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])

inner_njit: Final[Any] = njit(cache=True, nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)  # type: ignore[call-overload]
"""As ``njit(cache=True, nogil=True)``, for functions that Python does not call: the wrappers that such a call needs are
a third of the time of compilation. (numba's stubs lack these options.)
"""


def per_pixel(*, inline: Literal["never", "always"] = "never") -> Callable[[_Function], _Function]:
    """Return a decorator that compiles a function without allocations and without reference counts.

    Reference counts would take a fifth of the time of an image.

    Args:
        inline: ``always`` inlines the function into the kernels that call it.
    """
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "inline": inline, "_nrt": False}
    decorator: Callable[[_Function], _Function] = njit(**options)
    return decorator
