"""The command line of the modules that write a generated page of the documentation."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from mirror.schema.files import write_bytes


def write_page(default: str, about: str | None, make: Callable[[Path], str]) -> None:
    """Write a page into the file that the command line names, and print the file.

    Args:
        default: file of the page where the command line names none.
        about: the module's docstring, for ``--help``.
        make: returns the page's text; its argument is the file that is replaced.
    """
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("file", nargs="?", type=Path, default=Path(default), help=f"the page (default: {default})")
    file: Path = parser.parse_args().file
    write_bytes(file, make(file).encode())
    print(file)
