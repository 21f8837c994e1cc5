"""The reported entries against the paper's own tables, read by other means than they were written by."""

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
    """Source of every table, by label."""
    if not PAPER.is_file():
        pytest.skip(f"the paper's source is not at {PAPER} (MIRROR_PAPER)")
    text = PAPER.read_text()
    found = re.findall(r"\\begin\{table\*?\}(.*?)\\end\{table\*?\}", text, re.S)
    labels = {}
    for number, table in enumerate(found, start=1):
        label = re.search(r"\\label\{([^}]*)\}", table)
        assert label is not None
        labels[label[1]] = f"{number}\n{table}"
    return labels


def rows_of(table: str) -> list[tuple[str, list[float]]]:
    """What stands before the figures of each line, and the figures, in order."""
    found = []
    for line in re.split(r"\\\\", table.partition("\n")[2]):
        cells = [re.sub(r"\\textbf|\\bf|[{}\s]", "", cell) for cell in line.split("&")]
        figures = [float(cell) for cell in cells if re.fullmatch(r"-?\d+(\.\d+)?", cell)]
        if figures:
            found.append(("&".join(cells), figures))
    return found


def reported() -> list[Reported]:
    return [entry for entry in load_entries(REPORTED) if isinstance(entry, Reported)]


def test_every_printed_row_stands_on_the_board(tables: dict[str, str]) -> None:
    for label in ("tab:static_comparison", "tab:gen_fidelity", "tab:ablation", "tab:edit_iou"):
        printed = sorted(figures for _, figures in rows_of(tables[label]))
        entered = sorted([f.value for f in entry.figures] for entry in reported() if entry.paper.label == label)
        assert entered == printed, label


def test_rows_stand_under_their_method_and_data(tables: dict[str, str]) -> None:
    for label in ("tab:static_comparison", "tab:gen_fidelity"):
        # A data set's name stands in the first of its two lines.
        dataset = None
        for words, figures in rows_of(tables[label]):
            dataset = next((name for name in ("nuScenes", "MIRROR", "nuPlan") if name in words.split("&")[0]), dataset)
            (entry,) = [one for one in reported() if [f.value for f in one.figures] == figures]
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
    (entry,) = [one for one in reported() if one.paper.label == "tab:runtime"]
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


def test_every_table_of_results_is_there() -> None:
    labels = {"tab:static_comparison", "tab:gen_fidelity", "tab:ablation", "tab:edit_iou", "tab:runtime"}
    assert {entry.paper.label for entry in reported()} == labels
    assert all(entry.kind == "reported" for entry in reported())
