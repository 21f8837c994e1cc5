"""Methods by name: entry points ``mirror.methods``, or a file that the user names.

Code of a submission or of a model's folder is never run: the user installs a method, or names its file.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from mirror.errors import UsageError
from mirror.methods.capabilities import require_capabilities
from mirror.methods.plugin import InstalledMethod
from mirror.plugins import PluginKind, is_file_reference

METHODS: Final = PluginKind("method", "mirror.methods", "--method", "baselines")


def load_method(name: str) -> InstalledMethod:
    """Load the method that the user names.

    Args:
        name: name of an entry point, or ``FILE.py:OBJECT``.

    Raises:
        UsageError: there is no such method, it has no functions `reconstruct` and `open`, it lacks the function of a
            capability that it states, or one of its dependencies is missing.
    """
    method = METHODS.load(name)
    METHODS.require_parts(method, name, InstalledMethod)
    require_capabilities(METHODS, method, name)
    loaded: InstalledMethod = method
    return loaded


def method_label(name: str) -> str:
    """Return a method's name for documents: its entry point, or ``FILE.py:OBJECT`` without the file's folder."""
    return Path(name).name if is_file_reference(name) else name


def installed_method(name: str) -> InstalledMethod:
    """Load a method that a document names, which must be an installed one.

    Raises:
        UsageError: no method of that name is installed, or one of its dependencies is missing.
    """
    if is_file_reference(name):
        raise UsageError(
            f"the method {name!r} is a file, and a document does not decide which file is run",
            expected=f"an installed method: an entry point {METHODS.group}",
            remedy="install the method as a package, or use a verb that has --method",
        )
    return load_method(name)


def method_of_model(written: str, given: str | None = None, *, option: str = "--method ") -> InstalledMethod:
    """Load the method of a model: the installed one, or the file that the user names.

    Args:
        written: name of the method in the model's document.
        given: ``FILE.py:OBJECT`` as the user names it; None: nothing was named. A document does not decide which file
            is run.
        option: how the user names it, for messages.

    Raises:
        UsageError: the document names a file and the user names none or another, the user names a file for a model of
            an installed method, or the method cannot be loaded.
    """
    if given is None and not is_file_reference(written):
        return installed_method(written)
    if given is None or method_label(given) != written:
        in_file, name = is_file_reference(written), option.strip(" =")
        raise UsageError(
            "not given" if given is None else given, place=name,
            expected=f"the method of the training: {f'FOLDER/{written}' if in_file else written}",
            remedy=f"add {option}FOLDER/{written}" if in_file else f"leave {name} out",
        )  # fmt: skip
    return load_method(given)


def read_licence(name: str) -> str:
    """Read the licence of an installed method from its package's metadata; empty if none is stated."""
    if name not in METHODS.names() or (package := METHODS.find(name).dist) is None:
        return ""
    metadata = package.metadata
    return str(metadata["License-Expression"] or metadata["License"] or "")
