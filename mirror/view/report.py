"""The report of a dataset: images of every camera, maps, charts, splits, and the ledger of refused passes.

It is one HTML file without scripts or network access, readable on a phone and in dark mode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.statistics import TableRow, compute_table_row
from mirror.dataset.times import longitude_of, utc_and_solar
from mirror.pages.images import encode_image
from mirror.pages.rendering import render_page, render_part
from mirror.schema.documents import SplitDocument
from mirror.schema.files import write_bytes
from mirror.view.aerial import AerialImage
from mirror.view.images import (
    busiest_frame,
    compare_lights,
    condition_order,
    legend,
    middle_frame,
    place_images,
    rig_images,
    same_place,
)
from mirror.view.instant import cameras_over_time, draw_from_above
from mirror.view.svg import MAP_REACH, MapTrack, bars, scene_map, stacked_bars
from mirror.view.tables import describe_split, ledger_rows, traversal_rows

if TYPE_CHECKING:
    from markupsafe import Markup

LEDGER_HEADING: Final = "<h2>The ledger of refused passes</h2>"
"""By this heading a report is recognised, which may be replaced by a later one."""

_LARGE_PX: Final = 640
_SMALL_PX: Final = 360
_GROUND_PX: Final = 640
_MAP_POINTS: Final = 400
_MAX_CANDIDATES: Final = 3
_LIGHTS: Final = ("day", "dusk", "night")
_WEATHER: Final = ("clear", "clouds", "rain", "snow", "fog")


def write_report(
    dataset: Dataset, out: Path, title: str = "MIRROR dataset", *, aerial: AerialImage | None = None
) -> None:
    """Write the report.

    Args:
        dataset: the dataset, or a filtered view of it.
        out: the HTML file; it is replaced atomically.
        title: title of the page.
        aerial: an image of the ground below the maps; None: there is none.

    Raises:
        UsageError: the image of the ground is no image.
        DatasetError: an image cannot be read, or the file cannot be written.
    """
    scenes = dataset.table("scenes").to_pylist()
    traversals = dataset.table("traversals").to_pylist()
    passes = dataset.passes().to_pylist()
    refused, ledger = ledger_rows(passes)
    page = render_page(
        "mirror.view",
        "report.html",
        title=title,
        tiles=list_tiles(compute_table_row(dataset), traversals, passes, dataset.count("boxes")),
        instant=_show_instant(dataset, traversals),
        places=list(_list_places(dataset, scenes, traversals)),
        map_legend=map_legend({row["light"] for row in traversals}),
        maps=[draw_scene_map(dataset, scene, traversals, aerial) for scene in scenes],
        charts=list(draw_charts(dataset, traversals)),
        splits=list(_list_splits(dataset, traversals)),
        traversals=traversal_rows(traversals),
        passes=len(passes),
        refused=refused,
        ledger=ledger,
        rigs=list(_list_rigs(dataset, traversals)),
        root=dataset.root,
    )
    write_bytes(out, page.encode())


def list_tiles(
    totals: TableRow,
    traversals: Sequence[Mapping[str, Any]],
    passes: Sequence[Mapping[str, Any]],
    boxes: int,
) -> list[tuple[str, str]]:
    """Return the figures at the head of a report, each with its label."""
    cameras = {camera for row in traversals for camera in row["cameras"]}
    return [
        (f"{totals.scenes}", "scenes"),
        (f"{len(totals.cities)}", "cities"),
        (f"{totals.area_km2:.3f}", "km² of scenes"),
        (f"{len(traversals):,}", "traversals"),
        (f"{sum(row['decision'] == 'refused' for row in passes):,}", "passes refused"),
        (f"{sum(row['duration_s'] for row in traversals) / 60:,.1f}", "minutes"),
        (f"{sum(row['path_m'] for row in traversals) / 1000:,.2f}", "km driven"),
        (f"{len(cameras)}", "cameras"),
        (f"{sum(row['images'] for row in traversals):,}", "images"),
        (f"{boxes:,}", "boxes"),
    ]


def _count_box_layers(traversal: Mapping[str, Any]) -> int:
    return sum(layer.startswith("boxes/") for layer in traversal["layers"])


def _show_instant(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return one instant in large images, with its boxes; None: no traversal has images."""
    with_frames = [row for row in traversals if row["frames"]]
    if not with_frames:
        return None
    clear = [row for row in with_frames if (row["light"], row["weather"]) == ("day", "clear")] or with_frames
    frame = busiest_frame(dataset, [row["traversal_id"] for row in clear[:_MAX_CANDIDATES]])
    row = next(row for row in clear if row["traversal_id"] == frame.traversal_id)
    # With several layers of boxes, no layer is preferred: none is drawn.
    boxes = _count_box_layers(row) == 1
    return {
        "cameras": "one camera" if len(frame.images) == 1 else f"{len(frame.images)} cameras",
        "row": row,
        "times": _times(frame, row),
        "frame_index": frame.frame_index,
        "legend": legend(sorted(set(frame.boxes().category))) if boxes else None,
        "images": rig_images(frame, boxes=boxes, width_px=_LARGE_PX),
        "above": draw_from_above(frame, boxes=boxes),
        "over_time": cameras_over_time(dataset, frame.traversal_id, width_px=_SMALL_PX),
    }


