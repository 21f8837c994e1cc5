"""Compilation of functions that only compiled functions call."""

from __future__ import annotations

from typing import Any, Final

from numba import njit

inner_njit: Final[Any] = njit(cache=True, nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)  # type: ignore[call-overload]
"""As ``njit(cache=True, nogil=True)``, for functions that Python does not call: the wrappers that such a call needs are
a third of the time of compilation. (numba's stubs lack these options.)
"""
