"""What pydantic says about a value, in the words of a message."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic_core import ErrorDetails


def describe_problem(details: ErrorDetails) -> str:
    """What is wrong with a value: one of `pydantic.ValidationError.errors`, without the name of the exception."""
    return details["msg"].removeprefix("Value error, ")


def describe_expected(details: ErrorDetails) -> str:
    """What a right value is, such as ``a number greater than 0``."""
    expected = describe_problem(details).removeprefix("Input should be ")
    return f"a number {expected}" if expected.startswith(("greater", "less")) else expected
