"""The report of a large dataset as a small site: an overview with tables to filter and sort, and a page for each scene.

The pages need no network: style sheet, script and data are inside. Rows are drawn 200 at a time.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from mirror.dataset.dataset import Dataset
from mirror.dataset.statistics import compute_table_row
from mirror.html import style_sheet
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.files import write_bytes
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.version import __version__
from mirror.view.images import choose_passages, place_images, same_place
from mirror.view.report import draw_charts, draw_scene_map, format_tiles, map_legend, scene_name
from mirror.view.times import longitude_of, solar_time, utc

MARK: Final = ".made-by-mirror-report"
_MOST_PASSAGES: Final = 24
_IMAGE_PX: Final = 640
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
    dataset: Dataset, out: Path, title: str = "MIRROR dataset", *, progress: ProgressReporter | None = None
) -> Path:
    """Write the site.

    Args:
        dataset: the dataset, or a filtered view of it.
        out: folder of the site; pages of an earlier report are replaced.
        title: title of the pages.
        progress: receives the progress.

    Returns:
        The first page.

    Raises:
        UsageError: the folder is of another kind.
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
    pages = {}
    for scene in scenes:
        own = [row for row in traversals if row["scene_id"] == scene["scene_id"]]
        if own:
            pages[scene["scene_id"]] = f"scenes/{scene['scene_id']}.html"
            write_bytes(out / pages[scene["scene_id"]], _scene_page(dataset, scene, own, title).encode())
        reporter.advance(1)
    passes = dataset.passes().to_pylist()
    longitudes = {scene["scene_id"]: scene["longitude_deg"] for scene in scenes}
    for row in passes:
        row["entry_solar"] = solar_time(row["entry_ns"], longitudes.get(row["scene_id"]))
    tiles = format_tiles(compute_table_row(dataset), traversals, passes, dataset.count("boxes"))
    parts = [
        f"<header><h1>{escape(title)}</h1>{tiles}</header>",
        "<h2>Scenes</h2>",
        f'<div class="scenes">{"".join(_scene_link(scene, pages) for scene in scenes)}</div>',
        "<h2>Traversals</h2>",
        _table("traversals", traversals, _TRAVERSALS, ("scene", "light", "weather", "vehicle"), pages, where=True),
        "<h2>The ledger of passes</h2>",
        _table("passes", passes, _PASSES, ("decision", "rule", "scene", "light", "weather"), pages),
        "<h2>Conditions and contents</h2>",
        f'<div class="grid">{"".join(draw_charts(dataset, traversals))}</div>',
        f"<footer>Made by mirror {__version__} from the dataset {escape(dataset.root)}.</footer>",
    ]
    write_bytes(out / "index.html", _page(title, parts).encode())
    return out / "index.html"


def _scene_page(dataset: Dataset, scene: Mapping[str, Any], traversals: Sequence[Mapping[str, Any]], title: str) -> str:
    view = dataset.where(scene=scene["scene_id"])
    passing = same_place(view, traversals)
    passages = choose_passages(passing, _MOST_PASSAGES)
    of_all = f"{len(passages)}{f' of {len(passing)}' if len(passages) < len(passing) else ''}"
    parts = [
        f'<p><a href="../index.html">{escape(title)}</a></p><h1>{escape(scene_name(scene))}</h1>',
        f'<p class="where">dataset.where(scene={json.dumps(scene["scene_id"])})</p>',
        map_legend({row["light"] for row in traversals}),
        f'<div class="grid two">{draw_scene_map(view, scene, traversals)}</div>',
    ]
    if len(passages) > 1:
        parts += [
            f"<h2>One place in {of_all} traversals</h2>",
            place_images(view, passages, width_px=_IMAGE_PX),
        ]
    parts += [
        "<h2>Traversals</h2>",
        _table("traversals", traversals, _TRAVERSALS, ("light", "weather", "vehicle"), {}, where=True),
        "<h2>Conditions and contents</h2>",
        f'<div class="grid">{"".join(draw_charts(view, traversals))}</div>',
    ]
    return _page(f"{scene['scene_id']} - {title}", parts)


def _scene_link(scene: Mapping[str, Any], pages: Mapping[str, str]) -> str:
    name = scene["scene_id"]
    text = (
        f"<b>{escape(scene_name(scene))}</b><span>{scene['traversals']} traversals, {scene['images']:,} images,"
        f" {scene['duration_s'] / 60:.1f} min</span>"
    )
    return f'<a href="{escape(pages[name])}">{text}</a>' if name in pages else f"<a>{text}</a>"


def _table(
    name: str, rows: Sequence[Mapping[str, Any]], columns: Sequence[str], filters: Sequence[str],
    pages: Mapping[str, str], *, where: bool = False,
) -> str:  # fmt: skip
    """A table whose rows are data for the script."""
    data = {
        "name": name,
        "columns": [_SHORT.get(column, column) for column in columns],
        "filters": filters,
        "where": ["scene", "light", "weather", "vehicle"] if where else [],
        "pages": pages,
        "rows": [[utc(row[key]) if key == "entry_ns" else row[key] for key in columns] for row in rows],
    }
    # `</script>` in a name would end the element.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    return (
        f'<section class="table"><script type="application/json">{text}</script><div class="filters"></div>'
        '<div class="actions"><span class="about"></span><button class="csv">CSV</button>'
        '<button class="json">JSON</button><code class="where"></code></div>'
        '<div class="scroll"><table><thead></thead><tbody></tbody></table></div>'
        '<button class="more">more rows</button></section>'
    )


def _page(title: str, parts: Sequence[str]) -> str:
    own = files("mirror.view")
    style = style_sheet() + own.joinpath("report_site.css").read_text()
    script = own.joinpath("report_site.js").read_text()
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<style>{style}</style></head><body><main>{''.join(parts)}</main><dialog></dialog>"
        f"<script>{script}</script></body></html>\n"
    )
