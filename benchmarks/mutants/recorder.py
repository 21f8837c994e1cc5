"""Records which functions of a source tree are called, at the cost of one set insertion a call.

The modules of the tree are compiled with one more statement at the begin of every function. Functions that numba
compiles are left as they are: their calls are not recorded, nor are those in processes that tests start.
"""

from __future__ import annotations

import ast
import builtins
import functools
import sys
from collections.abc import Callable
from importlib.machinery import FileFinder, ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any, Final

_CALLED: Final = "_mirror_called"
# Decorators of functions that stay Python; any other decorator in a module that uses numba may compile.
_PYTHON: Final = {"property", "cached_property", "staticmethod", "classmethod", "cache", "lru_cache", "contextmanager"}
_Function = ast.FunctionDef | ast.AsyncFunctionDef


def start_recording(tree: Path, packages: tuple[str, ...], called: set[str]) -> Callable[[], None]:
    """Add ``FILE:LINE`` of each function of these packages of a tree to `called` when it is called, from now on.

    The modules must not be imported yet.

    Returns:
        A function that forgets what `functools.lru_cache` keeps, so that the next calls are seen again.
    """
    setattr(builtins, _CALLED, called.add)
    caches: list[Any] = []
    make_cache = functools.lru_cache

    def lru_cache(*words: Any, **more: Any) -> Any:
        made = make_cache(*words, **more)
        return note(made) if hasattr(made, "cache_clear") else lambda function: note(made(function))

    def note(cache: Any) -> Any:
        if cache.__module__.split(".")[0] in packages:
            caches.append(cache)
        return cache

    functools.lru_cache = lru_cache
    sys.meta_path.insert(0, _Finder(tree, packages))

    def forget() -> None:
        for cache in caches:
            cache.cache_clear()

    return forget


def with_calls(text: str, file: str) -> ast.Module:
    """Return the syntax tree of a source file whose functions note that they are called."""
    module = ast.parse(text)
    compiled = is_compiled(text)
    _add_calls(module, file, compiled=compiled)
    return ast.fix_missing_locations(module)


def is_compiled(text: str) -> bool:
    """Return whether a source file may have functions that numba compiles."""
    return "numba" in text or "mirror.compiled" in text


def first_line(function: _Function) -> int:
    """Return the first line of a function with its decorators."""
    return min(node.lineno for node in (function, *function.decorator_list))


def _add_calls(node: ast.AST, file: str, *, compiled: bool) -> None:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, _Function):
            if compiled and any(_name(one) not in _PYTHON for one in child.decorator_list):
                continue
            note = ast.parse(f"{_CALLED}({f'{file}:{first_line(child)}'!r})").body[0]
            at = 1 if ast.get_docstring(child, clean=False) is not None else 0
            near = child.body[min(at, len(child.body) - 1)]
            for part in ast.walk(note):
                ast.copy_location(part, near)
            _add_calls(child, file, compiled=compiled)
            child.body.insert(at, note)
        else:
            _add_calls(child, file, compiled=compiled)


def _name(decorator: ast.expr) -> str:
    call = decorator.func if isinstance(decorator, ast.Call) else decorator
    return str(getattr(call, "attr", getattr(call, "id", "")))


class _Loader(SourceFileLoader):
    """Compiles a module with notes of calls, whatever bytecode lies beside it."""

    tree: Path

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        file = Path(path).relative_to(self.tree).as_posix()
        code: CodeType = compile(with_calls(Path(path).read_text(), file), path, "exec", dont_inherit=True)
        return code


class _Finder:
    """Finds the modules of some packages of a tree."""

    def __init__(self, tree: Path, packages: tuple[str, ...]) -> None:
        self._loader = type("Loader", (_Loader,), {"tree": tree})
        self._packages = packages
        self._roots = [str(tree), str(tree / "baselines")]

    def find_spec(self, fullname: str, path: Any = None, target: object = None) -> ModuleSpec | None:
        if fullname.split(".")[0] not in self._packages:
            return None
        for folder in path if path is not None else self._roots:
            spec = FileFinder(str(folder), (self._loader, [".py"])).find_spec(fullname)
            if spec is not None and spec.loader is not None:
                return spec
        return None
