"""Lidar sweeps from a recording over a dataset to an export and back: the same bytes, stamps and poses."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.dataset.dataset import Dataset
from mirror.export.part import fetch_part
from mirror.export.run import ExportOptions, export
from mirror.geometry import Poses, interpolate
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.integrity import check
from mirror.recordings.lidars import LidarSweeps, read_lidars
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.kitti import LIDAR, RECEIVER, as_raw, write_kitti_raw
from tests.recordings.formats.nuscenes import write_nuscenes
from tests.recordings.formats.street import StreetDrive, synth_drives

MOUNTED = [0.9, 0.0, 1.8]
"""The lidar of the writer of nuScenes, metres."""
MISSING = 14


def ingest(recording: Path, scene: Roi, out: Path, trigger: Mapping[str, object] | None = None) -> Dataset:
    options = IngestOptions(workers=1, trigger=trigger or {})
    assert not ingest_recordings([recording], [scene], out, options).failures
    return mirror.open(out)


@pytest.fixture(scope="module")
def drive() -> StreetDrive:
    return synth_drives()[0]


@pytest.fixture(scope="module")
def nuscenes(drive: StreetDrive, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Dataset]:
    """A scene with sweeps, and its dataset."""
    root = tmp_path_factory.mktemp("nuscenes")
    source = write_nuscenes(root / "source", [drive.with_cameras(("front_wide",))], location="a-place")
    for sweeps in read_lidars(open_recording(source)):
        for number, uri in enumerate(sweeps.uris):
            write(Path(uri), number)
    place = drive.poses.translation[len(drive.poses) // 2]
    scene = Roi(scene_id="place", frame="a-place", x_m=float(place[0]), y_m=float(place[1]), radius_m=100.0)
    return source, ingest(source, scene, root / "dataset")


@pytest.fixture(scope="module")
def kitti(drive: StreetDrive, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Dataset]:
    """A drive of KITTI raw with a sweep 30 ms before each image but one, and the dataset of its middle."""
    root, raw = tmp_path_factory.mktemp("kitti"), as_raw(drive)
    folder = write_kitti_raw(root / "source", raw)
    lidar = folder / "velodyne_points"
    stamps = raw.box_ns - 30_000_123
    (lidar / "data").mkdir(parents=True)
    text = [str(stamp.astype("datetime64[ns]")).replace("T", " ") for stamp in stamps]
    (lidar / "timestamps.txt").write_text("\n".join(text) + "\n")
    for number in set(range(len(stamps))) - {MISSING}:
        write(lidar / "data" / f"{number:010d}.bin", number)
    track, middle = open_recording(folder).track(), len(stamps) // 2
    assert track.longitude_deg is not None and track.latitude_deg is not None
    place = {"longitude_deg": track.longitude_deg[middle], "latitude_deg": track.latitude_deg[middle]}
    scene = Roi(scene_id="street", radius_m=20.0, **place)
    return folder, ingest(folder, scene, root / "dataset", {"min_duration_s": 2.0, "min_path_m": 5.0})


def write(file: Path, seed: int) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(np.random.default_rng(seed).random(40, np.float32).tobytes())


def inside(sweeps: LidarSweeps, dataset: Dataset) -> list[int]:
    """The sweeps within the pass."""
    (row,) = dataset.table("traversals", ["entry_ns", "exit_ns"]).to_pylist()
    return [n for n, stamp in enumerate(sweeps.timestamp_ns.tolist()) if row["entry_ns"] <= stamp <= row["exit_ns"]]


def placed(recording: Recording, stamps: np.ndarray) -> Poses:
    """The vehicle's poses in a local frame."""
    track = recording.track()
    assert track.rotation is not None and track.x_m is not None and track.y_m is not None
    assert track.height_m is not None
    order = np.argsort(track.timestamp_ns, kind="stable")
    poses = Poses(track.rotation, np.column_stack([track.x_m, track.y_m, track.height_m]))[order]
    times, first = np.unique(track.timestamp_ns[order], return_index=True)
    return interpolate(times, poses[first], stamps)


def assert_close(one: Poses, other: Poses, tolerance: float = 1e-9) -> None:
    assert np.abs((one.inverse() @ other).log()).max() < tolerance


