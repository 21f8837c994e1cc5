"""Exports that hold images in files of their own: WebDataset shards and LeRobot's Parquet files."""

from __future__ import annotations

import json
import tarfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

import mirror
import mirror.export.lerobot as lerobot
import mirror.export.webdataset as webdataset
from mirror.dataset.dataset import Dataset
from mirror.dataset.index.build import build_index
from mirror.errors import UsageError
from mirror.export.episode_times import split_at_gaps
from mirror.export.run import ExportOptions, export
from mirror.export.scene import select_scene
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_exp
from mirror.progress import NullProgress
from tests.builders.dataset import Builder, Pass
from tests.builders.street import LENSES
from tests.interruption import interrupt_before


def members(path: Path) -> dict[str, bytes]:
    with tarfile.open(path) as tar:
        return {member.name: tar.extractfile(member).read() for member in tar.getmembers()}  # type: ignore[union-attr]


def pose_of(numbers: list[float]) -> Poses:
    return Poses(np.array([numbers[:4]]), np.array([numbers[4:]]))


def test_shards_hold_the_frames_exactly(street: Dataset, tmp_path: Path) -> None:
    written = export(street, "webdataset", tmp_path / "out", ExportOptions(split="novel"))
    shards = {path.name: members(path) for path in sorted((tmp_path / "out").glob("*.tar"))}
    assert set(shards) == {"train-000000.tar", "held_out-000000.tar"}
    found = {name: data for shard in shards.values() for name, data in shard.items()}
    assert sum(name.endswith(".mask.png") for name in found) == written.masks > 0
    boxes = 0
    for frame in street.frames():
        key = f"{frame.traversal_id.replace('.', '_')}-{frame.frame_index:06}"
        sample = json.loads(found[f"{key}.json"])
        shard = shards[f"{sample['role']}-000000.tar"]
        assert f"{key}.json" in shard
        assert sample["traversal_id"] == frame.traversal_id and sample["timestamp_ns"] == frame.timestamp_ns
        assert (pose_of(sample["world_SE3_ego"]).translation == frame.world_SE3_ego.translation).all()
        for camera, image in frame.images.items():
            assert found[f"{key}.{camera}.jpg"] == image.read()
            stated = sample["cameras"][camera]
            names = ("model", "width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
            assert Camera(*(stated[name] for name in names), tuple(stated["distortion"])) == LENSES[camera]
            pose = pose_of(stated["world_SE3_camera"])
            assert (pose.translation == image.world_SE3_camera.translation).all()
            assert (pose.rotation == image.world_SE3_camera.rotation).all()
            assert stated["timestamp_ns"] == image.timestamp_ns
        ours = frame.boxes("world")
        assert [box["track_id"] for box in sample["boxes"]] == list(ours.track_id)
        for row, box in enumerate(sample["boxes"]):
            assert (pose_of(box["world_SE3_box"]).translation == ours.pose[row].translation).all()
            assert box["size_m"] == ours.size_m[row].tolist() and box["category"] == ours.category[row]
            boxes += 1
    assert boxes == written.boxes > 0


def test_shards_end_at_their_size_and_a_call_continues(
    street: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(webdataset, "SHARD_BYTES", 40_000)
    once = export(street, "webdataset", tmp_path / "once")
    shards = sorted(path.name for path in (tmp_path / "once").glob("*.tar"))
    assert len(shards) > 2 and shards[0] == "all-000000.tar"
    with interrupt_before("*.tar", 2):
        export(street, "webdataset", tmp_path / "twice")
    done = list((tmp_path / "twice").glob("*.tar"))
    assert 0 < len(done) < len(shards) and not list((tmp_path / "twice").glob("*.tmp"))
    before = {path: path.stat().st_mtime_ns for path in done}
    twice = export(street, "webdataset", tmp_path / "twice")
    assert (twice.boxes, twice.masks) == (once.boxes, once.masks) and once.boxes and once.masks
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in before.items())
    for name in shards:
        assert (tmp_path / "once" / name).read_bytes() == (tmp_path / "twice" / name).read_bytes()


def test_undistorted_images_have_their_lens_in_the_sample(street: Dataset, tmp_path: Path) -> None:
    export(street.where(camera="rear"), "webdataset", tmp_path / "out", ExportOptions(undistort=True))
    found = members(tmp_path / "out" / "all-000000.tar")
    name = min(name for name in found if name.endswith(".rear.jpg"))
    lens = json.loads(found[name.replace(".rear.jpg", ".json")])["cameras"]["rear"]
    assert lens["model"] == "pinhole"
    pixels = cv2.imdecode(np.frombuffer(found[name], np.uint8), cv2.IMREAD_COLOR)
    assert pixels.shape == (lens["height_px"], lens["width_px"], 3)


def test_rows_of_lerobot_hold_the_frames_exactly(street: Dataset, tmp_path: Path) -> None:
    written = export(street, "lerobot", tmp_path / "out", ExportOptions(split="novel"))
    info = json.loads((tmp_path / "out" / "meta" / "info.json").read_text())
    rows = pq.read_table(tmp_path / "out" / "data" / "chunk-000" / "file-000.parquet").to_pylist()
    episodes = pq.read_table(tmp_path / "out" / "meta" / "episodes" / "chunk-000" / "file-000.parquet").to_pylist()
    assert (info["codebase_version"], info["total_frames"], info["total_episodes"]) == ("v3.0", len(rows), 2)
    assert sorted(info["splits"]) == ["held_out", "train"]
    frames = {(frame.traversal_id, frame.timestamp_ns): frame for frame in street.frames()}
    assert len(rows) == len(frames) and not written.notes
    for episode in episodes:
        mine = rows[episode["dataset_from_index"] : episode["dataset_to_index"]]
        assert [row["frame_index"] for row in mine] == list(range(episode["length"]))
        for row in mine:
            frame = frames[episode["traversal_id"], row["timestamp_ns"]]
            assert row["observation.state"] == [
                *frame.world_SE3_ego.rotation[0].tolist(),
                *frame.world_SE3_ego.translation[0].tolist(),
            ]
            for camera, image in frame.images.items():
                assert row[f"observation.images.{camera}"]["bytes"] == image.read()
                assert row[f"timestamp_ns.{camera}"] == image.timestamp_ns
                pose = pose_of(row[f"observation.camera_poses.{camera}"])
                assert (pose.translation == image.world_SE3_camera.translation).all()
        # The street's vehicles drive straight ahead at 10 m/s.
        step_s = np.diff([row["timestamp_ns"] for row in mine]).mean() * 1e-9
        for row in mine:
            assert np.abs(np.array(row["action"]) - (10.0 * step_s, 0.0, 0.0)).max() < 1e-6
        assert mine[0]["timestamp"] == 0.0
    stats = json.loads((tmp_path / "out" / "meta" / "stats.json").read_text())
    state = np.array([row["observation.state"] for row in rows])
    np.testing.assert_allclose(stats["observation.state"]["mean"], state.mean(axis=0))
    assert stats["observation.state"]["count"] == [len(rows)]
    assert set(info["features"]) == set(rows[0])


def test_the_action_is_the_motion_in_the_vehicles_frame() -> None:
    heading = np.radians([0.0, 90.0, 180.0])
    poses = Poses(
        quaternion_exp(np.outer(heading, (0.0, 0.0, 1.0))),
        np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.0], [3.0, 5.0, 0.0]]),
    )
    quarter = np.pi / 2
    np.testing.assert_allclose(
        lerobot.motions(poses), [[3.0, 1.0, quarter], [4.0, 0.0, quarter], [4.0, 0.0, quarter]], atol=1e-12
    )
    assert lerobot.motions(poses[:1]).tolist() == [[0.0, 0.0, 0.0]]


