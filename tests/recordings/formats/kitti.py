"""Writes drives as KITTI: the odometry benchmark's folder with poses of its first camera, and raw drives of a day."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj

from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_exp
from tests.recordings.formats.street import StreetDrive

# Places of the cameras in the frame of the first, in metres: two grey cameras, two colour cameras.
CENTRES_M = ((0.0, 0.0, 0.0), (0.537, 0.0, 0.0), (-0.06, 0.0003, -0.0027), (0.473, -0.0011, -0.0019))
# Turns to the rectified axes of each camera from its own.
TURNS = quaternion_exp(np.array([[0.01, -0.02, 0.005], [-0.013, 0.004, 0.01], [0.02, 0.01, -0.01], [0.0, 0.03, 0.002]]))
DISTORTION = (-0.37, 0.2, 1.5e-3, 1.8e-3, -0.07)
CAMERA = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.65]]))
RECEIVER = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.93]]))
"""The bodies of the poses above the ego, which lies on the road."""
LIDAR = Poses(quaternion_exp(np.array([[0.01, -0.005, 0.02]])), np.array([[0.81, -0.32, 0.8]]))
"""The lidar in the frame of the receiver."""
PLACE = (8.4343, 49.0150, 116.0)
"""Longitude, latitude and height of the world's origin."""
SIGMA_M = 0.07

# x forward, y left, z up in the axes of a camera.
_CAMERA_FROM_FLU = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def rectified(drive: StreetDrive, names: tuple[str, ...]) -> StreetDrive:
    """The drive with cameras beside its front camera, which take their images together; each has a lens of its own."""
    lens, mounting = drive.cameras["front_wide"], drive.ego_SE3_camera["front_wide"]
    here = np.array([[1.0, 0.0, 0.0, 0.0]])
    return replace(
        drive,
        cameras={name: replace(lens, fx_px=lens.fx_px + n, cx_px=lens.cx_px - n) for n, name in enumerate(names)},
        ego_SE3_camera={name: mounting @ Poses(here, np.array([c])) for name, c in zip(names, CENTRES_M)},
        image_ns=dict.fromkeys(names, drive.image_ns["front_wide"]),
    )


def from_first_camera(drive: StreetDrive, cameras: int = 4) -> StreetDrive:
    """The drive as the odometry benchmark has it: its world is the first camera at the first frame.

    The ego lies below the first camera. Stamps begin at 0, there is a pose for each frame, and there are no boxes. Ego
    and world are x forward, y left, z up.
    """
    drive = rectified(drive, tuple(f"image_{number}" for number in range(cameras)))
    stamps = drive.image_ns["image_0"]
    body = drive.ego_SE3_camera["image_0"] @ Poses.from_matrix(_CAMERA_FROM_FLU[None])
    first = (drive.poses_at(stamps[:1]) @ body).inverse()
    ego = body @ CAMERA.inverse()
    return replace(
        drive,
        pose_ns=stamps - stamps[0],
        poses_at=lambda relative: first @ drive.poses_at(np.asarray(relative) + stamps[0]) @ ego,
        ego_SE3_camera={name: ego.inverse() @ pose for name, pose in drive.ego_SE3_camera.items()},
        image_ns=dict.fromkeys(drive.image_ns, stamps - stamps[0]),
        box_ns=stamps[:0],
        objects=(),
    )


def write_kitti_odometry(root: Path, sequences: Mapping[str, StreetDrive], suffix: str = ".png") -> Path:
    """Write drives of `from_first_camera` by the names of their sequences, and return the folder."""
    (root / "poses").mkdir(parents=True)
    for name, drive in sequences.items():
        folder = root / "sequences" / name
        folder.mkdir(parents=True)
        stamps = drive.pose_ns
        matrix = _CAMERA_FROM_FLU @ matrices(drive.poses_at(stamps) @ drive.ego_SE3_camera["image_0"])
        (root / "poses" / f"{name}.txt").write_text("\n".join(join(one[:3]) for one in matrix) + "\n")
        (folder / "times.txt").write_text("\n".join(f"{stamp * 1e-9:.9e}" for stamp in stamps) + "\n")
        lines = [f"P{n}: {join(projection(drive, f'image_{n}', CENTRES_M[n]))}" for n in range(len(drive.cameras))]
        (folder / "calib.txt").write_text("\n".join([*lines, f"Tr: {join(np.eye(4)[:3])}"]) + "\n")
        for camera in drive.cameras:
            (folder / camera).mkdir()
            for index in range(len(stamps)):
                (folder / camera / f"{index:06d}{suffix}").write_bytes(drive.image(camera, index, suffix))
    return root


