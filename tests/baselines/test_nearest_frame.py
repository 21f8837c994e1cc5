"""The nearest pose, and the image taken at it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mirror.cli.main import main
from mirror.dataset import Dataset
from mirror.dataset.image import Image
from mirror.errors import DatasetError, ExitCode, UsageError
from mirror.evaluation.run import EvaluationOptions, evaluate
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.untrusted import open_untrusted
from mirror.evaluation.submission.writing import write_submission
from mirror.geometry.poses import Poses
from mirror.protocols.document import Protocol, load_protocol
from mirror.protocols.views import plan_views
from mirror_baselines.nearest_frame import APPEARANCE, METHOD, METRES_PER_RADIAN, find_nearest, render
from mirror_baselines.nearest_frame.matching import PAIRS_AT_ONCE
from tests.builders.lanes import CAMERAS, DRIVES, FRAMES

COLOURS = {name: np.array(colour) for name, _, _, colour, _ in DRIVES}


def random_poses(generator: np.random.Generator, count: int, spread_m: float = 30.0) -> Poses:
    return Poses(generator.normal(size=(count, 4)), generator.uniform(-spread_m, spread_m, (count, 3)))


def brute_force(wanted: Poses, there: Poses) -> list[int]:
    """Nearest poses by the definition, with another library's rotations."""
    found = []
    for ours, at in zip(wanted.rotation, wanted.translation):
        looking = Rotation.from_quat(ours, scalar_first=True).apply([0.0, 0.0, 1.0])
        costs = []
        for theirs, place in zip(there.rotation, there.translation):
            other = Rotation.from_quat(theirs, scalar_first=True).apply([0.0, 0.0, 1.0])
            angle = np.arccos(np.clip(looking @ other, -1.0, 1.0))
            costs.append(np.sum((at - place) ** 2) + (METRES_PER_RADIAN * 2.0 * np.sin(angle / 2.0)) ** 2)
        found.append(int(np.argmin(costs)))
    return found


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 20), st.sampled_from([0.0, 1e5, 1e8]))
def test_nearest_pose_matches_the_definition(seed: int, wanted: int, there: int, offset_m: float) -> None:
    generator = np.random.default_rng(seed)
    ours, theirs = random_poses(generator, wanted), random_poses(generator, there)
    expected = brute_force(ours, theirs)
    shift = np.array([offset_m, -offset_m, offset_m])
    moved = [Poses(poses.rotation, poses.translation + shift) for poses in (ours, theirs)]
    assert find_nearest(*moved).tolist() == expected


def test_nearest_pose_is_the_same_in_chunks() -> None:
    generator = np.random.default_rng(3)
    ours, theirs = random_poses(generator, 2500), random_poses(generator, 2000)
    parts = [Poses(ours.rotation[rows], ours.translation[rows]) for rows in (slice(0, 1000), slice(1000, None))]
    assert all(len(part) * len(theirs) < PAIRS_AT_ONCE < len(ours) * len(theirs) for part in parts)
    found = np.concatenate([find_nearest(part, theirs) for part in parts])
    assert find_nearest(ours, theirs).tolist() == found.tolist()


def test_ties_take_the_first_and_no_queries_give_no_rows() -> None:
    same = Poses(np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)), np.zeros((3, 3)))
    assert find_nearest(same, same).tolist() == [0, 0, 0]
    assert find_nearest(Poses(np.empty((0, 4)), np.empty((0, 3))), same).tolist() == []


