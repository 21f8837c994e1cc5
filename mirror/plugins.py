"""Loads plug-ins, from entry points or as ``FILE.py:OBJECT``, and names errors inside them by file and line."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from mirror.errors import UsageError
from mirror.installation import install_command

_OWN: Final = ("mirror", "hybridworldsim", "mirror_baselines", "mirror_leaderboard")
_loaded: Final[dict[str, str]] = {}
"""Plug-ins that were loaded: the file of a module, or the folder of a package, and its name in messages."""


@dataclass(frozen=True)
class PluginKind:
    """A kind of plug-in.

    Attributes:
        noun: name of the kind in messages, such as ``method``.
        group: its group of entry points.
        option: option that names a plug-in of this kind.
        extra: extra of MIRROR's own package that has the dependencies of its own plug-ins.
    """

    noun: str
    group: str
    option: str
    extra: str

    @property
    def entries(self) -> dict[str, EntryPoint]:
        """The installed plug-ins by name, in the order of names."""
        return {entry.name: entry for entry in sorted(entry_points(group=self.group), key=lambda entry: entry.name)}

    def load(self, name: str) -> Any:
        """Load a plug-in.

        Args:
            name: name of an entry point, or ``FILE.py:OBJECT``.

        Raises:
            UsageError: there is no such plug-in, or a package that it imports is missing.
        """
        if is_file_reference(name):
            return self._load_file(name)
        entries = self.entries
        if name not in entries:
            raise UsageError(
                f"no {self.noun} {name!r} is installed", place=self.option,
                expected=f"FILE.py:OBJECT, or an entry point {self.group}: {', '.join(entries) or 'none is installed'}",
            )  # fmt: skip
        entry = entries[name]
        is_own = entry.module.partition(".")[0] in _OWN
        try:
            found = entry.load()
        except ModuleNotFoundError as error:
            raise UsageError(
                f"{self.noun} {name!r} needs {error.name}, which is not installed",
                place=f"entry point {entry.value}",
                remedy=f"install its dependencies: {install_command(self.extra)}" if is_own else None,
            ) from error
        if not is_own and (source := getattr(sys.modules[entry.module.partition(".")[0]], "__file__", None)):
            place = Path(source)
            _loaded[str(place.parent if place.name == "__init__.py" else place)] = f"{self.noun} {name}"
        return found

    def _load_file(self, name: str) -> Any:
        file, _, attribute = name.rpartition(":")
        path = Path(file)
        if not path.is_file():
            raise UsageError("no such file", file=path, place=self.option, expected=f"a Python file with a {self.noun}")
        _loaded[str(path.resolve())] = f"{self.noun} {name}"
        module = _import_file(path.resolve())
        if not hasattr(module, attribute):
            public = sorted(key for key in vars(module) if not key.startswith("_"))
            raise UsageError(
                f"the file has no {attribute!r}", file=path, place=self.option, expected=f"one of {', '.join(public)}"
            )
        return getattr(module, attribute)


def is_file_reference(name: str) -> bool:
    """Return whether a name has the form ``FILE.py:OBJECT``."""
    file, colon, attribute = name.rpartition(":")
    return bool(colon) and file.endswith(".py") and attribute.isidentifier()


def error_in_plugin(error: BaseException) -> UsageError | None:
    """Describe an error that was raised in a plug-in, with the plug-in's file and line.

    Args:
        error: the error, with its traceback.

    Returns:
        The error to show; None: no code of a plug-in was running.
    """
    if not _loaded:
        return None
    frames = [(frame.filename, frame.lineno, frame.name) for frame in traceback.extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError) and error.filename is not None:
        frames.append((error.filename, error.lineno, "the module"))
    for file, line, function in reversed(frames):
        for place, called in _loaded.items():
            if file == place or Path(place) in Path(file).parents:
                where = "" if function in ("<module>", "the module") else f", in {function}"
                return UsageError(
                    f"{type(error).__name__}: {error}", file=file, place=f"line {line}{where}",
                    remedy=f"mend the {called}",
                )  # fmt: skip
    return None


def _import_file(path: Path) -> ModuleType:
    """Import a file once, under a name that follows from its path, so that pickling finds its classes again."""
    name = f"mirror_plugin_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise UsageError("it cannot be imported", file=path, expected="a Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
