"""Tests of written recordings: the folder reader returns the truth within the stated errors."""

import hashlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror.synth
from mirror.errors import DatasetError, UsageError
from mirror.geometry import angle_between_deg, quaternion_from_matrix, quaternion_multiply
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.poses import Poses
from mirror.ingest.rois import read_rois
from mirror.metrics.safety import inside_area
from mirror.recordings.readers.folder import FolderReader
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.schema.road_map import encode_road_map, read_road_map
from mirror.synth import PRESETS, Errors, SynthReport, street_map
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drives
from mirror.synth.model import Label
from mirror.synth.truth import Truth
from mirror.synth.writing.journal import open_journal
from mirror.synth.writing.poses import write_poses
from mirror.synth.writing.truth import TRUTH_KINDS
from tests.interruption import InterruptingProgress

Recorded = tuple[Path, SynthDrive]


@pytest.fixture(scope="module")
def tiny(tiny_recordings: SynthReport) -> SynthReport:
    return tiny_recordings


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """The first recording, written by one thread, with all kinds of truth."""
    out = tmp_path_factory.mktemp("synth") / "again"
    written = mirror.synth.write_recordings(out, traversals=1, workers=1, truth=TRUTH_KINDS)
    return written.recordings[0], make_drives("tiny", 0)[1][0]


def digest(folder: Path) -> dict[str, str]:
    return {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file() and "truth" not in file.relative_to(folder).parts
    }


def recordings(tiny: SynthReport) -> list[Recorded]:
    return list(zip(tiny.recordings, make_drives("tiny", 0)[1]))


def test_files_depend_neither_on_threads_nor_on_truth_kinds(tiny: SynthReport, first: Recorded) -> None:
    again = digest(first[0])
    assert len(again) > 100
    assert again == digest(tiny.recordings[0])


def test_the_exact_map_of_the_scene_lies_beside_the_recordings(tiny: SynthReport) -> None:
    drive = make_drives("tiny", 0)[1][0]
    path = tiny.recordings[0].parent / "maps" / f"{drive.roi.scene_id}.parquet"
    road_map = read_road_map(path)
    assert path.read_bytes() == encode_road_map(street_map(drive.world.plan)) == encode_road_map(road_map)
    times = np.arange(0.0, drive.truth.duration_s, 0.5)
    assert inside_area(drive.truth.poses(times).translation[:, :2], road_map.drivable_rings).all()


def test_rois_geojson_lists_the_scenes(tiny: SynthReport) -> None:
    assert read_rois(tiny.recordings[0].parent / "rois.geojson") == [make_drives("tiny", 0)[1][0].roi]


def test_recorded_poses_match_the_truth_within_the_noise(tiny: SynthReport) -> None:
    for path, drive in recordings(tiny):
        track = FolderReader().open(path, {}).track()
        truth = drive.world_SE3_ego(track.timestamp_ns)
        world = drive.frame.from_geodetic(track.longitude_deg, track.latitude_deg, track.height_m)
        off = np.linalg.norm(world - truth.translation, axis=1)
        assert 0.005 < off.mean() < 0.15
        assert off.max() < 0.3
        world_R_enu = quaternion_from_matrix(drive.frame.world_R_enu(track.longitude_deg, track.latitude_deg))
        turned = angle_between_deg(quaternion_multiply(world_R_enu, track.rotation), truth.rotation)
        assert 0.005 < turned.mean() < 0.1
        assert turned.max() < 0.2


def test_recordings_without_errors_equal_the_truth(tiny: SynthReport, tmp_path: Path) -> None:
    drive = make_drives("tiny", 0)[1][2]
    (tmp_path / "recording.json").write_bytes((tiny.recordings[2] / "recording.json").read_bytes())
    write_poses(tmp_path, drive, Errors.none())
    track = FolderReader().open(tmp_path, {}).track()
    world = drive.frame.from_geodetic(track.longitude_deg, track.latitude_deg, track.height_m)
    np.testing.assert_allclose(world, drive.world_SE3_ego(track.timestamp_ns).translation, atol=1e-5)
    assert track.sigma_m is None


