"""GeoParquet 1.1: WKB geometries, their bounding boxes, and the ``geo`` metadata of a file.

Source: https://geoparquet.org/releases/v1.1.0/. The longitudes of a geometry are continuous: across the antimeridian
they continue beyond 180 degrees, so that the geometry keeps its shape and its bounding box stays small.
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
    """Unwrap longitudes (N,) in degrees at the antimeridian."""
    # Full turns are counted as integers, so that a closed ring ends exactly at its first point.
    turns = np.round(np.diff(longitude_deg) / 360.0)
    return longitude_deg - 360.0 * np.concatenate([[0.0], np.cumsum(turns)])


def wkb_line(points: Float64) -> bytes:
    """Encode longitudes and latitudes (N, 2) as a LineString in little-endian WKB."""
    return struct.pack("<BII", 1, _LINESTRING, len(points)) + points.astype("<f8").tobytes()


def wkb_polygon(ring: Float64) -> bytes:
    """Encode a closed ring (N, 2) as a Polygon without holes in little-endian WKB."""
    return struct.pack("<BIII", 1, _POLYGON, 1, len(ring)) + ring.astype("<f8").tobytes()


def line_points(wkb: bytes) -> Float64:
    """Decode the points (N, 2) of a LineString of `wkb_line`."""
    return np.frombuffer(wkb, "<f8", offset=9).reshape(-1, 2)


def bounding_box(points: Float64) -> dict[str, float]:
    """Return the bounding box of longitudes and latitudes (N, 2) as a row of the column ``bbox``."""
    (xmin, ymin), (xmax, ymax) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return {"xmin": xmin, "ymin": ymin, "xmax": xmax, "ymax": ymax}


def with_geo_metadata(table: pa.Table, geometry_type: str) -> pa.Table:
    """Add the ``geo`` metadata for the columns ``geometry`` and ``bbox`` to a table.

    A table without any geometry has scenes in local metric frames only; its crs is null.
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
