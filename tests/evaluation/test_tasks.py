"""Hidden truth, distributions, edits, boxes and run time, each against a known answer."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mirror
from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.evaluation.extractors import make_extractor
from mirror.evaluation.extractors.diff_grabcut import DiffGrabCut
from mirror.evaluation.run import Evaluation, EvaluationOptions, evaluate
from mirror.evaluation.scorers import distributions, speed
from mirror.evaluation.scorers.distributions import split_into_clips
from mirror.evaluation.scorers.editing_accuracy import EditingScorer
from mirror.evaluation.submission.manifest import Appearance, Runtime, SubmittedMethod
from mirror.evaluation.submission.template import expected_files, make_manifest, write_manifest
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.methods import registry
from mirror.metrics.boxes.raster import polygon_mask
from mirror.metrics.features.frechet import frechet_distance
from mirror.protocols.document import Protocol, load_protocol
from mirror.protocols.png import encode_png
from mirror.protocols.truth.hidden import HIDDEN, HiddenDocument, make_hidden_document
from mirror.protocols.views import RenderView, plan_views
from mirror.protocols.views.edited_region import target_hull
from mirror.schema.files import read_json, write_json
from mirror.synth.hidden_truth import write_hidden_truth
from tests.evaluation.colours import Colours
from tests.evaluation.submissions import SPLIT, small, write_renders
from tests.other_bytes import give_other_bytes

ALONE = EvaluationOptions(workers=1)
SHIFTS = "".join(
    f'[[groups]]\nname = "{name}"\nroles = ["train"]\nego_shift_m = {shift}\n'
    for name, shift in (("here", 0.0), ("left-2m", 2.0))
)


def test_hidden_truth_shows_the_shifted_cameras(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    protocol = small(task="lane-shift", groups=SHIFTS, every=12)
    # Renders that copy the recorded images: right without a shift, wrong with a shift of two metres.
    plan = write_renders(dataset, protocol, tmp_path / "s")
    assert write_hidden_truth(dataset, plan, "tiny", 0, tmp_path / "hidden") == len(plan.views)
    said = read_json(tmp_path / "hidden" / HIDDEN, HiddenDocument)
    assert (said.preset, said.seed, said.plan_hash) == ("tiny", 0, plan.hash)
    done = evaluate(
        tmp_path / "s",
        root,
        protocol,
        SPLIT,
        tmp_path / "out",
        EvaluationOptions(workers=1, hidden=tmp_path / "hidden"),
    )
    assert done.result is not None
    assert done.result.dataset.hidden_truth is not None
    psnr = {
        figure.group: figure.value
        for figure in done.result.figures
        if (figure.metric, figure.level) == ("psnr", "group")
    }
    assert psnr["here"] is not None
    assert psnr["left-2m"] is not None
    # The remaining errors are noise, blur, JPEG and calibration.
    assert psnr["here"] > 28.0 > 24.0 > psnr["left-2m"]


@pytest.mark.parametrize(("preset", "seed"), [("tiny", 1), ("quick", 0)])
def test_hidden_truth_of_another_street_is_refused(dataset: Dataset, preset: str, seed: int, tmp_path: Path) -> None:
    plan = plan_views(dataset, small(task="lane-shift", groups=SHIFTS, every=12), SPLIT)
    with pytest.raises(MirrorError, match="preset"):
        write_hidden_truth(dataset, plan, preset, seed, tmp_path / "hidden")
    assert not (tmp_path / "hidden").exists()


def test_hidden_truth_with_another_appearance_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    """Another preset can have the same drives and timestamps: the check compares the images."""
    root = tmp_path / "dataset"
    # Images get other bytes by replacing files, so that links will do.
    shutil.copytree(dataset.root, root, copy_function=os.link)
    for frame in mirror.open(root).frames():
        for image in frame.images.values():
            give_other_bytes(root, image)
    plan = plan_views(mirror.open(root), small(task="lane-shift", groups=SHIFTS, every=12), SPLIT)
    with pytest.raises(DatasetError, match=r"is not what was recorded \(\d+\.\d dB\)"):
        write_hidden_truth(mirror.open(root), plan, "tiny", 0, tmp_path / "hidden")


def test_hidden_truth_is_required_and_its_errors_are_not_the_submissions(
    dataset: Dataset, root: Path, tmp_path: Path
) -> None:
    protocol = small(task="lane-shift", groups=SHIFTS, every=12)
    plan = write_renders(dataset, protocol, tmp_path / "s")
    hidden, out = tmp_path / "hidden", tmp_path / "out"
    shutil.copytree(tmp_path / "s" / "renders", hidden / "renders")

    def scored(name: str, protocol: Protocol, **options: Any) -> Evaluation:
        return evaluate(tmp_path / name, root, protocol, SPLIT, out, EvaluationOptions(workers=1, **options))

    assert scored("s", protocol, hidden=hidden).result is not None
    with pytest.raises(UsageError, match="nobody recorded"):
        scored("s", protocol)
    with pytest.raises(UsageError, match="no such folder"):
        scored("s", protocol, hidden=tmp_path / "none")
    with pytest.raises(DatasetError, match=f"{len(plan.views)} of {len(plan.views)} true images.*not at fault"):
        scored("s", protocol, hidden=tmp_path)
    first = hidden / plan.views[0].path
    whole = first.read_bytes()
    for data, words in ((whole[:-20], "damaged"), (encode_png(np.zeros((7, 11, 3), np.uint8)), "11 x 7 px")):
        first.write_bytes(data)
        with pytest.raises(DatasetError, match=f"1 of {len(plan.views)} true images.*{words}") as caught:
            scored("s", protocol, hidden=hidden)
        assert caught.value.file == str(first)
    first.write_bytes(whole)
    document = make_hidden_document(plan, "tiny", 0).model_copy(update={"plan_hash": "00" * 32})
    write_json(hidden / HIDDEN, document)
    with pytest.raises(UsageError, match="truth of other views"):
        scored("s", protocol, hidden=hidden)
    write_renders(dataset, small(), tmp_path / "plain")
    with pytest.raises(UsageError, match="recorded images"):
        scored("plain", small(), hidden=hidden)
    with pytest.raises(UsageError, match="extracts no regions"):
        scored("plain", small(), extractor="file:/nope")


FID = '[[metrics]]\nmetric = "fid"\nmode = "clean"\n[[metrics]]\nmetric = "kid"\nmode = "clean"\n'
FVD = '[[metrics]]\nmetric = "fvd"\nframes = 9\ncrop = "squeeze"\nddof = 0\n'


def test_distances_compare_the_features_of_each_group(
    dataset: Dataset, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = Colours()
    monkeypatch.setattr(distributions, "load_network", lambda metric, inputs: network)
    monkeypatch.setattr(distributions.DistributionScorer, "needs", lambda self, plan: {})
    groups = "".join(f'[[groups]]\nname = "{name}"\nroles = ["held_out"]\n' for name in ("same", "darker"))
    protocol = small(task="generation", groups=groups, every=1, metrics=FID + FVD)

    def change(view: RenderView, truth: UInt8) -> UInt8:
        return truth if view.group == "same" else (truth * 0.5).astype(np.uint8)

    write_renders(dataset, protocol, tmp_path / "s", change)
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is not None
    figures = {(figure.group, figure.metric): figure for figure in done.result.figures}
    assert figures["same", "fid"].value == pytest.approx(0.0, abs=1e-9)
    assert figures["same", "fvd"].value == pytest.approx(0.0, abs=1e-9)
    views = [view for view in done.plan.views if view.group == "darker"]
    assert figures["darker", "fid"].n == len(views)
    assert "fewer than 2048" in str(figures["darker", "fid"].note)
    assert done.inputs is not None
    pairs = [
        (network.prepare(done.inputs.render(view)), network.prepare(done.inputs.truth.image(view))) for view in views
    ]
    wanted = frechet_distance(*(np.stack([pair[side].numpy() for pair in pairs]) for side in (0, 1))).value
    assert figures["darker", "fid"].value == pytest.approx(wanted)
    low, high = figures["darker", "fid"].low, figures["darker", "fid"].high
    assert low is not None
    assert high is not None
    assert low < wanted < high
    # Equal images share one cached feature, and a second run computes none.
    assert network.computed == 2 * len(views) + 2 * figures["same", "fvd"].n
    evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert network.computed == 2 * len(views) + 2 * figures["same", "fvd"].n


def test_clips_have_consecutive_frames_of_one_camera() -> None:
    def views_of(camera: str, *frames: int) -> list[RenderView]:
        return [
            RenderView.model_construct(
                group="g", traversal_id="t", camera=camera, frame_index=frame, path=f"{camera}{frame}"
            )
            for frame in frames
        ]

    clips = split_into_clips([*views_of("a", 0, 1, 2, 3, 4, 6, 7, 8), *views_of("b", 0, 1, 3)], 3)
    assert [[view.path for view in clip] for clip in clips] == [["a0", "a1", "a2"], ["a6", "a7", "a8"]]


def test_without_weights_distances_are_unavailable(dataset: Dataset, root: Path, tmp_path: Path, monkeypatch) -> None:
    for name in ("MIRROR_WEIGHTS", "TORCH_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "nothing"))
    protocol = small(task="generation", metrics=FVD.replace("9", "400") + FID)
    write_renders(dataset, protocol, tmp_path / "s")
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is not None
    assert set(done.result.unavailable) == {"fid", "kid", "fvd"}
    assert "consecutive" in done.result.unavailable["fvd"]


def paint(view: RenderView, truth: UInt8, shift_px: float = 0.0) -> UInt8:
    if view.edits[0].world_SE3_target is None:
        return truth
    hull = target_hull(view, view.edits[0]) + np.array([shift_px, 0.0])
    painted = truth.copy()
    mask = polygon_mask(hull, view.width_px, view.height_px)
    noise = np.random.default_rng(0).normal(0, 6, (int(mask.sum()), 3))
    painted[mask] = np.clip(np.array([210, 30, 60]) + noise, 0, 255).astype(np.uint8)
    return painted


def test_editing_accuracy_of_painted_boxes(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    protocol = load_protocol("editing-accuracy")
    values = {}
    for name, shift in (("exact", 0.0), ("off", 12.0)):
        write_renders(dataset, protocol, tmp_path / name, lambda view, truth, by=shift: paint(view, truth, by))
        done = evaluate(tmp_path / name, root, protocol, SPLIT, tmp_path / f"{name}-out", ALONE)
        assert done.result is not None
        overall = [item for item in done.result.figures if (item.group, item.level) == ("all", "group")]
        values[name] = {figure.metric: figure for figure in overall}
        assert done.result.options == {"extractor": "diff-grabcut"}
    for metric in ("edit_iou_hull", "edit_iou_box", "edit_iou_ceiling"):
        exact, off = values["exact"][metric].value, values["off"][metric].value
        assert exact is not None
        assert off is not None
        assert exact > 0.97
        assert off < exact - 0.15


def test_vehicles_in_front_of_the_target_are_not_counted(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    protocol = load_protocol("editing-accuracy")
    write_renders(dataset, protocol, tmp_path / "s")
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.inputs is not None
    checked = 0
    for job in (scored.job for scored in done.scored):
        view = job.views[0]
        boxes = done.inputs.truth.recorded_frame_and_image(view)[0].boxes("world")
        camera_SE3_box = view.pose.inverse() @ boxes.pose
        distance_m = np.linalg.norm(camera_SE3_box.translation, axis=1)
        projected = project_boxes(view.lens, camera_SE3_box, boxes.size_m)
        others = np.array(boxes.track_id) != view.edits[0].track_id
        near = np.flatnonzero(projected.visible & (distance_m > 5.0) & others)
        if not len(near) or checked == 4:
            continue
        checked += 1
        first = near[np.argmin(distance_m[near])]
        occluder = polygon_mask(projected.hull(int(first)), view.width_px, view.height_px)
        counted = {}
        for share in (1.2, 0.7):
            target = Poses(camera_SE3_box.rotation[[first]], camera_SE3_box.translation[[first]] * share)
            size_m = (3.0, 3.0, 3.0)
            edit = view.edits[0].model_copy(
                update={"world_SE3_target": to_pose_numbers(view.pose @ target), "size_m": size_m}
            )
            moved = view.model_copy(update={"edits": (edit,)})
            hull = polygon_mask(target_hull(moved, edit), view.width_px, view.height_px)
            values = EditingScorer().score(replace(job, views=(moved, job.views[1])), done.inputs)
            visible = hull & done.inputs.scored_mask(view)
            visible &= ~occluder if share > 1.0 else True
            counted[share] = values["target_px"], int(visible.sum()), int(hull.sum())
        assert counted[0.7][0] == counted[0.7][1] > 0
        assert counted[1.2][0] == counted[1.2][1] < counted[1.2][2]
    assert checked == 4


def test_diff_grabcut_finds_the_changed_region_in_noise() -> None:
    rng = np.random.default_rng(3)
    street = np.clip(rng.normal(110, 5, (120, 200, 3)) + np.linspace(-40, 40, 200)[:, None], 0, 255)
    put = np.zeros((120, 200), np.bool_)
    put[40:90, 60:130] = True
    edited = street.copy()
    edited[put] = np.array([180, 60, 40]) + rng.normal(0, 8, (int(put.sum()), 3))
    everywhere = np.ones_like(put)
    for noise in (0.0, 3.0):
        again = np.clip(np.round(edited + rng.normal(0, noise, edited.shape)), 0, 255).astype(np.uint8)
        region = DiffGrabCut().extract(again, street.astype(np.uint8), everywhere, "a")
        assert (region & put).sum() / (region | put).sum() > 0.95
    same = street.astype(np.uint8)
    assert not DiffGrabCut().extract(same, same, everywhere, "a").any()
    assert not DiffGrabCut().extract(again, same, ~everywhere, "a").any()


def test_file_extractor_reads_masks(tmp_path: Path) -> None:
    mask = np.zeros((9, 16), np.uint8)
    mask[2:5, 3:9] = 255
    (tmp_path / "left").mkdir()
    (tmp_path / "left" / "a.png").write_bytes(encode_png(mask))
    image = np.zeros((9, 16, 3), np.uint8)
    counted = np.ones((9, 16), np.bool_)
    region = make_extractor(f"file:{tmp_path}").extract(image, image, counted, "renders/left/a.png")
    np.testing.assert_array_equal(region, mask > 0)


def test_masks_of_files_are_scored_again_when_they_change(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    """A second run into the same folder has the figures of a new run; one without a change reuses all values."""
    known = load_protocol("editing-accuracy-small")
    protocol = known.model_copy(update={"frames": known.frames.model_copy(update={"every": 20})})
    plan = write_renders(dataset, protocol, tmp_path / "s")
    options = EvaluationOptions(workers=1, extractor=f"file:{tmp_path / 'masks'}")

    def run(value: int, out: str) -> tuple[dict[str, float | None], bool]:
        for view in plan.views:
            file = tmp_path / "masks" / view.path.removeprefix("renders/")
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(encode_png(np.full((view.height_px, view.width_px), value, np.uint8)))
        done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / out, options)
        assert done.result is not None
        assert done.reused in (0, len(done.scored))
        return {item.metric: item.value for item in done.result.figures if item.group == "all"}, bool(done.reused)

    white, _ = run(255, "out")
    black, _ = run(0, "fresh")
    assert white != black
    assert run(0, "out") == (black, False)
    assert run(0, "out") == (black, True)


def write_sam(folder: Path, height: int, width: int) -> None:
    """Networks with the inputs of Segment Anything; the better of two masks is positive within the prompt."""
    onnx = pytest.importorskip("onnx")
    node, scale = onnx.helper.make_node, 1024 / max(height, width)

    def value(name: str, shape: list[int]) -> Any:
        return onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, shape)

    def save(name: str, nodes: list[Any], inputs: list[Any], outputs: list[Any], **constants: Any) -> None:
        arrays = [onnx.numpy_helper.from_array(np.asarray(array), key) for key, array in constants.items()]
        graph = onnx.helper.make_graph(nodes, name, inputs, outputs, arrays)
        model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
        onnx.save(model, str(folder / f"{name}.onnx"))

    image, embeddings = value("image", [1, 3, 1024, 1024]), value("image_embeddings", [1, 3, 1024, 1024])
    save("encoder", [node("Identity", ["image"], ["image_embeddings"])], [image], [embeddings])
    prompt = [value("point_coords", [1, 2, 2]), value("point_labels", [1, 2])]
    rest = [value("mask_input", [1, 1, 256, 256]), value("has_mask_input", [1]), value("orig_im_size", [2])]
    rows, columns = np.mgrid[:height, :width].astype(np.float32) + 0.5
    save(
        "decoder",
        [
            node("Reshape", ["point_coords", "four"], ["flat"]),
            node("Div", ["flat", "scale"], ["pixels"]),
            node("Split", ["pixels"], ["left", "top", "right", "bottom"], axis=0),
            node("Sub", ["x", "left"], ["a"]),
            node("Sub", ["right", "x"], ["b"]),
            node("Sub", ["y", "top"], ["c"]),
            node("Sub", ["bottom", "y"], ["d"]),
            node("Min", ["a", "b", "c", "d"], ["within"]),
            node("Neg", ["within"], ["beyond"]),
            node("Concat", ["beyond", "within"], ["masks"], axis=1),
            node("Identity", ["quality"], ["scores"]),
        ],
        [embeddings, *prompt, *rest],
        [value("masks", [1, 2, height, width]), value("scores", [1, 2])],
        four=np.array([4], np.int64),
        scale=np.array([scale], np.float32),
        x=columns[None, None],
        y=rows[None, None],
        quality=np.array([[0.1, 0.9]], np.float32),
    )


def test_the_sam_extractor_prompts_with_the_differing_rectangle(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    height, width = 90, 160
    with pytest.raises(UsageError, match=r"encoder\.onnx"):
        make_extractor(f"onnx-sam:{tmp_path}")
    write_sam(tmp_path, height, width)
    background = np.full((height, width, 3), 90, np.uint8)
    edited = background.copy()
    edited[20:60, 40:75] = (210, 30, 60)
    edited[50:70, 60:120] = (210, 30, 60)
    counted = np.ones((height, width), np.bool_)
    counted[:, 100:] = False
    differing = DiffGrabCut().extract(edited, background, counted, "a")
    rows, columns = np.flatnonzero(differing.any(axis=1)), np.flatnonzero(differing.any(axis=0))
    wanted = np.zeros((height, width), np.bool_)
    wanted[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] = True
    extractor = make_extractor(f"onnx-sam:{tmp_path}")
    np.testing.assert_array_equal(extractor.extract(edited, background, counted, "a"), wanted & counted)
    assert not extractor.extract(background, background, counted, "a").any()


def boxes_of(dataset: Dataset, traversal: str, sigma_m: float) -> dict[str, object]:
    rng = np.random.default_rng(0)
    frames = []
    for frame in dataset.where(traversal=traversal).frames():
        boxes = frame.boxes("ego")
        rows = [
            {
                "category": boxes.category[row],
                "score": 0.5,
                "ego_SE3_box": [
                    *boxes.pose.rotation[row].tolist(),
                    *(boxes.pose.translation[row] + rng.normal(0, sigma_m, 3)).tolist(),
                ],
                "size_m": boxes.size_m[row].tolist(),
            }
            for row in range(len(boxes))
        ]
        frames.append({"frame_index": frame.frame_index, "boxes": rows})
    return {"format": "mirror-detections", "version": "1.0", "frames": frames}


@pytest.mark.parametrize(("sigma_m", "ap"), [(0.0, 1.0), (3.0, 0.5)])
def test_annotation(dataset: Dataset, root: Path, tmp_path: Path, sigma_m: float, ap: float) -> None:
    protocol = load_protocol("annotation")
    plan = plan_views(dataset, protocol, SPLIT)
    for path in expected_files(plan):
        file = tmp_path / "s" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(boxes_of(dataset, file.name.removesuffix(".json"), sigma_m)))
    write_manifest(tmp_path / "s", make_manifest(plan, SubmittedMethod(name="boxes"), Appearance(policy="none")))
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is not None
    figures = {figure.metric: figure.value for figure in done.result.figures}
    assert figures["mean_ap"] is not None
    assert figures["mate_m"] is not None
    if sigma_m:
        assert figures["mean_ap"] < ap
    else:
        assert figures["mean_ap"] == pytest.approx(ap)
        assert figures["mate_m"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    "text",
    [
        "[]",
        '{"format": "mirror-detections", "version": "1.0", "frames": [{"frame_index": 100000, "boxes": []}]}',
        '{"format": "mirror-detections", "version": "1.0", "frames": [{"frame_index": 0, "boxes": [{"category": "ufo", '
        '"score": 0.5, "ego_SE3_box": [1, 0, 0, 0, 0, 0, 0], "size_m": [1, 1, 1]}]}]}',
        '{"format": "mirror-detections", "version": "1.0", "frames": [{"frame_index": 0, "boxes": [{"category": "car", '
        '"score": 0.5, "ego_SE3_box": [0, 0, 0, 0, 0, 0, 0], "size_m": [1, 1, 1]}]}]}',
    ],
    ids=["array", "frame", "class", "quaternion"],
)
def test_invalid_boxes_are_problems(dataset: Dataset, root: Path, tmp_path: Path, text: str) -> None:
    protocol = load_protocol("annotation")
    plan = plan_views(dataset, protocol, SPLIT)
    for path in expected_files(plan):
        file = tmp_path / "s" / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    write_manifest(tmp_path / "s", make_manifest(plan, SubmittedMethod(name="boxes"), Appearance(policy="none")))
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is None
    assert len(done.check.problems) == 1


def test_run_time_is_taken_from_the_manifest(dataset: Dataset, root: Path, tmp_path: Path) -> None:
    protocol = load_protocol("runtime")
    plan = plan_views(dataset, protocol, SPLIT)
    runtime = Runtime(device="a GPU", frames_per_second=21.0, model_bytes=8 * 10**8, driven_m=200.0)
    (tmp_path / "s").mkdir()
    manifest = make_manifest(plan, SubmittedMethod(name="fast"), Appearance(policy="none"), runtime)
    write_manifest(tmp_path / "s", manifest)
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is not None
    figures = {figure.metric: figure.value for figure in done.result.figures}
    assert figures == {"frames_per_second": 21.0, "model_bytes_per_100m": 4e8}
    assert set(done.result.unavailable) == {"training_s", "peak_memory_bytes"}
    assert math.isfinite(float(done.result.figures[0].value or 0.0))


SLOW = """
import time

