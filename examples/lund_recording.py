"""Turn street photos and their COLMAP model into a recording: ``python examples/lund_recording.py FOLDER RECORDING``.

FOLDER has ``images/`` with longitude, latitude and height in their EXIF data and a model in ``colmap/``, of one
SIMPLE_RADIAL camera, as in docs/rasterizer_training.md. It takes pycolmap (extra ``calibration``) and pillow.
COLMAP knows neither up, nor north, nor metres: up is what photos have in common, the rest tells their EXIF data.
"""

import csv
import json
import shutil
import sys
import zlib  # noqa: F401 - before pycolmap, whose wheel brings one of its own
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from mirror.arrays import Float64
from mirror.geometry.geodesy import ecef_R_enu, ecef_to_geodetic, geodetic_to_ecef
from mirror.geometry.quaternions import quaternion_from_matrix

HEIGHT_M = 1.6  # of the camera above the ground: it was held in a hand
START_NS = 1_400_000_000_000_000_000  # the photos tell no time: one a second
EGO_R_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
GPS = 34853


def places(photos: list[Path]) -> Float64:
    """(N, 3) longitude, latitude and height as cameras wrote them."""
    rows = []
    for photo in photos:
        tags = Image.open(photo).getexif().get_ifd(GPS)
        angles = [float(np.dot([float(part) for part in tags[key]], [1, 1 / 60, 1 / 3600])) for key in (4, 2)]
        signs = [-1.0 if tags[key] in ("W", "S") else 1.0 for key in (3, 1)]
        rows.append([*(sign * angle for sign, angle in zip(signs, angles)), float(tags[6])])
    return np.array(rows)


def levelled(rotations: Float64, centres: Float64, east_north_m: Float64) -> tuple[Float64, Float64, float]:
    """Cameras in east, north, up: rotations (N, 3, 3), centres (N, 3) and how many metres a unit of COLMAP's has."""
    up = -rotations[:, :, 1].mean(axis=0)
    up /= np.linalg.norm(up)
    x = np.cross(np.eye(3)[np.abs(up).argmin()], up)
    x /= np.linalg.norm(x)
    level = np.stack([x, np.cross(up, x), up])
    flat = centres @ level.T
    # A turn and a scale of the plane are one complex number.
    here, there = flat[:, 0] + 1j * flat[:, 1], east_north_m[:, 0] + 1j * east_north_m[:, 1]
    here, there = here - here.mean(), there - there.mean()
    factor = np.vdot(here, there) / np.vdot(here, here)
    scale, turn = abs(factor), np.angle(factor)
    enu = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]) @ level
    return enu @ rotations, scale * (centres - centres.mean(axis=0)) @ enu.T, scale


def main(folder: Path, out: Path) -> None:
    """Write the recording, and say where it lies."""
    model = pycolmap.Reconstruction(str(folder / "colmap"))
    images = sorted(model.images.values(), key=lambda image: image.name)
    lens = model.cameras[images[0].camera_id]
    if lens.model.name != "SIMPLE_RADIAL":
        sys.exit(f"{folder / 'colmap'}: camera {lens.camera_id} is {lens.model.name}, expected SIMPLE_RADIAL")
    focal, cx, cy, radial = lens.params

    gps = places([folder / "images" / image.name for image in images])
    middle = gps.mean(axis=0)
    origin = geodetic_to_ecef(*middle)
    ecef_R_place = ecef_R_enu(*middle[:2])
    metric = (geodetic_to_ecef(*gps.T) - origin) @ ecef_R_place
    rotations = np.stack([image.cam_from_world().rotation.matrix().T for image in images])
    enu_R_camera, centres, scale = levelled(
        rotations, np.stack([image.projection_center() for image in images]), metric
    )
    # The vehicle is whoever walks: its frame stands under the camera, and tilts as the camera does.
    enu_R_ego = enu_R_camera @ EGO_R_CAMERA.T
    longitude, latitude, height = ecef_to_geodetic(origin + (centres - HEIGHT_M * enu_R_ego[:, :, 2]) @ ecef_R_place.T)

    pictures = out / "images" / "front_wide"
    pictures.mkdir(parents=True)
    (out / "calibrations").mkdir()
    with (out / "poses.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["timestamp", "longitude_deg", "latitude_deg", "height_m", "qw", "qx", "qy", "qz"])
        for number, image in enumerate(images):
            stamp = START_NS + number * 1_000_000_000
            quaternion = quaternion_from_matrix(enu_R_ego[number]).ravel().tolist()
            table.writerow([stamp, longitude[number], latitude[number], height[number], *quaternion])
            shutil.copyfile(folder / "images" / image.name, pictures / f"{stamp}.jpg")
    calibration = {
        "camera": "front_wide", "model": "brown_conrady", "width_px": lens.width, "height_px": lens.height,
        "fx_px": focal, "fy_px": focal, "cx_px": cx, "cy_px": cy, "distortion": [radial, 0.0, 0.0, 0.0, 0.0],
        "ego_SE3_camera": [0.5, -0.5, 0.5, -0.5, 0.0, 0.0, HEIGHT_M], "method": "COLMAP",
    }  # fmt: skip
    (out / "calibrations" / "refined.json").write_text(json.dumps([calibration], indent=1))
    recording = {
        "format": "mirror-folder", "version": "1.0", "drive_id": "lund", "vehicle_id": "walker",
        "vehicle_type": "walker", "rig_id": "hand", "time_base": "unix_ns",
        "frame": {"kind": "wgs84"}, "is_clip": True, "light": "day",
        "weather": "clouds", "city": "Lund", "licence": "BSD-2-Clause", "reference_camera": "front_wide",
        "cameras": {"front_wide": {}},
    }  # fmt: skip
    (out / "recording.json").write_text(json.dumps(recording, indent=1))
    off = np.linalg.norm(centres[:, :2] - (metric - metric.mean(axis=0))[:, :2], axis=1)
    print(f"{len(images)} photos, {scale:.1f} m a unit of COLMAP's, {off.max():.0f} m at most from where EXIF says")
    print(f"the middle: --roi {middle[0]:.6f},{middle[1]:.6f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
