"""The report of an evaluation: headline, dataset and baseline first, breakdowns next, no empty column."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mirror.arrays import UInt8
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.evaluation.report import cover, error_map, write_report
from mirror.evaluation.result import GroupFigure
from mirror.evaluation.run import Evaluation, EvaluationOptions, evaluate
from mirror.protocols.views import RenderView
from tests.evaluation.submissions import SPLIT, small, write_renders

GROUPS = '[[groups]]\nname = "training"\nroles = ["train"]\n\n[[groups]]\nname = "novel"\nroles = ["held_out"]\n'
PROTOCOL = small(every=10, groups=GROUPS)


def darker(view: RenderView, truth: UInt8) -> UInt8:
    return truth // 2


def brighter(view: RenderView, truth: UInt8) -> UInt8:
    return np.clip(truth.astype(np.int16) + 20, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def scored(dataset: Dataset, root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Evaluation]:
    folder = tmp_path_factory.mktemp("report")
    found = {}
    for name, change in (("mine", brighter), ("floor", darker)):
        write_renders(dataset, PROTOCOL, folder / name, change, name=name)
        options = EvaluationOptions(workers=1)
        found[name] = evaluate(folder / name, root, PROTOCOL, SPLIT, folder / f"{name}-out", options)
    return found


def write(scored: dict[str, Evaluation], out: Path) -> str:
    floor = scored["floor"].result
    assert floor is not None
    write_report(scored["mine"], out / "report.html", [floor])
    return (out / "report.html").read_text()


def text_of(page: str) -> list[list[list[str]]]:
    """The cells of every table, by row."""
    tables = re.findall(r"<table>(.*?)</table>", page, re.S)
    rows = [re.findall(r"<tr>(.*?)</tr>", table, re.S) for table in tables]
    return [[re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row, re.S) for row in table] for table in rows]


def test_headline_dataset_and_baseline_come_first(scored: dict[str, Evaluation], tmp_path: Path) -> None:
    page = write(scored, tmp_path)
    places = [page.index(text) for text in ('class="tiles"', ">dataset ", "floor (baseline)", "By scene", "worst")]
    assert places == sorted(places)
    result = scored["mine"].result
    assert result is not None
    values = {(figure.group, figure.metric): figure.value for figure in result.figures if figure.level == "group"}
    assert f"<b>{values['training', 'psnr']:.2f} dB</b>" in page


def test_tables_have_no_empty_column(scored: dict[str, Evaluation], tmp_path: Path) -> None:
    tables = text_of(write(scored, tmp_path))
    assert len(tables) >= 4
    for table in tables:
        assert {len(row) for row in table} == {len(table[0])}
        for column in zip(*table[1:]):
            assert any(column), table[0]
    # The method and the baseline, for each group.
    assert [row[:2] for row in tables[0][1:]] == [
        ["training", "mine"],
        ["training", "floor (baseline)"],
        ["novel", "mine"],
        ["novel", "floor (baseline)"],
    ]


def test_remarks_stand_once_and_missing_weights_in_one_line(scored: dict[str, Evaluation], tmp_path: Path) -> None:
    mine = scored["mine"]
    assert mine.result is not None
    unavailable = {"lpips_alex": "weights <script> are missing; and much more", "lpips_vgg": "weights b are missing"}
    result = mine.result.model_copy(update={"unavailable": unavailable})
    write_report(Evaluation(mine.plan, mine.check, result, mine.inputs, mine.scored), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count("Not scored:") == 1
    line = "Not scored: lpips_alex (weights &lt;script&gt; are missing); lpips_vgg (weights b are missing)."
    assert line in page and "<script" not in page
    remarks = re.findall(r"<li>(.*?)</li>", page)
    assert remarks and len(set(remarks)) == len(remarks)


def test_many_metrics_have_a_row_each(scored: dict[str, Evaluation], tmp_path: Path) -> None:
    mine = scored["mine"]
    assert mine.result is not None
    figures = tuple(
        GroupFigure(metric=f"ap_{number}", group="all", value=0.1 * number, better="higher", n=3) for number in range(9)
    )
    result = mine.result.model_copy(update={"figures": figures})
    write_report(Evaluation(mine.plan, mine.check, result, mine.inputs, mine.scored), tmp_path / "report.html")
    (table,) = text_of((tmp_path / "report.html").read_text())
    assert table[0] == ["group", "method", "metric", "value", "n"]
    assert [row[2:4] for row in table[1:]] == [[f"ap_{number}", f"{0.1 * number:.4f}"] for number in range(9)]


def test_baseline_of_another_plan_is_refused(scored: dict[str, Evaluation], root: Path, tmp_path: Path) -> None:
    floor = scored["floor"].result
    assert floor is not None
    other = floor.model_copy(update={"dataset": floor.dataset.model_copy(update={"plan_hash": "0" * 64})})
    with pytest.raises(UsageError, match="another protocol, dataset or split"):
        write_report(scored["mine"], tmp_path / "report.html", [other])
    assert not (tmp_path / "report.html").exists()


def test_baseline_needs_a_report(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(root), str(tmp_path), "--baseline", str(tmp_path)]) == 2
    assert "--report" in capsys.readouterr().err


def test_pixels_outside_the_lens_are_grey_in_render_and_truth() -> None:
    image = np.full((4, 6, 3), 200, np.uint8)
    hidden = np.zeros((4, 6), np.bool_)
    hidden[0, :2] = True
    covered = cover(image, hidden)
    assert (covered[hidden] == covered[0, 0]).all() and (covered[~hidden] == 200).all()
    assert (image == 200).all()
    assert (error_map(image, image, ~hidden)[hidden] == covered[0, 0]).all()
