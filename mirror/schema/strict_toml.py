"""The only reader of TOML: whatever the bytes are, it returns a table or says what is wrong."""

from __future__ import annotations

import tomllib
from typing import Any, Final

_MAX_DEPTH: Final = 64
"""Documents of MIRROR have at most five levels."""

_MAX_DOTS: Final = 1000


class TomlError(ValueError):
    """Bytes that are not TOML, or tables that are nested too deep."""


def decode_toml(data: bytes) -> dict[str, Any]:
    """Decode the bytes of a TOML document.

    Raises:
        TomlError: the bytes are not UTF-8 or not TOML, or tables or arrays are nested too deep.
    """
    # The parser needs time in the square of the parts of a key.
    if max((line.partition(b"=")[0].count(b".") for line in data.splitlines()), default=0) > _MAX_DOTS:
        raise TomlError(f"a key of more than {_MAX_DOTS} parts")
    try:
        document = tomllib.loads(data.decode())
    except RecursionError as error:
        raise TomlError("nested too deep") from error
    except ValueError as error:
        # A syntax error, bytes that are no text, or an integer with thousands of digits.
        raise TomlError(str(error)) from error
    level: list[Any] = [document]
    for _ in range(_MAX_DEPTH):
        # The keys of one table, a.b.c, nest too, without recursion of the parser.
        level = [inner for value in level for inner in _members(value)]
        if not level:
            return document
    raise TomlError(f"nested deeper than {_MAX_DEPTH} levels")


def _members(value: Any) -> list[Any]:
    """The tables and arrays that a table or an array holds."""
    inner = value.values() if isinstance(value, dict) else value
    return [item for item in inner if isinstance(item, dict | list)]
