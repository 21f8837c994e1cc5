"""Renders the contact sheets of the synthetic street: ``python docs/images/sheets.py [NAME ...]``, by default all.

Each sheet is a JPEG in ``sheets/``. Its name is that of a function at the end of this file.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from mirror.arrays import AnyArray, UInt8
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.schema.documents import CANONICAL_CAMERAS
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drives
from mirror.synth.fleet.recipe import CONDITIONS
from mirror.synth.light.condition import Condition, Effects
from mirror.synth.light.sun import instant_of
from mirror.synth.model import Label
from mirror.synth.render import render
from mirror.synth.render.lens import make_lens
from mirror.synth.rigs import VEHICLE_TYPES
from mirror.synth.truth import static_flow

HERE = Path(__file__).parent / "sheets"
WIDTH_PX, GAP_PX, CAPTION_PX = 1800, 4, 17
QUALITIES = range(88, 50, -4)
MOST_BYTES = 440_000
FRONT = "front_wide"
NO_BONNET = ("guangzhou-urban-02", "lyon-highway-02", "karlsruhe-rural-04", "karlsruhe-campus-01")
MOMENTS = np.linspace(0.15, 0.85, 5)
BY_DAY = ("sun_shadows", "haze", "season", "foliage", "billboards", "traffic", "vignetting")
DATES = {"day": "2025-05-14", "dusk": "2025-07-02", "night": "2025-11-19"}
SEASONS = {"winter": "2026-01-21", "spring": "2025-04-12", "summer": "2025-07-02", "autumn": "2025-10-22"}
LABEL_COLOURS = {
    Label.SKY: (180, 130, 70), Label.ROAD: (128, 64, 128), Label.PAVEMENT: (232, 35, 244),
    Label.TERRAIN: (152, 251, 152), Label.BUILDING: (70, 70, 70), Label.WALL: (156, 102, 102),
    Label.POLE: (153, 153, 153), Label.TRAFFIC_LIGHT: (30, 170, 250), Label.TRAFFIC_SIGN: (0, 220, 220),
    Label.VEGETATION: (35, 142, 107), Label.BILLBOARD: (160, 170, 250), Label.FURNITURE: (180, 165, 180),
    Label.PERSON: (60, 20, 220), Label.RIDER: (0, 0, 255), Label.CAR: (142, 0, 0), Label.VAN: (190, 60, 0),
    Label.TRUCK: (70, 0, 0), Label.BUS: (100, 60, 0), Label.MOTORCYCLE: (230, 0, 0), Label.BICYCLE: (32, 11, 119),
    Label.EGO: (40, 40, 40),
}  # fmt: skip
"""Blue, green, red: the colours of Cityscapes."""


class Cell(NamedTuple):
    """One image of a sheet."""

    bgr: UInt8
    caption: str = ""


# The drives and their images


def drives(preset: str, width_px: int) -> list[SynthDrive]:
    """Return the drives of a preset that record images, with cameras of another resolution."""
    return [at_width(drive, width_px) for drive in make_drives(preset, 0)[1] if drive.recipe.images]


def at_width(drive: SynthDrive, width_px: int) -> SynthDrive:
    """Return a drive with cameras of another resolution."""
    return replace(drive, vehicle=replace(drive.vehicle, width_px=width_px))


def in_condition(drive: SynthDrive, date: str, light: str, weather: str, *, visit: int) -> SynthDrive:
    """Return the drive on another date, in another light and weather."""
    roi = drive.roi
    start = instant_of(date, light, roi.longitude_deg or 0.0, roi.latitude_deg or 0.0)
    return replace(drive, condition=Condition(start, light, weather, visit=visit))


def moment_ns(drive: SynthDrive) -> int:
    """Return the time of the front camera's most varied image, by the entropy of the classes."""
    small = make_lens(replace(drive.vehicle, width_px=160).cameras[FRONT])

    def variety(at_ns: int) -> float:
        pose = drive.world_SE3_camera(FRONT, np.array([at_ns]))
        return _entropy(drive.stage.render(drive.at(at_ns), small, pose).view.label)

    return max((at_share(drive, share) for share in MOMENTS), key=variety)


