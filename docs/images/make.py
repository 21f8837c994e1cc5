"""Makes the pictures of this folder from the synthetic street: ``python docs/images/make.py``.

``report.png`` is a screenshot of the page that ``make demo`` ends with.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.geometry import Poses
from mirror.geometry.box_projection import project_boxes
from mirror.synth.fleet import SynthDrive, drives_of

HERE = Path(__file__).parent
WIDTH_PX, GAP_PX = 1200, 5
COLOURS = {
    "car": (102, 209, 255),
    "van": (255, 208, 131),
    "truck": (107, 140, 247),
    "bus": (111, 71, 239),
    "pedestrian": (156, 242, 124),
    "cyclist": (255, 155, 212),
}


def drive(number: int, width_px: int, height_px: int) -> SynthDrive:
    """One drive of the demo with cameras of another resolution."""
    one = drives_of("demo", 0)[1][number]
    return replace(one, vehicle=replace(one.vehicle, width_px=width_px, height_px=height_px))


def pictures(one: SynthDrive, share: float) -> tuple[dict[str, UInt8], float]:
    """All seven pictures at a share of the drive's duration, without sensor noise; and the time."""
    time_s = share * one.truth.duration_s
    one.stage.look["noise"] = 0.0
    ego = one.truth.poses(np.array([time_s]))
    instant = one.stage.at(time_s, ego)
    found = {
        name: one.stage.picture(instant, lens, ego @ one.vehicle.ego_SE3_camera[name], 0).bgr
        for name, lens in one.lenses.items()
    }
    return found, time_s


def mosaic(one: SynthDrive, share: float) -> UInt8:
    """The seven cameras in two rows: three that look ahead, and the four others."""
    shown, _ = pictures(one, share)
    rows = (("front_left", "front_wide", "front_right"), ("rear_left", "front_narrow", "rear", "rear_right"))
    strips = []
    for names in rows:
        width = (WIDTH_PX - (len(names) - 1) * GAP_PX) // len(names)
        size = (width, round(width * 9 / 16))
        strip = np.full((size[1], WIDTH_PX, 3), 255, np.uint8)
        for number, name in enumerate(names):
            x = number * (WIDTH_PX - width) // (len(names) - 1)
            strip[:, x : x + width] = cv2.resize(shown[name], size, interpolation=cv2.INTER_AREA)
        strips += [strip, np.full((GAP_PX, WIDTH_PX, 3), 255, np.uint8)]
    return np.concatenate(strips[:-1])


def boxes(one: SynthDrive, share: float, camera: str) -> UInt8:
    """One picture with the 3D boxes of what it shows."""
    shown, time_s = pictures(one, share)
    ego = one.truth.poses(np.array([time_s]))
    pose = ego @ one.vehicle.ego_SE3_camera[camera]
    instant = one.stage.at(time_s, ego)
    seen = one.stage.picture(instant, one.lenses[camera], pose, 0).object
    picture, lens = shown[camera].copy(), one.vehicle.cameras[camera]
    numbers = [number for number in instant.placements if (seen == number).sum() > 60]
    for number in sorted(numbers, key=lambda number: -_away(instant.placements[number], pose)):
        user, place = one.stage.users[number], instant.placements[number]
        half = 0.5 * place.yaw_rad
        centre = [place.x_m, place.y_m, 0.5 * user.body.size_m[2]]
        world_SE3_box = Poses([[np.cos(half), 0, 0, np.sin(half)]], [centre])
        projected = project_boxes(lens, pose.inverse() @ world_SE3_box, [user.body.size_m])
        steps = np.linspace(0.0, 1.0, 9)[:, None]
        for start, end in projected.edges_m[0]:
            line = lens.project(start * (1 - steps) + end * steps).uv_px
            if np.isfinite(line).all():
                points = np.round(8 * (line - 0.5)).astype(np.int32)
                cv2.polylines(picture, [points], False, COLOURS[user.body.category], 1, cv2.LINE_AA, 3)
    return picture


def _away(place: object, pose: Poses) -> float:
    return float(np.hypot(place.x_m - pose.translation[0, 0], place.y_m - pose.translation[0, 1]))


def write(name: str, picture: UInt8) -> None:
    """Write a PNG of 256 colours: a third of the size, and no difference that is seen."""
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(picture[..., ::-1]))
    image = image.quantize(256, Image.Quantize.MEDIANCUT, kmeans=1, dither=Image.Dither.FLOYDSTEINBERG)
    image.save(HERE / name, optimize=True)
    print(name, f"{(HERE / name).stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    write("demo_frame.png", mosaic(drive(13, 800, 450), 0.31))
    write("boxes.png", boxes(drive(13, 960, 540), 0.45, "front_wide"))
