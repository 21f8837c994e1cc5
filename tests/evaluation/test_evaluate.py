"""Evaluation from end to end: figures, resumed runs, two processes, and refused submissions."""

from __future__ import annotations

import importlib.util
import json
import math
import shutil
import zlib
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from mirror.arrays import UInt8
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.evaluation.compare import compare
from mirror.evaluation.run import EvaluationOptions, evaluate, read_result
from mirror.evaluation.workers import ScoreLog, score_jobs
from mirror.geometry.box_projection import project_boxes
from mirror.protocols.document import load_protocol
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views import RenderView
from tests.evaluation.png_chunks import chunk, png
from tests.evaluation.submissions import SPLIT, small, write_renders
from tests.other_bytes import give_other_bytes

ALONE = EvaluationOptions(workers=1)


def noisy(sigma: float):
    def change(view: RenderView, truth: UInt8) -> UInt8:
        noise = np.random.default_rng(zlib.crc32(view.path.encode())).normal(0.0, sigma, truth.shape)
        return np.clip(np.round(truth + noise), 0, 255).astype(np.uint8)

    return change


@pytest.fixture(scope="module")
def folder(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("evaluate")
    for sigma in (4, 12):
        write_renders(dataset, small(every=2), folder / f"noise{sigma}", noisy(sigma), name=f"noise {sigma}")
    return folder


def test_psnr_is_of_the_scored_pixels(dataset: Dataset, root: Path, folder: Path, tmp_path: Path) -> None:
    protocol = small(every=2)
    done = evaluate(folder / "noise4", root, protocol, SPLIT, tmp_path, ALONE)
    assert done.result is not None
    rows = {row["path"]: row for row in pq.read_table(tmp_path / "images.parquet").to_pylist()}
    assert len(rows) == len(done.plan.views)
    truth = GroundTruth(dataset, protocol, done.plan.layers)
    traversals: dict[str, list[float]] = {}
    squares: list[float] = []
    pixels: list[int] = []
    free = 0
    for view in done.plan.views:
        render = cv2.imread(str(folder / "noise4" / view.path))[..., ::-1].astype(np.float64)
        frame, image = truth.recorded_frame_and_image(view)
        # Independent method: the recorded image is sampled at the rays of the raster's pixels.
        lens, scored = image.camera_model, truth.scored_mask(view)
        uv = lens.project(view.lens.rays().direction).uv_px
        margins = np.stack([uv[..., 0], lens.width_px - uv[..., 0], uv[..., 1], lens.height_px - uv[..., 1]])
        must = (margins > 4.0).all(axis=0)
        assert not scored[~(margins >= 0.0).all(axis=0)].any()
        own = image.static_mask()
        if own is not None:
            near = cv2.dilate(own, np.ones((9, 9), np.uint8))
            at = tuple(np.where(must, uv[..., axis], 0.0).astype(int) for axis in (1, 0))
            assert not scored[must & (own[at] > 0)].any()
            must &= near[at] == 0
        boxes = frame.boxes("world")
        projected = project_boxes(view.lens, view.pose.inverse() @ boxes.pose, boxes.size_m)
        for row in np.flatnonzero(projected.visible):
            u0, v0, u1, v1 = projected.bounds_px[row].astype(int)
            must[v0 : v1 + 1, u0 : u1 + 1] = False
            hull = projected.hull(int(row))
            middle = hull.mean(axis=0).astype(int)
            if (
                (np.ptp(hull, axis=0) > 6.0).all()
                and (middle >= 0).all()
                and (middle < (view.width_px, view.height_px)).all()
            ):
                assert not scored[middle[1], middle[0]]
        free += must.any()
        assert scored[must].all()
        row_of = rows[view.path]
        assert row_of["pixels"] == view.width_px * view.height_px
        assert row_of["scored_px"] == scored.sum()
        image = truth.image(view).astype(np.float64)
        error = np.mean((render[scored] - image[scored]) ** 2)
        squares.append(error * scored.sum())
        pixels.append(scored.sum())
        assert row_of["psnr"] == pytest.approx(10 * math.log10(255**2 / error), abs=1e-9)
        traversals.setdefault(view.traversal_id, []).append(row_of["psnr"])
    assert 2 * free > len(rows)
    figure = next(item for item in done.result.figures if item.metric == "psnr" and item.level == "group")
    assert figure.value == pytest.approx(np.mean([np.mean(values) for values in traversals.values()]))
    assert figure.n == len(rows)
    pooled = next(item for item in done.result.figures if item.metric == "psnr_pooled")
    assert (pooled.n, pooled.n_missing) == (figure.n, figure.n_missing)
    assert pooled.reason is None
    assert pooled.value == pytest.approx(10 * math.log10(255**2 * sum(pixels) / sum(squares)), abs=1e-9)
    assert done.result == read_result(tmp_path)
    assert read_result(tmp_path).hash == done.result.hash


def test_two_processes_and_a_resumed_run_give_equal_results(root: Path, folder: Path, tmp_path: Path) -> None:
    protocol = small(every=2)
    single = evaluate(folder / "noise4", root, protocol, SPLIT, tmp_path / "one", ALONE)
    two = evaluate(folder / "noise4", root, protocol, SPLIT, tmp_path / "two", EvaluationOptions(workers=2))
    assert single.result == two.result
    # As few images are scored in one process whatever is asked, the second one is asked here.
    assert single.inputs is not None
    pooled = score_jobs([one.job for one in single.scored], single.inputs, ScoreLog(tmp_path / "log"), workers=2)
    assert pooled.scored == single.scored
    assert single.reused == two.reused == 0
    # The state after a kill during the third line.
    log = tmp_path / "two" / "work" / "scored.jsonl"
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(lines[:2]) + lines[2][:40])
    again = evaluate(folder / "noise4", root, protocol, SPLIT, tmp_path / "two", ALONE)
    assert again.reused == 2
    assert again.result == single.result
    assert len(ScoreLog(log).known) == len(single.plan.views)


