"""Statistics of a dataset: its row in the paper's dataset table, and distributions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Float64, Int64
from mirror.dataset.area import covered_area_m2
from mirror.dataset.dataset import Dataset
from mirror.schema.documents import DriveDocument, Roi

_LIGHT: Final = ("day", "dusk", "night", "unknown")
_WEATHER: Final = ("clear", "clouds", "rain", "snow", "fog", "unknown")
_ROI_COLUMNS: Final = tuple(Roi.model_fields)
_SPAN_S: Final = 0.5
_STANDING_MPS: Final = 0.5
_EDGES_MPS: Final = tuple(float(edge) for edge in range(0, 42, 2))


@dataclass(frozen=True)
class TableRow:
    """The paper's dataset table (its table 1), for one dataset.

    Attributes:
        multi_traversal: whether a scene has more than one traversal.
        area_km2: area of the union of the scenes' circles.
        scenes: number of scenes with a traversal.
        area_per_scene_km2: area_km2 / scenes.
        cities: names, sorted. If the ROI of a scene has no city, the cities of its drives count, if known.
        hours: sum of the traversals' durations.
        cameras: largest number of cameras of a traversal.
        light: those of day, dusk, night, unknown that occur.
        weather: those of clear, clouds, rain, snow, fog, unknown that occur.
    """

    multi_traversal: bool
    area_km2: float
    scenes: int
    area_per_scene_km2: float
    cities: tuple[str, ...]
    hours: float
    cameras: int
    light: tuple[str, ...]
    weather: tuple[str, ...]

    @property
    def conditions(self) -> str:
        """Text of the table's column "Light", such as ``Day/Night/Rain``."""
        adverse = [name for name in self.weather if name in ("rain", "snow", "fog")]
        return "/".join(name.capitalize() for name in (*(n for n in self.light if n != "unknown"), *adverse)) or "--"


@dataclass(frozen=True)
class SceneRow:
    """Statistics of one scene, a row of a table.

    Attributes:
        scene_id: the scene.
        city: its city; None: unknown.
        scene_type: urban, highway, rural or campus; None: unknown.
        traversals: number of accepted passes.
        drives: number of their drives.
        hours: sum of the traversals' durations.
        images: number of images.
        light: number of traversals by light.
    """

    scene_id: str
    city: str | None
    scene_type: str | None
    traversals: int
    drives: int
    hours: float
    images: int
    light: Mapping[str, int]


@dataclass(frozen=True)
class ConditionCount:
    """Number and hours of the traversals of one light and weather."""

    light: str
    weather: str
    traversals: int
    hours: float


@dataclass(frozen=True)
class CategoryRow:
    """Number of boxes of one category in one layer.

    Attributes:
        layer: ``source@version``.
        category: class name in the source's words.
        boxes: number of boxes.
        objects: number of different track ids, counted in each traversal.
        mean_score: mean score of the boxes that have one; None: none has.
    """

    layer: str
    category: str
    boxes: int
    objects: int
    mean_score: float | None


@dataclass(frozen=True)
class Speed:
    """Distribution of the horizontal speed over half seconds, weighted by time.

    Attributes:
        edges_mps: (B + 1,) edges of the bins; higher speeds count in the last bin.
        hours: (B,) hours in each bin.
        mean_mps: mean over time.
        quantiles_mps: the speeds below which 5, 25, 50, 75 and 95 % of the time were driven, by percent.
        standing: share of the time below 0.5 m/s.
    """

    edges_mps: tuple[float, ...]
    hours: tuple[float, ...]
    mean_mps: float
    quantiles_mps: Mapping[int, float]
    standing: float


@dataclass(frozen=True)
class Statistics:
    """Statistics of a dataset or a view of one.

    Attributes:
        row: the row in the paper's dataset table.
        scenes: statistics of each scene, including those without a traversal.
        conditions: traversals by light and weather.
        speed: distribution of the speed; None: there are no traversals.
        vehicle_types: number of traversals by vehicle type.
        vehicles: number of vehicles.
        drives: number of drives with a traversal.
        traversals: number of accepted passes.
        refused: number of refused passes by rule.
        camera_hours: sum over traversals of hours times cameras.
        frames: number of frames.
        images: number of images.
        image_bytes: their total size.
        categories: boxes by layer and category, most frequent first.
    """

    row: TableRow
    scenes: Sequence[SceneRow]
    conditions: Sequence[ConditionCount]
    speed: Speed | None
    vehicle_types: Mapping[str, int]
    vehicles: int
    drives: int
    traversals: int
    refused: Mapping[str, int]
    camera_hours: float
    frames: int
    images: int
    image_bytes: int
    categories: Sequence[CategoryRow] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as JSON values, for ``--json``."""
        return asdict(self)


def compute_statistics(dataset: Dataset) -> Statistics:
    """Compute the statistics of a dataset or a view of one.

    Args:
        dataset: the dataset or view; tables of images and poses are read one scene at a time.
    """
    rois, own, traversals = _scenes_and_traversals(dataset)
    scenes = [_scene(roi, own[scene_id]) for scene_id, roi in rois.items()]
    refused = dataset.table("passes", ["rule"]).column("rule").drop_null()
    return Statistics(
        row=_row(dataset, rois, own, traversals),
        scenes=scenes,
        conditions=_conditions(traversals),
        speed=_speed(dataset, own),
        vehicle_types=_counted(item["vehicle_type"] for item in traversals),
        vehicles=len({item["vehicle_id"] for item in traversals}),
        drives=len({item["drive_id"] for item in traversals}),
        traversals=len(traversals),
        refused=_counted(refused.to_pylist()),
        camera_hours=sum(item["duration_s"] * len(item["cameras"]) for item in traversals) / 3600,
        frames=dataset.count("frames"),
        images=dataset.count("images"),
        image_bytes=sum(
            stored_bytes(dataset.where(scene=scene_id).table("images", ["codec", "byte_length", "uri"]))
            for scene_id, items in own.items()
            if items
        ),
        categories=_categories(dataset, [scene_id for scene_id, items in own.items() if items]),
    )


def compute_table_row(dataset: Dataset) -> TableRow:
    """Compute the row in the paper's dataset table, without reading images or poses."""
    return _row(dataset, *_scenes_and_traversals(dataset))


