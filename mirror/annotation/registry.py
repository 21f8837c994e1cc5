"""Installed annotators, found through the entry points ``mirror.annotators``."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Final

from mirror.annotation.protocol import InstalledAnnotator
from mirror.errors import UsageError
from mirror.installation import install_command

GROUP: Final = "mirror.annotators"


def annotator_names() -> list[str]:
    """Names of the installed annotators, sorted."""
    return sorted(entry.name for entry in entry_points(group=GROUP))


def installed_annotator(name: str) -> InstalledAnnotator:
    """Load an installed annotator by its entry-point name.

    Raises:
        UsageError: no annotator of that name is installed, or one of its dependencies is missing.
    """
    entries = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in entries:
        listed = ", ".join(sorted(entries)) or "none is installed"
        raise UsageError(f"no annotator {name!r} is installed", expected=f"an entry point {GROUP}: {listed}")
    try:
        annotator: InstalledAnnotator = entries[name].load()
    except ModuleNotFoundError as error:
        raise UsageError(
            f"annotator {name!r} needs {error.name}, which is not installed",
            place=f"entry point {entries[name].value}",
            remedy=f"install its dependencies: {install_command('models')}",
        ) from error
    return annotator