import numpy as np


class Slow:
    def reconstruct(self, dataset, task, out, progress): ...

    def open(self, model, appearance):
        def render(view):
            with (model / "seen").open("a") as seen:
                seen.write(".")
            time.sleep(0.02)
            return np.zeros((view.height_px, view.width_px, 3), np.uint8)

        return render


SLOW = Slow()
"""


def test_speed_of_a_method_in_a_file_is_measured(
    dataset: Dataset, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "slow.py"
    file.write_text(SLOW)
    monkeypatch.setattr(speed, "MIN_DURATION_S", 0.3)
    protocol = load_protocol("runtime")
    plan = plan_views(dataset, protocol, SPLIT)
    (tmp_path / "s").mkdir()
    write_manifest(tmp_path / "s", make_manifest(plan, SubmittedMethod(name="slow"), Appearance(policy="none")))
    done = evaluate(
        tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", EvaluationOptions(measured=(f"{file}:SLOW", tmp_path))
    )
    assert done.result is not None
    (figure,) = done.result.figures
    assert figure.group == "measured"
    assert figure.value is not None
    assert 20.0 < figure.value <= 50.5
    assert len((tmp_path / "seen").read_text()) == figure.n + 3


def test_missing_method_is_named() -> None:
    with pytest.raises(UsageError, match="no method"):
        registry.installed_method("none such")


def test_method_without_its_libraries_names_the_extra() -> None:
    code = (
        "import sys; sys.modules['gsplat'] = None\n"
        "from mirror.errors import UsageError\n"
        "from mirror.methods.registry import installed_method\n"
        "try: installed_method('mtgs_style')\n"
        "except UsageError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "needs gsplat" in done.stdout and "[baselines]" in done.stdout
