"""The data sets' own toolkits read the same files to the same numbers; ``make peers`` makes their results again."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pyproj

from mirror.geometry.cameras import camera_from_row
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import COLUMNS, Poses
from mirror.geometry.quaternions import (
    matrix_from_quaternion,
    quaternion_exp,
    quaternion_multiply,
    quaternion_normalise,
    rotate,
)
from mirror.recordings.protocol import Recording
from mirror.recordings.readers.kitti360_cameras import mei_pixels
from mirror.recordings.registry import open_recording
from tests.recordings.formats.compare import angle_between
from tests.recordings.formats.kitti360 import MEI
from tests.recordings.formats.peers import (
    argoverse2_input,
    kitti360_input,
    mapillary_tools_input,
    nuplan_input,
    nuscenes_input,
    py123d_input,
    pykitti_input,
    result,
    waymo_input,
)

LAKE = (8.4295857, 48.9843445)
SIZES = ("length_m", "width_m", "height_m")


def corners(row: dict[str, Any]) -> np.ndarray:
    """(8, 3) corners of a box in its own frame."""
    half = np.array([row[name] for name in SIZES]) / 2
    return half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def boxes_in_camera(
    recording: Recording, world_SE3_ego: Poses, camera: str, stamp_ns: int, box_ns: int
) -> dict[str, tuple[dict[str, Any], np.ndarray]]:
    """Row and (8, 3) corners of the boxes of an instant, in the frame of an image's camera, by track."""
    track = recording.track()
    calibration = next(row for row in recording.calibrations().to_pylist() if row["camera"] == camera)
    ego_SE3_camera = Poses.from_columns({name: [calibration[name]] for name in COLUMNS})
    times, first = np.unique(track.timestamp_ns, return_index=True)
    at = interpolate(times, world_SE3_ego[first], [stamp_ns, box_ns])
    boxes = recording.boxes()
    assert boxes is not None
    found = {}
    for row in boxes.to_pylist():
        if row["timestamp_ns"] == box_ns:
            box = Poses.from_columns({name: [row[name]] for name in COLUMNS})
            points = ((at[0] @ ego_SE3_camera).inverse() @ at[1] @ box).transform(corners(row))[0]
            found[row["track_id"]] = row, points
    return found


def projected_boxes(
    recording: Recording, world_SE3_ego: Poses, camera: str, stamp_ns: int, box_ns: int
) -> dict[str, tuple[dict[str, Any], np.ndarray, np.ndarray]]:
    """Row, corner pixels of a pinhole and depths of the boxes of an instant, in an image, by track."""
    calibration = next(row for row in recording.calibrations().to_pylist() if row["camera"] == camera)
    matrix = camera_from_row(calibration).intrinsic_matrix(first_pixel_centre=0.0)
    found = {}
    for name, (row, points) in boxes_in_camera(recording, world_SE3_ego, camera, stamp_ns, box_ns).items():
        pixels = points @ matrix.T
        found[name] = row, pixels[:, :2] / pixels[:, 2:], points[:, 2]
    return found


def same_corners(
    theirs: dict[str, Any], pixels: np.ndarray, depth: np.ndarray, *, depth_m: float = 1e-6, pixel_px: float = 1e-4
) -> None:
    """The corners are the same points in another order; pixels of corners in front of the camera count."""
    peer_depth, peer_pixels = np.array(theirs["depth_m"]), np.array(theirs["corners_px"])
    for at, place in zip(peer_depth, peer_pixels):
        nearest = np.argmin(np.abs(depth - at) + np.linalg.norm(pixels - place, axis=1) * (at > 0.5))
        assert abs(depth[nearest] - at) < depth_m
        if at > 0.5:
            assert np.abs(pixels[nearest] - place).max() < pixel_px


