"""GeoParquet 1.1: WKB geometries, their bounding boxes, and the ``geo`` metadata of a file.

Source: https://geoparquet.org/releases/v1.1.0/. Longitudes of one geometry are continuous: across the antimeridian
they go on beyond 180 degrees, so that the geometry keeps its shape and its bounding box stays small.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from functools import cache

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64
from mirror.schema.tables import BBOX

_LINESTRING, _POLYGON = 2, 3


def continuous(longitude_deg: Float64) -> Float64:
    """Longitudes (N,) without the jump at the antimeridian."""
    # Whole turns are counted, so that a ring that comes back to its first point does so to the last bit.
    turns = np.round(np.diff(longitude_deg) / 360.0)
    return longitude_deg - 360.0 * np.concatenate([[0.0], np.cumsum(turns)])


def wkb_line(points: Float64) -> bytes:
    """A LineString as little-endian WKB, from (N, 2) longitude and latitude."""
    return struct.pack("<BII", 1, _LINESTRING, len(points)) + points.astype("<f8").tobytes()


def wkb_polygon(ring: Float64) -> bytes:
    """A Polygon without holes as little-endian WKB, from its closed ring (N, 2)."""
    return struct.pack("<BIII", 1, _POLYGON, 1, len(ring)) + ring.astype("<f8").tobytes()


def line_points(wkb: bytes) -> Float64:
    """The points (N, 2) of a LineString that `wkb_line` wrote."""
    return np.frombuffer(wkb, "<f8", offset=9).reshape(-1, 2)


def bounding_box(points: Float64) -> dict[str, float]:
    """A row of the covering column, from (N, 2) longitude and latitude."""
    (xmin, ymin), (xmax, ymax) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return {"xmin": xmin, "ymin": ymin, "xmax": xmax, "ymax": ymax}


def with_geo_metadata(table: pa.Table, geometry_type: str) -> pa.Table:
    """The table with the ``geo`` metadata of its columns ``geometry`` and ``bbox``.

    A table without any geometry is of local metric frames: its crs is null.
    """
    boxes: Sequence[dict[str, float]] = [box for box in table.column("bbox").to_pylist() if box is not None]
    column: dict[str, object] = {
        "encoding": "WKB",
        "geometry_types": [geometry_type] if boxes else [],
        "crs": _crs84() if boxes else None,
        "covering": {"bbox": {field.name: ["bbox", field.name] for field in BBOX}},
    }
    if boxes:
        column["bbox"] = [
            min(box["xmin"] for box in boxes),
            min(box["ymin"] for box in boxes),
            max(box["xmax"] for box in boxes),
            max(box["ymax"] for box in boxes),
        ]
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    return table.replace_schema_metadata({**(table.schema.metadata or {}), b"geo": json.dumps(geo).encode()})


@cache
def _crs84() -> dict[str, object]:
    import pyproj

    return dict(pyproj.CRS("OGC:CRS84").to_json_dict())