def _entropy(labels: UInt8) -> float:
    share = np.bincount(labels.ravel()) / labels.size
    return float(-(share[share > 0] * np.log(share[share > 0])).sum())


def at_share(drive: SynthDrive, share: float) -> int:
    """Return the time at a share of the drive's duration."""
    return drive.condition.start_ns + round(share * drive.truth.duration_s * 1e9)


def passing_ns(drive: SynthDrive, place_m: AnyArray) -> int:
    """Return the time at which a drive is closest to a place."""
    stamps = drive.condition.start_ns + np.arange(0.0, drive.truth.duration_s, 0.1) * 1e9
    away = drive.world_SE3_ego(stamps.astype(np.int64)).translation - place_m
    return int(stamps[np.argmin((away**2).sum(axis=1))])


def describe_condition(drive: SynthDrive) -> str:
    """Describe the light and the weather of a drive."""
    condition = drive.condition
    return condition.light if condition.weather == "clear" else f"{condition.light}, {condition.weather}"


def row_of_cameras(drive: SynthDrive, at_ns: int) -> Iterator[Cell]:
    """Render the seven images of an instant."""
    instant = drive.at(at_ns)
    for name in CANONICAL_CAMERAS:
        yield Cell(drive.render(name, at_ns, instant).bgr, name)


# Layout


