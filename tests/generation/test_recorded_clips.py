"""From recordings to clips: windows, masks, backgrounds, refusals, resuming, and a training on the result."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from hybridworldsim.generation.clips.clip import ABSENT, CATEGORIES, Clip
from hybridworldsim.generation.clips.folder import read_clip, read_list
from hybridworldsim.generation.command import main
from hybridworldsim.generation.model_files import trained_rates
from hybridworldsim.generation.recorded.counting import count_clip
from hybridworldsim.generation.recorded.documents import ClipStatistics
from hybridworldsim.generation.recorded.hidden import HiddenShares
from hybridworldsim.generation.recorded.road_users import boxes_at
from hybridworldsim.generation.recorded.run import ClipRequest, make_recorded_clips
from hybridworldsim.generation.recorded.windows import WindowOptions, plan_windows, require_bounds
from hybridworldsim.generation.scenes.backgrounds import open_background
from hybridworldsim.generation.scenes.rig import rig_of
from hybridworldsim.generation.scenes.run import PIXELS
from mirror.annotation.masks import mask_layer
from mirror.cli.main import main as mirror_main
from mirror.dataset.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.dataset.split_document import read_split
from mirror.dataset.writing import open_to_write
from mirror.errors import DatasetError, ExitCode, UsageError
from mirror.progress import NullProgress
from mirror.schema.files import write_json
from mirror.schema.tables import BOXES, MASKS
from tests.conftest import ROOT
from tests.generation.clips import make_clip
from tests.interruption import interrupt_before

METHOD = f"{ROOT / 'examples' / 'method.py'}:METHOD"
SIZE, CAMERAS, FRAMES = (32, 48), ("front_wide", "front_left"), 6
REQUEST = ClipRequest(
    ("exact:tiny",), split="both", cameras=CAMERAS, size_px=SIZE, windows=WindowOptions(FRAMES, least_move_m=1.0)
)


@pytest.fixture(scope="module")
def recorded(tiny_dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The tiny street with masks, a split that trains on both traversals, and a second layer of boxes.

    In the second layer all cars are streetcars, which the generator does not know.
    """
    root = tmp_path_factory.mktemp("recorded") / "dataset"
    shutil.copytree(Path(tiny_dataset.root), root)
    mask_layer(open_to_write(root))
    dataset = mirror.open(root)
    both = read_split(dataset.store, "novel")
    train = dict.fromkeys(dataset.traversals(), "train")
    write_json(root / "splits" / "both.json", both.model_copy(update={"name": "both", "assignments": train}))
    for traversal in dataset.traversals():
        rows = dataset.where(traversal=traversal).table("boxes").to_pylist()
        names = set(BOXES.schema.names)
        changed = [
            {name: value for name, value in row.items() if name in names}
            | ({"category": "streetcar"} if row["category"] == "car" else {})
            for row in rows
        ]
        LayerWriter(Layout(root), traversal, "boxes", "mine", "1").finish(BOXES, changed, {})
    build_index(root)
    return mirror.open(root)


