"""Findings of files that could not be read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from mirror.errors import MirrorError
from mirror.integrity.finding import Finding


def unread(problems: Mapping[str, MirrorError], belongs: Callable[[str], bool]) -> Iterator[Finding]:
    """A finding for each problem with a file of that kind.

    Args:
        problems: why a file could not be read, by file.
        belongs: which files are meant.
    """
    for file, error in sorted(problems.items()):
        if belongs(file):
            yield Finding(file, error.place, error.problem + (f"; expected {error.expected}" if error.expected else ""))
