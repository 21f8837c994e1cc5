from __future__ import annotations

import json
import os
import shutil
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset.layout import Layout
from mirror.dataset.lock import writer_lock
from mirror.errors import DatasetError, MirrorError, RecordingError, UsageError
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.schema.documents import DriveDocument
from mirror.schema.files import read_json, read_table
from mirror.schema.tables import CALIBRATIONS, EGO_POSES, IMAGES, PASSES
from tests.builders.folder import LAT, LON, SCENE, START_NS, compact_tree, tree, write_recording

HOUR_NS = 3_600_000_000_000


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three drives: there, back in several pose files, and one that only touches the edge."""
    root = tmp_path_factory.mktemp("fleet")
    return [
        write_recording(root, "there"),
        write_recording(root, "back", start_ns=START_NS + HOUR_NS, from_m=120, to_m=-120, parts=3, seed=1),
        write_recording(root, "edge", start_ns=START_NS + 2 * HOUR_NS, from_m=-120, to_m=-50, seed=2),
    ]


@pytest.fixture
def copied(drives: list[Path], tmp_path: Path) -> list[Path]:
    """The same recordings, to be damaged."""
    for drive in drives:
        shutil.copytree(drive, tmp_path / "fleet" / drive.name)
    return [tmp_path / "fleet" / drive.name for drive in drives]


def test_passes_become_traversals_with_their_images(drives: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "dataset"
    report = ingest_recordings(drives, [SCENE], out)
    assert not report.failures
    layout = Layout(out)
    assert layout.drive_ids() == ["back", "edge", "there"]
    names = [one.traversal_id for one in report.traversals]
    # 60 m before the centre at 8 m/s from 120 m away: 7.5 s after the start.
    assert f"street.there.{(START_NS + 7_500_000_000) // 1_000_000}" in names
    assert [name.split(".")[1] for name in names] == ["back", "there"]
    ledger = read_table(layout.drive("edge") / "passes.parquet", PASSES).to_pylist()
    assert [(row["decision"], row["rule"], row["exit_kind"]) for row in ledger] == [
        ("refused", "min_duration", "recording_edge")
    ]
    for name in names:
        drive = drives[0].parent / name.split(".")[1]
        images = read_table(layout.recorded(name) / "images.parquet", IMAGES).to_pylist()
        poses = read_table(layout.recorded(name) / "ego_poses.parquet", EGO_POSES)
        entry, exit_ = 7.5e9, 22.5e9
        assert {image["camera"] for image in images} == {"front_wide", "rear"}
        for image in images:
            source = drive / "images" / image["camera"] / f"{image['timestamp_ns']}.jpg"
            assert (out / image["uri"]).samefile(source)
            assert image["byte_length"] == source.stat().st_size
            assert (image["width_px"], image["height_px"]) == (64, 48)
        inside = [
            path
            for path in (drive / "images" / "rear").iterdir()
            if entry <= int(path.stem) - START_NS - (HOUR_NS if drive.name == "back" else 0) <= exit_
        ]
        assert len(inside) == sum(image["camera"] == "rear" for image in images) > 40
        stamps = poses.column("timestamp_ns").to_numpy()
        assert stamps[0] <= min(image["timestamp_ns"] for image in images) - 9e8
        assert read_table(layout.recorded(name) / "calibrations.parquet", CALIBRATIONS).num_rows == 2


def test_world_is_east_north_up_at_the_roi(drives: list[Path], tmp_path: Path) -> None:
    report = ingest_recordings(drives[:1], [SCENE.model_copy(update={"height_m": 500.0})], tmp_path / "d")
    table = read_table(
        Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id) / "ego_poses.parquet", EGO_POSES
    )
    x, y, z = (table.column(name).to_numpy() for name in ("tx_m", "ty_m", "tz_m"))
    seconds = (table.column("timestamp_ns").to_numpy() - START_NS) * 1e-9
    # On a street of constant height h the tangent plane sees x grow by 1 + h / R, and drop by x^2 / 2R.
    assert np.allclose(x, (-120.0 + 8.0 * seconds) * (1 + 520 / 6.38e6), atol=2e-3)
    assert np.abs(y).max() < 2e-3
    assert np.allclose(z, 20.0, atol=2e-3)
    forward = 1 - 2 * (table.column("qy").to_numpy() ** 2 + table.column("qz").to_numpy() ** 2)
    assert np.allclose(forward, 1.0, atol=1e-9)


def test_frames_take_the_nearest_image(drives: list[Path], tmp_path: Path) -> None:
    report = ingest_recordings(drives[:1], [SCENE], tmp_path / "d")
    table = read_table(Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id) / "images.parquet", IMAGES)
    rows = table.to_pylist()
    front = {row["frame_index"]: row["timestamp_ns"] for row in rows if row["camera"] == "front_wide"}
    assert sorted(front) == list(range(len(front)))
    rear = {row["frame_index"]: row["timestamp_ns"] for row in rows if row["camera"] == "rear"}
    assert all(rear[frame] - front[frame] == 7_000_000 for frame in set(rear) & set(front))


def test_copies_are_files_of_their_own_with_the_same_bytes(drives: list[Path], tmp_path: Path) -> None:
    report = ingest_recordings(drives[:1], [SCENE], tmp_path / "d", IngestOptions(write=WriteOptions(transfer="copy")))
    assert report.linked == 0
    images = read_table(Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id) / "images.parquet", IMAGES)
    for image in images.to_pylist():
        copy, source = tmp_path / "d" / image["uri"], drives[0] / "images" / image["camera"] / Path(image["uri"]).name
        assert copy.read_bytes() == source.read_bytes()
        assert not copy.samefile(source)
        assert copy.stat().st_nlink == 1


def test_second_run_does_nothing(drives: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "d"
    ingest_recordings(drives, [SCENE], out)
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    report = ingest_recordings(drives, [SCENE], out, IngestOptions(verify=True))
    assert report.unchanged == ["there", "back", "edge"]
    assert not report.drives
    assert before == {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}


def test_order_and_number_of_runs_and_workers_do_not_matter(drives: list[Path], tmp_path: Path) -> None:
    ingest_recordings(drives, [SCENE], tmp_path / "a", IngestOptions(workers=4))
    for drive in reversed(drives):
        ingest_recordings([drive], [SCENE], tmp_path / "b", IngestOptions(workers=1))
    assert compact_tree(tmp_path / "a") == compact_tree(tmp_path / "b")


def test_new_roi_is_cut_out_of_the_drives_given_again(drives: list[Path], tmp_path: Path) -> None:
    west = SCENE.model_copy(update={"scene_id": "west", "longitude_deg": LON - 0.0008})
    ingest_recordings(drives, [SCENE], tmp_path / "a")
    ingest_recordings(drives, [west], tmp_path / "a")
    ingest_recordings(drives, [SCENE, west], tmp_path / "b")
    assert compact_tree(tmp_path / "a") == compact_tree(tmp_path / "b")
    with pytest.raises(DatasetError, match="another centre"):
        ingest_recordings(drives, [west.model_copy(update={"radius_m": 80.0})], tmp_path / "a")


def test_dry_run_judges_and_writes_nothing(drives: list[Path], tmp_path: Path) -> None:
    report = ingest_recordings(drives, [SCENE], tmp_path / "d", IngestOptions(dry_run=True))
    assert sum(one.accepted for drive in report.drives.values() for one in drive.passes) == 2
    assert not (tmp_path / "d").exists()


def test_no_image_is_opened_for_a_refused_pass(copied: list[Path], tmp_path: Path) -> None:
    edge = copied[2]
    for path in (edge / "images").rglob("*.jpg"):
        path.write_bytes(b"no image at all")
    there = copied[0]
    for path in (there / "images").rglob("*.jpg"):
        if not 7.4e9 <= int(path.stem) - START_NS <= 22.6e9:
            path.write_bytes(b"outside of every pass")
    report = ingest_recordings([there, edge], [SCENE], tmp_path / "d")
    assert not report.failures
    assert report.images > 80


def test_poses_only_drives_make_traversals_without_images(tmp_path: Path) -> None:
    drive = write_recording(tmp_path, "blind", cameras=())
    report = ingest_recordings([drive], [SCENE], tmp_path / "d")
    assert [one.images for one in report.traversals] == [0]
    rows = mirror.open(tmp_path / "d").table("traversals", ["has_images"])
    assert rows.column("has_images").to_pylist() == [False]


def test_other_thresholds_are_refused_and_the_datasets_own_are_the_default(drives: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "d"
    first = ingest_recordings(drives, [SCENE], out, IngestOptions(trigger={"min_duration_s": 5.0}))
    assert {one.traversal_id.split(".")[1] for one in first.traversals} == {"there", "back"}
    with pytest.raises(DatasetError, match="min_duration_s") as caught:
        ingest_recordings(drives, [SCENE], out, IngestOptions(trigger={"min_duration_s": 10.0}))
    assert "new folder" in str(caught.value)
    assert ingest_recordings(drives, [SCENE], out).unchanged == ["there", "back", "edge"]


def test_changed_recording_needs_replace_and_a_failed_replacement_harms_nothing(
    copied: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "d"
    there = copied[0]
    ingest_recordings(copied, [SCENE], out)
    before = tree(out)
    images = sorted((there / "images" / "rear").glob("*.jpg"))
    whole = images[30].read_bytes()
    images[30].unlink()
    images[30].write_bytes(whole[:-20])
    report = ingest_recordings(copied, [SCENE], out)
    assert "--replace" in str(report.failures[0][1])
    assert data_of(out) == before
    report = ingest_recordings(copied, [SCENE], out, IngestOptions(replace=True))
    assert "truncated" in str(report.failures[0][1])
    assert data_of(out) == before
    images[30].unlink()
    images[30].write_bytes(cv2.imencode(".jpg", np.zeros((48, 64, 3), np.uint8))[1].tobytes())
    assert not ingest_recordings(copied, [SCENE], out, IngestOptions(replace=True)).failures
    ingest_recordings(copied, [SCENE], tmp_path / "fresh")
    assert compact_tree(out) == tree(tmp_path / "fresh")


def test_a_replacement_drops_unfinished_work_on_the_replaced_traversals_alone(
    copied: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "d"
    report = ingest_recordings(copied[:2], [SCENE], out)
    names = [one.traversal_id for one in report.traversals]
    replaced = [name for name in names if f".{copied[0].name}." in name]
    left = [
        out / work / "1.abc" / f"{name}.jsonl" for work in (".deidentify", ".annotate", ".refine") for name in names
    ]
    left += [out / ".mvs" / "1.abc" / name / "rear" / "1.png" for name in names]
    reviews = out / ".deidentify" / "reviews.jsonl"
    for path in (*left, reviews):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"{}\n")
    assert not ingest_recordings(copied[:1], [SCENE], out, IngestOptions(replace=True)).failures
    kept = [path for path in left if path.exists()]
    assert kept == [path for path in left if not any(name in str(path) for name in replaced)]
    assert replaced and kept and reviews.exists()


def test_verify_notices_bytes_that_changed_behind_an_unchanged_size_and_time(
    copied: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "d"
    ingest_recordings(copied[:1], [SCENE], out, IngestOptions(write=WriteOptions(transfer="copy")))
    image = sorted((copied[0] / "images" / "rear").glob("*.jpg"))[30]
    status, data = image.stat(), bytearray(image.read_bytes())
    data[len(data) // 2] ^= 1
    image.write_bytes(data)
    os.utime(image, ns=(status.st_atime_ns, status.st_mtime_ns))
    options = IngestOptions(write=WriteOptions(transfer="copy"))
    assert ingest_recordings(copied[:1], [SCENE], out, options).unchanged == ["there"]
    options = IngestOptions(write=WriteOptions(transfer="copy"), verify=True)
    assert image.name in str(ingest_recordings(copied[:1], [SCENE], out, options).failures[0][1])


def test_second_writer_is_refused_or_waits(drives: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "d"
    release = threading.Timer(0.6, lambda: None)
    with writer_lock(Layout(out), wait=False):
        with pytest.raises(DatasetError, match="another run"):
            ingest_recordings(drives[:1], [SCENE], out)
        done = threading.Event()
        waiting = threading.Thread(
            target=lambda: (ingest_recordings(drives[:1], [SCENE], out, IngestOptions(wait=True)), done.set())
        )
        waiting.start()
        release.start()
        release.join()
        assert not done.is_set()
    waiting.join(30)
    assert done.is_set()
    assert Layout(out).drive_ids() == ["there"]


def _rewrite(drive: Path, **values: object) -> None:
    document = json.loads((drive / "recording.json").read_text())
    (drive / "recording.json").write_text(json.dumps({**document, **values}))


def _edit_poses(drive: Path, row: int, text: str) -> None:
    lines = (drive / "poses.csv").read_text().splitlines()
    lines[row + 1] = text.format(*lines[row + 1].split(","))
    (drive / "poses.csv").write_text("\n".join(lines) + "\n")


def _truncate_image(drive: Path) -> None:
    image = sorted((drive / "images" / "rear").glob("*.jpg"))[30]
    image.write_bytes(image.read_bytes()[:200])


def _shift_images(drive: Path) -> None:
    for camera in ("front_wide", "rear"):
        for path in sorted((drive / "images" / camera).glob("*.jpg")):
            path.rename(path.with_name(f"{int(path.stem) + 10 * HOUR_NS}.jpg"))


DAMAGE = {
    "truncated JSON": (lambda d: (d / "recording.json").write_text('{"format": '), "recording.json"),
    "truncated calibration": (lambda d: (d / "calibrations/factory.json").write_text("[{"), "factory.json"),
    "truncated Parquet": (
        lambda d: ((d / "poses.csv").unlink(), (d / "poses.parquet").write_bytes(b"PAR1" + bytes(50))),
        "poses.parquet",
    ),
    "truncated JPEG": (_truncate_image, "truncated"),
    "missing camera": (lambda d: shutil.rmtree(d / "images/rear"), "camera rear is missing"),
    "no poses": (lambda d: (d / "poses.csv").unlink(), "poses"),
    "empty poses": (lambda d: (d / "poses.csv").write_text("timestamp_ns,longitude_deg,latitude_deg\n"), "pose"),
    "empty folder": (lambda d: (shutil.rmtree(d), d.mkdir()), "the folder is empty"),
    "images on another clock": (_shift_images, "no pose covers any image"),
    "all poses wild": (
        lambda d: (d / "poses.csv").write_text("timestamp_ns,longitude_deg,latitude_deg\n1,999,5\n2,nan,nan\n"),
        "none of 2 poses is usable",
    ),
    "path out of the recording": (
        lambda d: _rewrite(d, cameras={"front_wide": {"static_mask": "../../x.png"}, "rear": {}}),
        "leads out of the recording",
    ),
    "zero quaternion": (
        lambda d: (d / "poses.csv").write_text(
            "timestamp_ns,longitude_deg,latitude_deg,qw,qx,qy,qz\n"
            f"{START_NS},{LON},{LAT},1,0,0,0\n{START_NS + 1},{LON},{LAT},0,0,0,0\n"
        ),
        "poses.csv",
    ),
    "id that is a path": (lambda d: _rewrite(d, drive_id="../up"), "drive_id"),
    "text for a number": (
        lambda d: [_edit_poses(d, row, "{0},east,{2},{3},{4}") for row in range(4, 14)],
        "10 of 301 rows make no pose (number 10), more than 1.00%",
    ),
}


def data_of(root: Path) -> dict[str, str]:
    """The hashes of a dataset's files without the lists of recordings that could not be ingested."""
    return {name: digest for name, digest in tree(root).items() if not name.startswith("failures/")}