def _list_places(
    dataset: Dataset, scenes: Sequence[Mapping[str, Any]], traversals: Sequence[Mapping[str, Any]]
) -> Iterable[tuple[str, Markup | None, Markup]]:
    """List one place of each scene in two lights, and in every traversal that passes it."""
    named: list[str] = []
    for scene in scenes:
        own = [row for row in traversals if row["scene_id"] == scene["scene_id"]]
        passages = same_place(dataset, own)
        if len(passages) > 1:
            pair = compare_lights(dataset, passages, f"light-{len(named)}", width_px=_LARGE_PX)
            named.append(scene_name(scene))
            yield named[-1], pair, place_images(dataset, passages, width_px=_SMALL_PX)


def scene_name(scene: Mapping[str, Any]) -> str:
    """Return a scene's id with its city and type."""
    where = ", ".join(str(scene[name]) for name in ("city", "scene_type") if scene[name])
    return f"{scene['scene_id']}{f' ({where})' if where else ''}"


def map_legend(lights: Iterable[str]) -> Markup:
    """Format the map's legend: a swatch for each light."""
    known = [light for light in _LIGHTS if light in lights]
    ordered = [*known, *sorted(set(lights) - set(known))]
    return render_part("mirror.view", "charts.html", "map_legend", ordered)


def draw_scene_map(
    dataset: Dataset,
    scene: Mapping[str, Any],
    traversals: Sequence[Mapping[str, Any]],
    aerial: AerialImage | None = None,
) -> Markup:
    """Draw the map of a scene with the lines of its traversals, over its recorded road map if there is one.

    Args:
        dataset: the dataset.
        scene: row of the scene.
        traversals: rows of traversals; those of other scenes are left out.
        aerial: an image of the ground below the map; None: there is none.
    """
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
        lines.append(MapTrack(x[inside] - centre[0], y[inside] - centre[1], row["light"], about))
    road_map = dataset.road_map(scene["scene_id"])
    return scene_map(
        f"{scene_name(scene)}: {len(lines)} traversals{'' if road_map is None else ', on its road map'}",
        scene["radius_m"],
        lines,
        north=scene["frame"] is None,
        roads=[] if road_map is None else [[ring - centre for ring in area.rings] for area in road_map.drivable],
        lanes=[] if road_map is None else [lane.center_m[:, :2] - centre for lane in road_map.lanes_of()],
        ground=None if aerial is None or scene["frame"] is not None else _show_ground(aerial, scene),
    )


def _show_ground(aerial: AerialImage, scene: Mapping[str, Any]) -> str | None:
    """Return the address of the ground below the map of a scene; None: the image does not show it."""
    place = scene["longitude_deg"], scene["latitude_deg"]
    cut = aerial.cut(*place, scene["radius_m"] * MAP_REACH, _GROUND_PX)
    return None if cut is None else f"data:image/jpeg;base64,{encode_image(cut)}"


def draw_charts(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> Iterable[Markup]:
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


def _list_splits(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> Iterable[dict[str, Any]]:
    for name in dataset.store.list_files("splits"):
        if name.endswith(".json"):
            yield describe_split(dataset.store.json(f"splits/{name}", SplitDocument), traversals)


def _list_rigs(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> Iterable[dict[str, Any]]:
    """List all cameras of one frame for every condition."""
    by_condition: dict[tuple[str, str], Mapping[str, Any]] = {}
    for row in traversals:
        if row["frames"]:
            by_condition.setdefault((row["light"], row["weather"]), row)
    for light, weather in sorted(by_condition, key=lambda key: condition_order(*key)):
        row = by_condition[light, weather]
        frame = middle_frame(dataset, row["traversal_id"])
        yield {
            "light": light,
            "weather": weather,
            "scene_id": row["scene_id"],
            "times": _times(frame, row),
            "images": rig_images(frame, boxes=False, width_px=_SMALL_PX),
        }


def _times(frame: Frame, row: Mapping[str, Any]) -> str:
    """Return the time of a frame in UTC, and its local solar time where the place is known."""
    return utc_and_solar(frame.timestamp_ns, longitude_of(row))
