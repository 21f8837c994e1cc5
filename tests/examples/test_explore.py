"""The notebook that explores a dataset runs, and shows datasets, frames, metrics and results as HTML."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.metrics.catalogue import MEASURES, Measure
from mirror.metrics.score import Score
from tests.conftest import ROOT
from tests.examples.notebook import run_notebook

NOTEBOOK = ROOT / "examples" / "explore.ipynb"


def images(html: str) -> list[np.ndarray]:
    data = re.findall(r'src="data:image/jpeg;base64,([^"]*)"', html)
    return [cv2.imdecode(np.frombuffer(base64.b64decode(one), np.uint8), cv2.IMREAD_COLOR) for one in data]


def test_the_notebook_runs_and_shows_what_it_says(
    tiny_dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / "dataset").symlink_to(tiny_dataset.root, target_is_directory=True)
    monkeypatch.chdir(tmp_path)
    shown = run_notebook(NOTEBOOK)
    kinds = [type(value) for value in shown]
    assert (
        kinds[:3] == [Dataset, Dataset, Frame]
        and {Measure, Score} <= set(kinds)
        and all(value is not None for value in shown)
    )
    assert len(shown[5]) == len(tiny_dataset.traversals())
    for value in shown:
        if hasattr(value, "_repr_html_") and not hasattr(value, "iloc"):
            closed = re.sub(r"<(img[^>]*|br)>", r"<\1/>", value._repr_html_())
            tags = {element.tag for element in ElementTree.fromstring(closed).iter()}
            assert not tags & {"script", "style", "link"}
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    # It is kept without outputs: they are of the reader's dataset.
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)


def test_datasets_and_frames_show_their_images_and_counts(tiny_dataset: Dataset) -> None:
    html = tiny_dataset._repr_html_()
    rows = tiny_dataset.table("traversals").to_pylist()
    assert len(images(html)) == len({(row["light"], row["weather"]) for row in rows})
    for count in (tiny_dataset.count("images"), tiny_dataset.count("frames"), len(rows)):
        assert f"<td>{count:,}" in html
    frame = tiny_dataset.frames()[0]
    html = frame._repr_html_()
    assert [one.shape[1] for one in images(html)] == [min(one.width_px, 160) for one in frame.images.values()]
    assert f"<td>{len(frame.boxes())}" in html or "<td>none" in html
    smallest = min(frame.images.values(), key=lambda image: image.width_px)
    assert images(html)[list(frame.images).index(smallest.camera)].shape[0] <= smallest.height_px


def test_text_is_escaped_and_what_is_missing_is_named(tiny_dataset: Dataset, tmp_path: Path) -> None:
    score = Score(float("nan"), "<script>no pixel</script>")
    assert "none: &lt;script&gt;no pixel" in score._repr_html_()
    assert "26.0206" in Score(26.0206)._repr_html_()
    html = MEASURES["psnr"]._repr_html_()
    assert "<b>PSNR</b>" in html and "<td>dB</td>" in html and "<td>higher</td>" in html
    root = Path(shutil.copytree(tiny_dataset.root, tmp_path / "<b>copy"))
    for file in root.glob("traversals/*/recorded/front_wide/*.jpg"):
        file.unlink()
    copy = mirror.open(root)
    html = copy._repr_html_()
    assert "&lt;b&gt;copy" in html and "<b>copy" not in html and not images(html) and "<i>" in html
    assert len(images(copy.frames()[0]._repr_html_())) == len(copy.frames()[0].images) - 1


def test_import_stays_light() -> None:
    code = "import sys, mirror; print(sorted({'jinja2', 'cv2', 'mirror.pages.notebook'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
