"""Names on the board: plain characters of one writing system, and no name that a reader takes for another one."""

from __future__ import annotations

import unicodedata
from typing import Final

from mirror_leaderboard.characters import find_prototype, find_scripts

_WITH_LATIN: Final = ("Jpan", "Hanb", "Kore")
"""Writing systems that Latin may stand beside (profile "highly restrictive" of Unicode Technical Standard 39)."""
_ALIKE: Final = str.maketrans("01589i|!", "olsbglll")
"""Digits, letters and marks that are drawn nearly alike, beside what the standard maps."""
_PAIRS: Final = (("rn", "m"), ("vv", "w"), ("cl", "d"))
_LEFT_OUT: Final = ("M", "P", "Z", "C", "Sk", "Lm")
"""Categories that distinguish no name: accents, punctuation, spaces, invisible characters, modifiers."""


def find_name_problem(name: str) -> str | None:
    """Find the reason why a name may not appear on the board; None if it may.

    A name has the form NFKC, begins and ends with a visible character, has no two spaces in a row, printable ASCII and
    else only characters that Unicode Technical Standard 39 allows in identifiers, of one writing system (profile
    "highly restrictive": Latin may stand beside Chinese, Japanese or Korean), and digits of one number system.
    """
    if unicodedata.normalize("NFKC", name) != name:
        return "is not in the Unicode form NFKC"
    if name != name.strip() or "  " in name:
        return "has spaces around it or several in a row"
    zeros, common = set(), None
    for character in name:
        scripts = _scripts_of(character)
        category = unicodedata.category(character)
        if scripts is None:
            return f"has the character U+{ord(character):04X}, which no plain name has"
        if category in ("Mn", "Me") and not scripts:
            return f"has the combining character U+{ord(character):04X}"
        if category == "Nd":
            zeros.add(ord(character) - unicodedata.decimal(character))
        if scripts:
            systems = scripts | set(_WITH_LATIN) if "Latin" in scripts else scripts
            common = systems if common is None else common & systems
    if common is not None and not common:
        return "has letters of several scripts"
    if len(zeros) > 1:
        return "has digits of several number systems"
    if not any(unicodedata.category(character)[0] in "LN" for character in name):
        return "has no letter and no digit"
    return None


def skeleton(name: str) -> str:
    """Reduce a name to a skeleton: names with equal skeletons look alike.

    Characters that are drawn alike become one (Unicode Technical Standard 39, section 4); in addition case, accents,
    spaces, punctuation and symbols that only modify are left out, and digits become the letters that they resemble.
    """
    folded = _map_alike(_map_alike(unicodedata.normalize("NFKC", name)).casefold())
    kept = "".join(character for character in folded if not unicodedata.category(character).startswith(_LEFT_OUT))
    reduced = kept.casefold().translate(_ALIKE)
    for pair, letter in _PAIRS:
        reduced = reduced.replace(pair, letter)
    return reduced


def _map_alike(text: str) -> str:
    decomposed = unicodedata.normalize("NFD", text)
    return unicodedata.normalize("NFD", "".join(map(find_prototype, decomposed)))


def _scripts_of(character: str) -> frozenset[str] | None:
    """Return the scripts of a character, empty for ASCII that is no letter; None: it cannot stand in a name."""
    if character.isascii():
        letters = frozenset({"Latin"}) if character.isalpha() else frozenset[str]()
        return letters if character.isprintable() else None
    return find_scripts(character)
