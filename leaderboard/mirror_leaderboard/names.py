"""Names on the board: no invisible characters, and no name that a reader takes for another one."""

from __future__ import annotations

import unicodedata
from typing import Final

_CONFUSABLE: Final = str.maketrans(
    {
        # Cyrillic and Greek letters, digits and marks that most fonts draw like a Latin letter or like each other.
        "а": "a", "в": "b", "с": "c", "ԁ": "d", "е": "e", "һ": "h", "і": "l", "ї": "l", "ј": "j", "к": "k",
        "ӏ": "l", "м": "m", "н": "h", "о": "o", "р": "p", "ԛ": "q", "ѕ": "s", "т": "t", "у": "y", "ѵ": "v",
        "ԝ": "w", "х": "x", "г": "r", "п": "n", "ո": "n", "ս": "u", "օ": "o", "հ": "h", "ց": "g",
        "α": "a", "β": "b", "ε": "e", "η": "n", "ι": "l", "κ": "k", "ν": "v", "ο": "o", "ρ": "p", "τ": "t",
        "υ": "u", "χ": "x", "γ": "y", "ω": "w", "σ": "o", "μ": "u",
        "ı": "l", "ɩ": "l", "ɑ": "a", "ɡ": "g", "ʏ": "y", "ꜱ": "s", "ᴏ": "o", "ℓ": "l", "ß": "b",
        "0": "o", "1": "l", "i": "l", "|": "l", "!": "l", "5": "s", "8": "b",
    }
)  # fmt: skip
_CAPITALS: Final = str.maketrans("ΑΒΕΖΗΙΚΜΝΟΡΤΥΧІЈЅ", "ABEZHIKMNOPTYXIJS")
"""Greek and Cyrillic capitals that are drawn like Latin ones, although their small letters are not."""

_IGNORED: Final = "Mn", "Me", "Cf", "Zs", "Zl", "Zp", "Pc", "Pd", "Cc"


def find_name_problem(name: str) -> str | None:
    """Find the reason why a name cannot stand on the board; None: it can.

    A name has the form NFKC, no space at its ends, no two spaces in a row, and visible characters alone.
    """
    if unicodedata.normalize("NFKC", name) != name:
        return "is not in the Unicode form NFKC"
    if name != name.strip() or "  " in name:
        return "has spaces around it or several in a row"
    for character in name:
        category = unicodedata.category(character)
        if character != " " and (category[0] in "CZ" or category in ("Mn", "Me") or character in "ㅤᅟᅠ"):
            return f"has the invisible or combining character U+{ord(character):04X}"
    return None


def skeleton(name: str) -> str:
    """Reduce a name to what a reader recognises: names with equal skeletons are confused with each other.

    Case, accents, spaces, hyphens and underscores are dropped, and letters of other scripts, digits and marks that are
    drawn like a Latin letter become that letter (in the sense of Unicode Technical Standard 39).
    """
    decomposed = unicodedata.normalize("NFKD", unicodedata.normalize("NFKC", name).translate(_CAPITALS).casefold())
    kept = "".join(character for character in decomposed if unicodedata.category(character) not in _IGNORED)
    return kept.translate(_CONFUSABLE).replace("rn", "m").replace("vv", "w").replace("cl", "d")