@pytest.mark.parametrize("damage", DAMAGE)
def test_one_bad_drive_is_reported_and_stops_neither_the_others_nor_harms_the_dataset(
    damage: str, copied: list[Path], tmp_path: Path
) -> None:
    there, back, _ = copied
    spoil, says = DAMAGE[damage]
    spoil(there)
    out = tmp_path / "d"
    ingest_recordings([back], [SCENE], out)
    before = tree(out)
    report = ingest_recordings([there], [SCENE], out)
    assert [path for path, _ in report.failures] == [there]
    assert says in str(report.failures[0][1])
    assert str(there) in str(report.failures[0][1])
    assert data_of(out) == before
    both = ingest_recordings([there, back], [SCENE], tmp_path / "e")
    assert (len(both.failures), sorted(both.drives)) == (1, ["back"])
    assert data_of(tmp_path / "e") == before
    with pytest.raises(MirrorError):
        ingest_recordings([there, back], [SCENE], tmp_path / "f", IngestOptions(fail_fast=True))


def test_nothing_is_left_where_every_drive_fails(copied: list[Path], tmp_path: Path) -> None:
    _truncate_image(copied[0])
    assert ingest_recordings(copied[:1], [SCENE], tmp_path / "d").failures
    assert tree(tmp_path / "d") == {}


