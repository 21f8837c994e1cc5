"""Small valid recordings, each with a ROI that it passes through; the tests damage them.

`BASES` holds a synthetic recording for every reader, `REAL_BASES` slices of real recordings.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyproj

from mirror.geometry.geodesy import ecef_R_enu
from mirror.geometry.quaternions import quaternion_from_matrix
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from mirror.schema.files import write_table
from mirror.schema.tables import BOXES
from tests.builders.folder import LAT, LON, START_NS, locate_on_street, write_recording
from tests.recordings.formats.argoverse2 import write_argoverse2
from tests.recordings.formats.colmap import write_colmap
from tests.recordings.formats.kitti import as_raw, from_first_camera, write_kitti_odometry, write_kitti_raw
from tests.recordings.formats.kitti360 import write_kitti360
from tests.recordings.formats.nuplan import write_nuplan
from tests.recordings.formats.nuscenes import write_nuscenes
from tests.recordings.formats.street import straight_drive
from tests.recordings.formats.video_gps import Fixes, camm6, gps5, write_video
from tests.recordings.formats.waymo import write_waymo

SECONDS = np.arange(0.0, 12.05, 0.1)
SPEED_MPS = 8.0
_POSITIONS = {"qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "tx_m": 9.0, "ty_m": 1.0, "tz_m": 0.8}
_SIZES = {"length_m": 4.5, "width_m": 1.9, "height_m": 1.6}


@dataclass(frozen=True)
class Base:
    """A valid recording.

    Attributes:
        reader: name of its reader.
        path: its folder.
        roi: a scene that it passes through once.
        drive: the recording's path in the folder; empty: the folder itself.
    """

    reader: str
    path: Path
    roi: Roi
    drive: str = ""

    @property
    def recording(self) -> Path:
        """The path that is ingested."""
        return self.path / self.drive

    @property
    def files(self) -> list[Path]:
        """Every file of the recording, sorted."""
        return sorted(file for file in self.path.rglob("*") if file.is_file())


def image(suffix: str, size: tuple[int, int], seed: int = 0) -> bytes:
    """An encoded image of (width, height): blocks of one colour, which a large PNG keeps in little time."""
    small = np.random.default_rng(seed).integers(0, 255, (6, 8, 3), np.uint8)
    return cv2.imencode(suffix, cv2.resize(small, size, interpolation=cv2.INTER_NEAREST))[1].tobytes()


def box_rows(stamps: list[int]) -> pa.Table:
    """One box of one car at each stamp."""
    columns = {field.name: pa.nulls(len(stamps), field.type) for field in BOXES.schema}
    for name, value in {**_POSITIONS, **_SIZES}.items():
        columns[name] = pa.array([value] * len(stamps))
    for name, text in {"track_id": "7", "category": "car", "source": "people", "source_version": "1.2"}.items():
        columns[name] = pa.array([text] * len(stamps))
    columns["timestamp_ns"] = pa.array(stamps, pa.int64())
    return pa.table(columns)


def folder(root: Path) -> Base:
    """Two cameras, a mask, boxes, a quaternion for each pose."""
    path = write_recording(root, "drive", from_m=-40.0, to_m=60.0)
    lines = (path / "poses.csv").read_text().splitlines()
    rows = [line.rpartition(",")[0] + ",1.0,0.0,0.0,0.0,0.1" for line in lines[1:]]
    header = lines[0].rpartition(",")[0] + ",qw,qx,qy,qz,sigma_m"
    (path / "poses.csv").write_text("\n".join([header, *rows]) + "\n")
    document = json.loads((path / "recording.json").read_text())
    document["cameras"]["front_wide"] = {"static_mask": "masks/front_wide.png"}
    (path / "recording.json").write_text(json.dumps(document, indent=1))
    (path / "masks").mkdir()
    (path / "masks" / "front_wide.png").write_bytes(cv2.imencode(".png", np.zeros((48, 64), np.uint8))[1].tobytes())
    stamps = sorted(int(file.stem) for file in (path / "images" / "rear").iterdir())
    exposures = "file,exposure_start_ns,exposure_end_ns\n" + "".join(f"{t}.jpg,{t},{t + 2000}\n" for t in stamps)
    (path / "images" / "rear.csv").write_text(exposures)
    write_table(path / "boxes.parquet", box_rows(stamps), BOXES)
    return Base("folder", path, Roi(scene_id="s", longitude_deg=LON, latitude_deg=LAT, radius_m=60.0))


def csv(root: Path) -> Base:
    """A GPS table of seconds since 1970."""
    lon, lat = locate_on_street(-40.0 + SPEED_MPS * SECONDS)
    rows = [f"{1_700_000_000 + t:.1f},{x:.9f},{y:.9f},520.0,1.5,Clear" for t, x, y in zip(SECONDS, lon, lat)]
    path = root / "drive"
    path.mkdir(parents=True)
    (path / "track.csv").write_text("timestamp,longitude,latitude,altitude,accuracy,weather\n" + "\n".join(rows) + "\n")
    return Base("csv", path, Roi(scene_id="s", longitude_deg=LON, latitude_deg=LAT, radius_m=60.0))


def boreas(root: Path) -> Base:
    """A sequence with images and a calibration; eastward."""
    path = root / "boreas-2021-08-05-13-34"
    (path / "camera").mkdir(parents=True)
    (path / "calib").mkdir()
    stamps = (1_628_184_886_000_000 + SECONDS * 1e6).astype(np.int64)
    header = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x"
    rows = [
        f"{t},{623400.0 + SPEED_MPS * s:.3f},4848821.131,153.6,8,0,0,1.71685,-1.32829,-0.15702,0,0,0"
        for t, s in zip(stamps, SECONDS)
    ]
    (path / "camera_poses.csv").write_text("\n".join([header, *rows]) + "\n")
    (path / "calib" / "P_camera.txt").write_text("1460.98 0 1230.0 0\n0 1460.93 1035.08 0\n0 0 1 0\n0 0 0 1\n")
    data = image(".png", (2448, 2048))
    for stamp in stamps[10:110:20]:
        (path / "camera" / f"{stamp}.png").write_bytes(data)
    lon, lat = pyproj.Transformer.from_crs(32617, 4326, always_xy=True).transform(623448.0, 4848821.131)
    return Base("boreas", path, Roi(scene_id="s", longitude_deg=lon, latitude_deg=lat, radius_m=60.0))


def comma2k19(root: Path) -> Base:
    """A route of two segments; straight on along the ellipsoid's surface."""
    path = root / "b0c9d2329ad1606b_2018-08-02--08-34-47"
    lon, lat = locate_on_street(-40.0 + SPEED_MPS * SECONDS)
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    position = np.column_stack(to_ecef.transform(lon, lat, np.full(len(lon), 520.0)))
    # Forward east, right south, down: columns of enu_R_device, turned into ECEF.
    enu_from_device = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    east = quaternion_from_matrix(ecef_R_enu(LON, LAT) @ enu_from_device).reshape(4)
    for number, rows in enumerate(np.array_split(np.arange(len(SECONDS)), 2)):
        here = path / str(number) / "global_pose"
        here.mkdir(parents=True)
        arrays = {
            "frame_gps_times": np.column_stack([np.full(len(rows), 2012.0), 404_000.0 + SECONDS[rows]]),
            "frame_positions": position[rows],
            "frame_orientations": np.tile(east, (len(rows), 1)),
        }
        for name, array in arrays.items():
            with (here / name).open("wb") as file:
                np.save(file, array)
    return Base("comma2k19", path, Roi(scene_id="s", longitude_deg=LON, latitude_deg=LAT, radius_m=60.0))


