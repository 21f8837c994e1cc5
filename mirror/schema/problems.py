"""Problems that pydantic finds in values, in the words of a message."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from mirror.schema.documents import IDENTIFIER

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails

_PATTERNS: Final = {
    IDENTIFIER: "should be letters, digits, _ and -, with a letter or a digit first, and at most 120 characters",
    r"^(https?://[^\s<>\"']*)?$": "should be an address that begins with http:// or https://",
}
"""The patterns of documents in words: a message shows no regular expression."""
_KEYS: Final = {"extra_forbidden": "this key is not known", "missing": "this key is missing"}

_QUOTE: Final = "'"


def describe_problem(details: ErrorDetails) -> str:
    """Describe the fault of a value, from an entry of `pydantic.ValidationError.errors`."""
    if details["type"] in _KEYS:
        return _KEYS[details["type"]]
    if details["type"] == "string_pattern_mismatch":
        pattern = details.get("ctx", {}).get("pattern", "")
        return _PATTERNS.get(pattern, "the text has another form than documented")
    if details["type"] == "union_tag_invalid":
        context = details["ctx"]
        known = context["expected_tags"].replace(_QUOTE, "")
        return f"{context['discriminator'].strip(_QUOTE)} {context['tag']!r} is none of {known}"
    return details["msg"].removeprefix("Value error, ")


def describe_problem_and_value(details: ErrorDetails) -> str:
    """Describe the fault of a value, and add the value, unless it is a whole document or a table of one."""
    value = details["input"]
    shown = "" if details["type"] == "missing" or isinstance(value, Mapping) else f" (got {value!r:.80})"
    return f"{describe_problem(details)}{shown}"


def describe_expected(details: ErrorDetails) -> str:
    """Describe a valid value, such as ``a number greater than 0``."""
    expected = describe_problem(details).removeprefix("Input should be ")
    return f"a number {expected}" if expected.startswith(("greater", "less")) else expected


def describe_problems(every: Sequence[ErrorDetails], whole: str = "the whole document") -> tuple[str, str]:
    """Describe all faults of a document at once, each with its place.

    Args:
        every: `pydantic.ValidationError.errors`.
        whole: place of a fault of the document itself.

    Returns:
        The problem and its place; of several problems the text names the place of each, and the place lists all.
    """
    places = [".".join(str(part) for part in details["loc"]) or whole for details in every]
    texts = [describe_problem_and_value(details) for details in every]
    if len(texts) == 1:
        return texts[0], places[0]
    listed = "; ".join(f"{place}: {text}" for place, text in zip(places, texts))
    return f"{len(texts)} faults: {listed}", ", ".join(dict.fromkeys(places))
