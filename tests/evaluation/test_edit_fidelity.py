"""Edits against their exact truth: known answers, an independent computation, and the order of floors and edits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from skimage.metrics import structural_similarity

from mirror.arrays import Bool, UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.evaluation.result import Result
from mirror.evaluation.run import Evaluation, EvaluationOptions, evaluate
from mirror.evaluation.scorers import distributions
from mirror.geometry.boxes import corners
from mirror.geometry.poses import Poses
from mirror.protocols.document import Protocol, load_protocol
from mirror.protocols.metrics import EditFidelity, Part, SsimMetric
from mirror.protocols.png import decode_render, encode_png
from mirror.protocols.views import RenderView, plan_views
from mirror.protocols.views.view import to_pose
from mirror.synth.hidden_truth import write_hidden_truth
from mirror_baselines.edited_recordings import EDITED_RECORDINGS
from tests.evaluation.colours import Colours
from tests.evaluation.submissions import SPLIT, write_renders

MOVED = ("left-1m", "left-2m")
SSIM = SsimMetric(metric="ssim", preset="gaussian11", mask="map")
KEPT = ("background", "0m", *MOVED)


def reduce_protocol(name: str) -> Protocol:
    """Reduce a protocol to few views and groups of both traversals, by day and by night."""
    known = load_protocol(name)
    assert known.vehicles is not None and known.ranking is not None
    groups = [group.model_copy(update={"roles": ("train", "held_out")}) for group in known.groups if group.name in KEPT]
    return known.model_copy(
        update={
            "groups": tuple(groups),
            "frames": known.frames.model_copy(update={"every": 8, "last": False}),
            "vehicles": known.vehicles.model_copy(update={"min_area_px": 100.0}),
            "ranking": known.ranking.model_copy(update={"groups": MOVED}),
            "metrics": (
                *(EditFidelity(metric="edit_fidelity", part=part, figure=SSIM) for part in get_args(Part)),
                *known.metrics,
            ),
            "intervals": known.intervals.model_copy(update={"resamples": 100}),
        }
    )


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return reduce_protocol("editing-accuracy")


@pytest.fixture(scope="module")
def hidden(tiny_dataset: Dataset, protocol: Protocol, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("truth") / "hidden"
    write_hidden_truth(tiny_dataset, plan_views(tiny_dataset, protocol, SPLIT), "tiny", 0, folder)
    return folder


def read_truth(hidden: Path, view: RenderView) -> UInt8:
    return decode_render((hidden / view.path).read_bytes(), view.width_px, view.height_px, view.path)


def run(
    dataset: Dataset,
    protocol: Protocol,
    folder: Path,
    hidden: Path | None,
    change: Callable[[RenderView, UInt8], UInt8],
) -> Evaluation:
    write_renders(dataset, protocol, folder / "s", change)
    options = EvaluationOptions(workers=1, hidden=hidden)
    return evaluate(folder / "s", Path(dataset.root), protocol, SPLIT, folder / "out", options)


def of_groups(result: Result | None) -> Mapping[tuple[str, str], float | None]:
    assert result is not None
    return {(one.group, one.metric): one.value for one in result.figures if one.level == "group"}


def test_the_exact_edit_reaches_the_top_and_floors_stay_below_edits(
    tiny_dataset: Dataset, protocol: Protocol, hidden: Path, tmp_path: Path
) -> None:
    """A patch without texture has the best overlap with the target box, and the lowest rank."""

    def blurred(view: RenderView, _: UInt8) -> UInt8:
        return np.asarray(cv2.GaussianBlur(read_truth(hidden, view), (0, 0), 1.5))

    changes = {"exact": lambda view, _: read_truth(hidden, view), "blurred": blurred}
    changes |= {name: edited.change for name, edited in EDITED_RECORDINGS.items()}
    found = {}
    for name, change in changes.items():
        done = run(tiny_dataset, protocol, tmp_path / name, hidden, change)
        assert done.result is not None and not done.result.unavailable
        found[name] = of_groups(done.result)
    key = ("all", "ms_structure_least")
    assert found["exact"][key] > 0.98
    floors = {name: found[name][key] for name in ("unmoved_recording", "erased_vehicle", "flat_patch")}
    assert max(floors.values()) < found["blurred"][key] < 1.0
    assert floors["flat_patch"] < 0.2, (floors, found["moved_cutout"][key], found["blurred"][key])
    overlap = {name: found[name]["all", "edit_iou_hull"] for name in found}
    assert max(overlap, key=lambda name: overlap[name]) == "flat_patch"
    # An image of the recording is right wherever nothing moves.
    assert found["unmoved_recording"]["all", "ssim_outside"] > found["blurred"]["all", "ssim_outside"]
    groups = {group for group, metric in found["exact"] if metric == "ms_structure_least"}
    assert groups == {*MOVED, "all"}


def corner_mask(view: RenderView, box: Poses, size_m: tuple[float, float, float]) -> Bool | None:
    """The grown hull of the projected corners of a box; None where a corner has no pixel."""
    seen = view.lens.project(corners(view.pose.inverse() @ box, np.array([size_m]))[0])
    if not seen.valid.all():
        return None
    points = seen.uv_px[ConvexHull(seen.uv_px).vertices]
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    grown = ConvexHull(middle + 1.2 * (points - middle))
    v, u = np.mgrid[: view.height_px, : view.width_px] + 0.5
    inside = np.stack([u, v], axis=-1) @ grown.equations[:, :2].T + grown.equations[:, 2]
    return np.asarray((inside <= 0.0).all(axis=-1))


def test_figures_of_parts_are_those_of_an_independent_computation(
    tiny_dataset: Dataset, protocol: Protocol, hidden: Path, tmp_path: Path
) -> None:
    done = run(tiny_dataset, protocol, tmp_path, hidden, EDITED_RECORDINGS["moved_cutout"].change)
    assert done.inputs is not None
    checked = 0
    for scored in done.scored:
        view = scored.job.views[0]
        if view.group not in MOVED:
            continue
        counted = done.inputs.scored_mask(view)
        (edit,) = view.edits
        assert edit.world_SE3_target is not None
        masks = [corner_mask(view, to_pose(box), edit.size_m) for box in (edit.world_SE3_box, edit.world_SE3_target)]
        old, new = masks
        if old is None or new is None:
            continue
        render, truth = done.inputs.render(view), read_truth(hidden, view)
        _, similarity = structural_similarity(
            render, truth, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True,
            data_range=255,
        )  # fmt: skip
        similarity[:5] = similarity[-5:] = similarity[:, :5] = similarity[:, -5:] = np.nan
        parts = {"old": old & counted, "new": new & counted, "outside": counted & ~(old | new)}
        if parts["new"].sum() < 100:
            assert np.isnan(scored.values["ssim_least"])
            continue
        checked += 1
        values = {}
        for name, part in parts.items():
            assert scored.values[f"{name}_px"] == part.sum()
            if part.sum() >= 100:
                values[name] = float(np.nanmean(similarity.mean(axis=2)[part]))
                assert scored.values[f"ssim_{name}"] == pytest.approx(values[name], abs=1e-6)
                squares = ((render[part].astype(np.float64) - truth[part]) ** 2).mean()
                assert scored.values[f"psnr_{name}"] == pytest.approx(10.0 * np.log10(255.0**2 / squares))
            else:
                assert "fewer than 100 scored pixels" in str(scored.values[f"ssim_{name}.reason"])
        assert scored.values["ssim_least"] == pytest.approx(min(values.values()), abs=1e-6)
    assert checked > 3


def test_without_hidden_truth_overlaps_stand_alone(tiny_dataset: Dataset, protocol: Protocol, tmp_path: Path) -> None:
    done = run(tiny_dataset, protocol, tmp_path, None, EDITED_RECORDINGS["flat_patch"].change)
    assert done.result is not None
    assert {name.partition("_")[0] for name in done.result.unavailable} == {"ms", "ssim", "psnr"}
    assert "submission hidden" in done.result.unavailable["ms_structure_least"]
    assert {metric for _, metric in of_groups(done.result)} == {"edit_iou_hull", "edit_iou_box", "edit_iou_ceiling"}
    with pytest.raises(UsageError, match="ms_structure_least"):
        evaluate(
            tmp_path / "s", Path(tiny_dataset.root), protocol, SPLIT, tmp_path / "out",
            EvaluationOptions(workers=1, require=("ms_structure_least",)),
        )  # fmt: skip


def test_sets_are_compared_with_the_recording_and_rows_with_the_exact_truth(
    tiny_dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A copied recording has distance 0 in every group; the figures against the exact truth rank."""
    monkeypatch.setattr(distributions, "load_network", lambda metric, inputs: Colours())
    monkeypatch.setattr(distributions.DistributionScorer, "needs", lambda self, plan: {})
    protocol = reduce_protocol("vehicle-translation")
    protocol = protocol.model_copy(update={"frames": protocol.frames.model_copy(update={"cameras": ("front_narrow",)})})
    write_hidden_truth(tiny_dataset, plan_views(tiny_dataset, protocol, SPLIT), "tiny", 0, tmp_path / "hidden")
    copied = run(
        tiny_dataset, protocol, tmp_path / "copied", tmp_path / "hidden", EDITED_RECORDINGS["unmoved_recording"].change
    )
    exact = run(
        tiny_dataset,
        protocol,
        tmp_path / "exact",
        tmp_path / "hidden",
        lambda view, _: read_truth(tmp_path / "hidden", view),
    )
    found = {name: of_groups(done.result) for name, done in (("copied", copied), ("exact", exact))}
    for group in MOVED:
        assert found["copied"][group, "fid"] == pytest.approx(0.0, abs=1e-9)
        assert found["exact"][group, "fid"] > 0.1
    assert found["exact"]["all", "ms_structure_least"] > 0.98
    assert found["copied"]["all", "ms_structure_least"] < 0.8
    assert protocol.ranking is not None and protocol.ranking.column == ("all", "ms_structure_least")
    # Another exact truth is another score, not another distance of sets.
    view = next(view for view in copied.plan.views if view.group == "left-2m")
    (tmp_path / "hidden" / view.path).write_bytes(encode_png(255 - read_truth(tmp_path / "hidden", view)))
    again = evaluate(
        tmp_path / "copied" / "s", Path(tiny_dataset.root), protocol, SPLIT, tmp_path / "copied" / "out",
        EvaluationOptions(workers=1, hidden=tmp_path / "hidden"),
    )  # fmt: skip
    assert of_groups(again.result)["left-2m", "fid"] == pytest.approx(0.0, abs=1e-9)
    assert of_groups(again.result)["all", "ms_structure_least"] < found["copied"]["all", "ms_structure_least"]
    assert again.reused == len(again.scored) - 1
