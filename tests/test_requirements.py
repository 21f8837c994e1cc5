"""The requirements of pyproject.toml against the sets of versions that are installed for tests."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TOOLS = {"dev", "bench", "docs"}
"""Extras of those who change the project: their packages are not needed at run time."""


def _read_set(name: str) -> dict[str, Version]:
    lines = [line for line in (ROOT / name).read_text().splitlines() if line and not line.startswith("#")]
    pairs = [line.split("==") for line in lines]
    return {package: Version(version) for package, version in pairs}


def _required() -> list[Requirement]:
    extras = PROJECT["optional-dependencies"]
    lines = [*PROJECT["dependencies"], *(line for name, ones in extras.items() if name not in TOOLS for line in ones)]
    return [Requirement(line) for line in lines if not line.startswith("mirror-dataset")]


@pytest.mark.parametrize("name", ["constraints.txt", "constraints-minimal.txt"])
def test_each_package_of_the_base_and_of_extras_is_pinned_within_its_bounds(name: str) -> None:
    pinned = _read_set(name)
    for required in _required():
        assert required.name in pinned, f"{name} does not pin {required.name}"
        assert required.specifier.contains(pinned[required.name]), f"{name}: {required} excludes its pin"


def test_the_builder_of_the_site_is_pinned() -> None:
    pinned = _read_set("constraints.txt")
    for required in map(Requirement, PROJECT["optional-dependencies"]["docs"]):
        assert required.specifier.contains(pinned[required.name]), required


def test_minimal_set_has_the_lower_bounds() -> None:
    pinned = _read_set("constraints-minimal.txt")
    for required in _required():
        lower = [Version(bound.version) for bound in required.specifier if bound.operator == ">="]
        assert len(lower) == 1, f"{required} has no lower bound"
        if required.name != "torch":  # only one build for processors is tested
            own = pinned[required.name]
            assert own.release[: len(lower[0].release)] == lower[0].release, f"{required}: pinned {own}"


def test_torch_is_one_in_which_weights_only_holds() -> None:
    for required in _required():
        if required.name == "torch":
            # weights_only=True can be bypassed below 2.6 (CVE-2025-32434) and 2.10 (CVE-2026-24747).
            assert not required.specifier.contains(Version("2.9.1"))