def test_nuscenes_devkit_reads_the_same(tmp_path: Path) -> None:
    recording = open_recording(nuscenes_input(tmp_path / "n"))
    track = recording.track()
    assert track.x_m is not None and track.rotation is not None
    map_SE3_ego = Poses(track.rotation, np.stack([track.x_m, track.y_m, track.height_m], axis=1))
    assert recording.rig is not None
    names = {camera.source_name: camera.name for camera in recording.rig.cameras}
    streams = recording.images()
    stamps_of = {Path(str(s.path(i))).name: int(t) for s in streams.values() for i, t in enumerate(s.exposure_start_ns)}
    images = result("nuscenes")["images"]
    assert len(images) == 3 * 4
    compared = 0
    for file, theirs in images.items():
        stamp = stamps_of[Path(file).name]
        assert stamp == theirs["timestamp_us"] * 1_000
        row = int(np.searchsorted(track.timestamp_ns, stamp))
        assert np.abs(map_SE3_ego.translation[row] - theirs["translation"]).max() < 1e-8
        assert abs(abs(map_SE3_ego.rotation[row] @ theirs["rotation"]) - 1.0) < 1e-12
        box_ns = theirs["sample_us"] * 1_000
        found = projected_boxes(recording, map_SE3_ego, names[theirs["channel"]], stamp, box_ns)
        assert set(found) == set(theirs["boxes"])
        ego = map_SE3_ego[int(np.searchsorted(track.timestamp_ns, box_ns))]
        for name, (box, pixels, depth) in found.items():
            peer = theirs["boxes"][name]
            assert box["category"] == peer["category"]
            same_corners(peer, pixels, depth)
            velocity = rotate(ego.rotation[0], [box["vx_mps"], box["vy_mps"], box["vz_mps"]])
            assert np.abs(velocity - peer["velocity_mps"]).max() < 1e-6
            compared += 1
    assert compared == 60


def test_av2_reads_the_same(tmp_path: Path) -> None:
    root = argoverse2_input(tmp_path / "a")
    recording = open_recording(root)
    track = recording.track()
    assert track.longitude_deg is not None and track.latitude_deg is not None and track.rotation is not None
    # In the tangent plane of the first pose; only motion between two poses enters the projections.
    lon, lat, height = track.longitude_deg, track.latitude_deg, track.height_m
    pipeline = (
        "+proj=pipeline +step +proj=cart +ellps=WGS84"
        f" +step +proj=topocentric +ellps=WGS84 +lon_0={float(lon[0])!r} +lat_0={float(lat[0])!r} +h_0=0"
    )
    place = np.stack(pyproj.Transformer.from_pipeline(pipeline).transform(lon, lat, height), axis=1)
    enu_SE3_ego = Poses(track.rotation, place)
    assert recording.rig is not None
    names = {camera.source_name: camera.name for camera in recording.rig.cameras}
    images = result("argoverse2")["images"]
    assert len(images) == 3 * 4
    compared = 0
    for file, theirs in images.items():
        channel, _, name = file.partition("/")
        stamp = int(Path(name).stem)
        row = int(np.searchsorted(track.timestamp_ns, stamp))
        assert track.timestamp_ns[row] == stamp
        assert np.abs(np.array([lat[row], lon[row]]) - theirs["latitude_longitude"]).max() < 1e-10
        assert height is not None and abs(height[row] - theirs["translation"][2]) < 1e-8
        found = projected_boxes(recording, enu_SE3_ego, names[channel], stamp, theirs["box_ns"])
        assert set(found) == set(theirs["boxes"])
        for track_id, (box, pixels, depth) in found.items():
            peer = theirs["boxes"][track_id]
            assert box["category"] == peer["category"]
            # A metre of the UTM grid is 0.03 % off a metre on the ground; the vehicle moves up to 2.1 m in between.
            peer_depth = np.array(peer["depth_m"])
            assert np.abs(np.sort(depth) - np.sort(peer_depth)).max() < 1e-3
            near = peer_depth > 2.0
            if near.all():
                peer_pixels = np.array(peer["corners_px"])
                for place_px in peer_pixels:
                    assert np.linalg.norm(pixels - place_px, axis=1).min() < 2e-2
                compared += 1
    assert compared > 10


def kitti360_poses(recording: Recording) -> Poses:
    """Poses in the dataset's world, from degrees: Mercator's projection, scaled at the lake, by PROJ."""
    track = recording.track()
    assert track.longitude_deg is not None and track.rotation is not None
    world = pyproj.Proj(f"+proj=merc +R=6378137 +k_0={math.cos(math.radians(LAKE[1]))!r}")
    place = np.stack(world(track.longitude_deg, track.latitude_deg), axis=1) - world(*LAKE)
    return Poses(track.rotation, np.column_stack([place, track.height_m]))


