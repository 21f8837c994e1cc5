"""The report of a large dataset as a small site: an overview with tables to filter and sort, and a page for each scene.

The pages need no network: style sheet, script and data are inside. Rows are drawn 200 at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mirror.dataset.dataset import Dataset
from mirror.dataset.statistics import compute_table_row
from mirror.dataset.times import longitude_of, solar_time, utc
from mirror.pages.images import encode_jpeg, scale_down
from mirror.pages.rendering import read_script, render_page, script_data
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.files import write_bytes
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.view.aerial import AerialImage
from mirror.view.images import (
    choose_passages,
    compare_lights,
    condition_order,
    middle_frame,
    place_images,
    same_place,
)
from mirror.view.report import draw_charts, draw_scene_map, list_tiles, map_legend, scene_name

if TYPE_CHECKING:
    from markupsafe import Markup

MARK: Final = ".made-by-mirror-report"
_MOST_PASSAGES: Final = 24
_IMAGE_PX: Final = 640
_TILE_PX: Final = 480
_TRAVERSALS: Final = (
    "scene_id", "traversal_id", "entry_ns", "entry_solar", "light", "weather", "vehicle_id", "vehicle_type",
    "duration_s", "path_m", "mean_speed_mps", "images",
)  # fmt: skip
_PASSES: Final = (
    "scene_id", "drive_id", "entry_ns", "entry_solar", "decision", "rule", "measured", "threshold", "light", "weather",
    "duration_s", "path_m", "overlap",
)  # fmt: skip
_SHORT: Final = {
    "scene_id": "scene", "traversal_id": "traversal", "entry_ns": "entry (UTC)", "entry_solar": "solar time",
    "vehicle_id": "vehicle", "drive_id": "drive",
}  # fmt: skip


def write_site(
    dataset: Dataset,
    out: Path,
    title: str = "MIRROR dataset",
    *,
    aerial: AerialImage | None = None,
    progress: ProgressReporter | None = None,
) -> Path:
    """Write the site.

    Args:
        dataset: the dataset, or a filtered view of it.
        out: folder of the site; pages of an earlier report are replaced.
        title: title of the pages.
        aerial: an image of the ground below the maps; None: there is none.
        progress: receives the progress.

    Returns:
        The first page.

    Raises:
        UsageError: the folder is of another kind, or the image of the ground is no image.
        DatasetError: an image cannot be read, or a file cannot be written.
    """
    reporter = progress or NullProgress()
    require_output_folder(out, FolderKind.REPORT)
    write_bytes(out / MARK, b"")
    scenes = dataset.table("scenes").to_pylist()
    traversals = dataset.table("traversals").to_pylist()
    for row in traversals:
        row["entry_solar"] = solar_time(row["entry_ns"], longitude_of(row))
    reporter.start("scenes", len(scenes))
    pages, images = {}, {}
    for scene in scenes:
        own = [row for row in traversals if row["scene_id"] == scene["scene_id"]]
        if own:
            pages[scene["scene_id"]] = f"scenes/{scene['scene_id']}.html"
            write_bytes(out / pages[scene["scene_id"]], _scene_page(dataset, scene, own, title, aerial).encode())
            image = _scene_image(dataset, own)
            if image is not None:
                images[scene["scene_id"]] = f"scenes/{scene['scene_id']}.jpg"
                write_bytes(out / images[scene["scene_id"]], image)
        reporter.advance(1)
    passes = dataset.passes().to_pylist()
    longitudes = {scene["scene_id"]: scene["longitude_deg"] for scene in scenes}
    for row in passes:
        row["entry_solar"] = solar_time(row["entry_ns"], longitudes.get(row["scene_id"]))
    page = _render_page(
        "report_overview.html",
        title=title,
        tiles=list_tiles(compute_table_row(dataset), traversals, passes, dataset.count("boxes")),
        scenes=[
            {
                "row": row,
                "name": scene_name(row),
                "page": pages.get(row["scene_id"]),
                "image": images.get(row["scene_id"]),
            }
            for row in scenes
        ],
        traversals=_table_data(
            "traversals", traversals, _TRAVERSALS, ("scene", "light", "weather", "vehicle"), pages, where=True
        ),
        passes=_table_data("passes", passes, _PASSES, ("decision", "rule", "scene", "light", "weather"), pages),
        charts=list(draw_charts(dataset, traversals)),
        root=dataset.root,
    )
    write_bytes(out / "index.html", page.encode())
    return out / "index.html"


def _scene_image(dataset: Dataset, traversals: Sequence[Mapping[str, Any]]) -> bytes | None:
    """Encode the front image of a scene's brightest traversal; None: no traversal has images."""
    with_frames = [row for row in traversals if row["frames"]]
    if not with_frames:
        return None
    row = min(with_frames, key=lambda row: condition_order(row["light"], row["weather"]))
    images = middle_frame(dataset, row["traversal_id"]).images
    camera = "front_wide" if "front_wide" in images else next(iter(images))
    return encode_jpeg(scale_down(images[camera].decode(), _TILE_PX))


def _scene_page(
    dataset: Dataset,
    scene: Mapping[str, Any],
    traversals: Sequence[Mapping[str, Any]],
    title: str,
    aerial: AerialImage | None,
) -> str:
    view = dataset.where(scene=scene["scene_id"])
    passing = same_place(view, traversals)
    passages = choose_passages(passing, _MOST_PASSAGES)
    places = None
    if len(passages) > 1:
        of_all = f"{len(passages)}{f' of {len(passing)}' if len(passages) < len(passing) else ''}"
        pair = compare_lights(view, passages, "light", width_px=_IMAGE_PX)
        places = {"of_all": of_all, "pair": pair, "images": place_images(view, passages, width_px=_IMAGE_PX)}
    return _render_page(
        "report_scene.html",
        title=f"{scene['scene_id']} - {title}",
        site_title=title,
        name=scene_name(scene),
        scene_id=scene["scene_id"],
        map_legend=map_legend({row["light"] for row in traversals}),
        map=draw_scene_map(view, scene, traversals, aerial),
        places=places,
        traversals=_table_data("traversals", traversals, _TRAVERSALS, ("light", "weather", "vehicle"), {}, where=True),
        charts=list(draw_charts(view, traversals)),
    )


def _table_data(
    name: str, rows: Sequence[Mapping[str, Any]], columns: Sequence[str], filters: Sequence[str],
    pages: Mapping[str, str], *, where: bool = False,
) -> Markup:  # fmt: skip
    """Encode the rows of a table, which the script draws."""
    data = {
        "name": name,
        "columns": [_SHORT.get(column, column) for column in columns],
        "filters": filters,
        "where": ["scene", "light", "weather", "vehicle"] if where else [],
        "pages": pages,
        "rows": [[utc(row[key]) if key == "entry_ns" else row[key] for key in columns] for row in rows],
    }
    return script_data(data)


def _render_page(template: str, **values: object) -> str:
    return render_page("mirror.view", template, script=read_script("mirror.view", "report_site.js"), **values)
