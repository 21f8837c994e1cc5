"""The hash of a document, in each style."""

from __future__ import annotations

import hashlib

import pytest

from mirror.schema.hashing import HashStyle, hash_document


@pytest.mark.parametrize(
    ("style", "written"),
    [
        (HashStyle.SORTED, '{"a": [1, null, "\\u00e9"], "b": {"c": 0.5, "d": true}}'),
        (HashStyle.CANONICAL, '{"a":[1,null,"\\u00e9"],"b":{"c":0.5,"d":true}}'),
        (HashStyle.AS_GIVEN, '{"b": {"d": true, "c": 0.5}, "a": [1, null, "\\u00e9"]}'),
    ],
)
def test_a_style_says_which_bytes_are_hashed(style: HashStyle, written: str) -> None:
    document = {"b": {"d": True, "c": 0.5}, "a": (1, None, "é")}
    assert hash_document(document, style) == hashlib.sha256(written.encode()).hexdigest()


def test_values_that_are_none_of_json_are_refused() -> None:
    with pytest.raises(TypeError, match="set"):
        hash_document({"a": {1}})