def test_changed_renders_are_scored_again(root: Path, dataset: Dataset, tmp_path: Path) -> None:
    protocol = small(every=5)
    plan = write_renders(dataset, protocol, tmp_path / "s", noisy(4))
    evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    write_renders(
        dataset, protocol, tmp_path / "s", lambda view, truth: noisy(8 if view == plan.views[0] else 4)(view, truth)
    )
    again = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert again.reused == len(plan.views) - 1
    other = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "fresh", ALONE)
    assert other.result == again.result


def test_infinite_psnr_is_counted_and_not_averaged(root: Path, dataset: Dataset, tmp_path: Path) -> None:
    protocol = small()
    write_renders(dataset, protocol, tmp_path / "s")
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is not None
    figures = {figure.metric: figure for figure in done.result.figures if figure.level == "group"}
    assert figures["psnr"].value is None
    assert figures["psnr"].n_inf == figures["psnr"].n > 0
    assert figures["ssim"].value == pytest.approx(1.0)
    assert figures["psnr_pooled"].value is None
    assert figures["psnr_pooled"].reason == "all images are equal to the truth"


def test_render_that_cannot_be_decoded_stops_the_scoring(root: Path, dataset: Dataset, tmp_path: Path) -> None:
    plan = write_renders(dataset, small(), tmp_path / "s")
    view = plan.views[1]
    bad = png(chunk(b"IDAT", zlib.compress(bytes(10))[:-4] + b"\0\0\0\0"), width=view.width_px, height=view.height_px)
    (tmp_path / "s" / view.path).write_bytes(bad)
    done = evaluate(tmp_path / "s", root, small(), SPLIT, tmp_path / "out", ALONE)
    assert done.result is None
    assert [problem.path for problem in done.check.problems] == [view.path]
    assert not (tmp_path / "out" / "result.json").exists()


