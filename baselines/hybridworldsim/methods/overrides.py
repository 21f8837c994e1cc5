"""Overrides settings of a method by name, for the command line."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, Final, TypeVar

from pydantic import TypeAdapter, ValidationError

from mirror.errors import UsageError

_Settings = TypeVar("_Settings")

_SEED: Final = "seed"
_ADAPTERS: Final[dict[type, TypeAdapter[Any]]] = {}


def override_settings(settings: _Settings, overrides: Mapping[str, str]) -> _Settings:
    """Replace settings by given values.

    Args:
        settings: a dataclass, which may hold dataclasses.
        overrides: values as text (JSON or a bare word) by dotted names, such as ``refinement.max_anchors``.

    Raises:
        UsageError: there is no such setting, or the value is invalid.
    """
    if not overrides:
        return settings
    values = asdict(settings)  # type: ignore[call-overload]
    known = _setting_names(values)
    # The two documents have the same settings in the same order.
    serialized_names = dict(zip(_setting_names(settings_document(settings)), known))
    for key, text in overrides.items():
        name = serialized_names.get(key, key)
        if name == _SEED:
            raise UsageError("the seed is not a setting", place="--set", expected="--seed")
        if name not in known:
            similar = difflib.get_close_matches(name, known, 3) or sorted(known)
            raise UsageError(
                f"no setting {name!r}", place="--set", expected=f"NAME=VALUE, such as {', '.join(similar)}"
            )
        *outer, last = name.split(".")
        group = values
        for key in outer:
            group = group[key]
        group[last] = _parse_value(name, text)
        for number in _numbers(group[last]):
            if not 0.0 <= number < math.inf:
                raise UsageError(f"{number:g}", place=f"--set {name}", expected="a finite number, 0 or more")
    try:
        return settings_adapter(type(settings)).validate_python(values)
    except ValidationError as error:
        first = error.errors()[0]
        # "Input should be a valid number, unable to parse ..."
        expected = first["msg"].removeprefix("Input should be ").partition(",")[0]
        raise UsageError(
            f"{first['input']!r}", place=f"--set {'.'.join(map(str, first['loc']))}", expected=expected
        ) from error


def settings_document(settings: Any) -> dict[str, Any]:
    """Return the settings as ``run.json`` stores them and as they are hashed, under older versions' names.

    Args:
        settings: a dataclass, which may hold dataclasses.
    """
    document: dict[str, Any] = settings_adapter(type(settings)).dump_python(settings, mode="json", by_alias=True)
    return document


def settings_adapter(settings: type[_Settings]) -> TypeAdapter[_Settings]:
    """Return the pydantic adapter of a class of settings, made once per class.

    Making one takes 3 ms, and a study reads the settings of hundreds of jobs.
    """
    if settings not in _ADAPTERS:
        _ADAPTERS[settings] = TypeAdapter(settings)
    return _ADAPTERS[settings]


def _setting_names(values: Mapping[str, Any], under: str = "") -> list[str]:
    """Dotted names of all settings."""
    names = []
    for key, value in values.items():
        names += _setting_names(value, f"{under}{key}.") if isinstance(value, dict) else [f"{under}{key}"]
    return names


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, list):
        for number in value:
            yield from _numbers(number)
    elif isinstance(value, int | float):
        yield float(value)


def _parse_value(name: str, text: str) -> Any:
    def refuse_number(word: str) -> float:
        raise UsageError(word, place=f"--set {name}", expected="a finite number")

    try:
        return json.loads(text, parse_constant=refuse_number)
    except (ValueError, RecursionError):
        return text
