"""The judges of the study, and the clips of the synthetic street."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
import torch

from benchmarks.studies.generation import make_clips
from benchmarks.studies.generation.benchmark import main as generation_benchmark
from benchmarks.studies.generation.judge_data import CROP_PX, crop, judged_boxes
from benchmarks.studies.generation.judges import (
    Classifier,
    JudgeTrainer,
    Segmenter,
    balanced_accuracy,
    blur,
    classifier_loss,
    classify,
    mask_ious,
    segment,
    segmenter_loss,
)
from benchmarks.studies.generation.make_clips import ROUTES, TEST_SEEDS, PlannedDrive, busy_share, planned_drives
from benchmarks.studies.generation.street_clips import StreetRecorder, StreetRig, busy_drive
from hybridworldsim.generation.clips.clip import ABSENT, CATEGORIES, Clip
from hybridworldsim.generation.clips.folder import read_clip, read_list
from hybridworldsim.generation.clips.map_lines import LINE_KINDS, move_lines
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.layout.images import draw_layout
from mirror.arrays import Float64


@pytest.fixture(scope="module")
def recorder() -> StreetRecorder:
    """A drive through a small synthetic street."""
    return StreetRecorder(busy_drive("tiny", "guangzhou-urban-01", 3, 0.3, "test-drive"), StreetRig())


@pytest.fixture(scope="module")
def times_s(recorder: StreetRecorder) -> Float64:
    """Two instants of the drive."""
    times_s = recorder.times_s
    return times_s[[len(times_s) // 2, len(times_s) // 2 + 5]]


@pytest.fixture(scope="module")
def street_clip(recorder: StreetRecorder, times_s: Float64) -> Clip:
    """The frames at these instants."""
    return recorder.record("test-clip", times_s)


def test_masks_without_backgrounds_are_those_of_the_clip(
    recorder: StreetRecorder, times_s: Float64, street_clip: Clip
) -> None:
    assert street_clip.tracks is not None
    np.testing.assert_array_equal(recorder.tracks(times_s), street_clip.tracks)


def test_busy_frames_show_a_road_user_with_enough_pixels() -> None:
    tracks = np.full((4, 2, 20, 20), ABSENT, np.int16)
    tracks[0, 1, :6, :10] = 3
    tracks[1, 0, :6, :9] = 3
    tracks[2, 0, :5, :10] = 1
    tracks[2, 1, :5, :10] = 2
    assert busy_share(tracks) == 0.25


def test_images_differ_from_their_background_where_road_users_and_their_shadows_are(street_clip: Clip) -> None:
    assert street_clip.tracks is not None
    shown = street_clip.tracks != ABSENT
    differs = (street_clip.images != street_clip.background).any(axis=-1)
    assert shown.any()
    assert differs[shown].mean() > 0.95
    # Elsewhere only their shadows and reflections differ.
    assert differs[~shown].mean() < 0.35


def test_boxes_enclose_the_pixels_of_their_road_users(street_clip: Clip) -> None:
    """Boxes, cameras and masks agree: a ray through a pixel of a road user meets its box, up to a border of a pixel."""
    assert street_clip.tracks is not None
    checked = 0
    for frame in range(len(street_clip)):
        for track in street_clip.boxes.at(frame).track.tolist():
            boxes = street_clip.boxes.at(frame)
            one = boxes[boxes.track == track]
            drawn = draw_layout(
                one, street_clip.intrinsics, street_clip.ego_SE3_camera, street_clip.size_px, OWN_STYLE
            )[:, 3]
            mask = street_clip.tracks[frame] == track
            grown = torch.nn.functional.max_pool2d(torch.from_numpy(drawn)[None], 3, 1, 1)[0].numpy() > 0.0
            assert (mask & ~grown).sum() == 0
            checked += int(mask.sum())
    assert checked > 100


def test_ego_motion_agrees_with_the_poses_of_static_boxes(street_clip: Clip) -> None:
    """A parked vehicle keeps its place in the frame of the clip's start."""
    first, second = street_clip.boxes.at(0), street_clip.boxes.at(1)
    moved = [
        np.linalg.norm(
            (street_clip.start_SE3_ego[0] @ first[first.track == track].ego_SE3_box[0])[:3, 3]
            - (street_clip.start_SE3_ego[1] @ second[second.track == track].ego_SE3_box[0])[:3, 3]
        )
        for track in set(first.track.tolist()) & set(second.track.tolist())
    ]
    assert min(moved) < 1e-6


