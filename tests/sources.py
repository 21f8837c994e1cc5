"""Syntax trees of source files: each file is parsed once for all tests that read it."""

from __future__ import annotations

import ast
import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path


@cache
def parse(file: Path) -> ast.Module:
    """Return the syntax tree of a file; tests do not change it."""
    return ast.parse(file.read_text())


@contextmanager
def without_collection() -> Iterator[None]:
    """Leave the trees that the block parses out of garbage collections, which would walk through millions of nodes."""
    gc.disable()
    yield
    gc.freeze()
    gc.enable()
