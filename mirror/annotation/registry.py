"""Annotators by name: entry points ``mirror.annotators``, or a file that the user names."""

from __future__ import annotations

from typing import Final

from mirror.annotation.protocol import InstalledAnnotator
from mirror.plugins import PluginKind

ANNOTATORS: Final = PluginKind("annotator", "mirror.annotators", "--annotator", "models")


def annotator_names() -> list[str]:
    """Names of the installed annotators, sorted."""
    return ANNOTATORS.names()


def installed_annotator(name: str) -> InstalledAnnotator:
    """Load an annotator.

    Args:
        name: name of an entry point, or ``FILE.py:OBJECT``.

    Raises:
        UsageError: there is no such annotator, or one of its dependencies is missing.
    """
    annotator: InstalledAnnotator = ANNOTATORS.load(name)
    return annotator
