"""One registry for all kinds of plug-ins: near names, duplicates, broken packages, and nothing loaded unasked."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from hybridworldsim.simulator.policy_registry import POLICIES
from mirror.annotation.descriptions import DESCRIBERS
from mirror.annotation.registry import ANNOTATORS
from mirror.cli.verbs import VERBS
from mirror.errors import MirrorError
from mirror.methods.registry import METHODS
from mirror.plugins import PluginKind
from mirror.privacy.detectors.registry import DETECTORS
from mirror.recordings.registry import READERS
from mirror.recordings.weather import CLASSIFIERS
from tests.wheels import install_plugins

KINDS = (READERS, METHODS, DETECTORS, ANNOTATORS, DESCRIBERS, POLICIES, CLASSIFIERS, VERBS)
kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.noun)


@pytest.fixture
def site(kind: PluginKind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two packages with plug-ins of one kind, good and bad."""
    names = ("works", "divides", "needs", "gone", "twice")
    for package in ("first_plugins", "other_plugins"):
        files = {
            f"{package}/__init__.py": "",
            f"{package}/works.py": "made = 'by the package'\n",
            f"{package}/divides.py": "\n1 / 0\n",
            f"{package}/needs.py": "import no_such_dependency\n",
        }
        own = names if package == "first_plugins" else ("twice",)
        entries = [(f"{name}_plugin", f"{package}.{name}:made") for name in own]
        install_plugins(monkeypatch, tmp_path, kind.group, *entries, package=package, files=files)
    yield tmp_path
    for name in [name for name in sys.modules if name.startswith(("first_plugins", "other_plugins"))]:
        del sys.modules[name]


@kinds
def test_every_registry_finds_and_refuses_alike(kind: PluginKind, site: Path) -> None:
    assert {"works_plugin", "divides_plugin", "twice_plugin"} <= set(kind.names())
    assert kind.find("divides_plugin").value == "first_plugins.divides:made"
    assert "first_plugins" not in sys.modules, "listing and finding load nothing"
    assert kind.load("works_plugin") == "by the package"
    for name, said in (
        ("work_plugin", f"no {kind.noun} 'work_plugin' is installed.*did you mean works_plugin"),
        ("xyz", "install the package that has it"),
        ("twice_plugin", "first_plugins 1.*other_plugins 1.*uninstall one"),
        ("divides_plugin", r"line 2, package first_plugins 1.*cannot be loaded: ZeroDivisionError: division by zero"),
        ("needs_plugin", "needs no_such_dependency, which is not installed.*uninstall first_plugins 1"),
        ("gone_plugin", "cannot be loaded: ModuleNotFoundError: No module named 'first_plugins.gone'"),
    ):
        with pytest.raises(kind.error, match=said) as caught:
            kind.load(name)
        assert isinstance(caught.value, MirrorError)


def test_entry_points_of_another_version_name_reinstalling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    moved = ("moved_module", "mirror.recordings.no_such_module:Reader"), ("moved_class", "mirror.errors:NoSuchClass")
    install_plugins(monkeypatch, tmp_path, READERS.group, *moved)
    for name, _ in moved:
        with pytest.raises(READERS.error, match="install MIRROR again"):
            READERS.load(name)
