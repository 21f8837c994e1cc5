"""Copies of the source tree by hard links, of which single files are replaced."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Final

_LEFT_OUT: Final = (".hypothesis", ".pytest_cache")
Stamps = dict[str, tuple[int, int, int]]


def link_tree(source: Path, destination: Path) -> None:
    """Replace a folder by one whose files are hard links to those of another, without those that tests left there.

    Whoever writes into a linked file changes both: use `replace_file`.
    """
    shutil.rmtree(destination, ignore_errors=True)
    shutil.copytree(source, destination, copy_function=os.link, ignore=shutil.ignore_patterns(*_LEFT_OUT))


def replace_file(file: Path, text: str) -> None:
    """Give a linked file another text, without its bytecode and without a change of the file that it is linked to."""
    file.unlink()
    file.write_text(text)
    for bytecode in file.parent.glob(f"__pycache__/{file.stem}.*.pyc"):
        bytecode.unlink()


def forget_kernels(file: Path) -> None:
    """Delete numba's compiled kernels of a source file."""
    for kernel in file.parent.glob(f"__pycache__/{file.stem}.*.nb[ic]"):
        kernel.unlink()


def read_stamps(tree: Path) -> Stamps:
    """Return inode, bytes and time of the last change of each file of a tree, without what runs leave there."""
    found = {}
    for folder, folders, names in os.walk(tree):
        folders[:] = [name for name in folders if name not in (*_LEFT_OUT, "__pycache__")]
        for name in names:
            path = Path(folder, name)
            of = path.stat()
            found[path.relative_to(tree).as_posix()] = (of.st_ino, of.st_size, of.st_mtime_ns)
    return found