def _scenes_and_traversals(
    dataset: Dataset,
) -> tuple[dict[str, Roi], dict[str, list[dict[str, Any]]], list[dict[str, Any]]]:
    """Scenes by id, the traversals of each scene, and all traversals."""
    traversals = dataset.table(
        "traversals",
        ["scene_id", "traversal_id", "drive_id", "vehicle_id", "vehicle_type", "entry_ns", "exit_ns", "duration_s",
         "light", "weather", "cameras", "images"],
    ).to_pylist()  # fmt: skip
    own: dict[str, list[dict[str, Any]]] = {scene_id: [] for scene_id in dataset.scenes()}
    for item in traversals:
        own[item["scene_id"]].append(item)
    rois = {row["scene_id"]: _roi(row) for row in dataset.table("scenes", _ROI_COLUMNS).to_pylist()}
    return rois, own, traversals


def _roi(row: Mapping[str, Any]) -> Roi:
    return Roi.model_validate({name: row[name] for name in _ROI_COLUMNS})


def _scene(roi: Roi, traversals: Sequence[Mapping[str, Any]]) -> SceneRow:
    return SceneRow(
        scene_id=roi.scene_id,
        city=roi.city,
        scene_type=roi.scene_type,
        traversals=len(traversals),
        drives=len({item["drive_id"] for item in traversals}),
        hours=_hours(traversals),
        images=sum(item["images"] for item in traversals),
        light=_counted((item["light"] for item in traversals), _LIGHT),
    )


def _row(
    dataset: Dataset,
    rois: Mapping[str, Roi],
    own: Mapping[str, Sequence[Mapping[str, Any]]],
    traversals: Sequence[Mapping[str, Any]],
) -> TableRow:
    visited = [roi for scene_id, roi in rois.items() if own[scene_id]]
    area_km2 = covered_area_m2(visited) * 1e-6
    drives_to_ask = {item["drive_id"] for roi in visited if roi.city is None for item in own[roi.scene_id]}
    cities = {roi.city for roi in visited} | {_drive_city(dataset, drive_id) for drive_id in sorted(drives_to_ask)}
    return TableRow(
        multi_traversal=any(len(items) > 1 for items in own.values()),
        area_km2=area_km2,
        scenes=len(visited),
        area_per_scene_km2=area_km2 / len(visited) if visited else 0.0,
        cities=tuple(sorted(city for city in cities if city is not None)),
        hours=_hours(traversals),
        cameras=max((len(item["cameras"]) for item in traversals), default=0),
        light=tuple(_counted((item["light"] for item in traversals), _LIGHT)),
        weather=tuple(_counted((item["weather"] for item in traversals), _WEATHER)),
    )


def _categories(dataset: Dataset, scenes: Iterable[str]) -> list[CategoryRow]:
    """Boxes by layer and category; the tables are read one scene at a time."""
    keys = ["source", "source_version", "category"]
    boxes: Counter[tuple[str, str]] = Counter()
    objects: Counter[tuple[str, str]] = Counter()
    scored: Counter[tuple[str, str]] = Counter()
    sums: dict[tuple[str, str], float] = {}
    for scene_id in scenes:
        table = dataset.where(scene=scene_id).table("boxes", [*keys, "traversal_id", "track_id", "score"])
        text = [table.column(name).cast(pa.string()) for name in (*keys, "traversal_id", "track_id")]
        table = pa.table(dict(zip((*keys, "traversal", "track"), text))).append_column("score", table.column("score"))
        counts = table.group_by([*keys, "traversal", "track"]).aggregate(
            [("score", "count"), ("score", "sum"), ([], "count_all")]
        )
        for row in counts.to_pylist():
            key = f"{row['source']}@{row['source_version']}", row["category"]
            boxes[key] += row["count_all"]
            objects[key] += 1
            scored[key] += row["score_count"]
            sums[key] = sums.get(key, 0.0) + (row["score_sum"] or 0.0)
    return [
        CategoryRow(*key, count, objects[key], sums[key] / scored[key] if scored[key] else None)
        for key, count in sorted(boxes.items(), key=lambda item: (item[0][0], -item[1], item[0][1]))
    ]


