"""nuscenes-devkit and av2 read the same files to the same numbers; ``make peers`` makes their results again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyproj

from mirror.geometry.cameras import camera_from_row
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import COLUMNS, Poses
from mirror.geometry.quaternions import rotate
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording
from tests.recordings.formats.peers import argoverse2_input, nuscenes_input, result

SIZES = ("length_m", "width_m", "height_m")


def corners(row: dict[str, Any]) -> np.ndarray:
    """(8, 3) corners of a box in its own frame."""
    half = np.array([row[name] for name in SIZES]) / 2
    return half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def projected_boxes(
    recording: Recording, world_SE3_ego: Poses, camera: str, stamp_ns: int, box_ns: int
) -> dict[str, tuple[dict[str, Any], np.ndarray, np.ndarray]]:
    """Row, corner pixels and depths of the boxes of an instant, in an image, by track."""
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
            matrix = camera_from_row(calibration).intrinsic_matrix(first_pixel_centre=0.0)
            pixels = points @ matrix.T
            found[row["track_id"]] = row, pixels[:, :2] / pixels[:, 2:], points[:, 2]
    return found


def same_corners(theirs: dict[str, Any], pixels: np.ndarray, depth: np.ndarray) -> None:
    """The corners are the same points in another order; pixels of corners in front of the camera count."""
    peer_depth, peer_pixels = np.array(theirs["depth_m"]), np.array(theirs["corners_px"])
    for at, place in zip(peer_depth, peer_pixels):
        nearest = np.argmin(np.abs(depth - at) + np.linalg.norm(pixels - place, axis=1) * (at > 0.5))
        assert abs(depth[nearest] - at) < 1e-6
        if at > 0.5:
            assert np.abs(pixels[nearest] - place).max() < 1e-4


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
