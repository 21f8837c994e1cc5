"""Renders the images of this folder from the synthetic street: ``python docs/images/make.py``.

``report.png`` is a screenshot of the page that ``make demo`` writes last.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.geometry import Poses
from mirror.geometry.box_projection import project_boxes
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drives
from mirror.synth.writing.boxes import world_SE3_boxes

HERE = Path(__file__).parent
WIDTH_PX, GAP_PX = 1200, 5
COLOURS = {
    "car": (102, 209, 255),
    "van": (255, 208, 131),
    "truck": (107, 140, 247),
    "bus": (111, 71, 239),
    "motorcycle": (208, 224, 64),
    "pedestrian": (156, 242, 124),
    "cyclist": (255, 155, 212),
}


def demo_drive(drive_id: str, width_px: int) -> SynthDrive:
    """Return one drive of the demo with cameras of another resolution."""
    drive = next(drive for drive in make_drives("demo", 0)[1] if drive.drive_id == drive_id)
    return replace(drive, vehicle=replace(drive.vehicle, width_px=width_px))


def instant_ns(drive: SynthDrive, share: float) -> int:
    """Return the Unix time at a share of the drive's duration, in nanoseconds."""
    return drive.condition.start_ns + round(share * drive.truth.duration_s * 1e9)


def mosaic(drive: SynthDrive, share: float) -> UInt8:
    """Arrange the images of the seven cameras in two rows: three forward cameras, and the four others."""
    at = instant_ns(drive, share)
    rows = (("front_left", "front_wide", "front_right"), ("rear_left", "front_narrow", "rear", "rear_right"))
    strips = []
    for names in rows:
        width = (WIDTH_PX - (len(names) - 1) * GAP_PX) // len(names)
        size = (width, round(width * 9 / 16))
        strip = np.full((size[1], WIDTH_PX, 3), 255, np.uint8)
        for number, name in enumerate(names):
            x = number * (WIDTH_PX - width) // (len(names) - 1)
            strip[:, x : x + width] = cv2.resize(drive.render(name, at).bgr, size, interpolation=cv2.INTER_AREA)
        strips += [strip, np.full((GAP_PX, WIDTH_PX, 3), 255, np.uint8)]
    return np.concatenate(strips[:-1])


def boxes(drive: SynthDrive, share: float, camera: str) -> UInt8:
    """Render one image with the 3D boxes of the road users that it shows."""
    at = instant_ns(drive, share)
    instant = drive.at(at)
    shown = drive.render(camera, at, instant)
    objects, image, lens = shown.view.object, shown.bgr.copy(), drive.vehicle.cameras[camera]
    pose = drive.world_SE3_camera(camera, np.array([at]))
    numbers = [number for number in instant.placements if (objects == number).sum() > 60]
    for number in sorted(numbers, key=lambda number: -_away(instant.placements[number], pose)):
        user = drive.road_users[number]
        world_SE3_box = world_SE3_boxes([user], [instant.placements[number]])
        projected = project_boxes(lens, pose.inverse() @ world_SE3_box, [user.body.size_m])
        steps = np.linspace(0.0, 1.0, 9)[:, None]
        for start, end in projected.edges_m[0]:
            line = lens.project(start * (1 - steps) + end * steps).uv_px
            if np.isfinite(line).all():
                points = np.round(8 * (line - 0.5)).astype(np.int32)
                cv2.polylines(image, [points], False, COLOURS[user.body.category], 1, cv2.LINE_AA, 3)
    return image


def _away(place: object, pose: Poses) -> float:
    return float(np.hypot(place.x_m - pose.translation[0, 0], place.y_m - pose.translation[0, 1]))


def write(name: str, bgr: UInt8) -> None:
    """Write a PNG with 256 colours: a third of the size without a visible difference."""
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(bgr[..., ::-1]))
    image = image.quantize(256, Image.Quantize.MEDIANCUT, kmeans=1, dither=Image.Dither.FLOYDSTEINBERG)
    image.save(HERE / name, optimize=True)
    print(name, f"{(HERE / name).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    write("demo_frame.png", mosaic(demo_drive("guangzhou-urban-01", 960), 0.31))
    write("boxes.png", boxes(demo_drive("guangzhou-urban-01", 960), 0.45, "front_wide"))
