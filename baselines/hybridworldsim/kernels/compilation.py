"""How kernels are compiled, and when again."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import numba
from numba.core import event

_Function = TypeVar("_Function", bound=Callable[..., Any])

_log: Final = logging.getLogger("hybridworldsim.rasterizer")
_kernels: Final[list[Any]] = []


def kernel(*, inline: Literal["never", "always"] = "never") -> Callable[[_Function], _Function]:
    """Compile a function that allocates nothing and lets go of Python's lock.

    The machine code is kept on disk for as long as the rasterizer's sources stay as they are: a kernel holds what it
    takes from other modules, which numba's own cache does not notice.

    Args:
        inline: ``always``: into the kernels that call it.
    """
    options: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "inline": inline, "_nrt": False}

    def compiled(function: _Function) -> _Function:
        dispatcher: Any = numba.njit(**options)(function)
        dispatcher._cache._cache_file._source_stamp = _SOURCES
        _kernels.append(dispatcher)
        return dispatcher

    return compiled


def _sources() -> str:
    """A hash of the sources that kernels are made of: this package and the rasterizer."""
    packages = (Path(__file__).parent, Path(__file__).parents[1] / "rasterizer")
    files = sorted(path for package in packages for path in package.rglob("*.py"))
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()


class _Announcer(event.Listener):
    """Says once a process that kernels are compiled, which takes a while."""

    said = False

    def on_start(self, compilation: Any) -> None:
        """Numba begins to compile something that it has not on disk."""
        if not self.said and any(compilation.data["dispatcher"] is one for one in _kernels):
            self.said = True
            _log.warning("compiling the rasterizer's kernels, which are then kept: up to half a minute")

    def on_end(self, compilation: Any) -> None:
        """Numba is done."""


_SOURCES: Final = _sources()
event.register("numba:compile", _Announcer())