def test_kitti360scripts_reads_the_same(tmp_path: Path) -> None:
    """The scripts round the pixels of rectified cameras, and leave p1 and p2 of the fisheyes out."""
    recording = open_recording(kitti360_input(tmp_path / "k"))
    track, world_SE3_ego = recording.track(), kitti360_poses(recording)
    theirs = result("kitti360")
    boxes = recording.boxes()
    assert boxes is not None
    rows = boxes.to_pylist()
    assert len(rows) == sum(len(there) for there in theirs["boxes"].values()) == 3 * 6
    for row in rows:
        frame = int(np.searchsorted(track.timestamp_ns, row["timestamp_ns"]))
        peer = theirs["boxes"][str(frame)][row["track_id"].partition("_")[2]]
        assert row["category"] == peer["name"]
        assert (row["vx_mps"] == 0.0) == peer["at_rest"]
        box = world_SE3_ego[frame] @ Poses.from_columns({name: [row[name]] for name in COLUMNS})
        found, expected = box.transform(corners(row))[0], np.array(peer["vertices_m"])
        assert np.linalg.norm(found[:, None] - expected, axis=2).min(axis=1).max() < 1e-6
    calibrations = {row["camera"]: row for row in recording.calibrations().to_pylist()}
    assert set(calibrations) == set(theirs["cameras"])
    rectified, fisheye = 0, 0
    for name, peer in theirs["cameras"].items():
        row, lens = calibrations[name], camera_from_row(calibrations[name])
        assert [row["width_px"], row["height_px"]] == peer["size_px"]
        if peer["projection"] is not None:
            matrix = np.array(peer["projection"])[:, :3]
            assert np.abs(lens.intrinsic_matrix(first_pixel_centre=0.0) - matrix).max() < 1e-8
        world_SE3_camera = world_SE3_ego @ Poses.from_columns({column: [row[column]] * 3 for column in COLUMNS})
        for number, image in peer["images"].items():
            pose = world_SE3_camera[int(number)]
            expected_pose = np.array(image["world_SE3_camera"])
            assert np.abs(pose.translation[0] - expected_pose[:3, 3]).max() < 1e-7
            assert np.abs(matrix_from_quaternion(pose.rotation)[0] - expected_pose[:3, :3]).max() < 1e-10
            for instance, pixels in image["vertices_px"].items():
                vertices = np.array(theirs["boxes"][number][instance]["vertices_m"])
                points = pose.inverse().transform(vertices)[0]
                ahead = points[:, 2] > 1.0
                if peer["projection"] is not None:
                    away = np.abs(lens.project(points[ahead]).uv_px - 0.5 - np.array(pixels)[ahead])
                    assert away.max(initial=0.0) < 0.5 + 1e-3
                    rectified += int(ahead.sum())
                    continue
                unit = points / np.linalg.norm(points, axis=1, keepdims=True)
                numbers = {**MEI[name], "p1": 0.0, "p2": 0.0}
                seen = np.arccos(unit[:, 2]) < np.radians(92.0)
                assert np.abs(mei_pixels(unit, numbers) - 0.5 - pixels)[seen].max(initial=0.0) < 1e-4
                inside = seen & (np.abs(np.array(pixels) - 700.0) < 700.0).all(axis=1)
                away = np.linalg.norm(lens.project(points[inside]).uv_px - 0.5 - np.array(pixels)[inside], axis=1)
                assert away.max(initial=0.0) < 0.5
                fisheye += int(inside.sum())
    assert (rectified, fisheye) == (224, 64)


def same_pose(pose: Poses, row: int, theirs: list[float]) -> None:
    """A pose is that of seven numbers, within 1e-8 m and 1e-10 rad."""
    assert np.abs(pose.translation[row] - theirs[4:]).max() < 1e-8
    rotation = quaternion_normalise([theirs[:4]])
    assert angle_between(pose.rotation[row : row + 1], rotation)[0] < 1e-10