def test_frames_without_a_camera_are_left_out_of_lerobot(street: Dataset, tmp_path: Path) -> None:
    selected = select_scene(street, None, None, undistort=False)
    fewer = [item for item in selected.images if not (item.image.camera == "rear" and item.frame.frame_index == 2)]
    cameras = sorted(LENSES)
    episodes, left_out = lerobot.complete_episodes(replace(selected, images=tuple(fewer)), cameras)
    assert left_out == 2 and [len(episode.frames) for episode in episodes] == [2, 2, 2, 2]
    alone = tuple(
        item for item in selected.images if (item.frame.frame_index % 2 == 0) == (item.image.camera == "rear")
    )
    with pytest.raises(UsageError, match="no frame has an image of each") as caught:
        lerobot.complete_episodes(replace(selected, images=alone), cameras)
    assert "--camera" in str(caught.value.remedy)


def test_a_camera_with_images_of_two_sizes_is_refused_before_anything_is_written(
    tmp_path: Path,
) -> None:
    lenses = {name: LENSES[name] for name in ("front_wide", "rear")}
    builder = Builder(tmp_path / "dataset", tuple(lenses), lenses=lenses)
    builder.scene("a", height_m=30.0)
    for drive_id, scale in (("d0", 1.0), ("d1", 0.5)):
        builder.lenses = lenses | {"rear": lenses["rear"].scaled(scale)}
        pixels = {name: np.zeros((lens.height_px, lens.width_px, 3), np.uint8) for name, lens in builder.lenses.items()}
        images = {name: cv2.imencode(".jpg", array)[1].tobytes() for name, array in pixels.items()}
        builder.drive(drive_id, [Pass("a", images=images)])
    build_index(builder.root)
    with pytest.raises(UsageError, match="images of 2 sizes") as caught:
        export(mirror.open(builder.root), "lerobot", tmp_path / "out")
    assert caught.value.place == "camera rear" and "--traversal" in str(caught.value.remedy)
    assert not (tmp_path / "out").exists()


