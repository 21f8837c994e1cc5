"""All templates of the project, with the packages that own them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
_SOURCES: Final = (ROOT, ROOT / "baselines", ROOT / "leaderboard")
_PACKAGES: Final = ("mirror", "hybridworldsim", "mirror_baselines", "mirror_leaderboard")

TEMPLATES: Final = sorted(
    path
    for source in _SOURCES
    for package in _PACKAGES
    if (source / package).is_dir()
    for path in (source / package).rglob("templates/*.html")
)


def package_of(template: Path) -> str:
    """Return the package that owns a template."""
    source = next(path for path in template.parents if path in _SOURCES)
    return ".".join(template.parent.parent.relative_to(source).parts)
