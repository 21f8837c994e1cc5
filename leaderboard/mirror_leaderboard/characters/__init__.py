"""Characters of names: which may stand in identifiers, of which scripts they are, and which are drawn alike.

The tables are data of the Unicode Consortium (Unicode Technical Standard 39, "Unicode Security Mechanisms"), under the
licence beside them; `make_tables` makes them.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterator
from functools import lru_cache
from importlib.resources import files
from typing import Final

_IMPLIED: Final = {
    "Han": ("Hanb", "Jpan", "Kore"),
    "Hiragana": ("Jpan",),
    "Katakana": ("Jpan",),
    "Hangul": ("Kore",),
    "Bopomofo": ("Hanb",),
}
"""Writing systems that a script is a part of: Chinese with Bopomofo, Japanese, Korean (section 5.1)."""
_EVERY: Final = ("Common", "Inherited")


def find_scripts(character: str) -> frozenset[str] | None:
    """Return the scripts of a character, empty if it belongs to all scripts; None if the character is not allowed.

    Allowed are the characters with the Identifier_Status *Allowed*: those of scripts in common modern use, without
    obsolete, technical and invisible ones, symbols and most punctuation.
    """
    first, last, scripts = _read_allowed()
    place = bisect.bisect_right(first, ord(character)) - 1
    return scripts[place] if place >= 0 and ord(character) <= last[place] else None


def find_prototype(character: str) -> str:
    """Return the characters that a character looks like, or the character itself (section 4)."""
    return _read_prototypes().get(character, character)


@lru_cache(maxsize=1)
def _read_allowed() -> tuple[list[int], list[int], list[frozenset[str]]]:
    rows = [(int(first, 16), int(last, 16), names.split()) for first, last, names in _read("allowed.tsv")]
    scripts = [
        frozenset(one for name in names for one in (name, *_IMPLIED.get(name, ()))).difference(_EVERY)
        for _, _, names in rows
    ]
    return [first for first, _, _ in rows], [last for _, last, _ in rows], scripts


@lru_cache(maxsize=1)
def _read_prototypes() -> dict[str, str]:
    return {
        chr(int(source, 16)): "".join(chr(int(code, 16)) for code in target.split())
        for source, target in _read("confusables.tsv")
    }


def _read(name: str) -> Iterator[list[str]]:
    for line in files(__name__).joinpath(name).read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            yield line.split("\t")
