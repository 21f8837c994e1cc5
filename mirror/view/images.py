"""Images on a page: a rig at one instant, one place in every traversal, 3D boxes drawn over them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.geometry.box_projection import project_boxes
from mirror.html import inline_image
from mirror.schema.documents import CANONICAL_CAMERAS

CATEGORY_HUES: Final = ("car", "truck", "bus", "van", "pedestrian", "cyclist", "motorcycle", "bicycle")
_EDGE_POINTS: Final = 6
_GOLDEN_DEG: Final = 137.5
_STOOD_M: Final = 1.0
_SAME_PLACE_M: Final = 12.0
_LIGHTS: Final = ("day", "dusk", "night")


@dataclass(frozen=True)
class Passage:
    """A traversal at a place.

    Attributes:
        traversal: its row of the table ``traversals``.
        frame_index: its frame nearest to the place.
        distance_m: how near.
        onward: whether it drives the way that the first one drives.
    """

    traversal: Mapping[str, Any]
    frame_index: int
    distance_m: float
    onward: bool


def condition_order(light: str, weather: str) -> tuple[int, str]:
    """By what conditions are sorted: day, dusk, night, then weather."""
    return (_LIGHTS.index(light) if light in _LIGHTS else len(_LIGHTS), weather)


def rig_images(frame: Frame, *, boxes: bool, width_px: int) -> str:
    """All images of one frame; the seven of a MIRROR rig in the places that they look to.

    Args:
        frame: the instant.
        boxes: draw its 3D boxes.
        width_px: wider images are scaled down.
    """
    seven = set(frame.images) >= set(CANONICAL_CAMERAS)
    figures = [
        _figure(
            _inlined(frame, camera, width_px),
            _overlay(frame, camera) if boxes else "",
            escape(camera),
            camera if seven else "",
        )
        for camera in frame.images
    ]
    return f'<div class="{"rig seven" if seven else "rig"}">{"".join(figures)}</div>'


def middle_frame(dataset: Dataset, traversal_id: str) -> Frame:
    """The frame in the middle of a traversal, or the one before it if that has more images."""
    frames = dataset.where(traversal=traversal_id).frames()
    middle = len(frames) // 2
    return max((frames[place] for place in {middle, max(middle - 1, 0)}), key=lambda frame: len(frame.images))


def busiest_frame(dataset: Dataset, traversal_ids: Sequence[str]) -> Frame:
    """The frame of some traversals that have images with the most cameras and, of those, the most boxes."""
    view = dataset.where(traversal=traversal_ids)
    boxes = view.table("boxes", ["traversal_id", "timestamp_ns"])
    counts = Counter(zip(boxes.column("traversal_id").to_pylist(), boxes.column("timestamp_ns").to_pylist()))
    rows = view.table("frames", ["traversal_id", "frame_index", "timestamp_ns", "images"]).to_pylist()
    best = max(rows, key=lambda row: (row["images"], counts[row["traversal_id"], row["timestamp_ns"]]))
    return frame_of(dataset, best["traversal_id"], best["frame_index"])


def frame_of(dataset: Dataset, traversal_id: str, frame_index: int) -> Frame:
    """One frame by its keys."""
    return next(frame for frame in dataset.where(traversal=traversal_id).frames() if frame.frame_index == frame_index)


def same_place(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> list[Passage]:
    """The place that most of a scene's traversals pass, and each one's frame there.

    Args:
        dataset: the dataset.
        traversals: rows of the scene's traversals.
    """
    with_frames = [one for one in traversals if one["frames"] > 1]
    if len(with_frames) < 2:
        return []
    tracks = {}
    for one in with_frames:
        table = dataset.where(traversal=one["traversal_id"]).table("frames", ["frame_index", "x_m", "y_m"])
        tracks[one["traversal_id"]] = tuple(table.column(name).to_numpy() for name in ("frame_index", "x_m", "y_m"))
    first = max(with_frames, key=lambda one: (one["frames"], one["traversal_id"]))
    _, first_x, first_y = tracks[first["traversal_id"]]
    nearest = np.stack(
        [np.hypot(first_x[:, None] - x, first_y[:, None] - y).min(axis=1) for _, x, y in tracks.values()]
    )
    passed = (nearest < _SAME_PLACE_M).sum(axis=0)
    spread = np.abs(np.arange(len(first_x)) - len(first_x) / 2)
    place = int(np.lexsort((spread, -passed))[0])
    ahead = _heading(first_x, first_y, place)
    found = []
    for one in with_frames:
        index, x, y = tracks[one["traversal_id"]]
        away = np.hypot(x - first_x[place], y - first_y[place])
        at = int(np.argmin(away))
        if away[at] < _SAME_PLACE_M:
            found.append(Passage(one, int(index[at]), float(away[at]), bool(_heading(x, y, at) @ ahead > 0)))
    return sorted(found, key=lambda one: condition_order(one.traversal["light"], one.traversal["weather"]))


def place_images(dataset: Dataset, passages: Sequence[Passage], *, width_px: int) -> str:
    """The same view in every traversal: forward, or backward from those that drive the other way."""
    figures = []
    for one in passages:
        frame = frame_of(dataset, one.traversal["traversal_id"], one.frame_index)
        wanted = "front_wide" if one.onward else "rear"
        camera = wanted if wanted in frame.images else next(iter(frame.images))
        light, weather = one.traversal["light"], one.traversal["weather"]
        caption = (
            f'<i class="dot {escape(light)}"></i><b>{escape(light)}, {escape(weather)}</b> '
            f"{utc(frame.timestamp_ns)[:16]}<br>{escape(one.traversal['vehicle_type'])}, {escape(camera)}"
            f"{'' if one.onward else ', driving the other way'}"
        )
        figures.append(_figure(_inlined(frame, camera, width_px), "", caption, ""))
    return f'<div class="places">{"".join(figures)}</div>'


def utc(stamp_ns: int) -> str:
    """A stamp in words."""
    return datetime.fromtimestamp(stamp_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def category_colours(categories: Iterable[str]) -> dict[str, str]:
    """The attributes that colour each category of a frame, the same in its legend and its images.

    Words that are not MIRROR's get hues of their own, a golden angle apart.
    """
    named = sorted(set(categories))
    foreign = [name for name in named if name not in CATEGORY_HUES]
    hues = {name: f'cx" style="--hue:{_GOLDEN_DEG * place % 360:.0f}' for place, name in enumerate(foreign)}
    return {name: hues.get(name) or f"c{CATEGORY_HUES.index(name)}" for name in named}


def _heading(x: Float64, y: Float64, at: int) -> Float64:
    """Direction of travel at a frame, from the frames before and after it that are elsewhere: it may be standing."""
    moved = np.flatnonzero(np.hypot(x - x[at], y - y[at]) > _STOOD_M)
    before, after = moved[moved < at][-1:], moved[moved > at][:1]
    first, last = (int(found[0]) if len(found) else at for found in (before, after))
    return np.array([x[last] - x[first], y[last] - y[first]])


def _figure(image: str, overlay: str, caption: str, area: str) -> str:
    style = f' style="grid-area:{area}"' if area else ""
    return f'<figure{style}><div class="shot">{image}{overlay}</div><figcaption>{caption}</figcaption></figure>'


def _inlined(frame: Frame, camera: str, width_px: int) -> str:
    return inline_image(frame.images[camera].decode(), camera, width_px)


def _overlay(frame: Frame, camera: str) -> str:
    """The edges of the boxes that an image shows, followed through its lens, as SVG in pixels."""
    image = frame.images[camera]
    lens = image.camera_model
    boxes = frame.boxes(f"camera:{camera}")
    projected = project_boxes(lens, boxes.pose, boxes.size_m)
    share = np.linspace(0.0, 1.0, _EDGE_POINTS)[:, None]
    colours = category_colours(frame.boxes().category)
    paths = []
    # Far ones first, so that near ones are drawn over them.
    for row in np.argsort(-np.linalg.norm(boxes.pose.translation, axis=1)):
        if not projected.visible[row]:
            continue
        ends = projected.edges_m[row]
        ends = ends[np.isfinite(ends).all(axis=(1, 2))]
        points = lens.project(ends[:, None, 0] * (1 - share) + ends[:, None, 1] * share)
        path = "".join(_polyline(line) for line in points.uv_px)
        category = boxes.category[row]
        paths.append(f'<path class="{colours[category]}" d="{path}"><title>{escape(category)}</title></path>')
    return f'<svg class="boxes" viewBox="0 0 {lens.width_px} {lens.height_px}">{"".join(paths)}</svg>'


def _polyline(points: Float64) -> str:
    shown = points[np.isfinite(points).all(axis=1)]
    return "M" + "L".join(f"{u:.1f} {v:.1f}" for u, v in shown) if len(shown) > 1 else ""


def legend(categories: Iterable[str]) -> str:
    """Which colour is which category."""
    colours = category_colours(categories)
    entries = [f'<span><i class="swatch {colour}"></i>{escape(name)}</span>' for name, colour in colours.items()]
    return f'<p class="key">{"".join(entries)}</p>'
