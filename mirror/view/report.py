"""A dataset on one page: pictures of every camera, maps, charts, and the ledger of refused passes.

One HTML file with everything in it: no script, no network; readable on a phone and in dark mode.
"""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.schema.files import write_bytes
from mirror.version import __version__
from mirror.view.svg import Line, bars, scene_map

_PICTURE_WIDTH_PX = 400
_JPEG_QUALITY = 80
_MAP_POINTS = 400
_REFUSED_ROWS = 200
_LIGHTS = ("day", "dusk", "night")
_RIG_ORDER = ("front_left", "front_wide", "front_right", "rear_left", "front_narrow", "rear_right", "rear")


def write_report(dataset: Dataset, out: Path, title: str = "MIRROR dataset") -> None:
    """Write the report.

    Args:
        dataset: what to report on; a filtered view is reported as such.
        out: the HTML file; replaced whole or not at all.
        title: of the page.

    Raises:
        DatasetError: a picture cannot be read, or the file cannot be written.
    """
    scenes = dataset.table("scenes").to_pylist()
    traversals = dataset.table("traversals").to_pylist()
    passes = dataset.passes().to_pylist()
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="dim">{escape(dataset.root)}</p>',
        _tiles(scenes, traversals, passes),
        "<h2>What the cameras see</h2>",
        *_pictures(dataset, traversals),
        "<h2>Where was driven</h2>",
        _key(),
        '<div class="grid">',
        *(_map(dataset, scene, traversals) for scene in scenes),
        "</div>",
        "<h2>Conditions and contents</h2>",
        '<div class="grid">',
        *_charts(dataset, traversals),
        "</div>",
        "<h2>The ledger</h2>",
        *_ledger(passes),
        f"<footer>Made by mirror {__version__} from the dataset alone.</footer>",
    ]
    style = files("mirror.view").joinpath("report.css").read_text()
    page = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<style>{style}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
    )
    write_bytes(out, page.encode())


def _tiles(scenes: Sequence[dict[str, Any]], traversals: Sequence[dict[str, Any]], passes: Sequence[Any]) -> str:
    area_km2 = sum(math.pi * scene["radius_m"] ** 2 for scene in scenes) / 1e6
    cameras = {camera for one in traversals for camera in one["cameras"]}
    tiles = {
        "scenes": f"{len(scenes)}",
        "km² of scenes": f"{area_km2:.3f}",
        "traversals": f"{len(traversals)}",
        "drives": f"{len({one['drive_id'] for one in traversals})}",
        "minutes": f"{sum(one['duration_s'] for one in traversals) / 60:.1f}",
        "km driven": f"{sum(one['path_m'] for one in traversals) / 1000:.2f}",
        "cameras": f"{len(cameras)}",
        "pictures": f"{sum(one['images'] for one in traversals):,}",
        "passes refused": f"{sum(one['decision'] == 'refused' for one in passes)}",
    }
    cells = "".join(f'<div class="tile"><b>{value}</b><span>{name}</span></div>' for name, value in tiles.items())
    return f'<div class="tiles">{cells}</div>'