def as_raw(drive: StreetDrive, *, rectified_images: bool = True) -> StreetDrive:
    """The drive as KITTI raw has it: its ego lies below the receiver, images lie at the stamps of its boxes.

    Each camera has stamps of its own. Boxes stand upright in the frame of the lidar. Of images that are not rectified,
    the lenses have distortion and the cameras axes of their own.
    """
    names = tuple(f"image_{number:02d}" for number in range(4))
    boxes = replace(drive, image_ns={"front_wide": drive.box_ns})
    drive = rectified(boxes, names)
    image_ns = {name: drive.box_ns + 1_001 * n for n, name in enumerate(names)}
    lidar = drive.poses_at(drive.box_ns) @ RECEIVER @ LIDAR
    objects = tuple(
        replace(one, world_SE3_box=lidar @ _upright(lidar.inverse() @ one.world_SE3_box)) for one in drive.objects
    )
    drive = replace(drive, image_ns=image_ns, objects=objects)
    if rectified_images:
        return replace(drive, pose_ns=drive.box_ns)
    turned = {name: Poses(turn[None], np.zeros((1, 3))) for name, turn in zip(names, TURNS)}
    return replace(
        drive,
        cameras={
            name: replace(lens, model="brown_conrady", distortion=DISTORTION, width_px=lens.width_px + 8)
            for name, lens in drive.cameras.items()
        },
        ego_SE3_camera={name: pose @ turned[name] for name, pose in drive.ego_SE3_camera.items()},
    )


def write_kitti_raw(root: Path, drive: StreetDrive, name: str = "2011_09_26_drive_0009_sync") -> Path:
    """Write a drive of `as_raw`, and return its folder, which lies in the folder of its day.

    The object with the number N is there from the frame N on. The calibration describes rectified and other images.
    """
    folder = root / name[:10] / name
    for sensor, stamps in {"oxts": drive.pose_ns, **drive.image_ns}.items():
        (folder / sensor / "data").mkdir(parents=True)
        text = [str(stamp.astype("datetime64[ns]")).replace("T", " ") for stamp in stamps]
        (folder / sensor / "timestamps.txt").write_text("\n".join(text) + "\n")
    for row, fix in enumerate(_fixes(drive.poses @ RECEIVER)):
        (folder / "oxts" / "data" / f"{row:010d}.txt").write_text(join(fix) + "\n")
    for camera, stamps in drive.image_ns.items():
        for index in range(len(stamps)):
            (folder / camera / "data" / f"{index:010d}.png").write_bytes(drive.image(camera, index, ".png"))
    _write_calibration(folder.parent, drive, distorted=name.endswith("_extract"))
    if name.endswith("_sync") and drive.objects:
        _write_tracklets(folder / "tracklet_labels.xml", drive)
    return folder


def _upright(poses: Poses) -> Poses:
    ahead = matrix_from_quaternion(poses.rotation)[:, :, 0]
    return Poses(quaternion_exp(np.outer(np.arctan2(ahead[:, 1], ahead[:, 0]), (0.0, 0.0, 1.0))), poses.translation)


def _fixes(world_SE3_receiver: Poses) -> np.ndarray:
    """(N, 30) numbers of the receiver; the world touches the ellipsoid at `PLACE`, by PROJ's topocentric frame."""
    lon, lat, height = to_degrees(world_SE3_receiver.translation)
    local = np.swapaxes(east_north_up(lon, lat), 1, 2) @ east_north_up(*np.array(PLACE[:2])[:, None])
    matrix = local @ matrix_from_quaternion(world_SE3_receiver.rotation)
    roll = np.arctan2(matrix[:, 2, 1], matrix[:, 2, 2])
    pitch = np.arcsin(-matrix[:, 2, 0])
    yaw = np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0])
    out = np.zeros((len(lon), 30))
    out[:, :6] = np.stack([lat, lon, height, roll, pitch, yaw], axis=1)
    out[:, 23:25] = SIGMA_M, 0.02
    out[:, 25:] = 4, 11, 6, 6, 6
    return out


def topocentric() -> pyproj.Transformer:
    """From degrees and height to metres east, north and up of `PLACE`."""
    lon, lat, height = PLACE
    return pyproj.Transformer.from_pipeline(
        f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84"
        f" +step +proj=topocentric +ellps=WGS84 +lon_0={lon} +lat_0={lat} +h_0={height}"
    )


