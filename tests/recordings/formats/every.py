"""One small drive in the layout of every reader, each with images where the reader knows any."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mirror.geometry.poses import Poses
from mirror.recordings.readers.boreas import BoreasReader
from tests.builders.folder import write_recording
from tests.recordings.formats.street import SECOND_NS, StreetDrive, straight_drive

# Places of the drive on the grids of the formats: UTM zones, and Mercator's projection of KITTI-360.
_UTM_M = (583_000.0, 4_507_000.0, 0.0)
_BOREAS_M = (623_426.0, 4_848_821.0)


def _smooth(drive: StreetDrive) -> StreetDrive:
    """The straight drive with two images a second."""
    step = np.arange(0, 12 * SECOND_NS, SECOND_NS // 2)
    start = int(drive.pose_ns[0])
    stamps = {name: start + 4_000_000 * (1 + number) + step for number, name in enumerate(drive.cameras)}
    return replace(drive, image_ns=stamps)


def street_drive() -> StreetDrive:
    """A drive eastward at 8 m/s for 12 s with two cameras."""
    return _smooth(straight_drive())


def film(drive: Path, camera: str) -> None:
    """Replace a camera's images of a `folder` recording by a video."""
    import av

    folder = drive / "images" / camera
    stamps = sorted(int(path.stem) for path in folder.iterdir())
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    (drive / "videos").mkdir(exist_ok=True)
    file = drive / "videos" / f"{camera}.mp4"
    rng = np.random.default_rng(0)
    with av.open(str(file), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"g": "10"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in stamps:
            image = cv2.resize(rng.integers(0, 255, (6, 8, 3), np.uint8), (64, 48))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "rgb24")))
        container.mux(stream.encode())
    with av.open(str(file)) as container:
        pts = sorted(frame.pts for frame in container.decode(video=0) if frame.pts is not None)
    rows = "".join(f"{p},{t},{t}\n" for p, t in zip(pts, stamps))
    (drive / "videos" / f"{camera}.csv").write_text("pts,exposure_start_ns,exposure_end_ns\n" + rows)


def _folder(root: Path) -> Path:
    drive = write_recording(root, "there", from_m=-50.0, to_m=50.0)
    film(drive, "rear")
    return drive


def _csv(root: Path) -> Path:
    root.mkdir(parents=True)
    drive = street_drive()
    east = 11.57 + 8.0 * (drive.pose_ns - drive.pose_ns[0]) * 1e-9 * 1.346e-5
    rows = [f"{stamp},{lon:.9f},48.13" for stamp, lon in zip(drive.pose_ns.tolist(), east.tolist())]
    (root / "drive.csv").write_text("time_ns,lon,lat\n" + "\n".join(rows) + "\n")
    return root / "drive.csv"


def _gpx(root: Path) -> Path:
    root.mkdir(parents=True)
    points = "".join(
        f'<trkpt lat="48.13" lon="{lon:.9f}"><ele>500.0</ele><time>{time.isoformat()}</time></trkpt>'
        for time, lon in _eastward()
    )
    namespace = "http://www.topografix.com/GPX/1/1"
    text = f'<gpx version="1.1" xmlns="{namespace}"><trk><trkseg>{points}</trkseg></trk></gpx>'
    (root / "drive.gpx").write_text(text)
    return root / "drive.gpx"


def _nmea(root: Path) -> Path:
    root.mkdir(parents=True)
    lines = []
    for time, lon in _eastward():
        stamp, place = f"{time:%H%M%S.%f}"[:-3], f"4807.8000,N,{int(lon):03d}{60.0 * (lon % 1.0):010.7f},E"
        for body in (
            f"GNGGA,{stamp},{place},4,12,0.8,453.0,M,47.0,M,,",
            f"GNRMC,{stamp},A,{place},15.5,90.0,{time:%d%m%y},,,A",
        ):
            lines.append(f"${body}*{reduce(xor, body.encode(), 0):02X}\r\n")
    (root / "drive.nmea").write_text("".join(lines))
    return root / "drive.nmea"


def _eastward() -> Iterator[tuple[datetime, float]]:
    """Times and longitudes of the drive at latitude 48.13."""
    stamps = street_drive().pose_ns
    for stamp in stamps.tolist():
        yield datetime.fromtimestamp(stamp / 1e9, UTC), 11.57 + 8.0 * (stamp - int(stamps[0])) * 1e-9 * 1.346e-5


