"""The road map of a scene, in the scene's frame, and its file: GeoParquet with a null crs.

A map is exact (from a synthetic street, or surveyed) or fitted to recordings; ``fitted`` tells which.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import shapely

from mirror.arrays import Float64
from mirror.errors import SchemaError, UsageError
from mirror.schema.documents import Document, Roi
from mirror.schema.files import encode_table, read_table, write_bytes
from mirror.schema.road_features import DRIVING as DRIVING
from mirror.schema.road_features import LaneKind as LaneKind
from mirror.schema.road_features import MapArea as MapArea
from mirror.schema.road_features import MapCrossing as MapCrossing
from mirror.schema.road_features import MapLane as MapLane
from mirror.schema.road_features import MapSignal as MapSignal
from mirror.schema.road_features import SignalState as SignalState
from mirror.schema.rollout_tables import ROAD_MAP, read_header

_METADATA: Final = b"mirror_road_map"
_MAPS_HELD: Final = 4


@dataclass(frozen=True, eq=False)
class RoadMap:
    """The map of one scene.

    Attributes:
        scene_id: the scene.
        frame: name of the scene's local metric frame; None: the east-north-up frame at the centre of its ROI.
        fitted: whether the map was fitted to recordings; otherwise it is exact.
        lanes: the lanes, by id.
        drivable: the drivable area.
        crossings: the crossings.
        signals: the signals, by id; a lane's ``signal`` refers to them.
        margin_m: of a fitted map: how far its drivable area reaches beyond the driven lines; None: exact map.

    Raises:
        UsageError: a lane refers to a lane or a signal that does not exist.
    """

    scene_id: str
    frame: str | None
    fitted: bool
    lanes: Mapping[str, MapLane]
    drivable: tuple[MapArea, ...]
    crossings: tuple[MapCrossing, ...] = ()
    signals: Mapping[str, MapSignal] = field(default_factory=dict)
    margin_m: float | None = None

    def __post_init__(self) -> None:
        for lane in self.lanes.values():
            named = (*lane.successors, *lane.predecessors, *lane.yields_to, lane.left, lane.right)
            unknown = next((name for name in named if name is not None and name not in self.lanes), None)
            if unknown is not None:
                raise UsageError(
                    f"there is no lane {unknown!r}",
                    place=f"lane {lane.lane_id!r}",
                    remedy="add the lane to the map, or take its name out of the lane",
                )
            if lane.signal is not None and lane.signal not in self.signals:
                raise UsageError(
                    f"there is no signal {lane.signal!r}",
                    place=f"lane {lane.lane_id!r}",
                    remedy="add the signal to the map, or take its name out of the lane",
                )

    @property
    def drivable_rings(self) -> tuple[Float64, ...]:
        """All rings of the drivable area, in the form for `mirror.metrics.safety.drivable_area_compliance`."""
        return tuple(ring for area in self.drivable for ring in area.rings)

    def lanes_of(self, kinds: Iterable[LaneKind] = DRIVING) -> tuple[MapLane, ...]:
        """Return the lanes of given kinds."""
        wanted = frozenset(kinds)
        return tuple(lane for lane in self.lanes.values() if lane.kind in wanted)

    def signal_lanes(self, signal_id: str) -> tuple[MapLane, ...]:
        """Return the lanes that a signal controls."""
        return tuple(lane for lane in self.lanes.values() if lane.signal == signal_id)


class RoadMapHeader(Document):
    """The metadata ``mirror_road_map`` of a map's file.

    Attributes:
        scene_id: the scene.
        frame: name of the scene's local metric frame; None: the east-north-up frame at the centre of its ROI.
        fitted: whether the map was fitted to recordings.
        margin_m: of a fitted map: how far its drivable area reaches beyond the driven lines.
    """

    scene_id: str
    frame: str | None
    fitted: bool
    margin_m: float | None


def write_road_map(path: str | Path, road_map: RoadMap) -> None:
    """Write a road map as one GeoParquet file, atomically; the same map gives the same bytes.

    Raises:
        DatasetError: the file cannot be written.
    """
    write_bytes(Path(path), encode_road_map(road_map))


@lru_cache(maxsize=_MAPS_HELD)
def encode_road_map(road_map: RoadMap) -> bytes:
    """Encode a road map as GeoParquet; the bytes of the last few maps are held."""
    rows: list[dict[str, Any]] = [
        *(_lane_row(road_map.lanes[name]) for name in sorted(road_map.lanes)),
        *(_area_row(area) for area in road_map.drivable),
        *(_crossing_row(crossing) for crossing in road_map.crossings),
        *(_signal_row(road_map.signals[name]) for name in sorted(road_map.signals)),
    ]
    data = pa.Table.from_pylist(rows, schema=ROAD_MAP.schema)
    boxes = [row["bbox"] for row in rows if row.get("bbox") is not None]
    header = RoadMapHeader(
        scene_id=road_map.scene_id, frame=road_map.frame, fitted=road_map.fitted, margin_m=road_map.margin_m
    )
    metadata = {_METADATA: header.model_dump_json().encode(), b"geo": json.dumps(_geo(boxes)).encode()}
    return encode_table(data.replace_schema_metadata(metadata), ROAD_MAP)


def read_road_map(path: str | Path, *, data: bytes | None = None) -> RoadMap:
    """Read a road map.

    Args:
        path: its file.
        data: bytes of the file; None: it is opened.

    Raises:
        DatasetError: the file is missing.
        SchemaError: the file is not a road map, or a feature is invalid; the feature is named.
    """
    path = Path(path)
    rows: Sequence[Mapping[str, Any]] = read_table(path, ROAD_MAP, data=data).to_pylist()
    header = read_header(path, _METADATA, RoadMapHeader, data=data)
    of = {kind: [row for row in rows if row["feature"] == kind] for kind in ("lane", "drivable", "crossing", "signal")}
    try:
        return RoadMap(
            scene_id=header.scene_id,
            frame=header.frame,
            fitted=header.fitted,
            margin_m=header.margin_m,
            lanes={row["feature_id"]: _read_lane(row) for row in of["lane"]},
            drivable=tuple(MapArea(row["feature_id"], _read_rings(row)) for row in of["drivable"]),
            crossings=tuple(MapCrossing(row["feature_id"], _read_rings(row)[0]) for row in of["crossing"]),
            signals={row["feature_id"]: _read_signal(row) for row in of["signal"]},
        )
    except UsageError as error:
        raise SchemaError(error.problem, file=path, place=error.place, expected=error.expected) from error


def require_map_of(road_map: RoadMap, roi: Roi, file: str | Path) -> None:
    """Raise an error unless a map is of the given scene.

    Args:
        road_map: the map.
        roi: region of interest of the scene.
        file: file of the map, for messages.

    Raises:
        UsageError: the map is of another scene or in another frame, or no lane and no part of the drivable area lies
            in the region of interest.
    """
    if road_map.scene_id != roi.scene_id:
        raise UsageError(f"a map of scene {road_map.scene_id}", file=file, expected=f"a map of {roi.scene_id}")
    frames = [frame or "east-north-up at the centre of the ROI" for frame in (road_map.frame, roi.frame)]
    if frames[0] != frames[1]:
        raise UsageError(f"a map in the frame {frames[0]}", file=file, expected=f"the scene's frame: {frames[1]}")
    center = shapely.Point(roi.x_m or 0.0, roi.y_m or 0.0)
    lines = [shapely.LineString(lane.center_m[:, :2]) for lane in road_map.lanes.values()]
    areas = [shapely.Polygon(area.rings[0], area.rings[1:]) for area in road_map.drivable]
    nearest_m = min((float(shape.distance(center)) for shape in (*lines, *areas)), default=np.inf)
    if nearest_m > roi.radius_m:
        raise UsageError(
            f"the nearest lane or drivable area is {nearest_m:.0f} m from the centre of scene {roi.scene_id}"
            if np.isfinite(nearest_m)
            else "there is no lane and no drivable area",
            file=file,
            expected=f"a map that reaches into the region of interest, which has a radius of {roi.radius_m:g} m",
            remedy="give the coordinates in the frame of the scene, in metres",
        )


def _geo(boxes: Sequence[Mapping[str, float]]) -> dict[str, object]:
    column: dict[str, object] = {
        "encoding": "WKB",
        "geometry_types": ["LineString Z", "Polygon"],
        "crs": None,
        "covering": {"bbox": {name: ["bbox", name] for name in ("xmin", "ymin", "xmax", "ymax")}},
    }
    if boxes:
        column["bbox"] = [
            *(min(box[name] for box in boxes) for name in ("xmin", "ymin")),
            *(max(box[name] for box in boxes) for name in ("xmax", "ymax")),
        ]
    return {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}


def _geometry(shape: shapely.Geometry) -> dict[str, object]:
    box = dict(zip(("xmin", "ymin", "xmax", "ymax"), shape.bounds))
    return {"geometry": shapely.to_wkb(shape, flavor="iso", byte_order=1), "bbox": box}


def _lane_row(lane: MapLane) -> dict[str, Any]:
    return {
        "feature": "lane",
        "feature_id": lane.lane_id,
        "kind": lane.kind,
        "width_m": lane.width_m.tolist(),
        "speed_limit_mps": lane.speed_limit_mps,
        "successors": list(lane.successors),
        "predecessors": list(lane.predecessors),
        "left": lane.left,
        "right": lane.right,
        "stop_m": lane.stop_m,
        "signal": lane.signal,
        "yields_to": list(lane.yields_to),
        **_geometry(shapely.LineString(lane.center_m)),
    }


def _area_row(area: MapArea) -> dict[str, Any]:
    polygon = shapely.Polygon(area.rings[0], area.rings[1:])
    return {"feature": "drivable", "feature_id": area.area_id, **_geometry(polygon)}


def _crossing_row(crossing: MapCrossing) -> dict[str, Any]:
    polygon = shapely.Polygon(crossing.outline_m)
    return {"feature": "crossing", "feature_id": crossing.crossing_id, **_geometry(polygon)}


def _signal_row(signal: MapSignal) -> dict[str, Any]:
    return {
        "feature": "signal",
        "feature_id": signal.signal_id,
        "phase_states": [state for state, _ in signal.phases],
        "phase_s": [duration_s for _, duration_s in signal.phases],
        "offset_s": signal.offset_s,
    }


def _read_geometry(row: Mapping[str, Any], kind: str) -> shapely.Geometry:
    try:
        shape = shapely.from_wkb(row["geometry"])
    except shapely.errors.GEOSException as error:
        raise UsageError("not WKB", place=f"{row['feature']} {row['feature_id']!r}, column geometry") from error
    if shape is None or shape.geom_type != kind:
        raise UsageError(
            "no geometry" if shape is None else f"a {shape.geom_type}",
            place=f"{row['feature']} {row['feature_id']!r}, column geometry",
            expected=f"a {kind}",
        )
    return shape


def _read_lane(row: Mapping[str, Any]) -> MapLane:
    line = _read_geometry(row, "LineString")
    if not line.has_z:
        raise UsageError("a line without heights", place=f"lane {row['feature_id']!r}", expected="a LineString Z")
    return MapLane(
        lane_id=row["feature_id"],
        kind=row["kind"],
        center_m=shapely.get_coordinates(line, include_z=True),
        width_m=np.array(row["width_m"] or (), np.float64),
        speed_limit_mps=row["speed_limit_mps"],
        successors=_names(row["successors"]),
        predecessors=_names(row["predecessors"]),
        left=row["left"],
        right=row["right"],
        stop_m=row["stop_m"],
        signal=row["signal"],
        yields_to=_names(row["yields_to"]),
    )


def _names(values: Iterable[str] | None) -> tuple[str, ...]:
    return tuple(values or ())


def _read_rings(row: Mapping[str, Any]) -> tuple[Float64, ...]:
    polygon = _read_geometry(row, "Polygon")
    return tuple(shapely.get_coordinates(ring)[:-1] for ring in (polygon.exterior, *polygon.interiors))


def _read_signal(row: Mapping[str, Any]) -> MapSignal:
    states, durations = row["phase_states"] or [], row["phase_s"] or []
    if len(states) != len(durations):
        raise UsageError(f"{len(states)} states and {len(durations)} durations", place=f"signal {row['feature_id']!r}")
    return MapSignal(row["feature_id"], tuple(zip(states, durations)), row["offset_s"] or 0.0)
