"""The figures by seed of the studies are those of their outcomes."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from benchmarks.published import STUDIES, format_csv, format_tables

pytest.importorskip("torch")


def test_committed_tables_are_those_of_the_outcomes() -> None:
    for name, text in format_tables().items():
        assert (STUDIES / name).read_text() == text, "run `python -m benchmarks published`"


def test_means_by_seed_are_those_of_the_reports() -> None:
    def read(study: str) -> list[dict[str, str]]:
        return list(csv.DictReader((STUDIES / study / "seeds.csv").open()))

    rows = [row for row in read("static_reconstruction") if (row["method"], row["core_minutes"]) == ("ours", "10")]
    streets = {"guangzhou-urban", "karlsruhe-campus", "karlsruhe-rural"}
    means = [float(row["train_PSNR"]) for row in rows if row["street"] in streets and row["width_px"] == "240"]
    report = (STUDIES / "static_reconstruction" / "report.md").read_text()
    assert f"| ours | {np.mean(means):.2f} | " in report
    scores = [float(row["score"]) for row in read("closed_loop") if (row["world"], row["policy"]) == ("exact", "night")]
    (line,) = [line for line in (STUDIES / "closed_loop" / "report.md").read_text().splitlines() if "| night |" in line]
    assert f"| {np.mean(scores):.3f} |" in line
    # Straight from the file, without the study's own reader.
    lines = [json.loads(line) for line in (STUDIES / "generation" / "outcomes.jsonl").read_text().splitlines()]
    (first,) = [line["figures"]["iou"] for line in lines if line["stage"] == "score-on-1"]
    assert read("generation")[1]["iou"] == f"{first:.6g}"


def test_figures_of_the_suite_are_those_of_its_table() -> None:
    rows = list(csv.DictReader((STUDIES / "suite_policies" / "seeds.csv").open()))
    table = (STUDIES / "suite_policies" / "README.md").read_text()
    assert len(rows) == table.count("| `") == 12
    for row in rows:
        score, low, high = (float(row[name]) for name in ("epdms", "epdms_low", "epdms_high"))
        figures = [float(row[name]) for name in ("collisions", "off_road", "progress")]
        ends = " | ".join(f"{value:.2f}" for value in figures)
        assert f"| `{row['policy']}` | {score:.3f} ({low:.3f} to {high:.3f}) | {ends} |" in table


def test_a_comma_in_a_cell_is_quoted() -> None:
    assert format_csv([{"a": "x,y", "b": 1 / 3}]) == 'a,b\n"x,y",0.333333\n'
