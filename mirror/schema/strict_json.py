"""The only reader of JSON: it refuses documents that JSON readers interpret in different ways."""

from __future__ import annotations

import json
from typing import Any


class JsonError(ValueError):
    """Text that is not JSON, or that repeats a key.

    Args:
        problem: what is wrong.
        place: line and column; None: not known.
    """

    def __init__(self, problem: str, place: str | None = None) -> None:
        super().__init__(problem)
        self.place = place


def decode_json(data: str | bytes, *, constants: bool = True) -> Any:
    """Decode a JSON text.

    Args:
        data: the text, or its bytes in UTF-8, UTF-16 or UTF-32.
        constants: accept NaN and Infinity, which many programs write although JSON does not have them.

    Raises:
        JsonError: the text is not JSON, is nested too deep, or repeats a key in an object: some readers take the first
            value of such a key, others the last.
    """
    try:
        return json.loads(data, object_pairs_hook=_make_object, parse_constant=None if constants else _refuse_constant)
    except json.JSONDecodeError as error:
        raise JsonError(f"not valid JSON ({error})", f"line {error.lineno}, column {error.colno}") from error
    except UnicodeDecodeError as error:
        raise JsonError(f"not valid JSON ({error})") from error
    except RecursionError as error:
        raise JsonError("not valid JSON (nested too deep)") from error
    except JsonError:
        raise
    except ValueError as error:
        # An integer with thousands of digits.
        raise JsonError(f"not valid JSON ({error})") from error


def _make_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        keys = [key for key, _ in pairs]
        raise JsonError(f"the key {next(key for key in keys if keys.count(key) > 1)!r:.80} stands twice in one object")
    return result


def _refuse_constant(word: str) -> Any:
    raise JsonError(f"not valid JSON (the number {word})")
