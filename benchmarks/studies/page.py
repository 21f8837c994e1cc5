"""The section of a page that the report of a study writes."""

from __future__ import annotations

from pathlib import Path

from mirror.errors import UsageError
from mirror.schema.files import write_bytes


def replace_section(page: Path, begin: str, end: str, section: str) -> None:
    """Replace the part of a page between two lines, and the lines themselves.

    Args:
        page: the page.
        begin: the line before the section.
        end: the line after it.
        section: the new section, with both lines.

    Raises:
        UsageError: the page lacks the lines.
    """
    text = page.read_text()
    first, last = text.find(begin), text.find(end)
    if first < 0 or last < first:
        raise UsageError("has no place for the report", file=page, expected=f"the lines {begin} and {end}")
    write_bytes(page, (text[:first] + section + text[last + len(end) :]).encode())
