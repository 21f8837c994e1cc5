"""The methods that are installed, found through the entry points ``mirror.methods``.

Nothing of a submission is run: who evaluates names the method, and has installed it.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Final

from mirror.errors import UsageError
from mirror.installation import install_command
from mirror.methods.plugin import InstalledMethod

GROUP: Final = "mirror.methods"


def installed_method(name: str) -> InstalledMethod:
    """A method that is installed.

    Raises:
        UsageError: there is none of that name, or what it needs is not installed.
    """
    found = {entry.name: entry for entry in entry_points(group=GROUP)}
    if name not in found:
        listed = ", ".join(sorted(found)) or "none is installed"
        raise UsageError(f"no method {name!r} is installed", expected=f"an entry point {GROUP}: {listed}")
    try:
        method: InstalledMethod = found[name].load()
    except ModuleNotFoundError as error:
        raise UsageError(
            f"method {name!r} needs {error.name}, which is not installed",
            place=f"entry point {found[name].value}",
            remedy=f"install what it needs: {install_command('baselines')}",
        ) from error
    return method


def read_licence(name: str) -> str:
    """Of the package that an installed method is in, as it says; empty if it does not."""
    for entry in entry_points(group=GROUP):
        if entry.name == name and entry.dist is not None:
            about = entry.dist.metadata
            return str(about["License-Expression"] or about["License"] or "")
    return ""
