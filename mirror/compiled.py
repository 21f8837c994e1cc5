"""Compilation with numba, and functions that run as plain Python where the input is too small to compile them for."""

from __future__ import annotations

import gc
import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import CodeType, FunctionType, SimpleNamespace
from typing import Any, Final, Literal, TypeVar

import numpy as np
from numba import njit, types
from numba.core import event
from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher, OmittedArg

_Function = TypeVar("_Function", bound=Callable[..., Any])

COMPILE_ALWAYS: Final = "MIRROR_COMPILE_ALWAYS"
"""Environment variable: where it is set, every function is compiled, however small its input is (`mirror compile`)."""
_always: Final[list[bool]] = [True] * (COMPILE_ALWAYS in os.environ)
# Python's hypot is not that of the C library, which compiled code and numpy call: their last bits differ.
_MATH: Final = SimpleNamespace(**(vars(math) | {"hypot": np.hypot}))

_WITHOUT_WRAPPERS: Final[dict[str, Any]] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
inner_njit: Final[Any] = njit(cache=True, nogil=True, **_WITHOUT_WRAPPERS)
"""As ``njit(cache=True, nogil=True)``, for functions that Python does not call: the wrappers that such a call needs are
a third of the time of compilation. (numba's stubs lack these options.)
"""
inner_numpy_njit: Final[Any] = njit(cache=True, nogil=True, error_model="numpy", **_WITHOUT_WRAPPERS)
"""As `inner_njit`, with numpy's divisions by zero: no exceptions."""
_PER_PIXEL: Final[dict[str, Any]] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}


def compiles_always() -> bool:
    """Return whether every function is to be compiled, however small its input is: in `mirror compile`."""
    return bool(_always)


def per_pixel(*, inline: Literal["never", "always"] = "never") -> Callable[[_Function], _Function]:
    """Return a decorator that compiles a function without allocations and without reference counts.

    Reference counts would take a fifth of the time of an image.

    Args:
        inline: ``always`` inlines the function into the kernels that call it.
    """
    decorator: Callable[[_Function], _Function] = njit(**_PER_PIXEL, inline=inline)
    return decorator


def inner_per_pixel(*, inline: Literal["never", "always"] = "never") -> Callable[[_Function], _Function]:
    """Return a decorator as `per_pixel` does, for functions that Python does not call: without wrappers for it.

    Args:
        inline: ``always`` inlines the function into the kernels that call it.
    """
    decorator: Callable[[_Function], _Function] = njit(**_PER_PIXEL, **_WITHOUT_WRAPPERS, inline=inline)
    return decorator


def compiled_above(elements: int, **options: Any) -> Callable[[_Function], _Function]:
    """Return a decorator that compiles a function once its inputs are large enough to pay for the compilation.

    A compilation takes 0.2 to 2 seconds. As long as the machine code is not cached on disk, and the arrays of all calls
    in this process have no more elements together than stated, calls run the function's own source as plain Python,
    with the sources of the compiled functions that it calls. Where the machine code is cached it is loaded at the first
    call, as by numba.

    Both forms return the same bits if the function computes with float64 and int64, writes products and not powers,
    and takes its elementary functions from `math`. numpy and numba differ in the types of mixed float32 and of small
    integers, and in the order of sums: such functions are always compiled.

    Args:
        elements: elements of the arrays of all calls that run as plain Python.
        options: of `numba.njit`, beside ``cache`` and ``nogil``.
    """

    def decorate(function: _Function) -> _Function:
        dispatcher: Any = njit(cache=True, nogil=True, **options)(function)
        if isinstance(dispatcher, Dispatcher):  # not with NUMBA_DISABLE_JIT
            dispatcher.__dict__["_compile_for_args"] = _Choice(dispatcher, elements).choose
        return dispatcher

    return decorate


