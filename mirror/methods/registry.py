"""Methods by name: entry points ``mirror.methods``, or a file that the user names.

Code of a submission or of a model's folder is never run: the user installs a method, or names its file.
"""

from __future__ import annotations

from typing import Final

from mirror.errors import UsageError
from mirror.methods.plugin import InstalledMethod
from mirror.plugins import PluginKind, is_file_reference

METHODS: Final = PluginKind("method", "mirror.methods", "--method", "baselines")


def load_method(name: str) -> InstalledMethod:
    """Load the method that the user names.

    Args:
        name: name of an entry point, or ``FILE.py:OBJECT``.

    Raises:
        UsageError: there is no such method, it has no functions `reconstruct` and `open`, or one of its dependencies
            is missing.
    """
    method = METHODS.load(name)
    missing = [function for function in ("reconstruct", "open") if not callable(getattr(method, function, None))]
    if missing or isinstance(method, type):
        problem = "a class, not an object" if isinstance(method, type) else f"it has no function {missing[0]}"
        raise UsageError(
            problem, file=name, place="--method",
            expected="an object with the functions reconstruct and open (mirror.methods.plugin.InstalledMethod)",
        )  # fmt: skip
    loaded: InstalledMethod = method
    return loaded


def installed_method(name: str) -> InstalledMethod:
    """Load a method that a document names; only an installed one is run.

    Raises:
        UsageError: no method of that name is installed, or one of its dependencies is missing.
    """
    if is_file_reference(name):
        raise UsageError(
            f"the method {name!r} is a file, and a document does not decide which file is run",
            expected=f"an installed method: an entry point {METHODS.group}",
            remedy="render with mirror render --method FILE.py:OBJECT; for other verbs install the method as a package",
        )
    return load_method(name)


def read_licence(name: str) -> str:
    """Read the licence of an installed method from its package's metadata; empty if none is stated."""
    entry = METHODS.entries.get(name)
    if entry is None or entry.dist is None:
        return ""
    metadata = entry.dist.metadata
    return str(metadata["License-Expression"] or metadata["License"] or "")
