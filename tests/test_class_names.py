"""No two public classes of the installed packages have one name."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

from tests.sources import parse, without_collection

ROOT = Path(__file__).parents[1]
PACKAGES = ("mirror", "baselines/hybridworldsim", "baselines/mirror_baselines", "leaderboard/mirror_leaderboard")
OF_EACH_VERB = {"Arguments"}
"""Each verb's own; nothing else imports them."""


def list_classes() -> dict[str, list[str]]:
    """Files that define a public class, by its name."""
    found = defaultdict(list)
    files = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]
    with without_collection():
        trees = {file: parse(file) for file in files}
    for file, tree in trees.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found[node.name].append(file.relative_to(ROOT).as_posix())
    return found


def test_each_public_class_has_a_name_of_its_own() -> None:
    classes = list_classes()
    assert len(classes) > 1000 and len(classes["Arguments"]) > 20
    several = {name: files for name, files in classes.items() if len(files) > 1}
    assert several.keys() == OF_EACH_VERB, several
