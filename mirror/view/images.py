"""Images on a page: all cameras of a rig at one time, one place in every traversal, and overlaid 3D boxes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.times import longitude_of, utc_and_solar
from mirror.geometry.box_projection import project_boxes
from mirror.pages.images import inline_image
from mirror.pages.rendering import render_part
from mirror.schema.documents import CANONICAL_CAMERAS

if TYPE_CHECKING:
    from markupsafe import Markup

CATEGORY_HUES: Final = ("car", "truck", "bus", "van", "pedestrian", "cyclist", "motorcycle", "bicycle")
_EDGE_POINTS: Final = 6
_GOLDEN_DEG: Final = 137.5
_STANDING_M: Final = 1.0
_SAME_PLACE_M: Final = 12.0
_LIGHTS: Final = ("day", "dusk", "night")


@dataclass(frozen=True)
class Passage:
    """A traversal at a place.

    Attributes:
        traversal: row of the table ``traversals``.
        frame_index: the frame nearest to the place.
        distance_m: distance of this frame from the place.
        is_same_direction: whether it drives in the direction of the first traversal.
    """

    traversal: Mapping[str, Any]
    frame_index: int
    distance_m: float
    is_same_direction: bool


def condition_order(light: str, weather: str) -> tuple[int, str]:
    """Return the sort key of conditions: day, dusk, night, then weather."""
    return (_LIGHTS.index(light) if light in _LIGHTS else len(_LIGHTS), weather)


def rig_images(frame: Frame, *, boxes: bool, width_px: int, against: Frame | None = None) -> Markup:
    """Format all images of one frame; images of a MIRROR rig are arranged by the directions of its seven cameras.

    Args:
        frame: the frame.
        boxes: whether to draw its 3D boxes.
        width_px: maximum width; wider images are scaled down.
        against: the same frame with another layer of boxes, which are drawn dashed; None: none.
    """
    shots = [
        {
            "camera": camera,
            "image": _inline(frame, camera, width_px),
            "overlay": _overlay(frame, against, camera) if boxes else None,
        }
        for camera in frame.images
    ]
    is_canonical = set(frame.images) >= set(CANONICAL_CAMERAS)
    return render_part("mirror.view", "images.html", "rig", shots, is_canonical)


def middle_frame(dataset: Dataset, traversal_id: str) -> Frame:
    """Return the middle frame of a traversal, or the frame before it if that one has more images."""
    frames = dataset.where(traversal=traversal_id).frames()
    middle = len(frames) // 2
    return max((frames[place] for place in {middle, max(middle - 1, 0)}), key=lambda frame: len(frame.images))


def busiest_frame(dataset: Dataset, traversal_ids: Sequence[str]) -> Frame:
    """Return the frame with the most boxes among the frames with the most cameras."""
    view = dataset.where(traversal=traversal_ids)
    boxes = view.table("boxes", ["traversal_id", "timestamp_ns"])
    counts = Counter(zip(boxes.column("traversal_id").to_pylist(), boxes.column("timestamp_ns").to_pylist()))
    rows = view.table("frames", ["traversal_id", "frame_index", "timestamp_ns", "images"]).to_pylist()
    best = max(rows, key=lambda row: (row["images"], counts[row["traversal_id"], row["timestamp_ns"]]))
    return frame_of(dataset, best["traversal_id"], best["frame_index"])


def frame_of(dataset: Dataset, traversal_id: str, frame_index: int) -> Frame:
    """Return a frame by its keys."""
    return next(frame for frame in dataset.where(traversal=traversal_id).frames() if frame.frame_index == frame_index)


def same_place(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> list[Passage]:
    """Find the place that the most traversals of a scene pass, and the frame of each traversal at this place.

    Args:
        dataset: the dataset.
        traversals: rows of the scene's traversals.
    """
    with_frames = [row for row in traversals if row["frames"] > 1]
    if len(with_frames) < 2:
        return []
    tracks = {}
    for row in with_frames:
        table = dataset.where(traversal=row["traversal_id"]).table("frames", ["frame_index", "x_m", "y_m"])
        tracks[row["traversal_id"]] = tuple(table.column(name).to_numpy() for name in ("frame_index", "x_m", "y_m"))
    first = max(with_frames, key=lambda row: (row["frames"], row["traversal_id"]))
    _, first_x, first_y = tracks[first["traversal_id"]]
    nearest = np.stack(
        [np.hypot(first_x[:, None] - x, first_y[:, None] - y).min(axis=1) for _, x, y in tracks.values()]
    )
    passed = (nearest < _SAME_PLACE_M).sum(axis=0)
    spread = np.abs(np.arange(len(first_x)) - len(first_x) / 2)
    place = int(np.lexsort((spread, -passed))[0])
    first_heading = _heading(first_x, first_y, place)
    passages = []
    for row in with_frames:
        index, x, y = tracks[row["traversal_id"]]
        distances = np.hypot(x - first_x[place], y - first_y[place])
        at = int(np.argmin(distances))
        if distances[at] < _SAME_PLACE_M:
            same = bool(_heading(x, y, at) @ first_heading > 0)
            passages.append(Passage(row, int(index[at]), float(distances[at]), same))
    return sorted(
        passages, key=lambda passage: condition_order(passage.traversal["light"], passage.traversal["weather"])
    )


def choose_passages(passages: Sequence[Passage], most: int) -> list[Passage]:
    """Choose at most ``most`` passages, in their order, with light and weather in turns, so that none is left out."""
    earlier: Counter[tuple[str, str]] = Counter()
    turns = []
    for number, passage in enumerate(passages):
        condition = (passage.traversal["light"], passage.traversal["weather"])
        turns.append((earlier[condition], number))
        earlier[condition] += 1
    return [passages[number] for number in sorted(number for _, number in sorted(turns)[:most])]


def place_images(dataset: Dataset, passages: Sequence[Passage], *, width_px: int) -> Markup:
    """Format the same view in every traversal: forward, or backward if the traversal drives the other way."""
    shots = []
    for passage in passages:
        frame, camera = _view_of(dataset, passage)
        row = passage.traversal
        shots.append(
            {
                **{name: row[name] for name in ("light", "weather", "vehicle_type")},
                "times": utc_and_solar(frame.timestamp_ns, longitude_of(row)),
                "camera": camera,
                "is_same_direction": passage.is_same_direction,
                "image": _inline(frame, camera, width_px),
            }
        )
    return render_part("mirror.view", "images.html", "places", shots)


def compare_lights(dataset: Dataset, passages: Sequence[Passage], name: str, *, width_px: int) -> Markup | None:
    """Format a place by day over the same place by night, or at dusk, with an edge to move.

    Args:
        dataset: the dataset.
        passages: the traversals at the place.
        name: name of the comparison, of which a page has one only.
        width_px: maximum width.

    Returns:
        The comparison of the two images of one size whose places are nearest to the place; None: there are none.
    """
    views: dict[tuple[str, bool, int, int], tuple[Passage, Frame, str]] = {}
    for passage in sorted(passages, key=lambda passage: passage.distance_m):
        frame, camera = _view_of(dataset, passage)
        lens = frame.images[camera].camera_model
        key = passage.traversal["light"], passage.is_same_direction, lens.width_px, lens.height_px
        views.setdefault(key, (passage, frame, camera))
    for light in ("night", "dusk"):
        for key, dark in views.items():
            bright = views.get(("day", *key[1:]))
            if key[0] == light and bright is not None:
                sides = [
                    (_inline(frame, camera, width_px), f"{one.traversal['light']}, {one.traversal['weather']}")
                    for one, frame, camera in (bright, dark)
                ]
                (left, left_words), (right, right_words) = sides
                width = min(key[2], width_px)
                return render_part(
                    "mirror.pages", "parts.html", "compare", name, left, right, width, left_words, right_words
                )
    return None


def _view_of(dataset: Dataset, passage: Passage) -> tuple[Frame, str]:
    """Return the frame of a passage and the camera that looks in the direction of the first one."""
    frame = frame_of(dataset, passage.traversal["traversal_id"], passage.frame_index)
    preferred = "front_wide" if passage.is_same_direction else "rear"
    return frame, preferred if preferred in frame.images else next(iter(frame.images))


@dataclass(frozen=True)
class Colour:
    """The colour of a category of boxes, the same in legends and images.

    Attributes:
        kind: CSS class.
        hue: hue of the class ``cx``, in degrees; None: the class has its own colour.
    """

    kind: str
    hue: int | None = None


def category_colours(categories: Iterable[str]) -> dict[str, Colour]:
    """Return the colour of each category; other categories than MIRROR's get hues a golden angle apart."""
    names = sorted(set(categories))
    others = [name for name in names if name not in CATEGORY_HUES]
    hues = {name: Colour("cx", round(_GOLDEN_DEG * number % 360)) for number, name in enumerate(others)}
    return {name: hues.get(name) or Colour(f"c{CATEGORY_HUES.index(name)}") for name in names}