def test_nan_fixes_are_cleaned_and_counted(copied: list[Path], tmp_path: Path) -> None:
    _edit_poses(copied[0], 100, "{0},nan,nan,{3},{4}")
    _edit_poses(copied[0], 120, "{0},1555.0,{2},{3},{4}")
    _edit_poses(copied[0], 140, "{0},{1},48.2,{3},{4}")
    ingest_recordings(copied[:1], [SCENE], tmp_path / "d")
    cleaning = read_json(Layout(tmp_path / "d").drive("there") / "drive.json", DriveDocument).cleaning
    assert (cleaning.invalid, cleaning.outliers, cleaning.poses - cleaning.kept) == (2, 1, 3)


def test_backward_time_is_sorted_or_refused(copied: list[Path], tmp_path: Path) -> None:
    lines = (copied[0] / "poses.csv").read_text().splitlines()
    lines[50], lines[60] = lines[60], lines[50]
    (copied[0] / "poses.csv").write_text("\n".join(lines) + "\n")
    report = ingest_recordings(copied[:1], [SCENE], tmp_path / "d")
    assert report.drives["there"].cleaning.backward_time == 10
    refused = ingest_recordings(
        copied[:1], [SCENE], tmp_path / "e", IngestOptions(cleaning={"backward_time": "refuse"})
    )
    assert "time runs backward" in str(refused.failures[0][1])


