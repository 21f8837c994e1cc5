"""The sources of the site: every page is in the navigation, and the references are those of the code."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from mirror.cli.verbs import all_commands

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def builder() -> ModuleType:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return importlib.import_module("make_site")
    finally:
        sys.path.remove(str(ROOT / "docs"))


@pytest.fixture(scope="module")
def sources(builder: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("site") / "docs"
    builder.write_sources(out)
    return out


def test_each_page_is_in_the_navigation_once(sources: Path) -> None:
    navigation = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n")[1]
    listed = re.findall(r"(?:: |- )(\S+\.md)$", navigation, re.M)
    written = sorted(path.relative_to(sources).as_posix() for path in sources.rglob("*.md"))
    assert sorted(listed) == written
    sections = re.findall(r"^  - ([\w -]+):", navigation, re.M)
    assert sections == ["Get started", "Tutorials", "How-to", "Concepts", "Reference", "Results"]


def test_links_stay_in_the_site(sources: Path) -> None:
    for page in sources.rglob("*.md"):
        for address in re.findall(r"\]\(([^)\s#]+)", page.read_text()):
            if "://" not in address and not address.startswith("mailto:"):
                target = (page.parent / address).resolve()
                assert target.exists() and target.is_relative_to(sources.resolve()), (page.name, address)


def test_the_command_line_has_every_verb(sources: Path) -> None:
    text = (sources / "reference" / "command-line.md").read_text()
    heads = re.findall(r"^### mirror (\S+)$", text, re.M)
    assert sorted(heads) == sorted(all_commands())
    # Every block is a usage, of the subcommands too.
    blocks = re.findall(r"```text\n(.*?)\n```", text, re.S)
    assert all(block.startswith("usage: mirror ") for block in blocks)
    assert "#### mirror dataset publish" in text and "--no-video" in text
    assert "\x1b" not in text


def test_the_python_reference_has_every_public_name(builder: ModuleType, sources: Path) -> None:
    text = (sources / "reference" / "python.md").read_text()
    named = set(re.findall(r"heading: (\S+)", text)) | set(re.findall(r"^- `(\S+)`", text, re.M))
    for package in builder.PACKAGES:
        assert {f"{package}.{name}" for name in importlib.import_module(package).__all__} <= named
