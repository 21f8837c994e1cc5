"""The ``>>>`` examples in the docstrings of public names run, and print what they show.

An example runs in a folder that holds a small dataset: ``mirror.open("dataset")``. It has one scene ``a`` with three
traversals, the cameras ``front_wide`` and ``rear``, boxes of the layer ``petr@1`` and a split ``novel``. The names
``mirror`` and ``np`` are imported. A new public name gets an example by writing it in its docstring.
"""

from __future__ import annotations

import doctest
import importlib
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset.index import build_index
from mirror.dataset.splits import make_split
from mirror.geometry import Camera
from mirror.schema.documents import NovelTraversal
from mirror.schema.tables import BOXES
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box

PACKAGES = ("mirror", "mirror.dataset", "mirror.geometry", "mirror.metrics")
OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
LENSES = {
    "front_wide": Camera("pinhole", 96, 64, 60.0, 60.0, 48.0, 32.0),
    "rear": Camera("pinhole", 96, 64, 60.0, 60.0, 48.0, 32.0),
}


def examples() -> Iterator[doctest.DocTest]:
    """Docstrings with an example: of each public name, and of the methods of a public class."""
    finder = doctest.DocTestFinder()
    found = set()
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            for test in finder.find(getattr(module, name), f"{package}.{name}", module=False, globs={}):
                if test.examples and test.docstring not in found:
                    found.add(test.docstring)
                    yield test


EXAMPLES = list(examples())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the dataset that the examples open."""
    folder = tmp_path_factory.mktemp("snippets")
    builder = Builder(folder / "dataset", cameras=tuple(LENSES), lenses=LENSES)
    builder.scene("a")
    for number, light in enumerate(("day", "dusk", "night")):
        start = EPOCH + number * 60 * SECOND
        jpeg = cv2.imencode(".jpg", np.full((64, 96, 3), 90 + number, np.uint8))[1].tobytes()
        images = dict.fromkeys(LENSES, jpeg)
        (traversal,) = builder.drive(f"d{number}", [Pass("a", start, frames=4, light=light, images=images)])
        rows = [box(start, "near", tx_m=9.0, ty_m=2.0), box(start, "far", category="van", tx_m=25.0)]
        builder.layer(traversal, "boxes", "petr@1", BOXES, rows)
    build_index(builder.root)
    make_split(builder.root, "novel", NovelTraversal(train=2, held_out=1))
    return folder


def test_public_names_have_examples() -> None:
    names = {test.name for test in EXAMPLES}
    assert {"mirror.Dataset.where", "mirror.Frame.boxes", "mirror.open"} <= names
    assert {name.rsplit(".", 1)[0] for name in names} & {"mirror.geometry"}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_example_prints_what_its_docstring_shows(
    example: doctest.DocTest, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    output: list[str] = []
    example.globs = {"mirror": mirror, "np": np}
    result = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False).run(example, out=output.append)
    assert result.failed == 0, "".join(output)