def test_two_drives_with_one_id(copied: list[Path], tmp_path: Path) -> None:
    _rewrite(copied[1], drive_id="there")
    report = ingest_recordings(copied, [SCENE], tmp_path / "d")
    assert len(report.failures) == 1
    assert "drive id 'there' is also that of" in str(report.failures[0][1])
    assert isinstance(report.failures[0][1], RecordingError)
    later = ingest_recordings(copied[1:2], [SCENE], tmp_path / "d")
    assert "is in the dataset already" in str(later.failures[0][1])


def test_rig_with_other_cameras_is_refused(copied: list[Path], tmp_path: Path) -> None:
    ingest_recordings(copied[:1], [SCENE], tmp_path / "d")
    _rewrite(copied[1], reference_camera="rear")
    report = ingest_recordings(copied[1:2], [SCENE], tmp_path / "d")
    assert "rig 'two'" in str(report.failures[0][1])


def test_swapped_roi_is_recognised(drives: list[Path], tmp_path: Path) -> None:
    swapped = SCENE.model_copy(update={"longitude_deg": LAT, "latitude_deg": LON})
    with pytest.raises(UsageError, match="exchanged"):
        ingest_recordings(drives, [swapped], tmp_path / "d")
    assert tree(tmp_path / "d") == {}