def test_clips_have_the_lines_of_the_exact_map_where_they_are_asked_for(
    recorder: StreetRecorder, times_s: Float64, street_clip: Clip
) -> None:
    """On the ground; borders of the drivable area on that of the carriageways, those of lanes half a width aside."""
    clip = recorder.record("with-map", times_s[:1], with_map=True)
    assert street_clip.lines is None and clip.lines is not None
    np.testing.assert_array_equal(clip.images[0], street_clip.images[0])
    plan, counts = recorder.drive.world.plan, dict.fromkeys(LINE_KINDS, 0)
    middles = [(shapely.LineString(one.line[:, :2]), one.width_m) for one in plan.network.lanes.values()]
    for line in move_lines(clip.lines, recorder.ego(times_s[:1]).matrix()[0]):
        counts[line.kind] += 1
        points = [shapely.Point(point) for point in line.points_m[:, :2].tolist()]
        # A kerb is up to 0.15 m high.
        assert np.abs(line.points_m[:, 2] - plan.height_m(*line.points_m[:, :2].T)).max() < 0.2
        assert np.hypot(*(line.points_m[:, :2] - recorder.ego(times_s[:1]).translation[0, :2]).T).min() <= 67.0
        if line.kind == "drivable":
            assert max(plan.carriageways.boundary.distance(point) for point in points) < 1e-6
        if line.kind == "lane":
            away = [max(abs(middle.distance(one) - 0.5 * width) for one in points[1:-1]) for middle, width in middles]
            assert min(away) < 0.02
    assert all(counts.values())


