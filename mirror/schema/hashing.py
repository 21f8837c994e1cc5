"""The hash of a document. A hash identifies data that users have, so that each keeps the style that it began with."""

from __future__ import annotations

import hashlib
import json
from enum import Enum


class HashStyle(Enum):
    """The form in which a document's values are written before they are hashed: ASCII JSON, on one line.

    Attributes:
        SORTED: keys in order, a space after a comma and a colon.
        CANONICAL: keys in order, no spaces.
        AS_GIVEN: keys as they come, a space after a comma and a colon.
    """

    SORTED = "sorted"
    CANONICAL = "canonical"
    AS_GIVEN = "as given"


def hash_document(document: object, style: HashStyle = HashStyle.SORTED) -> str:
    """Return the SHA-256 of the values of a document, in hexadecimal; its formatting in a file does not matter.

    Args:
        document: values of JSON; tuples count as lists.
        style: how they are written. Values without an object have the same hash as `SORTED` and `AS_GIVEN`.

    Raises:
        TypeError: a value is none of JSON.
    """
    separators = (",", ":") if style is HashStyle.CANONICAL else None
    text = json.dumps(document, sort_keys=style is not HashStyle.AS_GIVEN, separators=separators)
    return hashlib.sha256(text.encode()).hexdigest()