def test_data_files_of_lerobot_end_at_their_size(
    street: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lerobot, "FILE_BYTES", 10_000)
    export(street, "lerobot", tmp_path / "out")
    files = sorted((tmp_path / "out" / "data").rglob("*.parquet"))
    assert [file.name for file in files] == ["file-000.parquet", "file-001.parquet"]
    assert [pq.ParquetFile(file).num_row_groups for file in files] == [1, 1]
    episodes = pq.read_table(tmp_path / "out" / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert episodes.column("data/file_index").to_pylist() == [0, 1]


def test_lerobot_splits_a_traversal_at_a_gap(tmp_path: Path) -> None:
    builder = Builder(tmp_path / "dataset", ("front_wide",), (32, 24))
    builder.scene("a", height_m=30.0)
    images = {"front_wide": cv2.imencode(".jpg", np.zeros((24, 32, 3), np.uint8))[1].tobytes()}
    builder.drive("d0", [Pass("a", frames=20, images=images)])
    build_index(tmp_path / "dataset")
    selected = select_scene(mirror.open(tmp_path / "dataset"), None, None, undistort=False)
    # Eight periods without an image, and then the same rate again.
    kept = tuple(item for item in selected.images if not 6 <= item.frame.frame_index < 13)
    written = lerobot.LAYOUT.write(replace(selected, images=kept), tmp_path / "out", NullProgress())
    assert any("2 episodes" in note and "1 gap" in note for note in written.notes)
    info = json.loads((tmp_path / "out" / "meta" / "info.json").read_text())
    rows = pq.read_table(tmp_path / "out" / "data" / "chunk-000" / "file-000.parquet").to_pylist()
    assert info["total_episodes"] == 2 and len(rows) == 13
    assert [sum(row["episode_index"] == number for row in rows) for number in range(2)] == [6, 7]
    drift = [row["timestamp"] - row["frame_index"] / info["fps"] for row in rows]
    assert np.abs(drift).max() < 1e-4


def test_times_that_no_rate_describes_are_split_or_kept() -> None:
    assert split_at_gaps([5]) == [slice(0, 1)]
    assert split_at_gaps([0, 10, 24, 30, 50, 60]) == [slice(0, 4), slice(4, 6)]