@pytest.mark.parametrize("style", ["csv", "parquet", "parts", "gps", "heading"])
def test_every_pose_format_is_read_back(tiny: SynthReport, tmp_path: Path, style: str) -> None:
    drive = make_drives("tiny", 0)[1][2]
    styled = replace(drive, recipe=replace(drive.recipe, poses=style))
    text = (tiny.recordings[2] / "recording.json").read_text()
    (tmp_path / "recording.json").write_text(text.replace("unix_ns", "gps_us") if style == "gps" else text)
    write_poses(tmp_path, styled, drive.preset.errors)
    track = FolderReader().open(tmp_path, {}).track()
    truth = drive.world_SE3_ego(track.timestamp_ns)
    height = truth.translation[:, 2] if track.height_m is None else track.height_m
    world = drive.frame.from_geodetic(track.longitude_deg, track.latitude_deg, height)
    assert np.linalg.norm((world - truth.translation)[:, :2], axis=1).max() < 0.3
    assert angle_between_deg(track.rotation, truth.rotation).max() < (8.0 if style == "heading" else 0.5)


def test_image_times_lie_within_the_poses_and_one_image_is_lost(tiny: SynthReport) -> None:
    lost = 0
    for path, drive in recordings(tiny):
        recording = FolderReader().open(path, {})
        images, stamps = recording.images(), recording.track().timestamp_ns
        assert (recording.rig is not None) == bool(images) == drive.recipe.images
        if not images:
            continue
        assert tuple(images) == CANONICAL_CAMERAS
        lengths = {name: len(stream.exposure_start_ns) for name, stream in images.items()}
        lost += lengths["front_wide"] - lengths["rear"]
        for name, stream in images.items():
            assert stamps[0] < stream.exposure_start_ns[0]
            assert stream.exposure_end_ns[-1] < stamps[-1]
            image, camera = cv2.imread(str(stream.path(3))), drive.vehicle.cameras[name]
            assert image.shape == (camera.height_px, camera.width_px, 3)
            assert image.std() > 5, name
    assert lost == tiny.lost == 1
    assert tiny.images == sum(1 for _ in tiny.recordings[0].parent.rglob("*.jpg"))


