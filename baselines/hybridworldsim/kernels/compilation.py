"""Compilation of kernels with numba, and the stamp that decides when a cached kernel is compiled again."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from numba.core import event

from mirror.compiled import per_pixel

_Function = TypeVar("_Function", bound=Callable[..., Any])

_KERNELS: Final = Path(__file__).parent
_RASTERIZER: Final = _KERNELS.parent / "rasterizer"

_log: Final = logging.getLogger("hybridworldsim.rasterizer")
_dispatchers: Final[list[Any]] = []


def kernel(*, inline: Literal["never", "always"] = "never") -> Callable[[_Function], _Function]:
    """Compile a function with numba, to run without Python's global lock; the function must not allocate.

    The machine code is cached on disk. It is compiled again after any change of a source file in `kernels/`, in
    `rasterizer/` or in the folder of the function's own module: a kernel contains the helpers and constants that it
    takes from other modules, and numba's own cache checks the function's own file only.

    Args:
        inline: ``always``: inline the function into the kernels that call it.
    """

    def compile_kernel(function: _Function) -> _Function:
        dispatcher: Any = per_pixel(inline=inline)(function)
        cache: Any = dispatcher._cache._cache_file
        cache._source_stamp = _source_stamp(Path(function.__code__.co_filename).parent)
        cache._load_index = partial(_load_index, cache._load_index)
        _dispatchers.append(dispatcher)
        return dispatcher

    return compile_kernel


@lru_cache
def _source_stamp(folder: Path) -> str:
    """A hash of the source files in `kernels/`, in `rasterizer/` and in a folder with their subfolders."""
    files = {path for root in (_KERNELS, _RASTERIZER, folder) for path in root.rglob("*.py")}
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sorted(files))).hexdigest()


def _load_index(load: Callable[[], dict[Any, Any]]) -> dict[Any, Any]:
    """Load the index of a kernel's cache; an index that cannot be loaded after a class was renamed counts as empty.

    The index holds the types of arguments as pickles, which name their classes.
    """
    try:
        return load()
    except (ImportError, AttributeError):
        return {}


class _CompilationNotice(event.Listener):
    """Logs once per process that kernels are being compiled, because compilation is slow."""

    logged = False

    def on_start(self, compilation: Any) -> None:
        """Log when numba starts to compile one of the kernels, which is then not in the cache."""
        if not self.logged and any(compilation.data["dispatcher"] is dispatcher for dispatcher in _dispatchers):
            self.logged = True
            _log.warning("compiling the rasterizer's kernels and caching them: this takes up to half a minute")

    def on_end(self, compilation: Any) -> None:
        """Do nothing when numba has finished."""


event.register("numba:compile", _CompilationNotice())
