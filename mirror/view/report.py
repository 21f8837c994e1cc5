"""The report of a dataset: images of every camera, maps, charts, splits, and the ledger of refused passes.

It is one HTML file without scripts or network access, readable on a phone and in dark mode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.statistics import TableRow, compute_table_row
from mirror.html import style_sheet
from mirror.schema.documents import SplitDocument
from mirror.schema.files import write_bytes
from mirror.version import __version__
from mirror.view.images import (
    busiest_frame,
    condition_order,
    legend,
    middle_frame,
    place_images,
    rig_images,
    same_place,
)
from mirror.view.svg import Line, bars, scene_map, stacked_bars
from mirror.view.tables import ledger, split_table, traversal_table
from mirror.view.times import longitude_of, utc_and_solar

LEDGER_HEADING: Final = "<h2>The ledger of refused passes</h2>"
"""By this heading a report is recognised, which may be replaced by a later one."""

_LARGE_PX: Final = 640
_SMALL_PX: Final = 360
_MAP_POINTS: Final = 400
_MAX_CANDIDATES: Final = 3
_LIGHTS: Final = ("day", "dusk", "night")
_WEATHER: Final = ("clear", "clouds", "rain", "snow", "fog")


def write_report(dataset: Dataset, out: Path, title: str = "MIRROR dataset") -> None:
    """Write the report.

    Args:
        dataset: the dataset, or a filtered view of it.
        out: the HTML file; it is replaced atomically.
        title: title of the page.

    Raises:
        DatasetError: an image cannot be read, or the file cannot be written.
    """
    scenes = dataset.table("scenes").to_pylist()
    traversals = dataset.table("traversals").to_pylist()
    passes = dataset.passes().to_pylist()
    tiles = format_tiles(compute_table_row(dataset), traversals, passes, dataset.count("boxes"))
    parts = [
        f"<header><h1>{escape(title)}</h1>{tiles}</header>",
        *_format_instant(dataset, traversals),
        *_format_places(dataset, scenes, traversals),
        "<h2>Maps</h2>",
        map_legend({row["light"] for row in traversals}),
        f'<div class="grid two">{"".join(draw_scene_map(dataset, scene, traversals) for scene in scenes)}</div>',
        "<h2>Conditions and contents</h2>",
        f'<div class="grid">{"".join(draw_charts(dataset, traversals))}</div>',
        *_format_splits(dataset, traversals),
        "<h2>Traversals</h2>",
        traversal_table(traversals),
        LEDGER_HEADING,
        *ledger(passes),
        *_format_rigs(dataset, traversals),
        f"<footer>Made by mirror {__version__} from the dataset {escape(dataset.root)}.</footer>",
    ]
    style = style_sheet()
    page = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<style>{style}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )
    write_bytes(out, page.encode())


def format_tiles(
    totals: TableRow,
    traversals: Sequence[Mapping[str, Any]],
    passes: Sequence[Mapping[str, Any]],
    boxes: int,
) -> str:
    """Format the figures at the head of a report."""
    cameras = {camera for row in traversals for camera in row["cameras"]}
    tiles = {
        "scenes": f"{totals.scenes}",
        "cities": f"{len(totals.cities)}",
        "km² of scenes": f"{totals.area_km2:.3f}",
        "traversals": f"{len(traversals):,}",
        "passes refused": f"{sum(row['decision'] == 'refused' for row in passes):,}",
        "minutes": f"{sum(row['duration_s'] for row in traversals) / 60:,.1f}",
        "km driven": f"{sum(row['path_m'] for row in traversals) / 1000:,.2f}",
        "cameras": f"{len(cameras)}",
        "images": f"{sum(row['images'] for row in traversals):,}",
        "boxes": f"{boxes:,}",
    }
    cells = "".join(f'<div class="tile"><b>{value}</b><span>{name}</span></div>' for name, value in tiles.items())
    return f'<div class="tiles">{cells}</div>'


def _count_box_layers(traversal: Mapping[str, Any]) -> int:
    return sum(layer.startswith("boxes/") for layer in traversal["layers"])


def _format_instant(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    """Show one instant in large images, with its boxes."""
    with_frames = [row for row in traversals if row["frames"]]
    if not with_frames:
        yield '<p class="dim">No traversal has images.</p>'
        return
    clear = [row for row in with_frames if (row["light"], row["weather"]) == ("day", "clear")] or with_frames
    frame = busiest_frame(dataset, [row["traversal_id"] for row in clear[:_MAX_CANDIDATES]])
    row = next(row for row in clear if row["traversal_id"] == frame.traversal_id)
    # With several layers of boxes, no layer is preferred: none is drawn.
    boxes = _count_box_layers(row) == 1
    cameras = "One camera" if len(frame.images) == 1 else f"{len(frame.images)} cameras"
    yield f"<h2>One instant, {cameras.lower()}</h2>"
    yield (
        f'<p class="dim">{escape(row["scene_id"])}, {_times(frame, row)}, {escape(row["light"])}, '
        f"{escape(row['weather'])}, {escape(row['vehicle_type'])}; "
        f"frame {frame.frame_index} of {escape(row['traversal_id'])}</p>"
    )
    if boxes:
        yield '<input type="checkbox" id="boxes" checked><label for="boxes">3D boxes</label>'
        yield legend(sorted(set(frame.boxes().category)))
    yield rig_images(frame, boxes=boxes, width_px=_LARGE_PX)


def _format_places(
    dataset: Dataset, scenes: Sequence[Mapping[str, Any]], traversals: Sequence[Mapping[str, Any]]
) -> Iterable[str]:
    """Show one place of each scene in every traversal that passes it."""
    parts = []
    for scene in scenes:
        own = [row for row in traversals if row["scene_id"] == scene["scene_id"]]
        passages = same_place(dataset, own)
        if len(passages) > 1:
            parts.append(f"<h3>{escape(scene_name(scene))}</h3>{place_images(dataset, passages, width_px=_SMALL_PX)}")
    if parts:
        yield "<h2>One place, every traversal</h2>"
        yield '<p class="dim">The same view in every traversal that passes a place.</p>'
        yield from parts


def scene_name(scene: Mapping[str, Any]) -> str:
    """A scene's id with its city and type."""
    where = ", ".join(str(scene[name]) for name in ("city", "scene_type") if scene[name])
    return f"{scene['scene_id']}{f' ({where})' if where else ''}"


