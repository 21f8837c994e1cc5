"""The page of a drive: what it shows, and that it is escaped and has the margins of all pages."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hybridworldsim.simulator.rollout.page import write_page
from mirror.metrics.safety.report import FIGURES, SafetyFigure, SafetyReport
from mirror.schema.scenario import Scenario


@pytest.fixture
def safety() -> SafetyReport:
    figures = {name: SafetyFigure(name, float("nan"), "no <map> was given") for name in FIGURES}
    figures["collisions"] = SafetyFigure("collisions", 1.0, None, "<i>car-1</i>", 2_500_000_000)
    return SafetyReport(figures, (), (), None)


def test_page_shows_video_figures_and_causes(safety: SafetyReport, tmp_path: Path) -> None:
    (tmp_path / "drive.mp4").write_bytes(b"video")
    scenario = Scenario(name="cut-in", description="A car <cuts> in.")
    lines = ["The drive ended <early>.", "Exact map."]
    write_page(
        tmp_path / "a.html", scenario, "idm", "exact", lines, safety, 1_000_000_000, tmp_path / "drive.mp4"
    )  # fmt: skip
    text = (tmp_path / "a.html").read_text()
    body = text[text.index("<body") :]
    assert body.count("<main>") == 1 and "<title>cut-in, driven by idm</title>" in text
    assert '<video controls autoplay muted loop src="data:video/mp4;base64,dmlkZW8=">' in body
    assert "A car &lt;cuts&gt; in. World: exact." in body and "&lt;early&gt;.<br>Exact map." in body
    row = next(row for row in re.findall(r"<tr>(.*?)</tr>", body) if ">collisions<" in row)
    assert re.findall(r">([^<>]*)</td>", row) == ["collisions", "1", "", "lower", "&lt;i&gt;car-1&lt;/i&gt;", "1.50 s"]
    assert len(re.findall("<tr>", body)) == 1 + len(FIGURES)
    write_page(tmp_path / "b.html", scenario, "idm", "exact", lines, safety, 0, None)
    assert "<video" not in (tmp_path / "b.html").read_text()
