"""Wheels of plug-ins, packed from files as a build would: no package is installed for a test."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest


def write_wheel(
    folder: Path, package: str, files: Mapping[str, str], entry_points: Mapping[str, Sequence[tuple[str, str]]]
) -> Path:
    """Write a wheel of pure Python; on ``sys.path`` it counts as installed.

    Args:
        folder: where to write it.
        package: name of the distribution, with underscores.
        files: texts by path within the wheel.
        entry_points: names and objects (``module:object``) by group.

    Returns:
        The file.
    """
    metadata = f"{package}-1.dist-info"
    groups = [
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in rows) for group, rows in entry_points.items()
    ]
    members = {
        **files,
        f"{metadata}/METADATA": f"Metadata-Version: 2.1\nName: {package}\nVersion: 1\nLicense: MIT\n",
        f"{metadata}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{metadata}/entry_points.txt": "\n".join(groups),
    }
    wheel = folder / f"{package}-1-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as file:
        for name, text in members.items():
            file.writestr(zipfile.ZipInfo(name), text)
    return wheel


def install_plugins(
    monkeypatch: pytest.MonkeyPatch,
    folder: Path,
    group: str,
    *entries: tuple[str, str],
    package: str = "some_plugins",
    files: Mapping[str, str] | None = None,
) -> None:
    """Install a package with entry points of one group for the rest of a test.

    Args:
        monkeypatch: undoes it.
        folder: where the wheel is written.
        group: the group.
        entries: names and objects, ``module:object``.
        package: name of the distribution.
        files: modules of the package, by path within the wheel.
    """
    folder.mkdir(parents=True, exist_ok=True)
    monkeypatch.syspath_prepend(write_wheel(folder, package, files or {}, {group: entries}))
