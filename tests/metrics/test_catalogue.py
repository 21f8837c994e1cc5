"""The catalogue of metrics: one entry each, and one entry is all that a new metric needs beside its file."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from mirror.errors import UsageError
from mirror.metrics.catalogue import MEASURES, PARTS, find_measure, plain_names
from mirror.metrics.catalogue_page import fill_page
from mirror.metrics.features.lpips import TRUNK_WEIGHTS
from mirror.protocols.document import load_protocol, protocol_names
from mirror.protocols.metrics import Part
from mirror.weights.table import KNOWN
from tests.conftest import ROOT

_FILE = """
import numpy as np
from mirror.metrics.score import Score

def mean_error(render, truth, *, mask=None):
    difference = np.abs(render.astype(float) - truth).mean(axis=2)
    return Score(difference.mean() if mask is None else difference[mask].mean())
"""
_FILE_OF_ROLLOUTS = """
import numpy as np
from mirror.metrics.safety.report import SafetyFigure

def count_stops(log, road_map, route_m):
    return SafetyFigure("stops", float((np.hypot(log.vx_mps[:, 0], log.vy_mps[:, 0]) == 0.0).sum()))
"""
_ENTRY = """
from mirror.metrics import catalogue
catalogue.MEASURES["mean_error"] = catalogue.Measure(
    "Error", "mean difference of the scored pixels", "lower", 1, high=255.0, unit="levels",
    function="mean_error:mean_error", is_plain=True, name="mean_error",
)
catalogue.MEASURES["stops"] = catalogue.Measure(
    "Stops", "stamps at which the ego stands", "lower", 0, kind="rollout", function="stops:count_stops", is_plain=True,
    name="stops",
)
"""
_USE = """
import numpy as np
from mirror.evaluation.figures import compute_figures
from mirror.evaluation.report_tables import Footnotes, list_measures, summary_table
from mirror.evaluation.result import Result
from mirror.evaluation.scorers.reconstruction import score_pixels
from mirror.evaluation.submission.manifest import SubmittedMethod, SubmissionManifest
from mirror.metrics.catalogue import MEASURES, find_measure
from mirror.metrics.catalogue_page import format_tables
from mirror.pages.rendering import render_part
from mirror.protocols.document import Protocol, load_protocol
from mirror.protocols.views.view import RenderView
from mirror_leaderboard.entry import Figure

plain = load_protocol("static-reconstruction").model_dump(mode="json")
plain["metrics"].append({"metric": "mean_error"})
protocol = Protocol.model_validate(plain)
assert protocol.metric_names[-1] == "mean_error"
truth, mask = np.zeros((4, 6, 3), np.uint8), np.ones((4, 6), bool)
mask[0] = False
render = truth + np.uint8(5)
render[0] = 200
score, _ = score_pixels(protocol.metrics[-1], render, truth, mask, None)
view = RenderView.model_construct(
    group="training", scene_id="s", traversal_id="t", camera="c", light="day", weather="clear", timestamp_ns=0,
    frame_index=0, path="a",
)
figure = compute_figures(protocol, MEASURES["mean_error"], "training", [view], [score])[0]
assert (figure.metric, figure.value, figure.unit, figure.better) == ("mean_error", 5.0, "levels", "lower")
assert Figure(group="training", metric="mean_error", value=5.0).value == 5.0
assert MEASURES["mean_error"].head == "Error (levels)" and MEASURES["mean_error"].format(5.0) == "5.0"

manifest = SubmissionManifest.model_construct(method=SubmittedMethod(name="any"))
result = Result.model_construct(figures=(figure,), submission=manifest, protocol=protocol)
notes = Footnotes()
listed = render_part("mirror.evaluation", "figures.html", "metrics", list_measures(result))
assert "<b>Error</b> <code>mean_error</code>: mean difference of the scored pixels; lower is better." in listed
table = summary_table(result, (), notes)
shown = render_part("mirror.evaluation", "figures.html", "figures_table", table.head, table.rows)
assert "5.0000" in shown and "Error, levels ↓" in shown
assert find_measure("mean_error").better == "lower" and "| `mean_error` |" in format_tables()
"""
_USE_OF_ROLLOUTS = """
import numpy as np
from mirror.metrics.safety import FIGURES, StateLog, score_rollout
from mirror.protocols.document import Protocol, load_protocol

