"""Turn photos and their COLMAP model into a recording: ``python examples/lund_recording.py FOLDER RECORDING``.

FOLDER has ``images/`` and a model in ``colmap/``, as in docs/rasterizer_training.md: of one camera or several, of
photos in any order. Each photo keeps its camera's lens; photos of several sizes become a recording each, in RECORDING,
because the images of a MIRROR camera have one size. It takes pycolmap (extra ``calibration``) and pillow. COLMAP knows
neither up, nor north, nor metres: up is what the photos have in common; north and metres come from longitude and
latitude in the EXIF data of at least two photos. Where photos have none, ``--metres-per-unit NUMBER`` gives the metres,
and the recording is in a local frame.
"""

import csv
import json
import shutil
import sys
import zlib  # noqa: F401 - before pycolmap, whose wheel brings one of its own
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from PIL import Image

from mirror.arrays import Float64, Int64
from mirror.errors import ExitCode, MirrorError, UsageError
from mirror.geometry.geodesy import ecef_R_enu, ecef_to_geodetic, geodetic_to_ecef
from mirror.geometry.quaternions import quaternion_from_matrix

HEIGHT_M = 1.6  # of the camera above the ground: it was held in a hand
START_NS = 1_400_000_000_000_000_000  # the photos have no times: one per second, or fewer where they are far apart
SPEED_MPS, HALF_ACCELERATION_MPS2 = 60.0, 5.0  # greatest values between photos: ingest treats larger ones as outliers
EGO_R_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
GPS = 34853
CAMERA = "front_wide"
SUFFIXES = {".jpg": ".jpg", ".jpeg": ".jpg", ".png": ".png"}
LENSES: dict[str, tuple[str, list[str]]] = {
    "SIMPLE_PINHOLE": ("pinhole", []),
    "PINHOLE": ("pinhole", []),
    "SIMPLE_RADIAL": ("brown_conrady", ["k", "0", "0", "0", "0"]),
    "RADIAL": ("brown_conrady", ["k1", "k2", "0", "0", "0"]),
    "OPENCV": ("brown_conrady", ["k1", "k2", "p1", "p2", "0"]),
    "FULL_OPENCV": ("rational", ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"]),
    "SIMPLE_RADIAL_FISHEYE": ("kannala_brandt", ["k", "0", "0", "0"]),
    "RADIAL_FISHEYE": ("kannala_brandt", ["k1", "k2", "0", "0"]),
    "OPENCV_FISHEYE": ("kannala_brandt", ["k1", "k2", "k3", "k4"]),
}
"""COLMAP's camera models: what MIRROR calls them, and their coefficients in its order."""


@dataclass(frozen=True, eq=False)
class Walk:
    """The poses of N photos in metres.

    Attributes:
        images: images of the model.
        frame: the frame in recording.json.
        positions: columns of the table of poses, by name.
        world_R_ego: (N, 3, 3).
        metres_per_unit: metres per unit of the model.
        summary: text that is printed at the end.
    """

    images: list[pycolmap.Image]
    frame: dict[str, str]
    positions: dict[str, Float64]
    world_R_ego: Float64
    metres_per_unit: float
    summary: str

    def select(self, rows: Int64) -> "Walk":
        """Select photos by index."""
        positions = {name: column[rows] for name, column in self.positions.items()}
        return replace(
            self,
            images=[self.images[number] for number in rows],
            positions=positions,
            world_R_ego=self.world_R_ego[rows],
        )


def read_model(folder: Path) -> tuple[pycolmap.Reconstruction, list[pycolmap.Image]]:
    """Read the model and its images with a pose, by name; check that each has a photo of its camera's size."""
    try:
        model = pycolmap.Reconstruction(str(folder / "colmap"))
    except (ValueError, RuntimeError) as error:
        raise UsageError(f"no model can be read: {error}", file=folder / "colmap", expected="a COLMAP model") from error
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    if len(images) < 2:
        raise UsageError(f"{len(images)} images with a pose", file=folder / "colmap", expected="at least 2")
    photos = folder / "images"
    missing = [image.name for image in images if not (photos / image.name).is_file()]
    if missing:
        raise UsageError(
            f"{len(missing)} of {len(images)} photos of the model are missing: {', '.join(missing[:5])}",
            file=photos,
            remedy="put them there, or take these images out of the model",
        )
    kinds = {SUFFIXES.get(Path(image.name).suffix.lower()) for image in images}
    if len(kinds) > 1 or None in kinds:
        found = sorted({Path(image.name).suffix for image in images})
        raise UsageError(
            f"photos are {', '.join(found)}", file=photos, expected="all .jpg or all .png", remedy="convert them"
        )
    for image in images:
        lens, size = model.cameras[image.camera_id], Image.open(photos / image.name).size
        if lens.model.name not in LENSES:
            raise UsageError(
                f"camera {lens.camera_id} is {lens.model.name}",
                file=folder / "colmap",
                expected=" or ".join(LENSES),
                remedy="let COLMAP fit one of these, or undistort the photos",
            )
        if size != (lens.width, lens.height):
            raise UsageError(
                f"{size[0]} x {size[1]} pixels",
                file=photos / image.name,
                expected=f"{lens.width} x {lens.height}, as camera {lens.camera_id} of the model has",
            )
    return model, images


def read_gps(photos: list[Path]) -> Float64:
    """Read longitude, latitude and height (N, 3) from EXIF data; NaN without a position, height 0 without a height."""
    rows = []
    for photo in photos:
        tags = Image.open(photo).getexif().get_ifd(GPS)
        row = [np.nan, np.nan, 0.0]
        if all(key in tags for key in (1, 2, 3, 4)):
            angles = [float(np.dot([float(part) for part in tags[key]], [1, 1 / 60, 1 / 3600])) for key in (4, 2)]
            row[:2] = [-angle if tags[key] in ("W", "S") else angle for key, angle in zip((3, 1), angles)]
        if 6 in tags and np.isfinite(float(tags[6])):
            row[2] = -float(tags[6]) if tags.get(5) in (1, b"\1") else float(tags[6])
        rows.append(row)
    table = np.array(rows)
    table[~np.isfinite(table).all(axis=1)] = np.nan
    return table


def compute_level_rotation(folder: Path, rotations: Float64) -> Float64:
    """Compute a rotation (3, 3) from COLMAP's axes to axes with z up, from the mean up direction of the photos."""
    up = -rotations[:, :, 1].mean(axis=0)
    if np.linalg.norm(up) < 0.5:
        raise UsageError(
            "the photos have no up in common", file=folder / "images", expected="most of them held upright"
        )
    up /= np.linalg.norm(up)
    x = np.cross(np.eye(3)[np.abs(up).argmin()], up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def fit_turn_and_scale(folder: Path, here: Float64, there: Float64) -> tuple[Float64, float]:
    """Fit level coordinates (N, 2) to east and north (N, 2): a rotation about z (3, 3), and metres per unit."""
    spread = float(np.linalg.norm(np.ptp(there, axis=0))) if len(there) else 0.0
    if spread < 2.0 or not np.ptp(here, axis=0).any():
        raise UsageError(
            f"{len(there)} photos have a place in their EXIF data, {spread:.1f} m apart",
            file=folder / "images",
            expected="2 or more, over at least 2 m, for north and metres",
            remedy="--metres-per-unit NUMBER: metres a unit of the model; the recording is then in a local frame",
        )
    # a rotation and a scale of the plane are one complex number
    source, target = ((points - points.mean(axis=0)) @ [1, 1j] for points in (here, there))
    factor = np.vdot(source, target) / np.vdot(source, source)
    turn = np.angle(factor)
    matrix = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    return matrix, float(abs(factor))


def compute_walk(folder: Path, images: list[pycolmap.Image], metres_per_unit: float | None) -> Walk:
    """Compute poses in metres, geodetic from the positions in EXIF data, or local with the given metres per unit."""
    rotations = np.stack([image.cam_from_world().rotation.matrix().T for image in images])
    centres = np.stack([image.projection_center() for image in images])
    level = compute_level_rotation(folder, rotations)
    if metres_per_unit is not None:
        if not 0.0 < metres_per_unit < np.inf:
            raise UsageError(f"{metres_per_unit}", place="--metres-per-unit", expected="a number above 0")
        world_R_ego = level @ rotations @ EGO_R_CAMERA.T
        ground = metres_per_unit * (centres - centres.mean(axis=0)) @ level.T - HEIGHT_M * world_R_ego[:, :, 2]
        columns = dict(zip(("x_m", "y_m", "z_m"), ground.T))
        frame = {"kind": "local", "name": "colmap"}
        return Walk(
            images, frame, columns, world_R_ego, metres_per_unit, "local frame: its origin is the middle of the photos"
        )
    gps = read_gps([folder / "images" / image.name for image in images])
    known = np.isfinite(gps[:, 0])
    middle = gps[known].mean(axis=0) if known.any() else np.zeros(3)
    origin, ecef_R_place = geodetic_to_ecef(*middle), ecef_R_enu(*middle[:2])
    metric = (geodetic_to_ecef(*gps[known].T) - origin) @ ecef_R_place
    flat = centres @ level.T
    turn, scale = fit_turn_and_scale(folder, flat[known, :2], metric[:, :2])
    enu = scale * (flat - flat[known].mean(axis=0)) @ turn.T + [*metric[:, :2].mean(axis=0), 0.0]
    # the vehicle is the person who walks: its frame is on the ground under the camera and tilts with the camera
    world_R_ego = turn @ level @ rotations @ EGO_R_CAMERA.T
    geodetic = ecef_to_geodetic(origin + (enu - HEIGHT_M * world_R_ego[:, :, 2]) @ ecef_R_place.T)
    off = np.linalg.norm(enu[known, :2] - metric[:, :2], axis=1).max()
    summary = f"{off:.0f} m at most from where the EXIF data of {known.sum()} photos says\n"
    summary += f"the middle: --roi {middle[0]:.6f},{middle[1]:.6f}"
    columns = dict(zip(("longitude_deg", "latitude_deg", "height_m"), geodetic))
    return Walk(images, {"kind": "wgs84"}, columns, world_R_ego, scale, summary)


def make_calibrations(lenses: list[pycolmap.Camera], stamps: list[int]) -> list[dict[str, Any]]:
    """Make the rows of calibrations from the lens of each photo: one row per run of photos of one camera."""
    begins = [place for place, lens in enumerate(lenses) if place == 0 or lens.camera_id != lenses[place - 1].camera_id]
    rows: list[dict[str, Any]] = []
    for begin, end in zip(begins, [*begins[1:], len(lenses)]):
        lens = lenses[begin]
        values = {"0": 0.0} | dict(zip(lens.params_info.split(", "), map(float, lens.params)))
        model, coefficients = LENSES[lens.model.name]
        rows.append({
            "camera": CAMERA, "model": model, "width_px": lens.width, "height_px": lens.height,
            "fx_px": values.get("fx", values.get("f")), "fy_px": values.get("fy", values.get("f")),
            "cx_px": values["cx"], "cy_px": values["cy"], "distortion": [values[name] for name in coefficients],
            "ego_SE3_camera": [0.5, -0.5, 0.5, -0.5, 0.0, 0.0, HEIGHT_M],
            "valid_from_ns": None if begin == 0 else stamps[begin - 1] + 1,
            "valid_to_ns": None if end == len(lenses) else stamps[end - 1],
            "method": f"COLMAP, camera {lens.camera_id}",
        })  # fmt: skip
    return rows


def compute_interval_s(centres_m: Float64) -> int:
    """Compute whole seconds between photos at positions (N, 3), so that the motion stays within ingest's limits."""
    steps = np.linalg.norm(np.diff(centres_m, axis=0), axis=1)
    turns = np.linalg.norm(centres_m[1:-1] - 0.5 * (centres_m[:-2] + centres_m[2:]), axis=1)
    least = max(steps.max(initial=0.0) / SPEED_MPS, np.sqrt(turns.max(initial=0.0) / HALF_ACCELERATION_MPS2))
    return max(1, int(np.ceil(least)))


def write_recording(folder: Path, out: Path, drive: str, model: pycolmap.Reconstruction, walk: Walk) -> int:
    """Write photos of one size as a recording; return the seconds between photos."""
    seconds = compute_interval_s(walk.metres_per_unit * np.stack([image.projection_center() for image in walk.images]))
    stamps = [START_NS + number * seconds * 1_000_000_000 for number in range(len(walk.images))]
    photos = out / "images" / CAMERA
    photos.mkdir(parents=True)
    (out / "calibrations").mkdir()
    with (out / "poses.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["timestamp", *walk.positions, "qw", "qx", "qy", "qz"])
        for number, (stamp, image) in enumerate(zip(stamps, walk.images)):
            quaternion = quaternion_from_matrix(walk.world_R_ego[number]).ravel().tolist()
            table.writerow([stamp, *(column[number] for column in walk.positions.values()), *quaternion])
            suffix = SUFFIXES[Path(image.name).suffix.lower()]
            shutil.copyfile(folder / "images" / image.name, photos / f"{stamp}{suffix}")
    lenses = make_calibrations([model.cameras[image.camera_id] for image in walk.images], stamps)
    (out / "calibrations" / "refined.json").write_text(json.dumps(lenses, indent=1))
    recording = {
        "format": "mirror-folder", "version": "1.0", "drive_id": drive, "vehicle_id": "walker",
        "vehicle_type": "walker", "rig_id": "hand", "time_base": "unix_ns",
        "frame": walk.frame, "is_clip": True, "light": "day",
        "weather": "clouds", "city": "Lund", "licence": "BSD-2-Clause", "reference_camera": CAMERA,
        "cameras": {CAMERA: {}},
    }  # fmt: skip
    (out / "recording.json").write_text(json.dumps(recording, indent=1))
    return seconds


def main(folder: Path, out: Path, metres_per_unit: float | None = None) -> None:
    """Write one recording per photo size, and print their folders."""
    if out.exists():
        raise UsageError("is there already", file=out, expected="a new folder")
    model, images = read_model(folder)
    walk = compute_walk(folder, images, metres_per_unit)
    lenses = [model.cameras[image.camera_id] for image in images]
    sizes = np.array([f"{lens.width}x{lens.height}" for lens in lenses])
    part = out.with_name(out.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    for size in np.unique(sizes):
        own = walk.select(np.flatnonzero(sizes == size))
        whole = len(own.images) == len(images)
        seconds = write_recording(
            folder, part if whole else part / size, "lund" if whole else f"lund_{size}", model, own
        )
        kinds = len({image.camera_id for image in own.images})
        print(f"{out if whole else out / size}: {len(own.images)} photos, {kinds} lens(es), one every {seconds} s")
    part.rename(out)
    print(f"{walk.metres_per_unit:.1f} m a unit of COLMAP's, {walk.summary}")


if __name__ == "__main__":
    import argparse

    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="holds images/ and colmap/")
    parser.add_argument("recording", type=Path, help="a new folder")
    parser.add_argument("--metres-per-unit", type=float, help="of the model, where no photo has a place")
    chosen = parser.parse_args()
    try:
        main(chosen.folder, chosen.recording, chosen.metres_per_unit)
    except MirrorError as error:
        print(error, file=sys.stderr)
        sys.exit(ExitCode.COULD_NOT_RUN)
