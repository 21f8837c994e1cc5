"""Settings of a method with some of them changed by name, as a command line names them."""

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


def override_settings(settings: _Settings, words: Mapping[str, str]) -> _Settings:
    """Settings with others in place of some.

    Args:
        settings: a dataclass, of dataclasses.
        words: values as text (JSON, or a bare word) by names with dots, such as ``refinement.max_anchors``.

    Raises:
        UsageError: there is no such setting, or it has no such value.
    """
    if not words:
        return settings
    whole = asdict(settings)  # type: ignore[call-overload]
    known = _leaves(whole)
    # The two documents have the same settings in the same order.
    serialized_names = dict(zip(_leaves(settings_document(settings)), known))
    for given, text in words.items():
        name = serialized_names.get(given, given)
        if name == _SEED:
            raise UsageError("the seed is no setting", place="--set", expected="--seed")
        if name not in known:
            near = difflib.get_close_matches(name, known, 3) or sorted(known)
            raise UsageError(f"no setting {name!r}", place="--set", expected=f"NAME=VALUE, such as {', '.join(near)}")
        *outer, last = name.split(".")
        inner = whole
        for key in outer:
            inner = inner[key]
        inner[last] = _value(name, text)
        for number in _numbers(inner[last]):
            if not 0.0 <= number < math.inf:
                raise UsageError(f"{number:g}", place=f"--set {name}", expected="a finite number, 0 or more")
    try:
        return TypeAdapter(type(settings)).validate_python(whole)
    except ValidationError as error:
        first = error.errors()[0]
        # "Input should be a valid number, unable to parse ..."
        expected = first["msg"].removeprefix("Input should be ").partition(",")[0]
        raise UsageError(
            f"{first['input']!r}", place=f"--set {'.'.join(map(str, first['loc']))}", expected=expected
        ) from error


def settings_document(settings: Any) -> dict[str, Any]:
    """Settings as ``run.json`` stores them and as they are hashed: under the names that older versions wrote.

    Args:
        settings: a dataclass, of dataclasses.
    """
    document: dict[str, Any] = TypeAdapter(type(settings)).dump_python(settings, mode="json", by_alias=True)
    return document


def _leaves(whole: Mapping[str, Any], under: str = "") -> list[str]:
    """Names of all settings."""
    found = []
    for key, value in whole.items():
        found += _leaves(value, f"{under}{key}.") if isinstance(value, dict) else [f"{under}{key}"]
    return found


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, list):
        for one in value:
            yield from _numbers(one)
    elif isinstance(value, int | float):
        yield float(value)


def _value(name: str, text: str) -> Any:
    def no_number(word: str) -> float:
        raise UsageError(word, place=f"--set {name}", expected="a finite number")

    try:
        return json.loads(text, parse_constant=no_number)
    except ValueError:
        return text
