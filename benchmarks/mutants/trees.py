"""Copies of the source tree by hard links, of which single files are replaced."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Final

_LEFT_OUT: Final = (".hypothesis", ".pytest_cache")
Stamps = dict[str, tuple[int, int, int]]


def link_tree(source: Path, destination: Path) -> None:
    """Make a folder whose files are hard links to those of another, without those that tests left there.

    Where the folder exists, only what differs is removed and linked. Whoever writes into a linked file changes both:
    use `replace_file`.
    """
    wanted = _list_inodes(source)
    for path, inode in _list_inodes(destination).items() if destination.exists() else ():
        if wanted.get(path) == inode:
            del wanted[path]
        else:
            (destination / path).unlink()
    for path in wanted:
        (destination / path).parent.mkdir(parents=True, exist_ok=True)
        os.link(source / path, destination / path, follow_symlinks=False)


def _list_inodes(tree: Path) -> dict[str, int]:
    """Return the inode of each file and link of a tree, by relative path; the folders of `_LEFT_OUT` are removed."""
    found: dict[str, int] = {}
    folders = [""]
    while folders:
        prefix = folders.pop()
        with os.scandir(tree / prefix) as entries:
            for entry in entries:
                if entry.name in _LEFT_OUT:
                    shutil.rmtree(entry.path)
                elif entry.is_dir(follow_symlinks=False):
                    folders.append(f"{prefix}{entry.name}/")
                else:
                    found[prefix + entry.name] = entry.inode()
    return found


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