def _pictures(dataset: Dataset, traversals: Sequence[dict[str, Any]]) -> Iterable[str]:
    """All cameras of one frame for every condition that there is, from the middle of a traversal."""
    shown: dict[tuple[str, str], dict[str, Any]] = {}
    for one in traversals:
        if one["frames"]:
            shown.setdefault((one["light"], one["weather"]), one)
    if not shown:
        yield '<p class="dim">No traversal has pictures.</p>'
    order = sorted(shown, key=lambda key: (_light_order(key[0]), key[1]))
    for light, weather in order:
        one = shown[light, weather]
        frames = dataset.where(traversal=one["traversal_id"]).frames()
        frame = max((frames[len(frames) // 2 + step] for step in (0, -1) if len(frames) > 1 or step == 0), key=_cameras)
        yield f"<h3>{escape(light)}, {escape(weather)}</h3>"
        yield f'<p class="dim">{escape(one["traversal_id"])}, frame {frame.frame_index}, {_utc(frame.timestamp_ns)}</p>'
        yield f'<div class="rig">{"".join(_picture(frame, camera) for camera in _ordered(frame.images))}</div>'


def _light_order(light: str) -> int:
    return _LIGHTS.index(light) if light in _LIGHTS else len(_LIGHTS)


def _cameras(frame: Frame) -> int:
    return len(frame.images)


def _ordered(cameras: Iterable[str]) -> list[str]:
    known = {camera: number for number, camera in enumerate(_RIG_ORDER)}
    return sorted(cameras, key=lambda camera: (known.get(camera, len(known)), camera))


def _picture(frame: Frame, camera: str) -> str:
    picture = frame.images[camera].decode()
    height, width = picture.shape[:2]
    if width > _PICTURE_WIDTH_PX:
        size = (_PICTURE_WIDTH_PX, round(height * _PICTURE_WIDTH_PX / width))
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    encoded = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    data = base64.b64encode(encoded.tobytes()).decode()
    return (
        f'<figure><img alt="{escape(camera)}" src="data:image/jpeg;base64,{data}">'
        f"<figcaption>{escape(camera)}</figcaption></figure>"
    )


def _key() -> str:
    entries = [f'<span><i style="background:var(--{light})"></i>{light}</span>' for light in _LIGHTS]
    return f'<p class="key">{"".join(entries)}<span>● entry</span><span>▶ exit</span></p>'


def _map(dataset: Dataset, scene: dict[str, Any], traversals: Sequence[dict[str, Any]]) -> str:
    centre = (scene["x_m"], scene["y_m"]) if scene["frame"] is not None else (0.0, 0.0)
    lines = []
    for one in sorted(traversals, key=lambda one: _light_order(one["light"])):
        if one["scene_id"] != scene["scene_id"]:
            continue
        poses = dataset.where(traversal=one["traversal_id"]).table("ego_poses", ["timestamp_ns", "tx_m", "ty_m"])
        stamps, x, y = (poses.column(name).to_numpy() for name in ("timestamp_ns", "tx_m", "ty_m"))
        inside = np.flatnonzero((stamps >= one["entry_ns"]) & (stamps <= one["exit_ns"]))
        inside = inside[:: max(1, len(inside) // _MAP_POINTS)]
        about = f"{one['traversal_id']}: {one['light']}, {one['weather']}, {one['duration_s']:.0f} s"
        lines.append(Line(x[inside] - centre[0], y[inside] - centre[1], one["light"], about))
    where = ", ".join(str(scene[name]) for name in ("city", "scene_type") if scene[name])
    title = f"{scene['scene_id']}{f' ({where})' if where else ''}: {len(lines)} traversals"
    return scene_map(title, scene["radius_m"], lines)


def _charts(dataset: Dataset, traversals: Sequence[dict[str, Any]]) -> Iterable[str]:
    light = Counter(one["light"] for one in traversals)
    yield bars("Traversals by light", {key: light[key] for key in [*_LIGHTS, *sorted(set(light) - set(_LIGHTS))]})
    yield bars("Traversals by weather", dict(sorted(Counter(one["weather"] for one in traversals).items())))
    yield bars("Traversals by vehicle type", dict(sorted(Counter(one["vehicle_type"] for one in traversals).items())))
    speeds = Counter(int(one["mean_speed_mps"] // 2) * 2 for one in traversals)
    if speeds:
        steps = range(0, max(speeds) + 2, 2)
        yield bars("Traversals by mean speed", {f"{step} to {step + 2} m/s": speeds[step] for step in steps})
    categories = Counter(dataset.table("boxes", ["category"]).column("category").to_pylist())
    if categories:
        yield bars("Boxes by category", dict(categories.most_common(12)))
    cameras = Counter(camera for one in traversals for camera in one["cameras"])
    if cameras:
        yield bars("Traversals by camera", {camera: cameras[camera] for camera in _ordered(cameras)})


def _ledger(passes: Sequence[dict[str, Any]]) -> Iterable[str]:
    accepted = sum(one["decision"] == "accepted" for one in passes)
    refused = [one for one in passes if one["decision"] == "refused"]
    yield f"<p>{len(passes)} passes: {accepted} accepted, {len(refused)} refused.</p>"
    if not refused:
        return
    head = (
        "<tr><th>scene</th><th>drive</th><th>entry</th><th>rule</th><th class=n>measured</th><th class=n>asked for</th>"
        "<th class=n>duration</th><th class=n>path</th><th class=n>overlap</th><th>ends</th></tr>"
    )
    rows = [
        f"<tr><td>{escape(one['scene_id'])}</td><td>{escape(one['drive_id'])}</td><td>{_utc(one['entry_ns'])}</td>"
        f"<td>{escape(one['rule'])}</td><td class=n>{one['measured']:.3g}</td><td class=n>{one['threshold']:g}</td>"
        f"<td class=n>{one['duration_s']:.1f} s</td><td class=n>{one['path_m']:.1f} m</td>"
        f"<td class=n>{100 * one['overlap']:.1f} %</td>"
        f"<td>{escape(one['entry_kind'])} → {escape(one['exit_kind'])}</td></tr>"
        for one in refused[:_REFUSED_ROWS]
    ]
    yield f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'
    if len(refused) > _REFUSED_ROWS:
        yield f'<p class="dim">The first {_REFUSED_ROWS} of {len(refused)}; all are in index/passes.parquet.</p>'


def _utc(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