def contents(uris: Sequence[str]) -> list[bytes]:
    return [Path(uri).read_bytes() for uri in uris]


def test_sweeps_of_nuscenes_come_back(nuscenes: tuple[Path, Dataset], tmp_path: Path) -> None:
    source, dataset = nuscenes
    (sent,) = read_lidars(open_recording(source))
    own = inside(sent, dataset)
    assert len(own) > 200
    (kept,) = dataset.frames()[0].lidars
    assert (kept.sensor, kept.format) == ("LIDAR_TOP", "nuscenes_pcd_bin")
    assert kept.timestamp_ns.tolist() == sent.timestamp_ns[own].tolist()
    assert kept.uris == tuple(sent.uris[row] for row in own)
    assert_close(kept.ego_SE3_sensor, sent.ego_SE3_sensor[np.array(own)])
    assert kept.ego_SE3_sensor.translation[0].tolist() == MOUNTED
    out = tmp_path / "out"
    export(dataset, "nuscenes", out)
    made = open_recording(out)
    (found,) = read_lidars(made)
    assert (found.sensor, found.format) == (kept.sensor, kept.format)
    assert found.timestamp_ns.tolist() == kept.timestamp_ns.tolist()
    assert contents(found.uris) == contents(kept.uris)
    assert all(out in Path(uri).parents and Path(uri).samefile(old) for uri, old in zip(found.uris, kept.uris))
    assert_close(found.ego_SE3_sensor, kept.ego_SE3_sensor)
    assert_close(placed(made, kept.timestamp_ns), placed(open_recording(source), kept.timestamp_ns))
    # Each frame with boxes has its sweep; the other sweeps lie between them.
    tables = {
        name: json.loads((out / "v1.0-mirror" / f"{name}.json").read_text()) for name in ("sample", "sample_data")
    }
    sweeps = [row for row in tables["sample_data"] if row["filename"].endswith(".pcd.bin")]
    samples = [row["sample_token"] for row in sweeps if row["is_key_frame"]]
    assert sorted(samples) == sorted(row["token"] for row in tables["sample"]) and len(sweeps) == len(kept)
    assert [row["prev"] for row in sweeps[1:]] == [row["token"] for row in sweeps[:-1]]


def test_copies_are_no_links_and_a_second_call_changes_nothing(nuscenes: tuple[Path, Dataset], tmp_path: Path) -> None:
    _, dataset = nuscenes
    options = ExportOptions(copies=True)
    first = export(dataset, "nuscenes", tmp_path / "out", options)
    (found,), (kept,) = read_lidars(open_recording(tmp_path / "out")), dataset.frames()[0].lidars
    assert contents(found.uris) == contents(kept.uris)
    assert not any(Path(uri).samefile(old) for uri, old in zip(found.uris, kept.uris))
    assert export(dataset, "nuscenes", tmp_path / "out", options) == first


def test_sweeps_of_kitti_come_back(kitti: tuple[Path, Dataset], tmp_path: Path) -> None:
    source, dataset = kitti
    (sent,) = read_lidars(open_recording(source))
    assert (sent.sensor, sent.format, len(sent)) == ("velodyne", "kitti_velodyne_bin", 28)
    assert_close(sent.ego_SE3_sensor[:1], RECEIVER @ LIDAR, 1e-7)
    (kept,) = dataset.frames()[0].lidars
    own = inside(sent, dataset)
    assert 10 < len(own) < len(sent) and kept.timestamp_ns.tolist() == sent.timestamp_ns[own].tolist()
    export(dataset, "kitti", tmp_path / "kitti")
    about = json.loads((tmp_path / "kitti" / "sequences.json").read_text())
    assert len(about) == 4
    for sequence in about:
        folder = tmp_path / "kitti" / "sequences" / sequence["sequence"]
        files = sorted((folder / "velodyne").iterdir())
        assert contents([str(file) for file in files]) == contents(kept.uris)
        # An image in the middle has no sweep, and the numbers of the others are those of their images.
        stamps = {int(number): stamp for number, stamp in sequence["lidar"]["timestamp_ns"].items()}
        assert [int(file.stem) for file in files] == sorted(stamps) and list(
            stamps.values()
        ) == kept.timestamp_ns.tolist()
        first, times = sequence["first_timestamp_ns"], np.loadtxt(folder / "times.txt")
        assert all(0 < first + times[number] * 1e9 - stamp < 40e6 for number, stamp in stamps.items())
        lines = dict(line.split(":") for line in (folder / "calib.txt").read_text().splitlines())
        camera_SE3_lidar = Poses.from_matrix(
            np.vstack([np.array(lines["Tr"].split(), np.float64).reshape(3, 4), [[0.0, 0.0, 0.0, 1.0]]])
        )
        mounted = next(one for one in dataset.frames()[0].calibrations if one.camera == sequence["camera"])
        assert_close(mounted.ego_SE3_camera @ camera_SE3_lidar, kept.ego_SE3_sensor[:1])
        assert_close(Poses.from_matrix(np.array([sequence["lidar"]["ego_SE3_lidar"]])), kept.ego_SE3_sensor[:1])
    # Another format keeps the files too, and says what they are.
    written = export(dataset, "nuscenes", tmp_path / "nuscenes")
    assert any("kitti_velodyne_bin, which the devkit does not read" in note for note in written.notes)
    (found,) = read_lidars(open_recording(tmp_path / "nuscenes"))
    assert (found.sensor, found.format) == ("LIDAR_VELODYNE", "kitti_velodyne_bin")
    assert contents(found.uris) == contents(kept.uris)
    assert np.abs(found.timestamp_ns - kept.timestamp_ns).max() <= 500
    assert_close(found.ego_SE3_sensor, kept.ego_SE3_sensor)