def test_no_roi_is_an_error(drives: list[Path], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no ROI"):
        ingest_recordings(drives, [], tmp_path / "d")


def test_a_date_that_is_none_and_a_truncated_video_leave_the_dataset_as_it_was(
    copied: list[Path], real_data: Path, tmp_path: Path
) -> None:
    out = tmp_path / "d"
    ingest_recordings(copied[1:2], [SCENE], out)
    before = tree(out)
    table = tmp_path / "drive.csv"
    table.write_text(f"Date,Time,LAT,LON\n05/31/2021,10:00:00,{LAT},{LON}\n90/02/2032,10:00:01,{LAT},{LON}\n")
    report = ingest_recordings([table], [SCENE], out, IngestOptions(reader_options={"tz": "UTC"}))
    said = str(report.failures[0][1])
    assert "90/02/2032" in said
    assert str(table) in said
    assert "line 3" in said
    assert data_of(out) == before

    shutil.rmtree(copied[0] / "images/rear")
    (copied[0] / "videos").mkdir()
    whole = (real_data / "video" / "highway_h264_960x540.mp4").read_bytes()
    (copied[0] / "videos/rear.mp4").write_bytes(whole[: len(whole) // 2])
    (copied[0] / "videos/rear.csv").write_text(
        "pts,exposure_start_ns,exposure_end_ns\n"
        + "".join(f"{512 * k},{START_NS + k * 140_000_000},{START_NS + k * 140_000_000}\n" for k in range(220))
    )
    report = ingest_recordings(copied[:1], [SCENE], out)
    assert "rear.mp4" in str(report.failures[0][1])
    assert data_of(out) == before


def test_a_dataset_of_another_schema_version_is_refused_and_untouched(copied: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "d"
    ingest_recordings(copied[:1], [SCENE], out)
    document = json.loads((out / "dataset.json").read_text())
    (out / "dataset.json").write_text(json.dumps({**document, "schema_version": "2.0.0"}))
    before = tree(out)
    with pytest.raises(MirrorError, match=r"2\.0\.0 is newer.*pip install --upgrade"):
        ingest_recordings(copied, [SCENE], out)
    assert tree(out) == before
