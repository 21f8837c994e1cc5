"""Compares the reported entries with the tables in the paper's LaTeX source."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from mirror_leaderboard.entry import Reported, load_entries
from tests.leaderboard.conftest import REPORTED, REPOSITORY

PAPER = Path(os.environ.get("MIRROR_PAPER", REPOSITORY.parent / "shared" / "paper" / "hybridworldsim.tex"))


@pytest.fixture(scope="module")
def tables() -> dict[str, str]:
    """Return the source of every table by its label."""
    if not PAPER.is_file():
        pytest.skip(f"the paper's source is not at {PAPER} (MIRROR_PAPER)")
    text = PAPER.read_text()
    sources = re.findall(r"\\begin\{table\*?\}(.*?)\\end\{table\*?\}", text, re.S)
    labels = {}
    for number, table in enumerate(sources, start=1):
        label = re.search(r"\\label\{([^}]*)\}", table)
        assert label is not None
        labels[label[1]] = f"{number}\n{table}"
    return labels


def rows_of(table: str) -> list[tuple[str, list[float]]]:
    """Return the cells of each line with figures, and the figures, in their order."""
    rows = []
    for line in re.split(r"\\\\", table.partition("\n")[2]):
        cells = [re.sub(r"\\textbf|\\bf|[{}\s]", "", cell) for cell in line.split("&")]
        figures = [float(cell) for cell in cells if re.fullmatch(r"-?\d+(\.\d+)?", cell)]
        if figures:
            rows.append(("&".join(cells), figures))
    return rows


def reported() -> list[Reported]:
    return [entry for entry in load_entries(REPORTED) if isinstance(entry, Reported)]


def test_every_printed_row_is_on_the_board(tables: dict[str, str]) -> None:
    for label in ("tab:static_comparison", "tab:gen_fidelity", "tab:ablation", "tab:edit_iou"):
        printed = sorted(figures for _, figures in rows_of(tables[label]))
        entered = sorted([f.value for f in entry.figures] for entry in reported() if entry.paper.label == label)
        assert entered == printed, label


def test_rows_have_the_right_method_and_dataset(tables: dict[str, str]) -> None:
    for label in ("tab:static_comparison", "tab:gen_fidelity"):
        # Each dataset has two lines; the first one has its name.
        dataset = None
        for words, figures in rows_of(tables[label]):
            dataset = next((name for name in ("nuScenes", "MIRROR", "nuPlan") if name in words.split("&")[0]), dataset)
            (entry,) = [entry for entry in reported() if [f.value for f in entry.figures] == figures]
            assert entry.dataset == dataset
            assert (entry.method == "HybridWorldSim") == ("Ours" in words)
            assert entry.paper.row in words


def test_offsets_are_the_printed_ones(tables: dict[str, str]) -> None:
    heads = re.findall(r"\$Y=(-?[\d.]+)\$", tables["tab:gen_fidelity"])
    for dataset, printed in (("nuScenes", heads[:5]), ("MIRROR", heads[5:])):
        for entry in reported():
            if entry.protocol == "vehicle-translation" and entry.dataset == dataset:
                groups = [figure.group for figure in entry.figures]
                sides = [
                    f"{'left' if float(y) > 0 else 'right'}-{abs(float(y)):g}m" if float(y) else "0m" for y in printed
                ]
                assert groups == sides


def test_runtime(tables: dict[str, str]) -> None:
    table = tables["tab:runtime"]
    (entry,) = [entry for entry in reported() if entry.paper.label == "tab:runtime"]
    values = {figure.metric: figure.value for figure in entry.figures}
    megabytes = re.search(r"(\d+)\\,MB", table)
    rates = re.findall(r"(\d+) FPS", table)
    assert megabytes is not None
    assert values == {
        "model_bytes_per_100m": float(megabytes[1]) * 1e6,
        "mvs_frames_per_second": float(rates[0]),
        "frames_per_second": float(rates[1]),
    }


def test_tables_are_numbered_as_latex_does(tables: dict[str, str]) -> None:
    for entry in reported():
        assert int(tables[entry.paper.label].partition("\n")[0]) == entry.paper.table


def test_all_result_tables_have_entries() -> None:
    labels = {"tab:static_comparison", "tab:gen_fidelity", "tab:ablation", "tab:edit_iou", "tab:runtime"}
    assert {entry.paper.label for entry in reported()} == labels
    assert all(entry.kind == "reported" for entry in reported())
