"""The names that a user imports: all there, listed, imported on first use, and quick to start with."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

PACKAGES = [
    "mirror",
    "mirror.synth",
    "mirror.privacy",
    "mirror.metrics",
    "mirror.methods",
    "mirror.dataset",
    "mirror.protocols",
    "mirror.annotation",
    "mirror.recordings",
    "hybridworldsim",
    "hybridworldsim.simulator",
]
HEAVY = ("numpy", "pandas", "pyarrow", "torch", "numba", "cv2", "scipy", "rich", "tyro", "jinja2")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there_and_listed(package: str) -> None:
    module = import_module(package)
    assert sorted(module.__all__) == dir(module) == sorted(set(module.__all__))
    for name in module.__all__:
        assert getattr(module, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        module.no_such_name  # noqa: B018


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_imports_nothing_heavy(package: str) -> None:
    code = f"import sys, {package}; print(*[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
