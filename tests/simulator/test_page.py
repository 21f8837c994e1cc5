"""The page of a drive: what it shows, that it is escaped, and that its curves follow from its states."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapely import LineString, Polygon, box
from shapely.affinity import rotate, translate

from hybridworldsim.simulator.policies.references import LaneKeeping
from hybridworldsim.simulator.rollout.page import DrivePageContent, list_events, write_page
from hybridworldsim.simulator.rollout.run import run_rollout
from mirror.evaluation.drive_curves import DriveCurve, measure_gap
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.safety import StateLog, read_state_log
from mirror.metrics.safety.collisions import Collision, CollisionKind
from mirror.metrics.safety.report import FIGURES, SafetyFigure, SafetyReport
from mirror.schema.rollout import STATES_FILE
from mirror.schema.scenario import Scenario
from mirror.view.video import write_video
from tests.leaderboard.browser import Browser
from tests.simulator.requests import request

START_NS = 1_000_000_000


@pytest.fixture
def safety() -> SafetyReport:
    figures = {name: SafetyFigure(name, float("nan"), "no <map> was given") for name in FIGURES}
    figures["collisions"] = SafetyFigure("collisions", 1.0, None, "<i>car-1</i>", 2_500_000_000)
    figures["least_ttc"] = SafetyFigure("least_ttc", 0.25, None, "car-1", 2_100_000_000)
    hit = Collision("<i>car-1</i>", "car", 2_500_000_000, 3.0, CollisionKind.FRONT, True)
    return SafetyReport(figures, (hit,), (), None)


@pytest.fixture
def content(safety: SafetyReport, tmp_path: Path) -> DrivePageContent:
    (tmp_path / "drive.mp4").write_bytes(b"video")
    stamps = [START_NS + number * 500_000_000 for number in range(5)]
    curves = [
        DriveCurve("Speed", "m/s", "<b>forward</b>", np.array([1.0, 2.0, np.nan, 4.0, 5.0])),
        DriveCurve("Gap", "m", "ahead", np.full(5, np.nan)),
    ]
    scenario = Scenario(name="cut-in", description="A car <cuts> in.")
    lines = ["The drive ended <early>.", "Exact map."]
    return DrivePageContent(scenario, "idm", "exact", lines, safety, stamps, curves, tmp_path / "drive.mp4")


def test_page_shows_video_figures_and_causes(content: DrivePageContent, tmp_path: Path) -> None:
    write_page(tmp_path / "a.html", content)
    text = (tmp_path / "a.html").read_text()
    body = text[text.index("<body") :]
    assert body.count("<main>") == 1 and "<title>cut-in, driven by idm</title>" in text
    assert '<video controls autoplay muted loop src="data:video/mp4;base64,dmlkZW8=">' in body
    assert "A car &lt;cuts&gt; in. World: exact." in body and "&lt;early&gt;.<br>Exact map." in body
    assert "&lt;b&gt;forward&lt;/b&gt;" in body
    title = MEASURES["collisions"].title
    row = next(row for row in re.findall(r"<tr>(.*?)</tr>", body) if f">{title}<" in row)
    assert re.findall(r">([^<>]*)</td>", row)[-4:] == ["1", "lower", "&lt;i&gt;car-1&lt;/i&gt;", "1.50 s"]
    assert len(re.findall("<tr>", body)) == 1 + len(FIGURES)
    assert not any(re.search(rf">{name}<", body) for name in FIGURES if name != MEASURES[name].title)
    write_page(tmp_path / "b.html", replace(content, video=None))
    assert "<video" not in (tmp_path / "b.html").read_text()


def test_its_policy_allows_its_own_script_and_style_only(content: DrivePageContent, tmp_path: Path) -> None:
    write_page(tmp_path / "a.html", content)
    text = (tmp_path / "a.html").read_text()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1].replace("&#39;", "'")
    assert policy.startswith("default-src 'none'; img-src data:; media-src data:; ")
    for tag in ("style", "script"):
        (source,) = re.findall(rf"<{tag}>(.*?)</{tag}>", text, re.S)
        digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert " style=" not in text and " onclick=" not in text and "unsafe" not in policy


def test_curves_have_gaps_where_there_is_no_value(content: DrivePageContent, tmp_path: Path) -> None:
    write_page(tmp_path / "a.html", content)
    text = (tmp_path / "a.html").read_text()
    data = json.loads(re.search(r'id="curves">(.*?)</script>', text)[1])
    assert data["times"] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert [curve["values"] for curve in data["curves"]] == [[1.0, 2.0, None, 4.0, 5.0], [None] * 5]
    speed, gap = re.findall(r'<figure class="curve">(.*?)</figure>', text, re.S)
    points = [re.findall(r"[\d.]+ [\d.]+", path) for path in re.findall(r'class="value" d="([^"]*)"', speed)]
    assert [len(part) for part in points] == [2, 2]
    x, y = np.array([point.split() for part in points for point in part], float).T
    # Places are linear in time and value, and upwards is more.
    assert np.allclose(np.diff(x), np.array([0.5, 1.0, 0.5]) * (x[-1] - x[0]) / 2.0, atol=0.11)
    assert np.allclose(np.diff(y), np.array([1.0, 2.0, 1.0]) * (y[-1] - y[0]) / 4.0, atol=0.11) and y[0] > y[-1]
    assert "<svg" not in gap and "No value in this drive." in gap
    # The collision, 1.5 s after the start of 2 s, is marked there.
    bad = re.search(r'class="event bad"><title>([^<]*)</title><path d="M([\d.]+)', speed)
    assert "caused by the ego" in bad[1] and float(bad[2]) == pytest.approx(x[0] + 0.75 * (x[-1] - x[0]), abs=0.11)


def test_events_are_in_the_order_of_their_times(safety: SafetyReport) -> None:
    events = list_events(safety, START_NS)
    assert [(round(one.time_s, 2), one.kind) for one in events] == [(1.1, "note"), (1.5, "bad")]
    assert events[0].words == "least time to collision: 0.25 s, car-1"


def test_gap_equals_that_of_polygons() -> None:
    """Shapely cuts the other boxes with the strip ahead of the ego."""
    rng = np.random.default_rng(0)
    stamps, agents = 40, 16
    shape = (stamps, agents)
    log = StateLog(
        stamps_ns=np.arange(stamps, dtype=np.int64) * 10**8,
        x_m=rng.uniform(-20, 20, shape), y_m=rng.uniform(-20, 20, shape), yaw_rad=rng.uniform(-3, 3, shape),
        vx_mps=np.zeros(shape), vy_mps=np.zeros(shape),
        length_m=rng.uniform(1, 12, agents), width_m=rng.uniform(0.5, 3, agents),
        present=rng.random(shape) < np.r_[1.0, np.full(agents - 1, 0.7)],
        ids=tuple(map(str, range(agents))), categories=("car",) * agents, rear_axle_to_center_m=1.4,
    )  # fmt: skip
    expected = []
    for row in range(stamps):
        nearest = np.nan
        for agent in range(1, agents):
            if not log.present[row, agent]:
                continue
            length, width = log.length_m[agent], log.width_m[agent]
            other = rotate(
                box(-length / 2, -width / 2, length / 2, width / 2), log.yaw_rad[row, agent], use_radians=True
            )
            other = translate(other, log.x_m[row, agent] - log.x_m[row, 0], log.y_m[row, agent] - log.y_m[row, 0])
            other = rotate(other, -log.yaw_rad[row, 0], origin=(0, 0), use_radians=True)
            front, half = log.length_m[0] / 2, log.width_m[0] / 2
            part: Polygon = other.intersection(box(front, -half, 1000.0, half))
            if not part.is_empty:
                nearest = np.nanmin([nearest, part.bounds[0] - front])
        expected.append(nearest)
    assert 10 < np.isfinite(expected).sum() < 40
    assert np.allclose(measure_gap(log, farthest_m=1000.0), expected, atol=1e-9, equal_nan=True)
    near = measure_gap(log, farthest_m=5.0)
    assert np.array_equal(np.isfinite(near), np.nan_to_num(expected, nan=9.0) <= 5.0)


def test_curves_of_a_drive_are_those_of_its_states(tmp_path: Path) -> None:
    run_rollout(replace(request(LaneKeeping(), video=("front_wide",)), page=True), tmp_path / "run")
    log = read_state_log(tmp_path / "run" / STATES_FILE)
    text = (tmp_path / "run" / "report.html").read_text()
    data = json.loads(re.search(r'id="curves">(.*?)</script>', text)[1])
    assert data["times"] == pytest.approx(log.times_s)
    speed = np.array(data["curves"][0]["values"])
    way = LineString(np.column_stack([log.x_m[:, 0], log.y_m[:, 0]])).length
    assert np.trapezoid(speed, log.times_s) == pytest.approx(way, rel=0.01)


def test_marks_follow_the_video_and_events_move_it(content: DrivePageContent, tmp_path: Path, browser: Browser) -> None:
    write_video(tmp_path / "drive.mp4", [np.full((64, 96, 3), 40 * row, np.uint8) for row in range(5)], 2.0)
    write_page(tmp_path / "a.html", content)
    browser.open(tmp_path / "a.html")
    place = "document.querySelector('.now').getAttribute('x1')"
    value = "document.querySelector('output').textContent"
    browser.script("document.querySelector('video').pause()")
    # The second event is the collision, 1.5 s after the start of 2 s.
    browser.script("document.querySelectorAll('.events button')[1].click()")
    assert browser.script("document.querySelector('video').currentTime") == pytest.approx(1.501, abs=1e-6)
    assert (
        float(browser.script(place)) == pytest.approx(46 + 0.75 * (550 - 46), abs=0.3)
        and browser.script(value) == "4.0 m/s"
    )
    # A click on a chart at its first quarter.
    browser.script(
        "(()=>{const svg=document.querySelector('.curve svg'), box=svg.getBoundingClientRect();"
        "svg.dispatchEvent(new PointerEvent('pointerdown', {clientX: box.left + box.width * (46 + 126) / 560}))})()"
    )
    assert float(browser.script(place)) == pytest.approx(46 + 126, abs=0.3) and browser.script(value) == "2.0 m/s"
    # The video's own time moves the marks.
    seek = "v.currentTime=1.2; v.dispatchEvent(new Event('seeked'))"
    browser.script("(()=>{const v=document.querySelector('video'); " + seek + "})()")
    assert (
        float(browser.script(place)) == pytest.approx(46 + 0.6 * (550 - 46), abs=0.3)
        and browser.script(value) == "none"
    )
    assert not browser.warnings()
