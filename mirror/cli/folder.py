"""Arguments that must be a path on this machine."""

from __future__ import annotations

from pathlib import Path

from mirror.errors import UsageError


def local_folder(text: str) -> Path:
    """A path from the command line.

    Raises:
        UsageError: it is a URL: a path would take ``memory://x`` for a folder ``memory:/x``.
    """
    if "://" in text or "::" in text:
        raise UsageError(
            "this verb takes a path, not a URL",
            file=text,
            expected="a folder on this machine",
            remedy="copy the dataset here first; `mirror stats` and `mirror report` read URLs",
        )
    return Path(text)