def sheet(
    cells: Sequence[Cell], columns: int, captions: bool = True, tallest: float = 1.5, width_px: int = WIDTH_PX
) -> UInt8:
    """Arrange cells in rows with captions; the height of a cell is at most ``tallest`` times its width."""
    from PIL import Image, ImageDraw, ImageFont

    width = (width_px - (columns - 1) * GAP_PX) // columns
    scales = [min(1.0, width / tallest / cell.bgr.shape[0] * cell.bgr.shape[1] / width) for cell in cells]
    sizes = [
        (round(width * scale), round(width * scale * cell.bgr.shape[0] / cell.bgr.shape[1]))
        for scale, cell in zip(scales, cells)
    ]
    heights = [max(high for _, high in sizes[start : start + columns]) for start in range(0, len(cells), columns)]
    below = GAP_PX + (CAPTION_PX if captions else 0)
    tops = np.cumsum([0, *(height + below for height in heights)])
    page = Image.new("RGB", (width_px, int(tops[-1]) - GAP_PX), "white")
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(size=12)
    for number, (cell, size) in enumerate(zip(cells, sizes)):
        x, y = number % columns * (width + GAP_PX), int(tops[number // columns])
        height = heights[number // columns]
        image = cv2.resize(cell.bgr, size, interpolation=cv2.INTER_AREA)[..., ::-1]
        place = (x + (width - size[0]) // 2, y + (height - size[1]) // 2)
        page.paste(Image.fromarray(np.ascontiguousarray(image)), place)
        if captions:
            pen.text((x + width // 2, y + height + 1), cell.caption, "black", font, anchor="ma")
    return np.asarray(page)[..., ::-1]


def write(name: str, page: UInt8) -> None:
    """Write a JPEG with the best quality that stays below `MOST_BYTES`."""
    HERE.mkdir(exist_ok=True)
    for quality in QUALITIES:
        data = cv2.imencode(".jpg", page, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        if len(data) <= MOST_BYTES:
            break
    (HERE / f"{name}.jpg").write_bytes(bytes(data))
    print(f"{name}.jpg {page.shape[1]} x {page.shape[0]}, {len(data) / 1e3:.0f} kB, quality {quality}", flush=True)


# The sheets


def conditions() -> UInt8:
    """Return the four kinds of scene, each from one position in six conditions."""
    cells = []
    for first in drives("benchmark", 640):
        if first.drive_id not in NO_BONNET:
            continue
        place = None
        for visit, (light, weather) in enumerate(CONDITIONS):
            drive = in_condition(first, DATES[light], light, weather, visit=visit)
            if place is None:
                place = drive.world_SE3_ego(np.array([moment_ns(drive)])).translation
            image = drive.render(FRONT, passing_ns(drive, place)).bgr
            cells.append(Cell(image, f"{drive.roi.scene_type}, {describe_condition(drive)}"))
    return sheet(cells, len(CONDITIONS))


def cameras() -> UInt8:
    """Return the seven types of vehicle, each in another scene and light, with seven cameras each."""
    everyone, chosen = drives("paper", 640), dict[str, SynthDrive]()
    for scene, kind in enumerate(VEHICLE_TYPES):
        there = [drive for drive in everyone if drive.scene == scene and drive.vehicle.kind.name == kind]
        shown = {describe_condition(drive) for drive in chosen.values()}
        lamps = there[0].roi.scene_type in ("urban", "campus")
        chosen[kind] = min(
            there,
            key=lambda drive: describe_condition(drive) in shown or (drive.condition.light == "night" and not lamps),
        )
    cells = []
    for kind, drive in chosen.items():
        row = list(row_of_cameras(drive, moment_ns(drive)))
        cells.append(row[0]._replace(caption=f"{kind}: {drive.roi.scene_id}, {describe_condition(drive)}"))
        cells += row[1:]
        drive.forget()
    return sheet(cells, len(CANONICAL_CAMERAS))


def _all_cameras(preset: str) -> UInt8:
    cells = []
    for drive in drives(preset, 480):
        row, place = list(row_of_cameras(drive, moment_ns(drive))), drive.drive_id.partition("-")[2]
        cells.append(row[0]._replace(caption=f"{place}, {drive.vehicle.kind.name}: {describe_condition(drive)}"))
        cells += row[1:]
        drive.forget()
    return sheet(cells, len(CANONICAL_CAMERAS), width_px=WIDTH_PX if len(cells) < 50 else 1500)


def tiny() -> UInt8:
    """Return every drive of the preset with all cameras."""
    return _all_cameras("tiny")


def quick() -> UInt8:
    """Return every drive of the preset with all cameras."""
    return _all_cameras("quick")


def demo() -> UInt8:
    """Return every drive of the preset with all cameras."""
    return _all_cameras("demo")


def benchmark() -> UInt8:
    """Return all 32 traversals."""
    cells = []
    for drive in drives("benchmark", 480):
        number = drive.drive_id.rpartition("-")[2]
        cells.append(
            Cell(
                drive.render(FRONT, moment_ns(drive)).bgr,
                f"{drive.roi.scene_type} {number}: {describe_condition(drive)}",
            )
        )
        drive.forget()
    return sheet(cells, 8)


def paper() -> UInt8:
    """Return all traversals, one row per scene."""
    rows: dict[int, list[Cell]] = {}
    for drive in drives("paper", 320):
        rows.setdefault(drive.scene, []).append(Cell(drive.render(FRONT, at_share(drive, 0.4)).bgr))
        drive.forget()
    most = max(map(len, rows.values()))
    blank = Cell(np.full((9, 16, 3), 255, np.uint8))
    cells = [cell for row in rows.values() for cell in row + [blank] * (most - len(row))]
    return sheet(cells, most, captions=False)


def effects() -> UInt8:
    """Return one position on an autumn day and on a rainy night, with each visible effect switched off."""
    first = drives("benchmark", 640)[1]
    day, place = in_condition(first, SEASONS["autumn"], "day", "clear", visit=1), None
    night = in_condition(first, DATES["night"], "night", "rain", visit=1)
    cells = []
    for drive, names in ((day, BY_DAY), (night, [e.name for e in fields(Effects) if e.name not in BY_DAY])):
        if place is None:
            place = drive.world_SE3_ego(np.array([moment_ns(drive)])).translation
        at = passing_ns(drive, place)
        cells.append(Cell(drive.render(FRONT, at).bgr, f"all, {describe_condition(drive)}"))
        for name in names:
            off = replace(drive, condition=replace(drive.condition, effects=replace(Effects(), **{name: False})))
            cells.append(Cell(off.render(FRONT, at).bgr, f"no {name.replace('_', ' ')}"))
    return sheet(cells, 5)


def truth() -> UInt8:
    """Return an image and its ground truth."""
    drive = drives("benchmark", 960)[0]
    at = moment_ns(drive)
    shown, lens = drive.render(FRONT, at), drive.vehicle.cameras[FRONT]
    pose, later = (drive.world_SE3_camera(FRONT, np.array([at + step])) for step in (0, 100_000_000))
    view = shown.view
    flow = static_flow(view.distance_m, lens, pose, lens, later)
    normals = view.normal @ matrix_from_quaternion(pose.rotation)[0]
    return sheet(
        [
            Cell(shown.bgr, f"{drive.drive_id}, {FRONT}"),
            Cell(_depths(view.distance_m), "depth along the ray, 1 to 200 m"),
            Cell(_normals(normals), "normals in the camera's frame"),
            Cell(_classes(view.label), "classes"),
            Cell(_instances(view.object, shown.bgr), "road users"),
            Cell(_flow(flow), "flow of the static world, 0.1 s"),
        ],
        3,
    )


def _depths(distance_m: AnyArray) -> UInt8:
    share = np.log(np.clip(distance_m, 1.0, 200.0)) / np.log(200.0)
    return np.asarray(cv2.applyColorMap(np.round(255 * (1.0 - share)).astype(np.uint8), cv2.COLORMAP_TURBO))


def _normals(normals: AnyArray) -> UInt8:
    seen = (normals**2).sum(axis=2, keepdims=True) > 0.0
    facing = normals * np.array([1.0, -1.0, -1.0])
    return np.round(np.where(seen, 127.5 * (facing + 1.0), 255.0)).astype(np.uint8)[..., ::-1]


def _classes(labels: UInt8) -> UInt8:
    table = np.zeros((256, 3), np.uint8)
    for label, colour in LABEL_COLOURS.items():
        table[label] = colour
    return table[labels]


def _instances(objects: AnyArray, bgr: UInt8) -> UInt8:
    hues = (objects * 67 % 180).astype(np.uint8)
    full = np.full_like(hues, 255)
    colours = cv2.cvtColor(np.stack([hues, full // 4 * 3, full], axis=-1), cv2.COLOR_HSV2BGR)
    grey = np.repeat(bgr.mean(axis=2, keepdims=True) * 0.5, 3, axis=2)
    return np.where(objects[..., None] >= 0, colours, grey.astype(np.uint8))


def _flow(flow_px: AnyArray) -> UInt8:
    length, angle = cv2.cartToPolar(*np.ascontiguousarray(np.nan_to_num(flow_px).transpose(2, 0, 1)))
    strong = np.clip(np.sqrt(length / 60.0), 0.0, 1.0)
    hsv = np.stack([angle * 90 / np.pi, 255 * strong, np.full_like(strong, 255)], axis=-1)
    return np.asarray(cv2.cvtColor(np.round(hsv).astype(np.uint8), cv2.COLOR_HSV2BGR))


def seasons() -> UInt8:
    """Return the same view in four seasons, and on two more visits of the summer."""
    drive = drives("benchmark", 960)[0]
    pose: Poses = drive.world_SE3_camera(FRONT, np.array([moment_ns(drive)]))
    wanted = [(name, date, 1) for name, date in SEASONS.items()] + [("summer", SEASONS["summer"], v) for v in (2, 3)]
    cells = []
    for name, date, visit in wanted:
        there = in_condition(drive, date, "day", "clear", visit=visit)
        image = render(there.world, pose, drive.vehicle.cameras[FRONT], 0.0, there.condition)
        cells.append(Cell(image.bgr, f"{name}, visit {visit}"))
    return sheet(cells, 3)


SHEETS: tuple[Callable[[], UInt8], ...] = (
    conditions, cameras, tiny, quick, demo, benchmark, paper, effects, truth, seasons,
)  # fmt: skip


if __name__ == "__main__":
    for make in SHEETS:
        if len(sys.argv) == 1 or make.__name__ in sys.argv[1:]:
            write(make.__name__, make())