def _drive_city(dataset: Dataset, drive_id: str) -> str | None:
    return dataset.store.json(f"drives/{drive_id}/drive.json", DriveDocument).city


def _conditions(traversals: Sequence[Mapping[str, Any]]) -> list[ConditionCount]:
    conditions = []
    for light in _LIGHT:
        for weather in _WEATHER:
            matching = [item for item in traversals if (item["light"], item["weather"]) == (light, weather)]
            if matching:
                conditions.append(ConditionCount(light, weather, len(matching), _hours(matching)))
    return conditions


def _hours(traversals: Sequence[Mapping[str, Any]]) -> float:
    return float(sum(item["duration_s"] for item in traversals)) / 3600


def _counted(values: Iterable[str], order: Sequence[str] = ()) -> dict[str, int]:
    """Number of occurrences of each value: first the values of ``order``, then the others by frequency."""
    counts = Counter(values)
    known = [value for value in order if value in counts]
    return {value: counts[value] for value in (*known, *(v for v, _ in counts.most_common() if v not in known))}


def stored_bytes(images: pa.Table) -> int:
    """Return the size of the image files in bytes; a video counts once, whatever its number of frames.

    Args:
        images: the columns ``codec``, ``byte_length`` and ``uri`` of the `images` table.
    """
    is_still = pc.not_equal(images.column("codec").cast(pa.string()), "video")
    videos = images.filter(pc.invert(is_still)).group_by("uri").aggregate([("byte_length", "max")])
    parts = (images.filter(is_still).column("byte_length"), videos.column("byte_length_max"))
    return sum(pc.sum(part).as_py() or 0 for part in parts)


def _speed(dataset: Dataset, own: Mapping[str, Sequence[Mapping[str, Any]]]) -> Speed | None:
    speeds, seconds = [np.empty(0)], [np.empty(0)]
    for scene_id, items in own.items():
        poses = dataset.where(scene=scene_id).table("ego_poses", ["traversal_id", "timestamp_ns", "tx_m", "ty_m"])
        ids = poses.column("traversal_id").combine_chunks().dictionary_encode()
        stamps, x, y = (poses.column(name).to_numpy() for name in ("timestamp_ns", "tx_m", "ty_m"))
        codes, names = ids.indices.to_numpy(), ids.dictionary.to_pylist()
        # A traversal is one row group, so its poses are contiguous.
        bounds = np.flatnonzero(np.diff(codes, prepend=-1, append=-1))
        rows = {names[codes[start]]: slice(start, stop) for start, stop in pairwise(bounds.tolist())}
        for item in items:
            if item["traversal_id"] in rows:
                track = rows[item["traversal_id"]]
                speed, time = _segment_speeds(stamps[track], x[track], y[track], item["entry_ns"], item["exit_ns"])
                speeds.append(speed)
                seconds.append(time)
    speed, time = np.concatenate(speeds), np.concatenate(seconds)
    if not time.sum() > 0:
        return None
    return _distribution(speed, time)


def _segment_speeds(stamps: Int64, x: Float64, y: Float64, entry_ns: int, exit_ns: int) -> tuple[Float64, Float64]:
    """Speeds over half seconds from entry to exit, and the duration of each in seconds.

    Over shorter times, the noise of fixes at 100 Hz and more would count as speed.
    """
    end = (min(exit_ns, int(stamps[-1])) - entry_ns) * 1e-9
    start = max((int(stamps[0]) - entry_ns) * 1e-9, 0.0)
    if end <= start:
        return np.empty(0), np.empty(0)
    times = np.append(np.arange(start, end, _SPAN_S), end)
    seconds = (stamps - entry_ns) * 1e-9
    duration = np.diff(times)
    distance = np.hypot(np.diff(np.interp(times, seconds, x)), np.diff(np.interp(times, seconds, y)))
    positive = duration > 1e-9
    return distance[positive] / duration[positive], duration[positive]


def _distribution(speed: Float64, time: Float64) -> Speed:
    order = np.argsort(speed)
    passed = np.cumsum(time[order]) / time.sum()
    quantiles = {
        percent: float(speed[order[min(int(np.searchsorted(passed, percent / 100)), len(speed) - 1)]])
        for percent in (5, 25, 50, 75, 95)
    }
    hours, _ = np.histogram(np.minimum(speed, _EDGES_MPS[-1]), _EDGES_MPS, weights=time / 3600)
    return Speed(
        edges_mps=_EDGES_MPS,
        hours=tuple(hours.tolist()),
        mean_mps=float((speed * time).sum() / time.sum()),
        quantiles_mps=quantiles,
        standing=float(time[speed < _STANDING_MPS].sum() / time.sum()),
    )