def test_py123d_reads_the_same(tmp_path: Path) -> None:
    recording = open_recording(py123d_input(tmp_path / "k"))
    track, world_SE3_ego = recording.track(), kitti360_poses(recording)
    theirs = result("py123d")
    calibrations = {row["camera"]: row for row in recording.calibrations().to_pylist()}
    assert set(calibrations) == set(theirs["cameras"])
    mountings = {name: Poses.from_columns({key: [row[key]] for key in COLUMNS}) for name, row in calibrations.items()}
    for name, peer in theirs["cameras"].items():
        row = calibrations[name]
        assert [row["width_px"], row["height_px"]] == peer["size_px"]
        same_pose(mountings[name], 0, peer["ego_SE3_camera"])
        if peer["pixels_px"] is not None:
            pixels = camera_from_row(row).project(np.array(theirs["points"])).uv_px
            assert np.abs(pixels - 0.5 - peer["pixels_px"]).max() < 1e-8
    streams = recording.images()
    boxes = recording.boxes()
    assert boxes is not None
    rows = boxes.to_pylist()
    assert len(theirs["frames"]) == len(track.timestamp_ns) == 3
    for frame, peer in enumerate(theirs["frames"]):
        assert track.timestamp_ns[frame] == peer["timestamp_us"] * 1_000
        same_pose(world_SE3_ego, frame, peer["world_SE3_ego"])
        assert set(streams) == set(peer["images"])
        for name, image in peer["images"].items():
            assert str(streams[name].path(frame)).endswith(image["file"])
            assert streams[name].exposure_start_ns[frame] == image["timestamp_us"] * 1_000
            same_pose(world_SE3_ego[frame] @ mountings[name], 0, image["world_SE3_camera"])
        # Of boxes at rest, py123d keeps those that the lidar sees.
        moving = [row for row in rows if row["timestamp_ns"] == track.timestamp_ns[frame] and row["vx_mps"] is None]
        assert len(moving) == len(peer["boxes"]) == 5
        for row in moving:
            instance = row["track_id"].partition("_")[2]
            (other,) = (box for name, box in peer["boxes"].items() if int(name) % 1_000 == int(instance))
            assert row["category"].upper() == other["label"]
            assert np.abs(np.array([row[key] for key in SIZES]) - other["size_m"]).max() < 1e-8
            pose = world_SE3_ego[frame] @ Poses.from_columns({key: [row[key]] for key in COLUMNS})
            same_pose(pose, 0, other["world_SE3_box"])


def utm_poses(recording: Recording) -> Poses:
    """Poses in UTM zone 11, from degrees; PROJ turns them by its meridian convergence."""
    track = recording.track()
    assert track.longitude_deg is not None and track.rotation is not None
    utm = pyproj.Proj(proj="utm", zone=11, ellps="WGS84")
    place = np.stack([*utm(track.longitude_deg, track.latitude_deg), track.height_m], axis=1)
    convergence = np.radians(utm.get_factors(track.longitude_deg, track.latitude_deg).meridian_convergence)
    turn = quaternion_exp(np.outer(convergence, (0.0, 0.0, 1.0)))
    return Poses(quaternion_multiply(turn, track.rotation), place)