class _Choice:
    """The choice between plain Python and machine code, for calls whose machine code is not loaded."""

    def __init__(self, dispatcher: Any, elements: int) -> None:
        self._dispatcher, self._left = dispatcher, elements
        self._compile = dispatcher._compile_for_args
        self._is_cached: dict[tuple[Any, ...], bool] = {}

    def choose(self, *args: Any) -> Callable[..., Any]:
        """Return what runs a call, as numba's dispatcher asks for it; ``args`` are those of the call."""
        given = [argument.value if isinstance(argument, OmittedArg) else argument for argument in args]
        elements = max(1, sum(map(_count_elements, given)))
        if _always or elements > self._left or self._has_machine_code(args):
            return self._compile(*args)
        self._left -= elements
        return self._run

    def _has_machine_code(self, args: tuple[Any, ...]) -> bool:
        signature = tuple(
            types.Omitted(value.value) if isinstance(value, OmittedArg) else self._dispatcher.typeof_pyval(value)
            for value in args
        )
        if signature not in self._is_cached:
            self._is_cached[signature] = is_cached(self._dispatcher, signature)
        return self._is_cached[signature]

    def _run(self, *args: Any) -> Any:
        return run_plain(self._dispatcher, *args)


def runs_small_inputs_plainly(dispatcher: Any) -> bool:
    """Return whether a compiled function comes from `compiled_above`."""
    return isinstance(getattr(vars(dispatcher).get("_compile_for_args"), "__self__", None), _Choice)


@contextmanager
def machine_code_only() -> Iterator[None]:
    """Compile every function that is called within the block, however small its input is."""
    _always.append(True)
    try:
        yield
    finally:
        _always.pop()


def is_cached(dispatcher: Any, signature: tuple[Any, ...]) -> bool:
    """Return whether the machine code of a compiled function for types of arguments is on disk."""
    cache: Any = dispatcher._cache
    # Threads must not refresh numba's tables at one time: "generator already executing".
    with global_compiler_lock:
        dispatcher.targetctx.refresh()
        key = cache._index_key(signature, dispatcher.targetctx.codegen())
        return key in cache._cache_file._load_index()


def run_plain(dispatcher: Any, *args: Any) -> Any:
    """Run a compiled function, and the compiled functions that it calls, as plain Python."""
    # Compiled code does not warn.
    with np.errstate(all="ignore"):
        return _plain(dispatcher, {})(*map(_with_fields, args))


def _plain(dispatcher: Any, done: dict[int, FunctionType]) -> FunctionType:
    if id(dispatcher) in done:
        return done[id(dispatcher)]
    function: FunctionType = dispatcher.py_func
    names = dict(function.__globals__)
    plain = FunctionType(function.__code__, names, function.__name__, function.__defaults__, function.__closure__)
    done[id(dispatcher)] = plain
    for name in _names(function.__code__):
        if isinstance(names.get(name), Dispatcher):
            names[name] = _plain(names[name], done)
        elif names.get(name) is math:
            names[name] = _MATH
    return plain


def _names(code: CodeType) -> set[str]:
    return set(code.co_names).union(*(_names(inner) for inner in code.co_consts if isinstance(inner, CodeType)))


def _count_elements(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return value.size
    return sum(map(_count_elements, value)) if isinstance(value, tuple) else 0


def _with_fields(value: Any) -> Any:
    """An argument whose records have their fields as attributes, as they have in compiled functions."""
    if isinstance(value, OmittedArg):
        return value.value
    if isinstance(value, np.ndarray):
        return value.view(np.recarray) if value.dtype.names else value
    if isinstance(value, tuple):
        fields = map(_with_fields, value)
        return type(value)(*fields) if hasattr(value, "_fields") else tuple(fields)
    return value


class _NoCollection(event.Listener):
    """Stops the garbage collector while numba compiles: it would search the compiler's own objects again and again."""

    depth = 0

    def on_start(self, compilation: Any) -> None:
        """Stop the collector when the outermost function begins; numba compiles one at a time."""
        if self.depth == 0:
            self.was_enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, compilation: Any) -> None:
        """Let the collector go on when the outermost function is compiled."""
        self.depth -= 1
        if self.depth == 0 and self.was_enabled:
            gc.enable()


event.register("numba:compile", _NoCollection())
