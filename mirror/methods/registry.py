"""Installed methods, found through the entry points ``mirror.methods``.

Code of a submission is never run: the person who evaluates installs the method and names it.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Final

from mirror.errors import UsageError
from mirror.installation import install_command
from mirror.methods.plugin import InstalledMethod

GROUP: Final = "mirror.methods"


def installed_method(name: str) -> InstalledMethod:
    """Load an installed method by its entry-point name.

    Raises:
        UsageError: no method of that name is installed, or one of its dependencies is missing.
    """
    entries = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in entries:
        listed = ", ".join(sorted(entries)) or "none is installed"
        raise UsageError(f"no method {name!r} is installed", expected=f"an entry point {GROUP}: {listed}")
    try:
        method: InstalledMethod = entries[name].load()
    except ModuleNotFoundError as error:
        raise UsageError(
            f"method {name!r} needs {error.name}, which is not installed",
            place=f"entry point {entries[name].value}",
            remedy=f"install its dependencies: {install_command('baselines')}",
        ) from error
    return method


def read_licence(name: str) -> str:
    """Read the licence of an installed method from its package's metadata; empty if none is stated."""
    for entry in entry_points(group=GROUP):
        if entry.name == name and entry.dist is not None:
            metadata = entry.dist.metadata
            return str(metadata["License-Expression"] or metadata["License"] or "")
    return ""
