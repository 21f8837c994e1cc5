"""The registry of plug-ins: readers, methods, detectors, annotators, describers, policies, weather, and verbs.

A plug-in is an entry point of another package, or an object of a file, ``FILE.py:OBJECT``. It is loaded when it is
used; an error inside it is named with its package, file and line.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import sys
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from mirror.errors import MirrorError, UsageError
from mirror.installation import install_command

_OWN: Final = ("mirror", "hybridworldsim", "mirror_baselines", "mirror_leaderboard")
_loaded: Final[dict[str, str]] = {}
"""Plug-ins that were loaded: the file of a module, or the folder of a package, and its name in messages."""


@dataclass(frozen=True)
class PluginKind:
    """A kind of plug-in, with the registry of the installed ones.

    Attributes:
        noun: name of the kind in messages, such as ``method``.
        group: its group of entry points.
        option: option that names a plug-in of this kind.
        extra: extra of MIRROR's own package that has the dependencies of its own plug-ins.
        takes_files: whether ``FILE.py:OBJECT`` names a plug-in too.
        error: class of the errors.
    """

    noun: str
    group: str
    option: str
    extra: str
    takes_files: bool = True
    error: type[MirrorError] = UsageError

    def names(self) -> list[str]:
        """Return the names of the installed plug-ins, sorted; none is loaded."""
        return sorted({entry.name for entry in installed_entries(self.group)})

    def find(self, name: str) -> EntryPoint:
        """Find the entry point of an installed plug-in, without loading it.

        Raises:
            MirrorError: there is none, or packages differ on what the name means; an error of the class `error`.
        """
        # A package that was installed twice declares the same object again.
        entries = {entry.value: entry for entry in installed_entries(self.group) if entry.name == name}
        if len(entries) > 1:
            packages = " and ".join(f"{_package(entry)} ({value})" for value, entry in entries.items())
            raise self.error(
                f"two {self.noun}s are named {name!r}: of {packages}", place=f"entry points {self.group}",
                remedy="uninstall one of the packages",
            )  # fmt: skip
        for entry in entries.values():
            return entry
        known = self.names()
        listed = ", ".join(known) or "none is installed"
        near = find_near_name(name, known)
        raise self.error(
            f"no {self.noun} {name!r} is installed", place=self.option,
            expected=f"FILE.py:OBJECT, or an entry point {self.group}: {listed}" if self.takes_files else
            f"one of {listed}",
            remedy="install the package that has it" if near is None else f"did you mean {near}?",
        )  # fmt: skip

    def load(self, name: str) -> Any:
        """Load a plug-in.

        Args:
            name: name of an entry point, or ``FILE.py:OBJECT``.

        Raises:
            MirrorError: there is no such plug-in, several have its name, or it cannot be loaded; an error of the class
                `error`, which names the package and the package's own error.
        """
        if self.takes_files and is_file_reference(name):
            return self._load_file(name)
        entry = self.find(name)
        package = entry.module.partition(".")[0]
        if package not in _OWN:
            _remember(package, f"{self.noun} {name}")
        try:
            return entry.load()
        except MirrorError:
            raise
        except Exception as error:
            raise self._broken_error(entry, error) from error

    def load_all(self) -> dict[str, Any]:
        """Load all installed plug-ins, by name.

        Raises:
            MirrorError: as of `load`.
        """
        return {name: self.load(name) for name in self.names()}

    def require_parts(self, plugin: object, name: str, interface: type) -> None:
        """Require that a plug-in has the attributes and functions that its host uses.

        Args:
            plugin: the plug-in, or what it makes.
            name: its name, for messages.
            interface: the protocol that it follows.

        Raises:
            MirrorError: an attribute or a function is missing, or a function does not take the host's arguments; an
                error of the class `error`.
        """
        expected = f"an object as {interface.__module__}.{interface.__qualname__} describes it"
        stated = {part: getattr(interface, part, None) for part in sorted(list_parts(interface))}
        absent = [part for part in stated if not hasattr(plugin, part)]
        if absent or isinstance(plugin, type):
            problem = f"it has no {', '.join(absent)}" if absent else "a class, not an object"
            remedy = f"make an object of it in its file, and name that with {self.option}"
            raise self.error(
                problem, file=name, place=self.option, expected=expected,
                remedy=f"mend the {self.noun} {name}" if absent else remedy,
            )  # fmt: skip
        for part, function in stated.items():
            if inspect.isfunction(function):
                self.require_call(getattr(plugin, part), name, part, inspect.signature(function).parameters.values())

    def require_call(self, called: Any, name: str, part: str, given: Iterable[inspect.Parameter]) -> None:
        """Require that a plug-in, or a function of it, can be called with the host's arguments.

        Args:
            called: what the host calls.
            name: name of the plug-in, for messages.
            part: name of the function, for messages.
            given: the host's arguments, `self` among them.

        Raises:
            MirrorError: it cannot; an error of the class `error`.
        """
        own = [one for one in given if one.name != "self"]
        by_name = {one.name: None for one in own if one.kind is inspect.Parameter.KEYWORD_ONLY}
        try:
            inspect.signature(called).bind(*[None] * (len(own) - len(by_name)), **by_name)
        except (TypeError, ValueError) as error:
            if callable(called) and isinstance(error, ValueError):
                return  # A function of compiled code that does not state its arguments.
            listed = f"{part}({', '.join(one.name for one in own)})"
            raise self.error(
                f"{part} does not take the arguments of its host: {error}" if callable(called) else
                f"{part} is {type(called).__name__}, which cannot be called",
                file=name, place=self.option, expected=listed, remedy=f"mend the {self.noun} {name}",
            ) from error  # fmt: skip

    def _broken_error(self, entry: EntryPoint, error: Exception) -> MirrorError:
        """Describe the error of a plug-in that is installed but cannot be loaded."""
        place = f"package {_package(entry)}, entry point {entry.value}"
        is_own = entry.module.partition(".")[0] in _OWN
        is_absent = isinstance(error, ModuleNotFoundError) and f"{entry.module}.".startswith(f"{error.name}.")
        if is_own and (is_absent or isinstance(error, AttributeError)):
            return self.error(
                f"{self.noun} {entry.name!r} is not where its entry point says: that is of another version",
                place=place, remedy=f"install MIRROR again, which renews them: {install_command(self.extra)}",
            )  # fmt: skip
        if isinstance(error, ModuleNotFoundError) and not is_absent:
            return self.error(
                f"{self.noun} {entry.name!r} needs {error.name}, which is not installed", place=place,
                remedy=f"install its dependencies: {install_command(self.extra)}" if is_own
                else f"install {error.name}, or uninstall {_package(entry)}",
            )  # fmt: skip
        at = error_in_plugin(error)
        return self.error(
            f"{self.noun} {entry.name!r} cannot be loaded: {type(error).__name__}: {error}",
            file=None if at is None else at.file, place=place if at is None else f"{at.place}, {place}",
            remedy=f"repair or uninstall {_package(entry)}, or name another one with {self.option}",
        )  # fmt: skip

    def _load_file(self, name: str) -> Any:
        file, _, attribute = name.rpartition(":")
        path = Path(file)
        if not path.is_file():
            raise self.error("no such file", file=path, place=self.option, expected=f"a Python file with a {self.noun}")
        _loaded[str(path.resolve())] = f"{self.noun} {name}"
        try:
            module = _import_file(path.resolve())
        except SystemExit as ended:
            raise self.error(
                "the file ends the program when it is imported", file=path, place=self.option,
                expected=f"a Python file that only defines a {self.noun}",
                remedy='move what runs below `if __name__ == "__main__":`',
            ) from ended  # fmt: skip
        if not hasattr(module, attribute):
            public = sorted(key for key in vars(module) if not key.startswith("_"))
            raise self.error(
                f"the file has no {attribute!r}", file=path, place=self.option, expected=f"one of {', '.join(public)}"
            )
        return getattr(module, attribute)


def list_parts(interface: type) -> set[str]:
    """Return the names of a protocol's attributes and functions, inherited ones included."""
    classes = [one for one in interface.__mro__ if getattr(one, "_is_protocol", False) and one.__name__ != "Protocol"]
    return {name for one in classes for name in {*vars(one), *one.__annotations__} if not name.startswith("_")}


def installed_entries(group: str) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group, ordered by name; each package is read once per ``sys.path``."""
    return _entries(group, tuple(sys.path))


def find_near_name(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that most resembles a given one; None if none is similar."""
    import difflib

    return next(iter(difflib.get_close_matches(name, list(known), n=1)), None)


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


@cache
def _entries(group: str, path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    return tuple(sorted(entry_points(group=group), key=lambda entry: (entry.name, entry.value)))


def _package(entry: EntryPoint) -> str:
    """The name and version of the package that declares an entry point."""
    return "of unknown name" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"


def _remember(package: str, called: str) -> None:
    """Note where the code of a package lies, so that errors in it are named."""
    spec = importlib.util.find_spec(package)
    if spec is not None and spec.origin is not None:
        place = Path(spec.origin)
        _loaded[str(place.parent if place.name == "__init__.py" else place)] = called


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