def _heading(x: Float64, y: Float64, at: int) -> Float64:
    """Return the direction of travel at a frame, from the nearest frames at a distance: the vehicle may stand still."""
    moved = np.flatnonzero(np.hypot(x - x[at], y - y[at]) > _STANDING_M)
    before, after = moved[moved < at][-1:], moved[moved > at][:1]
    first, last = (int(indices[0]) if len(indices) else at for indices in (before, after))
    return np.array([x[last] - x[first], y[last] - y[first]])


def _inline(frame: Frame, camera: str, width_px: int) -> Markup:
    return inline_image(frame.images[camera].decode(), camera, width_px)


def _overlay(frame: Frame, against: Frame | None, camera: str) -> dict[str, Any]:
    """Return the visible boxes of a frame as paths in pixels, and those of another layer."""
    lens = frame.images[camera].camera_model
    return {
        "width_px": lens.width_px,
        "height_px": lens.height_px,
        "boxes": _trace_boxes(frame, camera),
        "against": None if against is None else _trace_boxes(against, camera),
    }


def _trace_boxes(frame: Frame, camera: str) -> list[dict[str, Any]]:
    """Return the edges of the visible boxes, where the rows of the image see them, as paths in pixels."""
    image = frame.images[camera]
    lens, velocity = image.camera_model, frame.boxes("world").velocity_mps
    boxes = frame.boxes(f"camera:{camera}")
    projected = project_boxes(lens, boxes.pose, boxes.size_m)
    fraction = np.linspace(0.0, 1.0, _EDGE_POINTS)[:, None]
    colours = category_colours(frame.boxes().category)
    traced = []
    # Far boxes first: near boxes are drawn over them.
    for row in np.argsort(-np.linalg.norm(boxes.pose.translation, axis=1)):
        if not projected.visible[row]:
            continue
        ends = projected.edges_m[row]
        ends = ends[np.isfinite(ends).all(axis=(1, 2))]
        points = ends[:, None, 0] * (1 - fraction) + ends[:, None, 1] * fraction
        if image.shutter.is_rolling:
            world = image.world_SE3_camera.transform(points.reshape(-1, 3))[0]
            lines = image.project_moving(world, velocity[row]).reshape(*points.shape[:2], 2)
        else:
            lines = lens.project(points).uv_px
        path = "".join(_polyline(line) for line in lines)
        category = boxes.category[row]
        traced.append({"path": path, "category": category, "colour": colours[category]})
    return traced


def _polyline(points: Float64) -> str:
    finite = points[np.isfinite(points).all(axis=1)]
    return "M" + "L".join(f"{u:.1f} {v:.1f}" for u, v in finite) if len(finite) > 1 else ""


def legend(categories: Iterable[str]) -> Markup:
    """Format the legend of the categories' colours."""
    return render_part("mirror.view", "images.html", "legend", category_colours(categories))