def test_a_sweep_that_is_gone_is_named(kitti: tuple[Path, Dataset], tmp_path: Path) -> None:
    source, dataset = kitti
    (kept,) = dataset.frames()[0].lidars
    hidden = Path(kept.uris[5])
    away = hidden.rename(source / "away")
    try:
        (finding,) = [found for rule, found in check(Path(dataset.root)).findings if rule.rule_id == "LID001"]
        assert "unverified" in str(finding) and hidden.name in str(finding)
        written = export(dataset, "kitti", tmp_path / "kitti")
    finally:
        away.rename(hidden)
    assert f"1 of {len(kept)} lidar sweeps are left out" in written.notes[0]
    assert len(list((tmp_path / "kitti" / "sequences" / "0000" / "velodyne").iterdir())) == len(kept) - 1
    assert not any(rule.rule_id.startswith("LID") for rule, _ in check(Path(dataset.root)).findings)


def test_a_fetched_part_has_no_reference(nuscenes: tuple[Path, Dataset], tmp_path: Path) -> None:
    _, dataset = nuscenes
    fetch_part(str(dataset.root), tmp_path / "part")
    assert mirror.open(tmp_path / "part").frames()[0].lidars == ()
    assert not list((tmp_path / "part").rglob("lidars*"))


@pytest.mark.real_data
def test_the_point_clouds_of_a_dgp_scene_come_back(real_data: Path, tmp_path: Path) -> None:
    source = open_recording(real_data / "dgp_scene_02")
    (sent,) = read_lidars(source)
    assert (sent.sensor, sent.format, len(sent)) == ("LIDAR", "dgp_npz", 3)
    track, trigger = source.track(), {"min_duration_s": 0.1, "min_path_m": 0.1}
    assert track.x_m is not None and track.y_m is not None
    scene = Roi(scene_id="dgp", frame=source.info.frame, x_m=track.x_m[0], y_m=track.y_m[0], radius_m=100.0)
    dataset = ingest(real_data / "dgp_scene_02", scene, tmp_path / "dataset", trigger)
    (kept,) = dataset.frames()[0].lidars
    export(dataset, "nuscenes", tmp_path / "out")
    made = open_recording(tmp_path / "out")
    (found,) = read_lidars(made)
    assert (found.sensor, found.format) == ("LIDAR", "dgp_npz")
    assert kept.timestamp_ns.tolist() == sent.timestamp_ns.tolist()
    # Stamps of nuScenes are microseconds; those of the scene count 100 ns.
    assert np.abs(found.timestamp_ns - sent.timestamp_ns).max() <= 500
    assert contents(found.uris) == contents(sent.uris)
    assert_close(found.ego_SE3_sensor, sent.ego_SE3_sensor)
    assert_close(placed(made, found.timestamp_ns), placed(source, sent.timestamp_ns))
