"""The designs of each region of the world: what a detector must find before it counts as one for a region's plates."""

from __future__ import annotations

from typing import Final

from benchmarks.plates.designs import FAMILIES, HELD_OUT, Design

_NAMES: Final = {
    "AR": ("argentine", "argentine, older", "mercosur"),
    "AU": ("australian",),
    "BR": ("mercosur",),
    "CA": ("canadian",),
    "CH": ("swiss", "swiss, rear"),
    "CN": ("chinese", "chinese, electric", "chinese, two rows"),
    "EU": ("european", "european, two rows", "french", "dutch", "italian", "austrian"),
    "GB": ("british, rear", "british, front"),
    "IL": ("israeli",),
    "IN": ("indian", "indian, two rows"),
    "JP": ("japanese", "japanese, small"),
    "KR": ("korean", "korean, two rows"),
    "MX": ("mexican",),
    "NO": ("norwegian, electric",),
    "RU": ("russian", "russian, two rows"),
    "SG": ("singaporean",),
    "TR": ("turkish",),
    "TW": ("taiwanese",),
    "US": ("american", "american, dark"),
    "ZA": ("south african",),
}
REGIONS: Final[dict[str, tuple[Design, ...]]] = {
    region: tuple(one for one in (*FAMILIES, *HELD_OUT) if one.name in names) for region, names in _NAMES.items()
}
"""Designs by region: an ISO 3166 code, or ``EU``. Typefaces, dirt and places are those of the test for all of them."""