def test_nuplan_devkit_reads_the_same(tmp_path: Path) -> None:
    recording = open_recording(nuplan_input(tmp_path / "p"))
    theirs = result("nuplan")
    assert (recording.info.drive_id, recording.info.vehicle_id) == (theirs["log"], theirs["vehicle"])
    track, utm_SE3_ego = recording.track(), utm_poses(recording)
    assert recording.rig is not None
    names = {camera.source_name: camera.name for camera in recording.rig.cameras}
    assert set(names) == set(theirs["cameras"])
    calibrations = {row["camera"]: row for row in recording.calibrations().to_pylist()}
    for channel, peer in theirs["cameras"].items():
        row = calibrations[names[channel]]
        matrix = camera_from_row(row).intrinsic_matrix(first_pixel_centre=0.0)
        assert [row["width_px"], row["height_px"]] == peer["size_px"]
        assert np.abs(matrix - peer["intrinsic"]).max() < 1e-8
        assert np.abs(np.array(row["distortion"]) - peer["distortion"]).max() < 1e-11
        mounting = [row[name] for name in COLUMNS]
        assert np.abs(np.array(mounting[4:]) - peer["translation"]).max() < 1e-11
        assert abs(abs(np.array(mounting[:4]) @ peer["rotation"]) - 1.0) < 1e-11
    streams = recording.images()
    stamps_of = {Path(str(s.path(i))).name: int(t) for s in streams.values() for i, t in enumerate(s.exposure_start_ns)}
    assert len(theirs["images"]) == 3 * 4
    compared = 0
    for file, peer in theirs["images"].items():
        stamp = stamps_of[Path(file).name]
        assert stamp == peer["timestamp_us"] * 1_000 and peer["epsg"] == 32611
        row_number = int(np.searchsorted(track.timestamp_ns, stamp))
        assert track.timestamp_ns[row_number] == stamp
        # Degrees and back to metres.
        assert np.abs(utm_SE3_ego.translation[row_number] - peer["translation"]).max() < 1e-5
        assert abs(abs(utm_SE3_ego.rotation[row_number] @ peer["rotation"]) - 1.0) < 1e-12
        box_ns = peer["lidar_us"] * 1_000
        found = projected_boxes(recording, utm_SE3_ego, names[peer["channel"]], stamp, box_ns)
        assert set(found) == set(peer["boxes"])
        ego = utm_SE3_ego[int(np.searchsorted(track.timestamp_ns, box_ns))]
        for track_id, (box, pixels, depth) in found.items():
            other = peer["boxes"][track_id]
            assert (box["category"], box["score"]) == (other["category"], other["confidence"])
            same_corners(other, pixels, depth, depth_m=1e-5, pixel_px=1e-3)
            velocity = rotate(ego.rotation[0], [box["vx_mps"], box["vy_mps"], box["vz_mps"]])
            assert np.abs(velocity - other["velocity_mps"]).max() < 1e-6
            compared += 1
    assert compared == 60


def test_waymo_open_dataset_reads_the_same(tmp_path: Path) -> None:
    """Its camera model computes in float32; the shutter is taken as global at the stamp of the image's pose."""
    root = waymo_input(tmp_path / "w")
    theirs = result("waymo")
    for component, columns in theirs["columns"].items():
        (file,) = (root / component).iterdir()
        # Parquet names the values of a list differently.
        assert {f.name: str(f.type).replace("element:", "item:") for f in pq.read_schema(file)} == columns
    recording = open_recording(root)
    assert (recording.info.light, recording.info.weather, recording.info.city) == ("day", "clear", "San Francisco")
    assert theirs["stats"] == ["Day", "location_sf", "sunny"]
    track = recording.track()
    assert track.x_m is not None and track.rotation is not None
    world_SE3_ego = Poses(track.rotation, np.stack([track.x_m, track.y_m, track.height_m], axis=1))
    assert recording.rig is not None
    names = {camera.source_name: camera.name for camera in recording.rig.cameras}
    calibrations = {row["camera"]: row for row in recording.calibrations().to_pylist()}
    assert set(names) == set(theirs["cameras"])
    for source, peer in theirs["cameras"].items():
        row = calibrations[names[source]]
        assert [row["width_px"], row["height_px"]] == peer["size_px"]
        assert row["shutter_direction"] == peer["shutter"].lower()
        # Waymo's cameras are x forward, y left, z up.
        axes = matrix_from_quaternion([[row[key] for key in COLUMNS[:4]]])[0][:, [2, 0, 1]] * (1.0, -1.0, -1.0)
        expected = np.array(peer["extrinsic"])
        assert np.abs(axes - expected[:3, :3]).max() < 1e-11
        assert np.abs(expected[:3, 3] - [row[key] for key in COLUMNS[4:]]).max() < 1e-11
    streams = recording.images()
    assert len(theirs["images"]) == 3 * 4
    seen = 0
    for peer in theirs["images"]:
        name = names[peer["camera"]]
        start, end = (round(Fraction(second) * 10**9) for second in peer["exposure_s"])
        index = int(np.argmin(np.abs(streams[name].exposure_start_ns - start)))
        assert (streams[name].exposure_start_ns[index], streams[name].exposure_end_ns[index]) == (start, end)
        stamp = round(Fraction(peer["pose_s"]) * 10**9)
        for at_ns, matrix in ((stamp, peer["pose"]), (peer["box_us"] * 1_000, peer["vehicle_pose"])):
            row_number = int(np.argmin(np.abs(track.timestamp_ns - at_ns)))
            pose = world_SE3_ego[row_number]
            assert abs(track.timestamp_ns[row_number] - at_ns) < 500
            assert np.abs(pose.translation[0] - np.array(matrix)[:3, 3]).max() < 1e-9
            assert np.abs(matrix_from_quaternion(pose.rotation)[0] - np.array(matrix)[:3, :3]).max() < 1e-9
        found = boxes_in_camera(recording, world_SE3_ego, name, stamp, peer["box_us"] * 1_000)
        assert set(found) == set(peer["boxes"])
        lens = camera_from_row(calibrations[name])
        for track_id, (row, points) in found.items():
            other = peer["boxes"][track_id]
            assert f"TYPE_{row['category'].upper()}" == other["type"]
            yaw = 2.0 * math.atan2(row["qz"], row["qw"])
            mine = [row[key] for key in (*COLUMNS[4:], *SIZES)]
            assert np.abs(np.array(mine) - other["box"][:6]).max() < 1e-9
            assert abs(math.remainder(yaw - other["box"][6], 2.0 * math.pi)) < 1e-9
            inside = np.array(other["seen"])
            away = np.abs(lens.project(points[inside]).uv_px - np.array(other["corners_px"])[inside])
            assert away.max(initial=0.0) < 1e-3
            seen += int(inside.sum())
    assert seen == 160


