"""Versions of the toolkit and of the packages that affect figures."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Final

from mirror.version import __version__

_PACKAGES: Final = ("numpy", "opencv-contrib-python-headless", "scipy", "torch", "numba", "pyarrow")


def list_versions() -> dict[str, str]:
    """List the versions of the toolkit, of Python and of the packages that affect figures."""
    versions = {"mirror": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions
