"""Folders of tests mirror the source: each is named as the package that it tests, or stands in a short list."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

TESTS = Path(__file__).parent
ROOT = TESTS.parent
SOURCES = {
    "baselines": "baselines/mirror_baselines",
    "benchmarks": "benchmarks",
    "examples": "examples",
    "leaderboard": "leaderboard/mirror_leaderboard",
}
"""Packages whose tests lie in a folder of their own; the other folders are parts of `mirror` or of `hybridworldsim`."""
OTHERS = {
    "builders": "writers of datasets, of a small street and of recordings in the `folder` format",
    "fuzz": "damaged recordings of all readers",
    "golden": "what earlier versions wrote",
    "peers": "other toolkits that read our files, and what they read",
    "real": "real recordings, where they are",
    "tutorials": "the commands and the code of the pages of docs that are tutorials",
    "recordings/formats": "writers of the formats that are read",
    "mvs/learned/architectures": "listings of published networks",
}
"""Folders that test no single package, and what they hold."""


def folders() -> Iterator[str]:
    for path in sorted(TESTS.rglob("*")):
        if path.is_dir() and path.name != "__pycache__" and any(path.glob("*.*")):
            yield path.relative_to(TESTS).as_posix()


def is_package(folder: str) -> bool:
    first, *rest = folder.split("/")
    bases = [SOURCES[first]] if first in SOURCES else [f"mirror/{first}", f"baselines/hybridworldsim/{first}"]
    return any(any(Path(ROOT, base, *rest).glob("*.py")) for base in bases)


def test_each_folder_of_tests_is_named_as_what_it_tests() -> None:
    inside = tuple(f"{folder}/" for folder in OTHERS)
    assert [name for name in folders() if not (name in OTHERS or name.startswith(inside) or is_package(name))] == []
    assert [name for name in OTHERS if not (TESTS / name).is_dir() or is_package(name)] == []