@pytest.fixture(scope="module")
def made(recorded: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("clips") / "clips"
    make_recorded_clips(recorded, replace(REQUEST, boxes="synth@0.1.0"), out, NullProgress())
    return out


def first_clip(dataset: Dataset, folder: Path) -> tuple[Clip, list]:
    """The first clip of a folder, and its frames in the dataset."""
    clip = read_clip(folder, read_list(folder).training[0])
    frames = dataset.with_layers(boxes="synth@0.1.0").where(traversal=clip.drive_id).frames()
    first = int(clip.clip_id.rpartition("-")[2])
    return clip, [frame for frame in frames if frame.frame_index >= first][: len(clip)]


def digest(folder: Path) -> dict[str, str]:
    return {
        file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def test_backgrounds_are_seen_from_where_each_camera_was(recorded: Dataset, made: Path) -> None:
    clip, frames = first_clip(recorded, made)
    rig = rig_of(recorded.where(traversal=clip.drive_id).frames(), CAMERAS, SIZE, PIXELS)
    render, _ = open_background("exact:tiny", recorded, "nearest", [])
    for place, frame in enumerate(frames):
        ego = frame.world_SE3_ego
        for row, view in enumerate(rig.views(frame, ego, "day", "clear")):
            pose = frame.images[view.camera].world_SE3_camera
            stamp = frame.images[view.camera].timestamp_ns
            expected = render(view.model_copy(update={"world_SE3_camera": pose, "timestamp_ns": stamp}))
            np.testing.assert_array_equal(
                clip.background[place, row], cv2.resize(expected, SIZE[::-1], interpolation=cv2.INTER_AREA)
            )
            np.testing.assert_allclose(ego.matrix()[0] @ clip.cameras_at(place)[row], pose.matrix()[0], atol=1e-9)
        images, street = rig.images(frame)
        np.testing.assert_array_equal(clip.images[place][street], images[street])
        np.testing.assert_array_equal(clip.images[place][~street], clip.background[place][~street])
        assert clip.excluded is not None and clip.excluded[place][~street].all()


def test_masks_name_the_nearest_road_user(recorded: Dataset, made: Path) -> None:
    """The middle of each box that is in view shows it, or one that is nearer to the camera."""
    clip, frames = first_clip(recorded, made)
    assert clip.tracks is not None
    numbers = {name: number for number, name in enumerate(frames[0].track_ids)}
    compared = 0
    for place, frame in enumerate(frames):
        for row, camera in enumerate(CAMERAS):
            boxes = frame.boxes(f"camera:{camera}")
            lens = mirror.geometry.Camera(
                "pinhole", SIZE[1], SIZE[0], clip.intrinsics[row, 0, 0], clip.intrinsics[row, 1, 1],
                clip.intrinsics[row, 0, 2], clip.intrinsics[row, 1, 2],
            )  # fmt: skip
            middle = lens.project(boxes.pose.translation)
            away = np.linalg.norm(boxes.pose.translation, axis=1)
            by_number = {numbers[name]: away[at] for at, name in enumerate(boxes.track_id)}
            for box in np.flatnonzero(middle.valid & (away < 25.0)):
                u, v = middle.uv_px[box].astype(int)
                if clip.excluded is not None and clip.excluded[place, row, v, u]:
                    continue
                shown = int(clip.tracks[place, row, v, u])
                assert shown != ABSENT and by_number[shown] <= away[box] + 3.0
                compared += 1
    assert compared > 5
    assert 0.0 < (clip.tracks != ABSENT).mean() < 0.5


def test_statistics_count_windows_road_users_and_errors(recorded: Dataset, made: Path) -> None:
    statistics = ClipStatistics.model_validate_json((made / "statistics.json").read_bytes())
    listed = read_list(made).training
    clips = [read_clip(made, name) for name in listed]
    assert statistics.counts.windows == len(listed) > 1
    assert statistics.candidates == len(listed) + statistics.standing + statistics.quiet
    assert statistics.counts.seconds == pytest.approx(sum(len(clip) / clip.rate_hz for clip in clips))
    seen = {(clip.drive_id, int(track)) for clip in clips for track in np.unique(clip.tracks) if track != ABSENT}
    assert sum(statistics.counts.tracks.values()) == len(seen)
    free = [(clip.tracks == ABSENT) & ~clip.excluded for clip in clips]  # type: ignore[operator]
    squares = [np.square(clip.images.astype(float) - clip.background).mean(-1)[mask] for clip, mask in zip(clips, free)]
    expected = -10.0 * np.log10(np.concatenate(squares).mean() / 255.0**2)
    assert statistics.counts.error.psnr_db == pytest.approx(expected, abs=1e-6)
    assert cv2.imread(str(made / "sheet.png")).shape[1] == 2 * len(CAMERAS) * SIZE[1]


def test_the_sizes_of_road_users_are_shares_of_the_view() -> None:
    counts = count_clip(make_clip())
    # 4 x 8 of 16 x 24 pixels in both views of eight frames.
    assert counts.shown == {"car": {"below 1 %": 0, "1 to 5 %": 0, "5 % and more": 16}}
    assert counts.tracks == {"car": 1} and counts.masked == pytest.approx(32 / 384)


def test_road_users_of_other_classes_are_counted_and_not_trained_on(
    recorded: Dataset, made: Path, tmp_path: Path
) -> None:
    out = tmp_path / "clips"
    request = replace(REQUEST, boxes="mine@1", least_busy=0.0)
    statistics = make_recorded_clips(recorded, request, out, NullProgress())
    assert set(statistics.unknown_boxes) == {"streetcar"}
    lost = 0
    for name in read_list(made).training:
        with_cars, without = read_clip(made, name), read_clip(out, name)
        assert with_cars.tracks is not None and without.tracks is not None
        classes = dict(zip(with_cars.boxes.track.tolist(), with_cars.boxes.category.tolist()))
        gone = (with_cars.tracks != ABSENT) & (without.tracks == ABSENT)
        assert {CATEGORIES[classes[track]] for track in np.unique(with_cars.tracks[gone]).tolist()} <= {"car"}
        # Their pixels stay masked: no box says what is there.
        np.testing.assert_array_equal(without.excluded, with_cars.excluded | gone)
        lost += int(gone.sum())
    assert lost > 100


def test_an_interrupted_run_and_workers_give_the_same_clips(recorded: Dataset, tmp_path: Path) -> None:
    """Over a model of one colour a camera: each worker would build the exact street."""
    model = tmp_path / "model"
    words = ["reconstruct", str(recorded.root), "--split", "both", "--boxes", "synth@0.1.0", "--method", METHOD]
    assert mirror_main([*words, "--out", str(model)]) == ExitCode.DONE
    request = replace(REQUEST, backgrounds=(str(model),), boxes="synth@0.1.0", method=METHOD)
    whole, out = tmp_path / "whole", tmp_path / "clips"
    make_recorded_clips(recorded, request, whole, NullProgress())
    with interrupt_before("*.npz", 2):
        make_recorded_clips(recorded, request, out, NullProgress())
    with pytest.raises(DatasetError, match=r"no clips\.json"):
        read_list(out)
    kept = {file.name: file.stat().st_mtime_ns for file in out.glob("*.npz")}
    assert kept
    with pytest.raises(UsageError, match="other settings"):
        make_recorded_clips(recorded, replace(request, min_score=0.4), out, NullProgress())
    make_recorded_clips(recorded, replace(request, workers=2), out, NullProgress())
    assert {name: (out / name).stat().st_mtime_ns for name in kept} == kept
    assert len(kept) < len(read_list(whole).training) and digest(out) == digest(whole)


def test_a_generator_is_trained_on_the_clips(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["train", str(made), "--steps", "2", "--autoencoder-steps", "2", "--batch", "1"]
    assert main([*words, "--out", str(tmp_path / "g"), "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["steps"] == 2
    # The rate of the recording, which is lower than that of the verb.
    assert trained_rates(tmp_path / "g/generator/model.safetensors") == pytest.approx((0.5, 0.5))


def test_what_is_missing_is_refused_with_the_verb_that_makes_it(
    tiny_dataset: Dataset, recorded: Dataset, tmp_path: Path
) -> None:
    plain = replace(REQUEST, split="novel")
    for dataset, request, part, remedy in (
        (tiny_dataset, plain, "no masks of road users", "mirror annotate masks"),
        (recorded, replace(plain, role="held_out"), "role held_out", "leave out --role"),
        (recorded, replace(plain, split=None), "without --split", ""),
        (recorded, plain, "2 layers of boxes", ""),
        (recorded, replace(plain, boxes="synth@0.1.0", cameras=("front_wide", "top")), "no camera top", "--cameras"),
        (recorded, replace(plain, boxes="synth@0.1.0", size_px=(60, 90)), "90 x 60 px", "whole tokens"),
        (recorded, replace(plain, backgrounds=("exact:tiny", "exact:tiny")), "exact:tiny", ""),
    ):
        with pytest.raises(UsageError) as caught:
            make_recorded_clips(dataset, request, tmp_path / "out", NullProgress())
        assert part in str(caught.value) and remedy in (caught.value.remedy or "")
    assert not (tmp_path / "out").exists()


def test_what_a_window_may_lack_must_be_said(recorded: Dataset, tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    shutil.copytree(Path(recorded.root), root)
    traversal = recorded.traversals()[0]
    masks = recorded.where(traversal=traversal).table("masks").to_pylist()
    shutil.rmtree(next((root / "traversals" / traversal / "layers" / "masks").iterdir()))
    writer = LayerWriter(Layout(root), traversal, "masks", "mine", "1")
    of_camera = [row for row in masks if row["camera"] == CAMERAS[0]]
    rows = []
    for row in masks:
        if row is not of_camera[1]:
            pixels = (Path(recorded.root) / row["uri"]).read_bytes()
            file = writer.file(f"{row['camera']}/{row['timestamp_ns']}.png", pixels)
            rows.append({"camera": row["camera"], "timestamp_ns": row["timestamp_ns"], "kind": "dynamic", **file})
    writer.finish(MASKS, rows, {})
    build_index(root)
    dataset = mirror.open(root)
    options = WindowOptions(FRAMES, least_move_m=1.0)
    planned = plan_windows(dataset, traversal, CAMERAS, options)
    assert sorted(planned.lacking)[-2:] == [0.0, pytest.approx(1 / (FRAMES * len(CAMERAS)))]
    with pytest.raises(UsageError) as caught:
        require_bounds([planned], options)
    assert "--may-lack" in str(caught.value) and "--may-lack 0.09" in (caught.value.remedy or "")
    strict = plan_windows(dataset, traversal, CAMERAS, replace(options, may_lack=0.0))
    assert len(strict.firsts) == len(planned.firsts) - 1 and strict.left_out == 1
    require_bounds([strict], replace(options, may_lack=0.0))
    with pytest.raises(UsageError, match="no window is left"):
        require_bounds([plan_windows(dataset, traversal, CAMERAS, replace(options, least_move_m=1e5))], options)


def test_boxes_are_moved_to_the_time_of_an_image(recorded: Dataset) -> None:
    frame = recorded.with_layers(boxes="synth@0.1.0").frames()[2]
    still, later = (boxes_at(frame, 0.3, frame.timestamp_ns + shift) for shift in (0, 500_000_000))
    np.testing.assert_allclose(
        later.pose.translation - still.pose.translation, 0.5 * np.nan_to_num(still.velocity_mps), atol=1e-9
    )
    assert np.abs(still.velocity_mps).max() > 1.0


def test_the_share_of_images_that_hide_a_place_is_that_of_recorded_masks(recorded: Dataset) -> None:
    """Against the recorded images and masks, one by one, in the recorded raster."""
    drives, images = [], []
    for traversal in recorded.traversals():
        frames = recorded.where(traversal=traversal).frames()
        drives.append((frames, rig_of(frames, CAMERAS, (64, 96), PIXELS)))
        images += [frame.images[camera] for frame in frames for camera in CAMERAS if camera in frame.images]
    place = frames[3].world_SE3_ego.translation[0]
    boxes = recorded.with_layers(boxes="synth@0.1.0").where(traversal=traversal).frames()[3].boxes("world")
    points = np.concatenate([boxes.pose.translation, boxes.pose.translation + np.array([0.0, 0.0, 6.0])])
    points = points[np.linalg.norm(points - place, axis=1) < 30.0]
    found = HiddenShares(drives, lambda view: pytest.fail("nothing is rendered")).of_points(points, place)
    looked, hidden = np.zeros(len(points)), np.zeros(len(points))
    for image in images:
        if np.linalg.norm(image.world_SE3_camera.translation[0] - place) > 40.0:
            continue
        seen = image.camera_model.project(image.world_SE3_camera.inverse().transform(points)[0])
        (mask,) = [one.decode() for one in image.masks() if one.kind == "dynamic"]
        for point in np.flatnonzero(seen.valid):
            u, v = seen.uv_px[point].astype(int)
            looked[point] += 1
            hidden[point] += mask[v, u] > 0
    expected = hidden / np.maximum(looked, 1)
    assert len(points) > 4 and expected.max() > 0.3
    # Of frames that stand within six metres of each other one is used; lenses are undistorted.
    assert np.abs(found - expected).mean() < 0.1