def _boreas(root: Path) -> Path:
    drive = street_drive()
    path = root / "boreas-2021-08-05-13-34"
    (path / "camera").mkdir(parents=True)
    (path / "calib").mkdir()
    seconds = (drive.pose_ns - drive.pose_ns[0]) * 1e-9
    header = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,angvel_y,angvel_x"
    # The camera's axes point right, down and forward: this roll is that of a level camera on a drive northward.
    rows = [
        f"{stamp // 1_000},{_BOREAS_M[0]},{_BOREAS_M[1] + 8.0 * s:.4f},153.6,0,8,0,{np.pi / 2},0,0,0,0,0"
        for stamp, s in zip(drive.pose_ns.tolist(), seconds.tolist())
    ]
    (path / "camera_poses.csv").write_text("\n".join([header, *rows]) + "\n")
    (path / "calib" / "P_camera.txt").write_text("1500 0 1224 0\n0 1500 1024 0\n0 0 1 0\n0 0 0 1\n")
    for index, stamp in enumerate(drive.image_ns["front_wide"].tolist()[::3]):
        image = np.zeros((2048, 2448, 3), np.uint8)
        image[: 100 * (index + 1)] = 200
        encoded = cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, 1))[1]
        (path / "camera" / f"{stamp // 1_000}.png").write_bytes(encoded.tobytes())
    assert BoreasReader().recognises(path)
    return path


def _dgp(root: Path) -> Path:
    drive = street_drive()
    path = root / "scene"
    for folder in ("calibration", "rgb"):
        (path / folder).mkdir(parents=True)
    data, samples = [], []
    for camera in drive.cameras:
        mounting = drive.ego_SE3_camera[camera]
        for index, stamp in enumerate(drive.image_ns["front_wide"].tolist()):
            lens, name = drive.cameras[camera], f"rgb/{camera}_{index}.png"
            (path / name).write_bytes(drive.image(camera, index, ".png"))
            pose = _dgp_pose(drive.poses_at(np.array([stamp])) @ mounting)
            moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=stamp // 1_000)
            image = {"filename": name, "width": lens.width_px, "height": lens.height_px, "pose": pose}
            key = f"{camera}_{index}"
            data.append(
                {"key": key, "id": {"name": camera, "timestamp": moment.isoformat()}, "datum": {"image": image}}
            )
            samples.append({"calibration_key": "abc", "datum_keys": [key]})
    lenses = list(drive.cameras.values())
    calibration = {
        "names": list(drive.cameras),
        "extrinsics": [_dgp_pose(mounting) for mounting in drive.ego_SE3_camera.values()],
        "intrinsics": [{"fx": c.fx_px, "fy": c.fy_px, "cx": c.cx_px - 0.5, "cy": c.cy_px - 0.5} for c in lenses],
    }
    (path / "calibration" / "abc.json").write_text(json.dumps(calibration))
    (path / "scene_0123456789.json").write_text(json.dumps({"samples": samples, "data": data, "log": "one"}))
    return path


def _dgp_pose(pose: Poses) -> dict[str, Any]:
    return {
        "rotation": dict(zip(("qw", "qx", "qy", "qz"), pose.rotation[0].tolist())),
        "translation": dict(zip("xyz", pose.translation[0].tolist())),
    }


def _comma2k19(root: Path) -> Path:
    import av

    from mirror.geometry.geodesy import ecef_R_enu, geodetic_to_ecef
    from mirror.geometry.quaternions import quaternion_from_matrix, quaternion_multiply

    route = root / "b0c9d2329ad1606b|2018-08-02--08-34-47"
    place = np.array([-122.4]), np.array([37.7])
    # Forward, right and down of a drive eastward, in east, north, up.
    turn = quaternion_multiply(quaternion_from_matrix(ecef_R_enu(*place)), np.array([[0.0, 1.0, 0.0, 0.0]]))
    east = ecef_R_enu(*place)[0][:, 0]
    for number in range(2):
        poses = route / str(number) / "global_pose"
        poses.mkdir(parents=True)
        frames = number * 30 + np.arange(30)
        arrays = {
            "frame_gps_times": np.stack([np.full(30, 2012.0), 404_000.0 + frames * 0.2], axis=1),
            "frame_positions": geodetic_to_ecef(*place, np.zeros(1)) + frames[:, None] * 1.6 * east,
            "frame_orientations": np.tile(turn, (30, 1)),
        }
        for name, array in arrays.items():
            with (poses / name).open("wb") as file:
                np.save(file, array)
        video = route / str(number) / "video.h264"
        with av.open(str(video), "w") as container:
            stream = container.add_stream("libx264", rate=20, options={"preset": "ultrafast"})
            stream.width, stream.height, stream.pix_fmt = 1164, 874, "yuv420p"
            stream.gop_size, stream.max_b_frames = 20, 0
            for frame in frames.tolist():
                image = np.full((874, 1164, 3), 60, np.uint8)
                image[:, 15 * frame + 15 :] = 200
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "rgb24")))
            container.mux(stream.encode())
        video.rename(video.with_name("video.hevc"))
    return route