def test_rotation_counts_as_metres() -> None:
    turned = Rotation.from_euler("y", 0.5).as_quat(scalar_first=True)
    there = Poses(np.array([turned, [1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.0], [4.9, 0.0, 0.0]]))
    assert find_nearest(Poses.identity(), there).tolist() == [1]
    farther = Poses(there.rotation, np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
    assert find_nearest(Poses.identity(), farther).tolist() == [0]


def test_views_show_the_nearest_drive_in_the_same_direction(dataset: Dataset, protocol: Protocol) -> None:
    plan = plan_views(dataset, protocol, "novel")
    shown = {view.path: image for views, image in render(dataset, plan) for view in views}
    assert set(shown) == {view.path for view in plan.views}
    for view in plan.views:
        if view.group == "novel":
            # The oncoming drive is nearer but looks in the opposite direction.
            assert np.abs(shown[view.path].mean(axis=(0, 1)) - COLOURS["near"]).max() < 3
        drive = view.traversal_id.split(".")[1]
        if view.group == "training":
            assert np.abs(shown[view.path].mean(axis=(0, 1)) - COLOURS[drive]).max() < 3


def test_training_images_are_opened_once_and_truth_never(
    dataset: Dataset, protocol: Protocol, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: Counter[tuple[str, str, int]] = Counter()
    decode = Image.decode

    def counted(self: Image, *, verify: bool = False) -> object:
        opened[self.uri.split("/")[1], self.camera, self.timestamp_ns] += 1
        return decode(self, verify=verify)

    monkeypatch.setattr(Image, "decode", counted)
    plan = plan_views(dataset, protocol, "novel")
    list(render(dataset, plan))
    assert set(opened.values()) == {1}
    asked = {(view.traversal_id, view.camera, view.timestamp_ns) for view in plan.views}
    assert not asked & set(opened)
    # At most one neighbour of each training view and one match of each held-out view is opened.
    assert len(opened) <= len(plan.views)


def test_only_what_is_needed_is_read(dataset: Dataset, protocol: Protocol) -> None:
    plain = protocol.model_dump(mode="json")
    plain["groups"] = [group for group in plain["groups"] if group["name"] == "novel"]
    plan = plan_views(dataset, Protocol.model_validate(plain), "novel")
    for path in Path(dataset.root).glob("traversals/*/recorded/*/*.jpg"):
        if ".near." not in str(path):
            path.unlink()
    assert sum(len(views) for views, _ in render(dataset, plan)) == len(plan.views)


def test_moved_cameras_may_show_their_recorded_image(dataset: Dataset) -> None:
    plan = plan_views(dataset, load_protocol("lane-shift"), "novel")
    for views, image in render(dataset, plan):
        for view in views:
            drive = view.traversal_id.split(".")[1]
            if view.group in ("right-1m", "left-1m"):
                assert np.abs(image.mean(axis=(0, 1)) - COLOURS[drive]).max() < 3


def test_the_submission_is_sound_and_scored(dataset: Dataset, protocol: Protocol, tmp_path: Path) -> None:
    plan = plan_views(dataset, protocol, "novel")
    out = tmp_path / "submission"
    assert write_submission(dataset, plan, render, METHOD, APPEARANCE, out) == len(plan.views)
    report = check_submission(open_untrusted(out), plan)
    assert report.problems == ()
    assert report.manifest is not None
    assert report.manifest.runtime is not None
    assert report.manifest.runtime.frames_per_second is not None
    done = evaluate(out, dataset.root, protocol, "novel", tmp_path / "result", EvaluationOptions(workers=1))
    assert done.result is not None
    values = {figure.group: figure.value for figure in done.result.figures if figure.level == "group"}
    # Two constant colours have a known mean square error.
    error = np.mean((COLOURS["near"] - COLOURS["new"]) ** 2.0)
    assert values["novel"] == pytest.approx(10 * np.log10(255**2 / error), abs=0.2)
    with pytest.raises(UsageError, match="it holds a submission already"):
        write_submission(dataset, plan, render, METHOD, APPEARANCE, out)


def test_renderer_that_skips_views_is_refused(dataset: Dataset, protocol: Protocol, tmp_path: Path) -> None:
    plan = plan_views(dataset, protocol, "novel")
    with pytest.raises(DatasetError, match="0 of"):
        write_submission(dataset, plan, lambda *_: (), METHOD, APPEARANCE, tmp_path / "out")
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_protocol_without_renders_is_refused(dataset: Dataset, tmp_path: Path) -> None:
    for name in ("annotation", "runtime"):
        plan = plan_views(dataset, load_protocol(name), "novel")
        with pytest.raises(UsageError, match="requests no renders"):
            write_submission(dataset, plan, render, METHOD, APPEARANCE, tmp_path / name)


def test_command(dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["baseline", dataset.root, "--method", "nearest_frame", "--split", "novel", "--out", str(tmp_path / "out")]
    assert main(words) == ExitCode.DONE
    views = len(CAMERAS) * (4 * 4)
    assert FRAMES == 12
    assert f"{views} renders" in capsys.readouterr().out
    assert main(words) == ExitCode.COULD_NOT_RUN
    assert "mirror baseline: " in capsys.readouterr().err
