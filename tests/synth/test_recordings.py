"""What is written is what was: the folder reader gives back the truth, within the stated errors."""

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror.synth
from mirror.errors import UsageError
from mirror.geometry import angle_between_deg, matrix_from_quaternion, quaternion_from_matrix, quaternion_multiply
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.poses import Poses
from mirror.ingest.rois import read_rois
from mirror.recordings.folder import FolderReader
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.synth.fleet import drives_of


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return mirror.synth.write_recordings(tmp_path_factory.mktemp("synth") / "tiny", workers=2)


def digest(folder: Path) -> dict[str, str]:
    return {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def test_files_do_not_depend_on_the_number_of_threads(tiny: list[Path], tmp_path: Path) -> None:
    mirror.synth.write_recordings(tmp_path / "again", traversals=1, workers=1)
    again = digest(tmp_path / "again" / tiny[0].name)
    assert len(again) > 100
    assert again == digest(tiny[0])


def test_rois_are_those_of_the_scenes(tiny: list[Path]) -> None:
    assert read_rois(tiny[0].parent / "rois.geojson") == [drives_of("tiny", 0)[1][0].world.roi]


def test_recorded_poses_are_the_true_ones_within_the_stated_noise(tiny: list[Path]) -> None:
    for path, drive in zip(tiny, drives_of("tiny", 0)[1]):
        track = FolderReader().open(path, {}).track()
        truth = drive.world_SE3_ego(track.timestamp_ns)
        world = drive.frame.from_geodetic(track.longitude_deg, track.latitude_deg, track.height_m)
        off = np.linalg.norm(world - truth.translation, axis=1)
        assert 0.005 < off.mean() < 0.1
        assert off.max() < 0.25
        world_R_enu = quaternion_from_matrix(drive.frame.world_R_enu(track.longitude_deg, track.latitude_deg))
        turned = angle_between_deg(quaternion_multiply(world_R_enu, track.rotation), truth.rotation)
        assert 0.005 < turned.mean() < 0.1
        assert turned.max() < 0.2


def test_pictures_lie_within_the_poses_and_one_is_lost(tiny: list[Path]) -> None:
    for path, drive in zip(tiny, drives_of("tiny", 0)[1]):
        recording = FolderReader().open(path, {})
        images, stamps = recording.images(), recording.track().timestamp_ns
        assert (recording.rig is not None) == bool(images) == drive.recipe.pictures
        if not images:
            continue
        assert tuple(images) == CANONICAL_CAMERAS
        lengths = {name: len(stream.exposure_start_ns) for name, stream in images.items()}
        lost = drive.recipe.dropped
        assert lengths["front_wide"] - lengths["rear"] == (1 if lost else 0)
        for name, stream in images.items():
            assert stamps[0] < stream.exposure_start_ns[0]
            assert stream.exposure_end_ns[-1] < stamps[-1]
            picture = cv2.imread(str(stream.path(3)))
            assert picture.shape == (90, 160, 3)
            assert picture.std() > 10, name


def test_calibrations_are_off_the_truth_by_the_errors_of_their_stage(tiny: list[Path]) -> None:
    vehicle = drives_of("tiny", 0)[1][0].vehicle
    table = FolderReader().open(tiny[0], {}).calibrations().to_pandas()
    errors = {"factory": [], "online": []}
    for row in table.to_dict("records"):
        true = vehicle.ego_SE3_camera[row["camera"]]
        believed = Poses.from_columns({name: [row[name]] for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")})
        errors[row["stage"]].append(float(angle_between_deg(true.rotation, believed.rotation)[0]))
        assert np.linalg.norm(true.translation - believed.translation) < 0.06
    assert len(errors["factory"]) == len(errors["online"]) == 7
    assert 0.1 < np.mean(errors["factory"]) < 1.0
    assert 0.01 < np.mean(errors["online"]) < 0.15
    assert set(table["model"]) == {"kannala_brandt", "pinhole"}


@pytest.mark.parametrize("number", [0, 1])
def test_boxes_enclose_what_is_drawn(tiny: list[Path], number: int) -> None:
    drive = drives_of("tiny", 0)[1][number]
    boxes = FolderReader().open(tiny[number], {}).boxes().to_pandas()
    stamp = int(np.unique(boxes["timestamp_ns"])[6])
    rows = boxes[boxes["timestamp_ns"] == stamp]
    time_s = (stamp - drive.condition.start_ns) * 1e-9
    ego = drive.world_SE3_ego(np.array([stamp]))
    instant = drive.stage.at(time_s, ego)
    names = [user.track_id for user in drive.stage.users]
    ego_SE3_box = Poses.from_columns(rows)
    sizes = rows[["length_m", "width_m", "height_m"]].to_numpy()
    held = 0
    for camera in CANONICAL_CAMERAS:
        mounting = drive.vehicle.ego_SE3_camera[camera]
        picture = drive.stage.picture(instant, drive.lenses[camera], ego @ mounting, 0)
        lens = drive.vehicle.cameras[camera]
        projected = project_boxes(lens, mounting.inverse() @ ego_SE3_box, sizes)
        for place, track_id in enumerate(rows["track_id"]):
            v, u = np.nonzero(picture.object == names.index(track_id))
            if not len(u):
                continue
            assert projected.visible[place]
            hull = projected.hull(place).astype(np.float32)
            inside = [cv2.pointPolygonTest(hull, (float(a) + 0.5, float(b) + 0.5), True) for a, b in zip(u, v)]
            assert min(inside) > -0.1, (camera, track_id)
            held += len(u)
    assert held > 500


def test_distances_are_those_of_the_ground_and_the_sky_has_none(tiny: list[Path]) -> None:
    drive = drives_of("tiny", 0)[1][0]
    ego = drive.truth.poses(np.array([6.0]))
    instant = drive.stage.at(6.0, ego)
    pose = ego @ drive.vehicle.ego_SE3_camera["rear"]
    lens = drive.lenses["rear"]
    picture = drive.stage.picture(instant, lens, pose, 0)
    directions = lens.rays @ matrix_from_quaternion(pose.rotation)[0].T
    height = pose.translation[0, 2] + picture.distance_m * directions[..., 2]
    known = picture.distance_m < 1e8
    assert 0.05 < (~known).mean() < 0.6
    assert height[known].min() > -1e-3
    ground = known & (np.abs(height) < 1e-3)
    assert ground.mean() > 0.3


def test_the_mask_of_the_vehicle_itself_is_where_its_bonnet_is_drawn(tiny: list[Path]) -> None:
    rig = FolderReader().open(tiny[0], {}).rig
    masks = {camera.name: camera.static_mask for camera in rig.cameras if camera.static_mask is not None}
    assert list(masks) == ["front_wide"]
    mask = masks["front_wide"]
    assert mask.shape == (90, 160)
    assert 0.05 < (mask > 0).mean() < 0.4
    assert mask[-1, 80] and not mask[:45].any()
    # The bonnet stays while the street goes by: pictures under the mask differ less than those beside it.
    stream = FolderReader().open(tiny[0], {}).images()["front_wide"]
    pictures = np.stack([cv2.imread(str(stream.path(index))) for index in range(4, 12)]).astype(float)
    change = pictures.std(axis=0).mean(axis=2)
    assert change[mask > 0].mean() < change[45:][mask[45:] == 0].mean()


def test_misuse_is_named(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("mine")
    with pytest.raises(UsageError, match="not an empty folder"):
        mirror.synth.write_recordings(tmp_path / "full")
    with pytest.raises(UsageError, match="no preset 'huge'"):
        mirror.synth.write_recordings(tmp_path / "a", "huge")
    with pytest.raises(UsageError, match="3 scenes"):
        mirror.synth.write_recordings(tmp_path / "b", "demo", scenes=3)
    with pytest.raises(UsageError, match="0 traversals"):
        mirror.synth.write_recordings(tmp_path / "c", traversals=0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full"]
