"""Imports: test modules stand alone, and no module imports a package around it, or itself by way of others."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests.sources import parse, without_collection

TESTS = Path(__file__).parent
PACKAGES = [TESTS.parent / name for name in ("mirror", "baselines/hybridworldsim", "baselines/mirror_baselines",
                                             "leaderboard/mirror_leaderboard")]  # fmt: skip


def test_no_test_module_or_private_name_is_imported() -> None:
    found = []
    for file in TESTS.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if not isinstance(node, ast.ImportFrom | ast.Import):
                continue
            module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
            for alias in node.names:
                parts = f"{module}.{alias.name}".strip(".").split(".")
                test = parts[0] == "tests" and any(part.startswith("test_") for part in parts)
                own = parts[0] in ("mirror", "hybridworldsim", "mirror_leaderboard", "benchmarks", "tests")
                private = own and any(part.startswith("_") and not part.startswith("__") for part in parts)
                if test or private:
                    found.append(f"{file.relative_to(TESTS)}: {'.'.join(parts)}")
    assert not found


@pytest.fixture(scope="module")
def imports() -> dict[str, set[str]]:
    """The modules of the packages that each module imports, also where a function does or types alone are meant."""
    files = {name: file for package in PACKAGES for name, file in list_modules(package)}
    with without_collection():
        return {name: set(list_imports(parse(file), files.keys())) for name, file in files.items()}


def list_modules(package: Path) -> Iterator[tuple[str, Path]]:
    for file in package.rglob("*.py"):
        parts = file.relative_to(package.parent).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), file


def list_imports(tree: ast.Module, modules: Collection[str]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom) and node.module in modules:
            # What is imported is a module of a package, or a name in a module.
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in modules else str(node.module) for name in names)


def test_no_module_imports_a_package_around_it(imports: dict[str, set[str]]) -> None:
    # The face of a package imports the modules in it: `import mirror` is for others.
    assert len(imports) > 1000
    found = [(name, one) for name, used in imports.items() for one in used if name.startswith(f"{one}.")]
    assert not found


def test_no_module_imports_itself_by_way_of_others(imports: dict[str, set[str]]) -> None:
    with pytest.raises(CycleError):
        TopologicalSorter({"a": {"b"}, "b": {"a"}}).prepare()
    TopologicalSorter(imports).prepare()