def map_legend(lights: Iterable[str]) -> str:
    """Format the map's legend: a swatch for each light."""
    known = [light for light in _LIGHTS if light in lights]
    ordered = [*known, *sorted(set(lights) - set(known))]
    entries = [f'<span><i class="swatch {escape(light)}"></i>{escape(light)}</span>' for light in ordered]
    return (
        f'<p class="key">{"".join(entries)}<span>● entry</span><span>▶ exit</span><span>┄ region of interest</span></p>'
    )


def draw_scene_map(dataset: Dataset, scene: Mapping[str, Any], traversals: Sequence[Mapping[str, Any]]) -> str:
    """Draw the map of a scene with the lines of its traversals, over its recorded road map if there is one."""
    centre = (scene["x_m"], scene["y_m"]) if scene["frame"] is not None else (0.0, 0.0)
    lines = []
    for row in traversals:
        if row["scene_id"] != scene["scene_id"]:
            continue
        poses = dataset.where(traversal=row["traversal_id"]).table("ego_poses", ["timestamp_ns", "tx_m", "ty_m"])
        stamps, x, y = (poses.column(name).to_numpy() for name in ("timestamp_ns", "tx_m", "ty_m"))
        inside = np.flatnonzero((stamps >= row["entry_ns"]) & (stamps <= row["exit_ns"]))
        inside = inside[:: max(1, len(inside) // _MAP_POINTS)]
        about = f"{row['traversal_id']}: {row['light']}, {row['weather']}, {row['duration_s']:.0f} s"
        lines.append(Line(x[inside] - centre[0], y[inside] - centre[1], row["light"], about))
    road_map = dataset.road_map(scene["scene_id"])
    return scene_map(
        f"{scene_name(scene)}: {len(lines)} traversals{'' if road_map is None else ', on its road map'}",
        scene["radius_m"],
        lines,
        north=scene["frame"] is None,
        roads=[] if road_map is None else [[ring - centre for ring in area.rings] for area in road_map.drivable],
        lanes=[] if road_map is None else [lane.center_m[:, :2] - centre for lane in road_map.lanes_of()],
    )


def draw_charts(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    """Draw the charts of conditions, boxes, speeds, vehicles and images."""
    by_condition: dict[str, dict[str, float]] = {light: {} for light in _LIGHTS}
    for row in traversals:
        counts = by_condition.setdefault(row["light"], {})
        counts[row["weather"]] = counts.get(row["weather"], 0) + 1
    weather = [name for name in (*_WEATHER, "unknown") if any(name in counts for counts in by_condition.values())]
    yield stacked_bars("Traversals by light and weather", by_condition, weather)
    categories = _count_values(dataset, "boxes", "category")
    if categories:
        yield bars("Boxes by category", dict(categories.most_common(12)))
    speeds = Counter(int(row["mean_speed_mps"] // 2) * 2 for row in traversals)
    if speeds:
        steps = range(min(speeds), max(speeds) + 2, 2)
        yield bars("Traversals by mean speed", {f"{step} to {step + 2} m/s": speeds[step] for step in steps})
    yield bars("Traversals by vehicle type", dict(sorted(Counter(row["vehicle_type"] for row in traversals).items())))
    images = _count_values(dataset, "images", "camera")
    if images:
        yield bars("Images by camera", {camera: images[camera] for camera in dataset.cameras()})


def _count_values(dataset: Dataset, table: str, column: str) -> Counter[str]:
    counts = pc.value_counts(dataset.table(table, [column]).column(column).cast(pa.string())).to_pylist()
    return Counter({entry["values"]: entry["counts"] for entry in counts})


def _format_splits(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    names = [name for name in dataset.store.list_files("splits") if name.endswith(".json")]
    if names:
        yield "<h2>Splits</h2>"
    for name in names:
        yield split_table(dataset.store.json(f"splits/{name}", SplitDocument), traversals)


def _format_rigs(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> Iterable[str]:
    """Show all cameras of one frame for every condition, folded up."""
    by_condition: dict[tuple[str, str], Mapping[str, Any]] = {}
    for row in traversals:
        if row["frames"]:
            by_condition.setdefault((row["light"], row["weather"]), row)
    if not by_condition:
        return
    yield "<h2>All cameras in every condition</h2>"
    for light, weather in sorted(by_condition, key=lambda key: condition_order(*key)):
        row = by_condition[light, weather]
        frame = middle_frame(dataset, row["traversal_id"])
        yield (
            f'<details><summary><i class="dot {escape(light)}"></i>{escape(light)}, {escape(weather)} '
            f'<span class="dim">{escape(row["scene_id"])}, {_times(frame, row)}</span></summary>'
            f"{rig_images(frame, boxes=False, width_px=_SMALL_PX)}</details>"
        )


def _times(frame: Frame, row: Mapping[str, Any]) -> str:
    """The time of a frame in UTC, and its local solar time where the place is known."""
    return utc_and_solar(frame.timestamp_ns, longitude_of(row))