def test_calibration_errors_match_their_stage(tiny: SynthReport) -> None:
    path, drive = recordings(tiny)[0]
    table = FolderReader().open(path, {}).calibrations().to_pandas()
    errors = {"factory": [], "online": []}
    for row in table.to_dict("records"):
        true = drive.vehicle.ego_SE3_camera[row["camera"]]
        believed = Poses.from_columns({name: [row[name]] for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")})
        errors[row["stage"]].append(float(angle_between_deg(true.rotation, believed.rotation)[0]))
        assert np.linalg.norm(true.translation - believed.translation) < 0.06
    assert len(errors["factory"]) == len(errors["online"]) == 7
    assert 0.1 < np.mean(errors["factory"]) < 1.0
    assert 0.01 < np.mean(errors["online"]) < 0.15


def test_boxes_enclose_the_rendered_objects(tiny: SynthReport) -> None:
    held = 0
    for path, drive in recordings(tiny)[:2]:
        boxes = FolderReader().open(path, {}).boxes().to_pandas()
        counts = boxes["timestamp_ns"].value_counts()
        stamp = int(counts.index[0])
        rows = boxes[boxes["timestamp_ns"] == stamp]
        clock = drive.preset.errors.draw_clocks(CANONICAL_CAMERAS, np.random.default_rng([drive.seed, 2]))["front_wide"]
        true_ns = stamp - clock.error_ns
        instant = drive.at(true_ns)
        names = [user.track_id for user in drive.road_users]
        sizes = rows[["length_m", "width_m", "height_m"]].to_numpy()
        for camera, lens in drive.vehicle.cameras.items():
            image = drive.render(camera, true_ns, instant)
            mounting = drive.vehicle.ego_SE3_camera[camera]
            projected = project_boxes(lens, mounting.inverse() @ Poses.from_columns(rows), sizes)
            for place, track_id in enumerate(rows["track_id"]):
                v, u = np.nonzero(image.view.object == names.index(track_id))
                if not len(u):
                    continue
                assert projected.visible[place]
                hull = projected.hull(place).astype(np.float32)
                inside = [cv2.pointPolygonTest(hull, (float(a) + 0.5, float(b) + 0.5), True) for a, b in zip(u, v)]
                assert min(inside) > -1.0, (camera, track_id)
                held += len(u)
    assert held > 500


def test_ego_mask_covers_the_rendered_bonnet(tiny: SynthReport) -> None:
    path, drive = recordings(tiny)[0]
    rig = FolderReader().open(path, {}).rig
    masks = {camera.name: camera.static_mask for camera in rig.cameras if camera.static_mask is not None}
    mask = masks["front_wide"]
    assert 0.05 < (mask > 0).mean() < 0.4
    true_ns = drive.condition.start_ns + 3_000_000_000
    label = drive.render("front_wide", true_ns).view.label
    assert (mask[label == Label.EGO] == 255).all()
    assert (label == Label.EGO).sum() > 0.8 * (mask > 0).sum()


def test_exact_poses_and_calibrations_are_written_beside_the_recording(first: Recorded) -> None:
    path, drive = first
    truth = Truth(path)
    poses = truth.poses().to_pandas()
    assert sorted(poses["body"].unique()) == sorted(("ego", *CANONICAL_CAMERAS))
    recorded = FolderReader().open(path, {})
    ego = poses[poses["body"] == "ego"]
    np.testing.assert_array_equal(ego["timestamp_ns"], recorded.track().timestamp_ns)
    for name, stream in recorded.images().items():
        rows = poses[poses["body"] == name]
        middle = stream.exposure_start_ns + (stream.exposure_end_ns - stream.exposure_start_ns) // 2
        np.testing.assert_array_equal(rows["timestamp_ns"], middle)
        assert np.abs(rows["true_ns"] - rows["timestamp_ns"]).max() < 1_000_000
        expected = drive.world_SE3_camera(name, rows["true_ns"].to_numpy())
        np.testing.assert_allclose(Poses.from_columns(rows).matrix(), expected.matrix(), atol=1e-12)
    lenses = {one.camera: one for one in truth.calibrations()}
    assert lenses["rear"].fx_px == drive.vehicle.cameras["rear"].fx_px


def test_flow_maps_points_to_the_next_image(first: Recorded) -> None:
    """Compares the flow with the distances of the next image, at points that both images show."""
    path, drive = first
    truth, camera = Truth(path), "rear"
    poses = truth.poses().to_pandas()
    rows = poses[poses["body"] == camera].reset_index(drop=True)
    moved = np.hypot(*np.diff(rows[["tx_m", "ty_m"]].to_numpy(), axis=0).T)
    number = int(np.argmax(moved))
    before, after = (int(rows["timestamp_ns"][number + step]) for step in (0, 1))
    flow = truth.read("flow", camera, before)
    distance, later = truth.read("depth", camera, before), truth.read("depth", camera, after)
    lens = drive.vehicle.cameras[camera]
    here, there = (Poses.from_columns(rows.iloc[[number + step]]) for step in (0, 1))
    v, u = np.mgrid[0 : lens.height_px, 0 : lens.width_px]
    goes = np.round(np.stack([u, v], axis=-1) + flow)
    labels = truth.read("semantic", camera, before)
    near = np.isfinite(distance) & np.isfinite(goes).all(axis=-1) & (labels < 6)
    near &= (goes[..., 0] >= 0) & (goes[..., 0] < lens.width_px) & (goes[..., 1] >= 0) & (goes[..., 1] < lens.height_px)
    points = here.transform(lens.rays().direction[near] * distance[near][:, None])[0]
    expected = np.linalg.norm(points - there.translation[0], axis=1)
    column, row = goes[near].astype(int).T
    seen = later[row, column]
    agree = np.abs(seen / expected - 1.0) < 0.1
    assert near.sum() > 500
    assert agree.mean() > 0.7


def test_truth_masks_and_boxes_agree_on_the_objects(first: Recorded) -> None:
    path, drive = first
    truth = Truth(path)
    boxes = truth.boxes().to_pandas()
    objects = [one.track_id for one in truth.document.objects]
    assert objects == [user.track_id for user in drive.road_users]
    shown = boxes[boxes["pixels"] > 0]
    assert len(shown) > 50
    assert shown["visibility"].between(0.0, 1.0).all() and (shown["visibility"] < 0.9).any()
    for row in shown.sample(12, random_state=1).itertuples():
        mask = truth.read("instance", row.camera, row.timestamp_ns) == objects.index(row.track_id) + 1
        assert mask.sum() == row.pixels
        v, u = np.nonzero(mask)
        assert (u.min(), v.min(), u.max() + 1, v.max() + 1) == (row.u_min_px, row.v_min_px, row.u_max_px, row.v_max_px)


def test_normals_agree_with_the_distances(first: Recorded) -> None:
    path, drive = first
    truth, camera = Truth(path), "rear"
    stamp = int(truth.poses().to_pandas().query("body == @camera")["timestamp_ns"].iloc[4])
    normals, distance = truth.read("normals", camera, stamp), truth.read("depth", camera, stamp)
    assert np.array_equal(np.isnan(normals).any(axis=2), np.isinf(distance))
    rays = drive.vehicle.cameras[camera].rays().direction
    known = np.isfinite(distance)
    np.testing.assert_allclose(np.linalg.norm(normals[known], axis=1), 1.0, atol=1e-4)
    assert (np.einsum("ij,ij->i", normals[known], rays[known]) < 1e-3).all()
    points = rays * np.where(known, distance, np.nan)[..., None]
    across, down = points[1:-1, 2:] - points[1:-1, :-2], points[2:, 1:-1] - points[:-2, 1:-1]
    plane = np.cross(across, down)
    plane /= np.linalg.norm(plane, axis=2, keepdims=True)
    cosine = np.abs((plane * normals[1:-1, 1:-1]).sum(axis=2))
    assert np.nanmedian(cosine) > 0.999


def test_an_interrupted_run_resumes_and_keeps_complete_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # With few and small images, since they are all written twice.
    monkeypatch.setitem(PRESETS, "tiny", replace(PRESETS["tiny"], width_px=64, image_hz=0.15))
    whole = mirror.synth.write_recordings(tmp_path / "whole", workers=2)
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        mirror.synth.write_recordings(out, workers=2, progress=InterruptingProgress(6, phases=1))
    kept = out / whole.recordings[0].name / "recording.json"
    before, half = kept.stat().st_mtime_ns, out / whole.recordings[1].name
    assert half.exists() and not (half / "recording.json").exists()
    with pytest.raises(UsageError, match="recordings made with another --seed"):
        mirror.synth.write_recordings(out, seed=1)
    # The state that a killed process leaves behind.
    (half / "images" / ".half.jpg.77.tmp").write_bytes(b"half")
    (out / ".synth.json.77.tmp").write_bytes(b"half")
    again = mirror.synth.write_recordings(out, workers=2)
    assert kept.stat().st_mtime_ns == before
    assert digest(out) == digest(tmp_path / "whole")
    counts = [(one.images, one.lost, one.boxes, one.unseen) for one in (again, whole)]
    assert counts[0] == counts[1]
    assert mirror.synth.write_recordings(out, workers=2) == again


def test_a_second_writer_of_the_same_folder_is_refused(tmp_path: Path) -> None:
    with (
        open_journal(tmp_path / "out", {"seed": "0"}),
        pytest.raises(DatasetError, match="another run is writing"),
        open_journal(tmp_path / "out", {"seed": "0"}),
    ):
        pass


def test_invalid_arguments_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("mine")
    with pytest.raises(UsageError, match="a folder with other files"):
        mirror.synth.write_recordings(tmp_path / "full")
    with pytest.raises(UsageError, match="no preset 'huge'"):
        mirror.synth.write_recordings(tmp_path / "a", "huge")
    with pytest.raises(UsageError, match="3 scenes"):
        mirror.synth.write_recordings(tmp_path / "b", "demo", scenes=3)
    with pytest.raises(UsageError, match="0 traversals"):
        mirror.synth.write_recordings(tmp_path / "c", traversals=0)
    with pytest.raises(UsageError, match="truth of kinds boxes, depth"):
        mirror.synth.write_recordings(tmp_path / "d", "paper", truth=("depth", "boxes", "poses"))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full"]