def to_degrees(position_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Longitude, latitude and height of (N, 3) metres from `PLACE`."""
    lon, lat, height = topocentric().transform(*position_m.T, direction="INVERSE")
    return np.asarray(lon), np.asarray(lat), np.asarray(height)


def east_north_up(lon_deg: np.ndarray, lat_deg: np.ndarray) -> np.ndarray:
    """(N, 3, 3) the directions east, north and up at places, in the columns, in earth-centred axes."""
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    zero = np.zeros_like(lon)
    east = [-np.sin(lon), np.cos(lon), zero]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.moveaxis(np.array([east, north, up]), 2, 0).swapaxes(1, 2)


def _write_calibration(folder: Path, drive: StreetDrive, *, distorted: bool) -> None:
    """The three files; what of a camera the drive does not have, follows from what it has."""
    lidar_SE3_receiver = matrices(LIDAR.inverse())[0]
    lidar_SE3_ego = matrices((RECEIVER @ LIDAR).inverse())[0]
    turns = matrix_from_quaternion(np.array(TURNS))
    names = list(drive.cameras)
    mountings = {name: matrices(pose)[0] for name, pose in drive.ego_SE3_camera.items()}
    # camera_SE3_rectified of the first camera, and ego_SE3_camera of the cameras before rectification.
    unturned = {
        name: mountings[name] if distorted else mountings[name] @ _motion(turns[n]) for n, name in enumerate(names)
    }
    first = unturned[names[0]]
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for n, name in enumerate(names):
        lens, digits = drive.cameras[name], name[-2:]
        motion = np.linalg.inv(unturned[name]) @ first
        matrix = lens.intrinsic_matrix(first_pixel_centre=0.0)
        other = 8 if distorted else 0
        lines += [
            f"S_{digits}: {lens.width_px + 8 - other:.6e} {lens.height_px:.6e}",
            f"K_{digits}: {join(matrix)}",
            f"D_{digits}: {join(np.array(DISTORTION))}",
            f"R_{digits}: {join(motion[:3, :3])}",
            f"T_{digits}: {join(motion[:3, 3])}",
            f"S_rect_{digits}: {lens.width_px - other:.6e} {lens.height_px:.6e}",
            f"R_rect_{digits}: {join(turns[n])}",
            f"P_rect_{digits}: {join(projection(drive, name, CENTRES_M[n]))}",
        ]
    (folder / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    of_lidar = np.linalg.inv(first) @ np.linalg.inv(lidar_SE3_ego)
    for file, motion in (("imu_to_velo", lidar_SE3_receiver), ("velo_to_cam", of_lidar)):
        text = f"calib_time: 25-May-2012 16:47:16\nR: {join(motion[:3, :3])}\nT: {join(motion[:3, 3])}\n"
        (folder / f"calib_{file}.txt").write_text(text)


def _motion(rotation: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3] = rotation
    return out


def _write_tracklets(file: Path, drive: StreetDrive) -> None:
    lidar = (drive.poses_at(drive.box_ns) @ RECEIVER @ LIDAR).inverse()
    items = []
    for number, one in enumerate(drive.objects):
        length, width, height = one.size_m
        matrix = matrices(lidar @ one.world_SE3_box)[number:]
        poses = "".join(
            f"<item><tx>{m[0, 3]!r}</tx><ty>{m[1, 3]!r}</ty><tz>{m[2, 3] - height / 2!r}</tz><rx>0</rx><ry>0</ry>"
            f"<rz>{float(np.arctan2(m[1, 0], m[0, 0]))!r}</rz><state>2</state><occlusion>0</occlusion></item>\n"
            for m in matrix.astype(object).reshape(-1, 4, 4)
        )
        items.append(
            f"<item><objectType>{one.category}</objectType><h>{height!r}</h><w>{width!r}</w><l>{length!r}</l>"
            f"<first_frame>{number}</first_frame><poses><count>{len(matrix)}</count><item_version>2</item_version>\n"
            f"{poses}</poses><finished>1</finished></item>\n"
        )
    file.write_text(
        '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
        '<boost_serialization signature="serialization::archive" version="9">\n<tracklets class_id="0">'
        f"<count>{len(items)}</count><item_version>1</item_version>\n{''.join(items)}</tracklets>\n"
        "</boost_serialization>\n"
    )


def projection(drive: StreetDrive, camera: str, centre_m: tuple[float, float, float]) -> np.ndarray:
    """(3, 4) from the frame of the first camera to pixels, whose first has its centre at 0."""
    matrix = drive.cameras[camera].intrinsic_matrix(first_pixel_centre=0.0)
    return matrix @ np.column_stack([np.eye(3), -np.array(centre_m)])


def join(values: np.ndarray) -> str:
    """Numbers of a line, by rows."""
    return " ".join(f"{value:.15e}" for value in values.ravel())


def matrices(poses: Poses) -> np.ndarray:
    """(N, 4, 4)."""
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = matrix_from_quaternion(poses.rotation), poses.translation
    return out