def test_clips_with_maps_are_no_part_of_the_study(
    recorder: StreetRecorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One drive of one frame."""
    monkeypatch.setattr(make_clips, "planned_drives", lambda: [PlannedDrive("guangzhou-urban-01", 3, True)])
    monkeypatch.setattr(make_clips, "TEST_FRAMES", 1)
    monkeypatch.setattr(make_clips, "busy_drive", lambda *_: recorder.drive)
    monkeypatch.setattr(make_clips, "StreetRecorder", lambda *_: recorder)
    assert generation_benchmark(["clips", "--map", "--out", str(tmp_path)]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["clips-with-maps"]
    listed = read_list(tmp_path / "clips-with-maps")
    assert listed.source.endswith("1 drives, with maps") and len(listed.test) == 1
    assert read_clip(tmp_path / "clips-with-maps", listed.test[0]).lines
    assert "mirror generate train" in capsys.readouterr().out


def test_drives_of_the_study_are_distinct() -> None:
    drives = planned_drives()
    assert len({drive.drive_id for drive in drives}) == len(drives)
    assert sum(drive.test for drive in drives) == len(TEST_SEEDS) * len(ROUTES) >= 6


def test_judged_boxes_show_enough(street_clip: Clip) -> None:
    assert street_clip.tracks is not None
    found = list(judged_boxes(street_clip))
    assert found
    for box in found:
        assert (street_clip.tracks[box.frame, box.view] == box.track).sum() >= 60
        rows, columns = np.nonzero(street_clip.tracks[box.frame, box.view] == box.track)
        left, top, right, bottom = box.square_px
        assert left - 1 <= columns.min()
        assert columns.max() <= right
        assert top - 1 <= rows.min()
        assert rows.max() <= bottom


def test_a_crop_is_the_square_of_the_image() -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8)
    same = crop(image, np.array([10.0, 20.0, 10.0 + CROP_PX, 20.0 + CROP_PX]))
    assert np.array_equal(same, image[20 : 20 + CROP_PX, 10 : 10 + CROP_PX])
    ramp = np.tile(np.arange(96, dtype=np.uint8)[None, :, None], (64, 1, 3))
    doubled = crop(ramp, np.array([10.0, 10.0, 10.0 + 2 * CROP_PX, 10.0 + 2 * CROP_PX]))
    # The centre of the first pixel of the crop lies between columns 10 and 11.
    np.testing.assert_allclose(doubled[5, :, 0], 10.5 + 2 * np.arange(CROP_PX), atol=0.51)


def test_the_segmenter_learns_what_the_background_does_not_show() -> None:
    rng = np.random.default_rng(0)
    backgrounds = rng.integers(0, 256, (12, 4, 6, 3), np.uint8).repeat(8, axis=1).repeat(8, axis=2)
    images, masks = backgrounds.copy(), np.zeros((12, 32, 48), bool)
    for image, mask in zip(images, masks):
        top, left = rng.integers(0, 20), rng.integers(0, 32)
        image[top : top + 12, left : left + 16] = rng.integers(0, 256, 3)
        mask[top : top + 12, left : left + 16] = True
    torch.manual_seed(0)
    segmenter = Segmenter(width=8)
    before = mask_ious(segment(segmenter, images, backgrounds), masks).mean()
    trainer = JudgeTrainer(segmenter, segmenter_loss(segmenter, images, backgrounds, masks, 6), 120)
    for number in range(120):
        trainer.step(number)
    assert mask_ious(segment(segmenter, images, backgrounds), masks).mean() > before + 0.4


def test_the_classifier_learns_colours() -> None:
    rng = np.random.default_rng(0)
    classes = rng.integers(0, len(CATEGORIES), 60)
    colours = 50 + 150 * np.array([[row >> channel & 1 for channel in range(3)] for row in range(len(CATEGORIES))])
    noise = rng.integers(0, 20, (60, CROP_PX, CROP_PX, 3))
    crops = (colours[classes][:, None, None] + noise).astype(np.uint8)
    classifier = Classifier(width=8)
    trainer = JudgeTrainer(classifier, classifier_loss(classifier, crops, classes, 24), 80)
    for number in range(80):
        trainer.step(number)
    assert balanced_accuracy(classify(classifier, crops), classes) > 0.6


def test_scores_by_hand() -> None:
    true = np.zeros((2, 20, 20), bool)
    true[0, :10, :10] = True
    found = np.zeros_like(true)
    found[0, :10, 5:15] = True
    # The second mask is too small to count: 50 of 150 pixels agree in the first.
    true[1, :5, :5] = True
    assert mask_ious(found, true).tolist() == [pytest.approx(50 / 150)]
    assert balanced_accuracy(np.array([0, 0, 0, 1]), np.array([0, 0, 0, 2])) == 0.5
    assert balanced_accuracy(np.array([0, 1, 1, 2]), np.array([0, 0, 1, 2])) == pytest.approx(2.5 / 3)


def test_blur_keeps_the_mean_and_spreads_a_point() -> None:
    image = torch.zeros(1, 3, 15, 15)
    image[..., 7, 7] = 1.0
    blurred = blur(image, 1.0)
    assert float(blurred.sum()) == pytest.approx(3.0, abs=1e-5)
    line = np.exp(-0.5 * np.arange(-3, 4) ** 2)
    np.testing.assert_allclose(blurred[0, 0, 7, 4:11], line / line.sum() * (1 / line.sum()), atol=1e-6)
    flat = torch.full((1, 3, 9, 9), 0.3)
    torch.testing.assert_close(blur(flat, 0.7), flat)


def test_clips_without_masks_are_not_judged(street_clip: Clip, tmp_path: Path) -> None:
    assert list(judged_boxes(replace(street_clip, tracks=None))) == []