def dgp(root: Path) -> Base:
    """A scene of one camera and one lidar with boxes; along x of its own frame."""
    path = root / "scene"
    for name in ("calibration", "ontology", "rgb/CAM", "bounding_box_3d/LIDAR"):
        (path / name).mkdir(parents=True)
    level = {"qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0}
    forward = {"qw": 0.5, "qx": -0.5, "qy": 0.5, "qz": -0.5}
    samples, data = [], []
    for number, seconds in enumerate(SECONDS[::5]):
        stamp = np.datetime64(START_NS + round(seconds * 1e9), "ns")
        text = str(stamp.astype("datetime64[us]")) + "Z"
        name = f"{number:06d}"
        (path / "rgb" / "CAM" / f"{name}.jpg").write_bytes(image(".jpg", (64, 48), number))
        place = {"x": SPEED_MPS * seconds - 40.0, "y": 0.0, "z": 0.0}
        camera_datum = {
            "image": {
                "filename": f"rgb/CAM/{name}.jpg", "width": 64, "height": 48, "channels": 3, "annotations": {},
                "pose": {"rotation": forward, "translation": {**place, "z": 1.6}},
            }
        }  # fmt: skip
        cloud = {
            "point_cloud": {
                "filename": f"point_cloud/LIDAR/{name}.npz",
                "annotations": {"1": f"bounding_box_3d/LIDAR/{name}.json"},
                "pose": {"rotation": level, "translation": place},
            }
        }
        for sensor, content in (("CAM", camera_datum), ("LIDAR", cloud)):
            key = f"{sensor.lower()}{number}"
            data.append({"id": {"name": sensor, "timestamp": text, "log": "l"}, "key": key, "datum": content})
        samples.append({"calibration_key": "cal", "datum_keys": [f"cam{number}", f"lidar{number}"]})
        box = {
            "class_id": 1,
            "instance_id": 7,
            "box": {
                "pose": {"rotation": level, "translation": {"x": 9.0, "y": 1.0, "z": 0.8}},
                "length": 4.5, "width": 1.9, "height": 1.6,
            },
        }  # fmt: skip
        (path / "bounding_box_3d" / "LIDAR" / f"{name}.json").write_text(json.dumps({"annotations": [box]}))
    origin = {"x": 0.0, "y": 0.0, "z": 0.0}
    calibration = {
        "names": ["CAM", "LIDAR"],
        "extrinsics": [
            {"rotation": forward, "translation": {**origin, "z": 1.6}},
            {"rotation": level, "translation": origin},
        ],
        "intrinsics": [{"fx": 50.0, "fy": 50.0, "cx": 31.5, "cy": 23.5}, {}],
    }
    (path / "calibration" / "cal.json").write_text(json.dumps(calibration))
    (path / "ontology" / "ont.json").write_text(json.dumps({"items": [{"id": 1, "name": "Car"}]}))
    scene = {"name": "s", "log": "l", "ontologies": {"1": "ont"}, "samples": samples, "data": data}
    (path / "scene_0123456789.json").write_text(json.dumps(scene, indent=1))
    roi = Roi(scene_id="s", frame="scene_01234567", x_m=0.0, y_m=0.0, radius_m=60.0)
    return Base("dgp", path, roi)


def mcap(root: Path) -> Base:
    """A log of ROS 2 messages with its topics file."""
    from tests.recordings.readers.message_logs.writer import TOPICS, drive, messages, write_mcap

    path = root / "monday"
    path.mkdir(parents=True)
    write_mcap(path / "monday_0.mcap", messages(drive(12.0)))
    (path / "topics.toml").write_text(TOPICS)
    return Base("mcap", path, Roi(scene_id="s", longitude_deg=LON, latitude_deg=LAT, radius_m=200.0))


def rosbag2(root: Path) -> Base:
    """The same log as a database."""
    from tests.recordings.readers.message_logs.writer import TOPICS, drive, messages, write_rosbag2

    path = root / "monday"
    path.mkdir(parents=True)
    write_rosbag2(path / "monday_0.db3", messages(drive(12.0)), definitions=True)
    (path / "topics.toml").write_text(TOPICS)
    return Base("rosbag2", path, Roi(scene_id="s", longitude_deg=LON, latitude_deg=LAT, radius_m=200.0))


def nuscenes(root: Path) -> Base:
    """One scene of two cameras, in a map of no known place."""
    path = write_nuscenes(root / "nuscenes", [straight_drive()], location="town")
    return Base("nuscenes", path, Roi(scene_id="s", frame="town", x_m=8.0, y_m=0.0, radius_m=60.0))


def argoverse2(root: Path) -> Base:
    """One log in the city's frame."""
    path = write_argoverse2(root, straight_drive().placed((5122.0, 2432.0, 66.0)))
    return Base("argoverse2", path, _roi_around(path, "argoverse2"))


def colmap(root: Path) -> Base:
    """A text model of two cameras without a rig."""
    path = write_colmap(root / "photos", [straight_drive()], text=True, rigs=False)
    return Base("colmap", path, Roi(scene_id="s", frame="colmap_photos", x_m=0.0, y_m=0.0, radius_m=60.0))


def colmap_rig(root: Path) -> Base:
    """A binary model of a rig of two cameras."""
    base = colmap(root)
    shutil.rmtree(base.path)
    write_colmap(base.path, [straight_drive()])
    return base


def nuplan(root: Path) -> Base:
    """A log with the images of one camera."""
    drive = straight_drive().placed((664_400.0, 3_998_300.0, 605.0)).with_cameras(("front_wide",))
    database = write_nuplan(root / "nuplan", drive)
    roi = _roi_around(database, "nuplan")
    return Base("nuplan", root / "nuplan", roi, database.relative_to(root / "nuplan").as_posix())


def waymo(root: Path) -> Base:
    """One segment with one camera."""
    path = write_waymo(root / "waymo", [straight_drive().with_cameras(("front_wide",))])
    return Base("waymo", path, Roi(scene_id="s", frame="waymo_straight_000_020", x_m=8.0, y_m=0.0, radius_m=60.0))


def kitti360(root: Path) -> Base:
    """One drive of a rectified camera and a fisheye, with a parked car."""
    drive = straight_drive().placed((1107.0, 3826.0, 115.0))
    cameras = {"front_wide": "front_wide", "rear_left": "rear"}
    drive = replace(
        drive,
        cameras={name: drive.cameras[other] for name, other in cameras.items()},
        ego_SE3_camera={name: drive.ego_SE3_camera[other] for name, other in cameras.items()},
        image_ns=dict.fromkeys(cameras, drive.image_ns["front_wide"]),
    )
    drive.cameras["rear_left"] = replace(drive.cameras["rear_left"], width_px=1400, height_px=1400)
    path = write_kitti360(root / "kitti", [replace(drive, objects=())], parked=drive.objects, boxes=True)
    return Base("kitti360", path, _roi_around(path, "kitti360"))


def kitti_odometry(root: Path) -> Base:
    """One sequence of a stereo pair, two frames a second."""
    drive = straight_drive()
    start = int(drive.pose_ns[0])
    drive = replace(drive, image_ns={"front_wide": start + np.arange(0, 12 * 10**9, 10**9 // 2)})
    path = write_kitti_odometry(root / "kitti", {"03": from_first_camera(drive, cameras=2)})
    return Base("kitti_odometry", path, Roi(scene_id="s", frame="kitti_odometry_03", x_m=40.0, y_m=0.0, radius_m=90.0))


def kitti_raw(root: Path) -> Base:
    """One drive of a camera, with a parked car."""
    drive = straight_drive()
    stamps = drive.pose_ns[::2]
    rows = np.searchsorted(drive.box_ns, stamps, side="right") - 1
    objects = tuple(replace(one, world_SE3_box=one.world_SE3_box[rows]) for one in drive.objects)
    drive = as_raw(replace(drive, box_ns=stamps, objects=objects))
    path = write_kitti_raw(root, drive.with_cameras(("image_00",)))
    return Base("kitti_raw", path.parent, _roi_around(path, "kitti_raw"), path.name)


def video_gps(root: Path) -> Base:
    """A video with fixes of GPMF."""
    (root / "videos" / "day").mkdir(parents=True)
    path = write_video(root / "videos" / "day" / "drive.mp4", "gpmd", gps5(Fixes(seconds=15)), 1000)
    return Base("video_gps", path.parents[1], _roi_around(path, "video_gps"), f"day/{path.name}")


def video_camm(root: Path) -> Base:
    """A video with fixes of CAMM."""
    (root / "videos" / "day").mkdir(parents=True)
    fixes = Fixes(seconds=15)
    path = write_video(root / "videos" / "day" / "drive.mov", "camm", camm6(fixes), 62, created_ns=fixes.start_ns)
    return Base("video_gps", path.parents[1], _roi_around(path, "video_gps"), f"day/{path.name}")


def ncore(root: Path) -> Base:
    """One sequence in a file, with boxes."""
    from tests.recordings.formats.ncore import write_ncore

    path = write_ncore(root / "ncore", [straight_drive().with_cameras(("front_wide",))])
    (path / "straight.json").unlink()
    return Base("ncore", path, Roi(scene_id="s", frame="ncore_straight", x_m=8.0, y_m=0.0, radius_m=60.0))


def ncore_folders(root: Path) -> Base:
    """One sequence in three folders of arrays, with their consolidated metadata alone: no other is read."""
    from tests.recordings.formats.ncore import write_ncore

    drive = straight_drive().with_cameras(("front_wide",))
    path = write_ncore(root / "ncore", [drive], store_type="directory", groups=True)
    (path / "straight.json").unlink()
    for file in (file for name in (".zgroup", ".zattrs", ".zarray") for file in path.rglob(name)):
        file.unlink()
    return Base("ncore", path, Roi(scene_id="s", frame="ncore_straight", x_m=8.0, y_m=0.0, radius_m=60.0))


def real_boreas(root: Path, real_data: Path) -> Base:
    """20 s of a real sequence, without images."""
    path = root / "boreas-2021-08-05-13-34"
    path.mkdir(parents=True)
    header, *rows = (real_data / "boreas" / path.name / "camera_poses.csv").read_text().splitlines()
    (path / "camera_poses.csv").write_text("\n".join([header, *rows[3000:3200]]) + "\n")
    return Base("boreas", path, _roi_around(path, "boreas"))


def real_comma2k19(root: Path, real_data: Path) -> Base:
    """20 s of a real segment, as two segments."""
    path = root / "b0c9d2329ad1606b_2018-08-02--08-34-47"
    (source,) = (real_data / "comma2k19" / "Example_1").glob("*/40/global_pose")
    for number in range(2):
        folder_of_poses = path / str(number) / "global_pose"
        folder_of_poses.mkdir(parents=True)
        for name in ("frame_gps_times", "frame_positions", "frame_orientations"):
            with (folder_of_poses / name).open("wb") as file:
                np.save(file, np.load(source / name, allow_pickle=False)[200 * number : 200 * (number + 1)])
    return Base("comma2k19", path, _roi_around(path, "comma2k19"))


def _roi_around(path: Path, reader: str) -> Roi:
    """A scene that contains the whole recording."""
    track = open_recording(path, reader).track()
    assert track.longitude_deg is not None and track.latitude_deg is not None
    centre = {"longitude_deg": float(track.longitude_deg[0]), "latitude_deg": float(track.latitude_deg[0])}
    return Roi(scene_id="s", radius_m=2000.0, **centre)


REAL_BASES: dict[str, Callable[[Path, Path], Base]] = {"boreas": real_boreas, "comma2k19": real_comma2k19}
BASES: dict[str, Callable[[Path], Base]] = {
    "folder": folder,
    "csv": csv,
    "boreas": boreas,
    "dgp": dgp,
    "comma2k19": comma2k19,
    "mcap": mcap,
    "nuscenes": nuscenes,
    "argoverse2": argoverse2,
    "colmap": colmap,
    "colmap_rig": colmap_rig,
    "nuplan": nuplan,
    "waymo": waymo,
    "kitti360": kitti360,
    "ncore": ncore,
    "ncore_folders": ncore_folders,
    "rosbag2": rosbag2,
    "kitti_odometry": kitti_odometry,
    "kitti_raw": kitti_raw,
    "video_gps": video_gps,
    "video_camm": video_camm,
}
