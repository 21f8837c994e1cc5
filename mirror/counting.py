"""Numbers of things in messages."""

from __future__ import annotations


def count_of(number: int, noun: str) -> str:
    """Return a number with its noun: ``1 image``, ``2,000 images``.

    Args:
        number: how many there are.
        noun: in the singular; its plural ends with ``s``, that of a noun in ``-y`` after a consonant with ``ies``.
    """
    if number != 1:
        noun = f"{noun[:-1]}ies" if noun.endswith("y") and noun[-2] not in "aeiou" else f"{noun}s"
    return f"{number:,} {noun}"
