"""Test modules stand alone: what several need lies in a module without tests, and private names are not imported."""

from __future__ import annotations

import ast
from pathlib import Path

TESTS = Path(__file__).parent


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