plain = load_protocol("safety").model_dump(mode="json")
plain["metrics"].append({"metric": "stops"})
assert Protocol.model_validate(plain).metric_names[-1] == "stops"
zeros = np.zeros((3, 1))
log = StateLog(
    np.array([0, 1, 2]) * 10**9, zeros, zeros, zeros, np.array([[0.0], [0.0], [2.0]]), zeros, np.full(1, 4.0),
    np.full(1, 2.0), np.ones((3, 1), bool), ("ego",), ("car",), 1.0,
)
report = score_rollout(log)
assert report.figures["stops"].value == 2.0 and list(FIGURES)[-1] == "stops"
"""


@pytest.mark.parametrize("use", [_USE, _USE_OF_ROLLOUTS], ids=["images", "rollouts"])
def test_a_metric_is_added_by_its_file_and_one_entry(tmp_path: Path, use: str) -> None:
    (tmp_path / "mean_error.py").write_text(_FILE)
    (tmp_path / "stops.py").write_text(_FILE_OF_ROLLOUTS)
    done = subprocess.run(
        [sys.executable, "-c", _ENTRY + use], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_every_metric_of_a_protocol_stands_in_the_catalogue() -> None:
    named = {name for protocol in protocol_names() for name in load_protocol(protocol).metric_names}
    assert named - {"nuscenes_detection"} <= set(MEASURES)
    assert all(measure.name == name and measure.low < measure.high for name, measure in MEASURES.items())
    assert find_measure("ap_car").name == "ap_car" and find_measure("ap_car").high == 1.0
    with pytest.raises(UsageError, match="metric 'psnrr' is unknown"):
        find_measure("psnrr")


@pytest.mark.parametrize("name", plain_names("image"))
def test_functions_of_the_catalogue_score_one_image(name: str) -> None:
    truth = np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8)
    for render in (255 - truth, np.where(truth < 128, np.uint8(255), np.uint8(0)), truth):
        score = MEASURES[name].load()(render, truth, mask=None)
        assert MEASURES[name].low <= score <= MEASURES[name].high


SHOWN = {
    1: ("frames_per_second mvs_frames_per_second model_bytes_per_100m off_road wrong_lane progress"),
    2: (
        "psnr psnr_invariant psnr_affine psnr_cc psnr_pooled fid kid fvd edit_iou training_s peak_memory_bytes"
        " at_fault_collisions collisions impact_speed least_ttc ttc_nuplan_within_bound ttc_navsim_within_bound"
        " drivable_area drivable_margin red_lights comfort ttc_nuplan progress_share"
    ),
    3: (
        "matched_structure ms_structure ssim lpips lpips_alex lpips_vgg lpips_squeeze st_lpips_alex st_lpips_vgg"
        " edit_iou_hull edit_iou_box edit_iou_ceiling mean_ap nds nds_no_attr mate_m mase maoe_rad mave_mps maae ap"
        " epdms pdms"
    ),
}
NEGATIVE = {"ms_structure": -1.0, "ssim": -1.0, "kid": -1.0, "drivable_margin": -np.inf, "progress": -np.inf}
SHARES = (
    "matched_structure ms_structure ssim edit_iou edit_iou_hull edit_iou_box edit_iou_ceiling mean_ap nds "
    "nds_no_attr mase maae ap epdms pdms ttc_nuplan_within_bound ttc_navsim_within_bound drivable_area comfort "
    "progress_share"
)
# Protocols name them without options.
PLAIN = (
    "psnr matched_structure ms_structure psnr_invariant psnr_affine frames_per_second model_bytes_per_100m "
    "training_s peak_memory_bytes epdms pdms at_fault_collisions collisions impact_speed ttc_nuplan_within_bound "
    "ttc_navsim_within_bound drivable_margin off_road wrong_lane red_lights comfort progress_share"
)


def whole(name: str) -> str:
    """The metric of which another is that of a part of the image."""
    return re.sub(f"_({'|'.join(PARTS)})$", "", name)


def test_boards_show_digits_that_a_metric_has() -> None:
    digits = {name: count for count, names in SHOWN.items() for name in names.split()}
    for name, measure in MEASURES.items():
        assert measure.format(7.0 / measure.scale) == f"{7:.{digits[whole(name)]}f}", name


def test_values_of_a_metric_have_bounds() -> None:
    for name, measure in MEASURES.items():
        assert measure.low == NEGATIVE.get(whole(name), 0.0), name
        assert measure.high == (1.0 if whole(name) in SHARES.split() else np.inf), name


def test_metrics_without_options_are_named_alone() -> None:
    assert {name for name, measure in MEASURES.items() if measure.is_plain} == set(PLAIN.split())


def test_metrics_that_scorers_compute_have_no_function() -> None:
    with pytest.raises(TypeError, match="fid has no function"):
        MEASURES["fid"].load()


def test_needed_weights_are_those_that_are_loaded() -> None:
    assert {name for measure in MEASURES.values() for name in measure.needs} <= set(KNOWN)
    for net, trunk in TRUNK_WEIGHTS.items():
        assert MEASURES[f"lpips_{net}"].needs == (trunk, f"lpips-heads-{net}")


def test_each_part_of_an_edited_image_has_a_sentence() -> None:
    assert set(PARTS) == set(get_args(Part))


def test_the_page_of_metrics_is_that_of_the_catalogue() -> None:
    page = (ROOT / "docs" / "metrics.md").read_text()
    assert page == fill_page(page), "run `python -m mirror.metrics.catalogue_page docs/metrics.md`"
    described = "".join(page.read_text() for page in (ROOT / "docs" / "metrics").glob("*.md"))
    without_row = [name for name in plain_names("image") if f"`{name}" not in described]
    assert not without_row, "say in a page of docs/metrics what the functions compute"


def test_the_page_of_safety_states_the_units_of_the_catalogue() -> None:
    page = (ROOT / "docs" / "safety.md").read_text()
    for names, unit in re.findall(r"^\| (`[^|]*?) \|.*\| ([^|]*?) ?\|$", page.partition("## Figures")[2], re.M):
        assert {MEASURES[name].unit for name in re.findall(r"`(\w+)`", names)} == {unit}, names
    stated = set(re.findall(r"`(\w+)`", page.partition("## Figures")[2].partition("###")[0]))
    assert {name for name, measure in MEASURES.items() if measure.kind == "rollout"} <= stated
