"""All templates of the project with the packages that own them, and all sources."""

from __future__ import annotations

from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
_FOLDERS: Final = (ROOT, ROOT / "baselines", ROOT / "leaderboard")
_PACKAGES: Final = ("mirror", "hybridworldsim", "mirror_baselines", "mirror_leaderboard")
_FILES: Final = sorted(
    path
    for folder in _FOLDERS
    for package in _PACKAGES
    if (folder / package).is_dir()
    for path in (folder / package).rglob("*")
    if path.suffix in (".html", ".py")
)

TEMPLATES: Final = [path for path in _FILES if path.parent.name == "templates" and path.suffix == ".html"]
SOURCES: Final = [path for path in _FILES if path.suffix == ".py"]


def package_of(template: Path) -> str:
    """Return the package that owns a template."""
    source = next(path for path in template.parents if path in _FOLDERS)
    return ".".join(template.parent.parent.relative_to(source).parts)