def test_pykitti_reads_the_same_odometry(tmp_path: Path) -> None:
    """The world of pykitti has the axes of the camera; of a projection it takes the baseline along x alone."""
    recording = open_recording(pykitti_input(tmp_path / "k") / "odometry")
    theirs = result("pykitti")["odometry"]
    track = recording.track()
    assert track.rotation is not None and len(track) == 3
    assert np.abs(track.timestamp_ns / 1_000 - theirs["times_us"]).max() <= 0.5
    # x forward, y left, z up in the axes of a camera.
    turn = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    expected = np.array(theirs["world_SE3_camera"])
    ego = Poses(track.rotation, np.column_stack([track.x_m, track.y_m, track.height_m]))
    place = ego.transform(np.array([[0.0, 0.0, 1.65]]))[:, 0]
    assert np.abs(place @ turn.T - expected[:, :3, 3]).max() < 1e-9
    assert np.abs(turn @ matrix_from_quaternion(track.rotation) @ turn.T - expected[:, :3, :3]).max() < 1e-9
    streams = recording.images()
    rows = {row["camera"]: row for row in recording.calibrations().to_pylist()}
    assert set(rows) == set(streams) == set(theirs["intrinsics"])
    lidar = np.array(theirs["camera_SE3_lidar"]["image_0"])
    for name, row in rows.items():
        matrix = camera_from_row(row).intrinsic_matrix(first_pixel_centre=0.0)
        assert np.abs(matrix - theirs["intrinsics"][name]).max() < 1e-9
        mounting = Poses.from_columns({column: [row[column]] for column in COLUMNS})
        # The frame of the first camera from this camera's.
        placed = np.linalg.inv(np.array(theirs["camera_SE3_lidar"][name]) @ np.linalg.inv(lidar))
        away = turn @ (mounting.translation[0] - (0.0, 0.0, 1.65)) - placed[:3, 3]
        assert np.abs(away).max() < (1e-9 if name in ("image_0", "image_1") else 3.5e-3)
        assert np.abs(turn @ matrix_from_quaternion(mounting.rotation)[0] - placed[:3, :3]).max() < 1e-9
        assert [Path(str(streams[name].path(index))).name for index in range(3)] == theirs["files"][name]


