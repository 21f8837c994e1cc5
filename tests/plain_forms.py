"""Both forms of compiled functions, side by side: machine code, and the same source as plain Python."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

from mirror.compiled import machine_code_only, run_plain, runs_small_inputs_plainly


def compare_forms(patch: pytest.MonkeyPatch, *modules: ModuleType, own: bool = False) -> dict[str, int]:
    """Let each call of a function that is compiled above a size, of these modules, run in both forms.

    A call fails if results or arguments differ in a bit.

    Args:
        patch: puts both forms in place.
        modules: modules that import the functions.
        own: these modules have the functions themselves, and no other compiled function there calls them.

    Returns:
        The number of calls by name of the function, which the calls fill.
    """
    calls: dict[str, int] = {}
    for module in modules:
        for name, value in vars(module).copy().items():
            # In its own module another compiled function may call it.
            is_meant = isinstance(value, Dispatcher) and (value.py_func.__module__ == module.__name__) == own
            if is_meant and runs_small_inputs_plainly(value):
                patch.setattr(module, name, _both(value, name, calls))
    return calls


def _both(dispatcher: Any, name: str, calls: dict[str, int]) -> Any:
    calls[name] = 0

    def call(*args: Any) -> Any:
        calls[name] += 1
        others = copy.deepcopy(args)
        with machine_code_only():
            result = dispatcher(*args)
        plain = run_plain(dispatcher, *others)
        for kind, first, second in (("result", result, plain), ("arguments", args, others)):
            assert list(_bits(first)) == list(_bits(second)), f"{kind} of {name}"
        return result

    return call


def _bits(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple):
        for item in value:
            yield from _bits(item)
    elif isinstance(value, np.ndarray):
        yield value.shape, value.tobytes()
    else:
        yield None if value is None else np.asarray(value, np.float64 if isinstance(value, float) else None).tobytes()
