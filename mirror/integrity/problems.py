"""Findings for unreadable files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from mirror.errors import MirrorError
from mirror.integrity.finding import Finding


def report_unreadable(problems: Mapping[str, MirrorError], belongs: Callable[[str], bool]) -> Iterator[Finding]:
    """Yield a finding for each unreadable file of a kind.

    Args:
        problems: error of each unreadable file, by file.
        belongs: whether a file is of that kind.
    """
    for file, error in sorted(problems.items()):
        if belongs(file):
            yield Finding(file, error.place, error.problem + (f"; expected {error.expected}" if error.expected else ""))
