"""Figures for print: the coverage is exact, each figure has its data, and files open in their formats."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.view.figures import FIGURES, count_coverage, driven_lines

pytest.importorskip("matplotlib", reason="the extra view is not installed")


def test_a_straight_line_covers_its_cells_once() -> None:
    line = np.array([[-25.0, 5.0], [25.0, 5.0]])
    cells = count_coverage([line, line[::-1], line[:1]], 30.0)
    assert cells.shape == (6, 6)
    # Two lines through y = 5 m, that is the row just north of the middle; the third is a single point.
    expected = np.zeros((6, 6), int)
    expected[3, :] = 2
    expected[3, 0] = 3
    np.testing.assert_array_equal(cells, expected)


@given(st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=2, max_size=6))
def test_cells_that_a_line_runs_through_are_counted_once_and_no_others(points: list[tuple[float, float]]) -> None:
    line = shapely.LineString(points)
    cells = count_coverage([np.array(points)] * 3, 40.0)
    assert set(np.unique(cells)) <= {0, 3}
    for row, column in np.ndindex(cells.shape):
        west, south = 10.0 * column - 40.0, 10.0 * row - 40.0
        cell = shapely.box(west, south, west + 10.0, south + 10.0)
        if cells[row, column]:
            assert line.distance(cell) < 1e-9
        else:
            # Lines are sampled each metre: a shorter piece may lie between two samples.
            pieces = [shapely.LineString(pair).intersection(cell.buffer(-1e-6)).length for pair in pairwise(points)]
            assert max(pieces) <= 1.0 + 1e-9


def test_lines_run_from_entry_to_exit(street: Dataset) -> None:
    scene = street.table("scenes").to_pylist()[0]
    lines = driven_lines(street, scene)
    assert len(lines) == 2
    for row, line in lines:
        length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        assert length == pytest.approx(10.0 * row["duration_s"], rel=0.25)


def test_every_figure_in_every_format(street: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "plot",
        street.root,
        "--out",
        str(tmp_path / "out"),
        "--format",
        "png",
        "svg",
        "pdf",
        "--dpi",
        "60",
        "--json",
    ]
    assert main(words) == 0
    files = [Path(name) for name in json.loads(capsys.readouterr().out)["figures"]]
    assert {file.stem for file in files} == set(FIGURES)
    for file in files:
        if file.suffix == ".png":
            pixels = cv2.imread(str(file))
            assert pixels is not None
            # Something is drawn: more than one colour.
            assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 10
        elif file.suffix == ".svg":
            assert ElementTree.fromstring(file.read_text()).tag.endswith("svg")
        else:
            assert file.read_bytes().startswith(b"%PDF")


def test_wrong_options_are_refused(street: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "out")
    assert main(["plot", street.root, "--out", out, "--figure", "pie"]) == 2
    assert "no figure 'pie'" in capsys.readouterr().err
    assert main(["plot", street.root, "--out", out, "--dpi", "5"]) == 2
    assert main(["plot", street.root, "--out", street.root]) == 2
    assert not (tmp_path / "out").exists()