def _log_messages(root: Path) -> list[Any]:
    from tests.recordings.readers.message_logs.drives import ONE
    from tests.recordings.readers.message_logs.films import VIDEO, packets, video_messages
    from tests.recordings.readers.message_logs.writer import TOPICS, messages

    root.mkdir(parents=True)
    (root / "log.toml").write_text(TOPICS + VIDEO)
    scratch = root / "scratch"
    scratch.mkdir()
    return messages(ONE) + video_messages(packets(scratch, "h264"), "h264")


def _mcap(root: Path) -> Path:
    from tests.recordings.readers.message_logs.writer import write_mcap

    return write_mcap(root / "log.mcap", _log_messages(root))


def _rosbag2(root: Path) -> Path:
    from tests.recordings.readers.message_logs.writer import write_rosbag2

    return write_rosbag2(root / "log.db3", _log_messages(root), definitions=False)


def _nuscenes(root: Path) -> Path:
    from tests.recordings.formats.nuscenes import CHANNELS, write_nuscenes

    drive = street_drive().placed((900.0, 700.0, 0.0))
    names = tuple(name for name in drive.cameras if name in CHANNELS)
    return write_nuscenes(root, [drive.with_cameras(names)]) / "scene-0001"


def _argoverse2(root: Path) -> Path:
    from tests.recordings.formats.argoverse2 import write_argoverse2

    drive = street_drive().placed((2_000.0, 1_000.0, 0.0))
    return write_argoverse2(root, _dateless(drive))


def _dateless(drive: StreetDrive) -> StreetDrive:
    """The drive on a clock that begins in January 1980, as that of the logs."""
    shift = int(drive.pose_ns[0]) - 315_970_000 * SECOND_NS
    return replace(
        drive,
        pose_ns=drive.pose_ns - shift,
        box_ns=drive.box_ns - shift,
        image_ns={name: stamps - shift for name, stamps in drive.image_ns.items()},
        poses_at=lambda stamps: drive.poses_at(np.asarray(stamps) + shift),
    )


def _colmap(root: Path) -> Path:
    from tests.recordings.formats.colmap import write_colmap

    return write_colmap(root / "photos", [street_drive()], names="numbers")


def _nuplan(root: Path) -> Path:
    from tests.recordings.formats.nuplan import write_nuplan

    drive = street_drive()
    # The reader knows nuPlan's own cameras alone.
    return write_nuplan(root, drive.placed(_UTM_M).upright())


def _waymo(root: Path) -> Path:
    from tests.recordings.formats.waymo import write_waymo

    drive = street_drive().with_cameras(("front_wide",))
    write_waymo(root, [drive])
    return root / f"{drive.name}_000_020"


def _kitti360(root: Path) -> Path:
    from tests.recordings.formats.kitti360 import CAMERAS, write_kitti360

    drive = street_drive()
    (camera,) = (name for name in CAMERAS if name in drive.cameras)
    return write_kitti360(root, [drive.with_cameras((camera,)).placed((100.0, 100.0, 0.0))]) / drive.name


def _kitti_odometry(root: Path) -> Path:
    from tests.recordings.formats.kitti import from_first_camera, write_kitti_odometry

    return write_kitti_odometry(root, {"03": from_first_camera(street_drive(), cameras=2)}) / "03"


def _kitti_raw(root: Path) -> Path:
    from tests.recordings.formats.kitti import as_raw, write_kitti_raw

    drive = street_drive()
    return write_kitti_raw(root, as_raw(replace(drive, box_ns=drive.image_ns["front_wide"], objects=())))


def _video_gps(root: Path) -> Path:
    from tests.recordings.formats.video_gps import Fixes, gps9, write_video

    root.mkdir(parents=True)
    return write_video(root / "drive.mp4", "gpmd", gps9(Fixes()), 1000)


def _ncore(root: Path) -> Path:
    from mirror.recordings.discovery import find_recordings
    from tests.recordings.formats.ncore import write_ncore

    (path,) = find_recordings([write_ncore(root, [street_drive()])]).recordings
    return path


WRITERS: dict[str, Callable[[Path], Path]] = {
    "folder": _folder,
    "boreas": _boreas,
    "dgp": _dgp,
    "comma2k19": _comma2k19,
    "csv": _csv,
    "gpx": _gpx,
    "nmea": _nmea,
    "mcap": _mcap,
    "rosbag2": _rosbag2,
    "nuscenes": _nuscenes,
    "argoverse2": _argoverse2,
    "colmap": _colmap,
    "nuplan": _nuplan,
    "waymo": _waymo,
    "kitti360": _kitti360,
    "kitti_odometry": _kitti_odometry,
    "kitti_raw": _kitti_raw,
    "video_gps": _video_gps,
    "ncore": _ncore,
}
"""Writes the drive into a folder and returns the recording's path, by the name of the reader."""
