"""The report of an evaluation: headline, dataset and baseline first, breakdowns next, no empty column."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.arrays import UInt8
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.evaluation.report import cover, error_map, write_report
from mirror.evaluation.result import GroupFigure
from mirror.evaluation.run import Evaluation, EvaluationOptions, evaluate
from mirror.metrics.catalogue import MEASURES, find_measure
from mirror.protocols.views import RenderView
from tests.evaluation.submissions import SPLIT, small, write_renders
from tests.leaderboard.browser import Browser

GROUPS = '[[groups]]\nname = "training"\nroles = ["train"]\n\n[[groups]]\nname = "novel"\nroles = ["held_out"]\n'
DATA = re.compile(r'src="data:image/jpeg;base64,([^"]*)"')
PROTOCOL = small(every=10, groups=GROUPS)


def darker(view: RenderView, truth: UInt8) -> UInt8:
    return truth // 2


def brighter(view: RenderView, truth: UInt8) -> UInt8:
    return np.clip(truth.astype(np.int16) + 12 + sum(view.path.encode()) % 9, 0, 255).astype(np.uint8)


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


def test_headline_and_images_come_first(scored: dict[str, Evaluation], tmp_path: Path) -> None:
    page = write(scored, tmp_path)
    order = ('class="tiles"', ">dataset ", "<b>best: ", "<b>median: ", "<b>worst: ", "floor (baseline)", "By scene")
    places = [page.index(text) for text in order]
    assert places == sorted(places)
    result = scored["mine"].result
    assert result is not None
    values = {(figure.group, figure.metric): figure.value for figure in result.figures if figure.level == "group"}
    assert f"<b>{values['training', 'psnr']:.2f} dB</b>" in page
    assert "Training traversals: PSNR" in page


def test_a_result_is_a_table_in_a_notebook(scored: dict[str, Evaluation]) -> None:
    result = scored["mine"].result
    assert result is not None
    html = result._repr_html_()
    of_groups = [figure for figure in result.figures if figure.level == "group"]
    assert html.count("<tr>") == 1 + len(of_groups)
    figure = next(one for one in of_groups if one.metric == "psnr" and one.group == "novel")
    assert f"<td>Novel traversals</td><td>PSNR</td><td>{figure.value:.2f} dB</td>" in html


def test_best_median_and_worst_renders_are_compared_with_their_truth(
    scored: dict[str, Evaluation], tmp_path: Path
) -> None:
    page = write(scored, tmp_path)
    sections = re.findall(r"<h2>([^<]*): best, median and worst renders</h2>(.*?)(?=<h2>)", page, re.S)
    assert [name for name, _ in sections] == ["Training traversals", "Novel traversals"]
    for _, section in sections:
        count = section.count('class="compare"')
        ranked = [float(value) for value in re.findall(r"<b>\w+: PSNR ([\d.]+) dB</b>", section)]
        assert len(ranked) == count and ranked == sorted(set(ranked), reverse=True)
        names = re.findall(r'<input type="radio" name="([^"]*)"', section)
        # Each comparison has steps of its own, of which one is chosen.
        assert len(names) == 21 * len(set(names)) == 21 * count and section.count(" checked>") == count
        for stage in re.findall(r'<div class="stage">(.*?)</div></div>', section, re.S):
            images = [cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), 1) for data in DATA.findall(stage)]
            assert len(images) == 2 and images[0].shape == images[1].shape
            # The renders of this method are its truth, 12 to 20 levels brighter.
            assert 6 < images[1].mean() - images[0].mean() < 21
    assert page.count('class="examples"') == 2 and page.index("By scene") > page.rindex('class="compare"')


def test_the_edge_follows_the_chosen_step_without_a_script(
    scored: dict[str, Evaluation], tmp_path: Path, browser: Browser
) -> None:
    write(scored, tmp_path)
    for width in (1280, 390):
        browser.open(tmp_path / "report.html", width=width, height=800)
        for step, share in ((2, 0.1), (20, 1.0), (10, 0.5)):
            browser.script(f"document.querySelectorAll('.compare')[0].querySelectorAll('input')[{step}].click()")
            found = browser.script(
                "(()=>{const stage=document.querySelector('.stage').getBoundingClientRect(),"
                "edge=document.querySelector('.stage .edge').getBoundingClientRect();"
                "return (edge.left + edge.width / 2 - stage.left) / stage.width})()"
            )
            assert found == pytest.approx(share, abs=0.01)
        # No image is enlarged, and the page is not wider than the window.
        enlarged = "[...document.images].filter(image => image.width > image.naturalWidth + 1).length"
        assert browser.script(enlarged) == 0
        assert browser.script("document.documentElement.scrollWidth") <= width


def test_figures_have_the_names_of_boards(scored: dict[str, Evaluation], tmp_path: Path) -> None:
    page = write(scored, tmp_path)
    result = scored["mine"].result
    assert result is not None
    for figure in result.figures:
        measure = find_measure(figure.metric)
        assert f"<b>{measure.title}</b> <code>{measure.name}</code>" in page
    heads = {cell for table in text_of(page) for cell in table[0]}
    assert "PSNR, dB ↑" in heads and not heads & set(MEASURES)


def test_tables_have_no_empty_column(scored: dict[str, Evaluation], tmp_path: Path) -> None:
    tables = text_of(write(scored, tmp_path))
    assert len(tables) >= 4
    for table in tables:
        assert {len(row) for row in table} == {len(table[0])}
        for column in zip(*table[1:]):
            assert any(column), table[0]
    # The method and the baseline, for each group.
    assert [row[:2] for row in tables[0][1:]] == [
        ["Training traversals", "mine"],
        ["Training traversals", "floor (baseline)"],
        ["Novel traversals", "mine"],
        ["Novel traversals", "floor (baseline)"],
    ]


def test_remarks_stand_once_and_missing_weights_in_one_line(scored: dict[str, Evaluation], tmp_path: Path) -> None:
    mine = scored["mine"]
    assert mine.result is not None
    unavailable = {"lpips_alex": "weights <script> are missing; and much more", "lpips_vgg": "weights b are missing"}
    result = mine.result.model_copy(update={"unavailable": unavailable})
    write_report(Evaluation(mine.plan, mine.check, result, mine.inputs, mine.scored), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count("Not scored:") == 1
    line = "Not scored: LPIPS alex (weights &lt;script&gt; are missing); LPIPS vgg (weights b are missing)."
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
    assert [row[2:4] for row in table[1:]] == [[f"AP {number} ↑", f"{0.1 * number:.4f}"] for number in range(9)]


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