def test_unavailable_metrics_are_listed_and_can_be_required(
    root: Path, dataset: Dataset, tmp_path: Path, monkeypatch
) -> None:
    for name in ("MIRROR_WEIGHTS", "TORCH_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "nothing"))
    lpips = '[[metrics]]\nmetric = "lpips"\nnet = "{}"\nmask = "map"\n'
    networks = ("alex", "vgg")
    protocol = small(metrics='[[metrics]]\nmetric = "psnr"\n' + "".join(lpips.format(name) for name in networks))
    write_renders(dataset, protocol, tmp_path / "s", noisy(4))
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is not None
    assert set(done.result.unavailable) == {"lpips_alex", "lpips_vgg"}
    assert "vgg16-397923af.pth" in done.result.unavailable["lpips_vgg"]
    assert {figure.metric for figure in done.result.figures} == {"psnr", "psnr_pooled"}
    for name in ("lpips", "lpips_vgg"):
        with pytest.raises(UsageError, match="required and unavailable"):
            evaluate(
                tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", EvaluationOptions(workers=1, require=[name])
            )
    # A wrong option comes before the problems of the submission.
    (tmp_path / "s" / "manifest.json").unlink()
    with pytest.raises(UsageError, match="no metric"):
        evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", EvaluationOptions(workers=1, require=["fid"]))


def test_commands(
    root: Path,
    folder: Path,
    dataset: Dataset,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    protocol = load_protocol("static-reconstruction-omnire")
    for sigma in (3, 9):
        write_renders(dataset, protocol, tmp_path / f"s{sigma}", noisy(sigma), name=f"<b>{sigma}</b>")
    words = ["--truth", str(root), "--workers", "1"]
    assert main(["evaluate", str(tmp_path / "s3"), *words, "--report", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["result"]["protocol"]["name"] == protocol.name
    page = Path(said["report"]).read_text()
    assert "<b>3</b>" not in page
    assert "&lt;b&gt;3&lt;/b&gt;" in page
    assert page.count("data:image/jpeg") % 3 == 0
    assert "worst" in page
    assert "No interval: fewer than 5 blocks" in page
    assert main(["evaluate", str(tmp_path / "s9"), *words]) == 0
    text = capsys.readouterr().out
    assert "psnr" in text
    assert "unavailable" in text
    assert "no interval: fewer than 5 blocks" in text
    assert main(["evaluate", str(tmp_path / "s9"), *words, "--require", "lpips"]) in (0, 2)
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "s3-results"), str(tmp_path / "s9-results"), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["others"][0]["rows"]
    assert all(row["difference"] < 0 for row in rows if row["metric"] == "psnr")
    monkeypatch.setenv("COLUMNS", "60")
    assert main(["compare", str(tmp_path / "s3-results"), str(tmp_path / "s9-results")]) == 0
    text = capsys.readouterr().out
    assert "…" not in text
    assert all(f"{row[key]:.4f}" in text for row in rows for key in ("first", "other") if row[key] is not None)
    monkeypatch.delenv("COLUMNS")
    nothing = ["--weights", f"alexnet={tmp_path}/nothing"]
    assert main(["evaluate", str(tmp_path / "s3"), *words, *nothing]) == 2
    assert "no such file" in capsys.readouterr().err
    (tmp_path / "other.pth").write_bytes(b"other weights")
    assert main(["evaluate", str(tmp_path / "s3"), *words, "--weights", f"alexnet={tmp_path}/other.pth"]) == 2
    assert "--weights alexnet" in capsys.readouterr().err
    (tmp_path / "s9" / "renders").rename(tmp_path / "s9" / "moved")
    assert main(["evaluate", str(tmp_path / "s9"), *words]) == 1
    assert "missing" in capsys.readouterr().out
    for verb in (["evaluate", *words], ["submission", "check", "--truth", str(root)]):
        assert main([*verb, str(folder / "noise4")]) == 2
        assert "Remedy: give the file with --protocol FILE.toml" in capsys.readouterr().err


def test_paired_differences_have_smaller_intervals(root: Path, folder: Path, tmp_path: Path) -> None:
    protocol = small(every=2)
    for name in ("noise4", "noise12"):
        evaluate(folder / name, root, protocol, SPLIT, tmp_path / name, ALONE)
    first, (other,) = compare([tmp_path / "noise4", tmp_path / "noise12"])
    assert first.submission.method.name == "noise 4"
    row = next(row for row in other.rows if row.metric == "psnr")
    assert row.better == "first"
    assert row.difference is not None
    assert row.low is not None
    assert row.high is not None
    assert row.low <= row.difference <= row.high < 0.0
    assert row.difference == pytest.approx(20 * math.log10(4 / 12), abs=0.5)
    assert row.p_value is not None
    assert row.p_value < 0.01
    same = compare([tmp_path / "noise4", tmp_path / "noise4"])[1][0].rows[0]
    assert same.difference == 0.0
    assert same.better is None
    with pytest.raises(UsageError):
        compare([tmp_path / "noise4"])


def test_st_lpips_replaces_lpips_under_its_own_name(root: Path, dataset: Dataset, tmp_path: Path, monkeypatch) -> None:
    if importlib.util.find_spec("stlpips_pytorch") is None or importlib.util.find_spec("torch") is None:
        pytest.skip("needs pip install --no-deps stlpips-pytorch, for its weights")
    for name in ("MIRROR_WEIGHTS", "TORCH_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "nothing"))
    protocol = small(every=9, metrics='[[metrics]]\nmetric = "lpips"\nnet = "alex"\nmask = "zero-fill"\n')
    write_renders(dataset, protocol, tmp_path / "s", noisy(8))
    done = evaluate(
        tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", EvaluationOptions(workers=1, stand_ins=True)
    )
    assert done.result is not None
    assert set(done.result.unavailable) == {"lpips_alex"}
    assert {figure.metric for figure in done.result.figures} == {"st_lpips_alex"}
    assert set(done.result.weights) == {"st-lpips-alex"}
    assert any("another metric" in warning for warning in done.result.warnings)
    value = next(figure.value for figure in done.result.figures if figure.level == "group")
    assert value is not None
    assert 0.0 < value < 1.0


def test_a_changed_truth_is_scored_again_though_no_table_says_so(root: Path, dataset: Dataset, tmp_path: Path) -> None:
    protocol = small(every=5)
    plan = write_renders(dataset, protocol, tmp_path / "s", noisy(4))
    copy = Path(shutil.copytree(root, tmp_path / "dataset"))
    first = evaluate(tmp_path / "s", copy, protocol, SPLIT, tmp_path / "out", ALONE)
    _, image = GroundTruth(dataset, protocol, plan.layers).recorded_frame_and_image(plan.views[0])
    give_other_bytes(copy, image)
    again = evaluate(tmp_path / "s", copy, protocol, SPLIT, tmp_path / "out", ALONE)
    assert again.reused == first.reused + len(plan.views) - 1
    fresh = evaluate(tmp_path / "s", copy, protocol, SPLIT, tmp_path / "fresh", ALONE)
    assert fresh.result == again.result != first.result


def test_a_changed_static_mask_is_scored_again(root: Path, dataset: Dataset, tmp_path: Path) -> None:
    protocol = small(every=5)
    write_renders(dataset, protocol, tmp_path / "s", noisy(4))
    copy = Path(shutil.copytree(root, tmp_path / "dataset"))
    evaluate(tmp_path / "s", copy, protocol, SPLIT, tmp_path / "out", ALONE)
    for mask in copy.glob("rigs/*.png"):
        height, width = cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE).shape
        half = np.zeros((height, width), np.uint8)
        half[height // 2 :] = 255
        mask.unlink()
        cv2.imwrite(str(mask), half)
    again = evaluate(tmp_path / "s", copy, protocol, SPLIT, tmp_path / "out", ALONE)
    assert again.reused == 0