def test_pykitti_reads_the_same_raw_drive(tmp_path: Path) -> None:
    """The world of pykitti is Mercator's sphere around the first fix; of a projection it takes the shift along x."""
    recording = open_recording(pykitti_input(tmp_path / "k") / "raw" / "2011_09_26" / "2011_09_26_drive_0009_sync")
    theirs = result("pykitti")["raw"]
    track = recording.track()
    assert track.rotation is not None and track.sigma_m is not None and len(track) == 3
    assert track.longitude_deg is not None and track.latitude_deg is not None and track.height_m is not None
    # The receiver is 0.93 m above the ego: seen from it, up is the third column of its rotation.
    matrix = matrix_from_quaternion(track.rotation)
    geod = pyproj.Geod(ellps="WGS84")
    east, north, up = (0.93 * matrix[:, :, 2]).T
    heading, metres = np.degrees(np.arctan2(east, north)), np.hypot(east, north)
    lon, lat, _ = geod.fwd(track.longitude_deg, track.latitude_deg, heading, metres)
    degrees = np.column_stack([lon, lat])
    assert np.abs(degrees - theirs["degrees"]).max() < 1e-11
    assert np.abs(track.height_m + up - theirs["height_m"]).max() < 1e-6
    assert track.sigma_m.tolist() == theirs["sigma_m"]
    degrees = np.array(theirs["degrees"])
    stamps = np.array(theirs["times"], "datetime64[ns]").astype(np.int64)
    assert np.abs(track.timestamp_ns - stamps).max() < 1_000
    expected = np.array(theirs["world_SE3_receiver"])
    assert np.abs(matrix_from_quaternion(track.rotation) - expected[:, :3, :3]).max() < 1e-11
    radians = np.radians(degrees)
    sphere = np.column_stack([radians[:, 0], np.log(np.tan(np.pi / 4 + radians[:, 1] / 2))])
    place = 6378137.0 * np.cos(radians[0, 1]) * (sphere - sphere[0])
    assert np.abs(place - expected[:, :2, 3]).max() < 1e-6
    streams = recording.images()
    rows = {row["camera"]: row for row in recording.calibrations().to_pylist()}
    assert set(rows) == set(streams) == set(theirs["intrinsics"])
    for name, row in rows.items():
        matrix = camera_from_row(row).intrinsic_matrix(first_pixel_centre=0.0)
        assert np.abs(matrix - theirs["intrinsics"][name]).max() < 1e-9
        mounting = Poses.from_columns({column: [row[column]] for column in COLUMNS})
        receiver = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.93]]))
        away = (mounting.inverse() @ receiver).matrix()[0] - theirs["camera_SE3_receiver"][name]
        assert np.abs(away[:3, :3]).max() < 1e-10
        assert np.abs(away[:3, 3]).max() < (1e-9 if name in ("image_00", "image_01") else 3.5e-3)
        assert [Path(str(streams[name].path(index))).name for index in range(3)] == theirs["files"][name]
    # Tracklets turn about the z of the lidar alone.
    boxes, lidar = recording.boxes(), Poses.from_matrix(theirs["lidar_SE3_receiver"])
    assert boxes is not None
    table = boxes.to_pandas()
    upright = lidar @ Poses.from_columns(table)
    assert np.abs(rotate(upright.rotation, (0.0, 0.0, 1.0)) - (0.0, 0.0, 1.0)).max() < 1e-9


def test_mapillary_tools_reads_the_same_fixes(tmp_path: Path) -> None:
    """Of GPS5, mapillary_tools keeps the time of the payload for all its fixes; of CAMM, the seconds of GPS."""
    theirs = result("mapillary_tools")
    files = sorted(mapillary_tools_input(tmp_path / "m").iterdir())
    assert [file.stem for file in files] == sorted(theirs)
    for file in files:
        track, peer = open_recording(file).track(), theirs[file.stem]
        found = np.column_stack([track.longitude_deg, track.latitude_deg, track.height_m])
        assert len(found) == 48 and np.abs(found - peer["degrees"]).max() < 1e-9
        media_s = (track.timestamp_ns - track.timestamp_ns[0]) * 1e-9
        if file.stem in ("gps5", "camm5"):
            assert np.abs(media_s - np.array(peer["media_s"])).max() < 1e-6
        if file.stem == "gps9":
            assert np.abs(track.timestamp_ns * 1e-9 - peer["unix_s"]).max() < 1e-6
        if file.stem == "camm6":
            assert np.abs(track.timestamp_ns * 1e-9 - 315_964_800 + 18 - peer["unix_s"]).max() < 1e-6
