"""Regions of interest: read from GeoJSON, CSV or the command line, and kept in ``rois.geojson``."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import ValidationError

from mirror.errors import DatasetError, SchemaError, UsageError
from mirror.geometry.geodesy import surface_distance_m
from mirror.schema.documents import Roi
from mirror.schema.files import write_bytes
from mirror.schema.problems import describe_expected, describe_problem
from mirror.schema.strict_json import JsonError, decode_json

_ALIASES = {
    "id": "scene_id",
    "name": "scene_id",
    "lon": "longitude_deg",
    "lng": "longitude_deg",
    "longitude": "longitude_deg",
    "lat": "latitude_deg",
    "latitude": "latitude_deg",
    "radius": "radius_m",
    "height": "height_m",
    "x": "x_m",
    "y": "y_m",
}
_FAR_M = 100_000.0
_NEAR_M = 20_000.0


def read_rois(path: Path) -> list[Roi]:
    """Read ROIs from a GeoJSON or CSV file.

    GeoJSON: a FeatureCollection of points with the properties of `Roi` (``scene_id`` and, if not 200 m, ``radius_m``),
    or the properties alone. CSV: a header with ``scene_id`` and ``longitude_deg``, ``latitude_deg`` (or ``lon``,
    ``lat``; local frames: ``frame``, ``x_m``, ``y_m``), ``radius_m`` if not 200.

    Raises:
        UsageError: the file is missing.
        SchemaError: with the feature or line and the key at fault.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise UsageError("missing", file=path, expected="a GeoJSON or CSV file of ROIs") from error
    except OSError as error:
        raise UsageError(
            f"cannot be read: {error.strerror}", file=path, expected="a GeoJSON or CSV file of ROIs"
        ) from error
    except UnicodeDecodeError as error:
        raise SchemaError("not text", file=path, expected="a GeoJSON or CSV file of ROIs") from error
    if text.lstrip().startswith("{"):
        rois = _from_geojson(text, path)
    else:
        rows = csv.DictReader(text.splitlines())
        rois = [_roi(row, path, f"line {number}") for number, row in enumerate(rows, start=2)]
    if not rois:
        raise SchemaError("no ROI in it", file=path, expected="at least one point")
    _refuse_repeated(rois, path)
    return rois


def parse_roi(text: str) -> Roi:
    """Parse a ROI from the command line: ``lon,lat[,radius_m[,scene_id]]``.

    Raises:
        UsageError: not of that form, or off the globe.
    """
    parts = [part.strip() for part in text.split(",")]
    expected = "lon,lat[,radius_m[,scene_id]] in degrees and metres, longitude first"
    if not 2 <= len(parts) <= 4:
        raise UsageError(f"{text!r} is not a ROI", place="--roi", expected=expected)
    try:
        lon, lat = float(parts[0]), float(parts[1])
    except ValueError as error:
        raise UsageError(f"{text!r} is not a ROI", place="--roi", expected=expected) from error
    if not -180.0 <= lon <= 180.0:
        raise UsageError(
            f"longitude {parts[0]}", place=f"--roi {text}", expected="-180 to 180 degrees, longitude first"
        )
    values: dict[str, object] = {"longitude_deg": lon, "latitude_deg": lat}
    if len(parts) > 2:
        values["radius_m"] = parts[2]
    values["scene_id"] = parts[3] if len(parts) > 3 else f"roi_{_degrees(lon)}_{_degrees(lat)}"
    try:
        return _roi(values, Path("--roi"), text)
    except SchemaError as error:
        raise UsageError(
            error.problem, place=f"--roi {text}", expected=error.expected or expected, remedy=error.remedy
        ) from error


def write_rois(path: Path, rois: Iterable[Roi], generator: str | None = None) -> None:
    """Write ``rois.geojson``, sorted by id, atomically.

    Args:
        path: the file.
        rois: the regions.
        generator: command that the file names as its writer; None: it names none.
    """
    features = []
    for roi in sorted(rois, key=lambda roi: roi.scene_id):
        geometry = None
        if roi.frame is None:
            geometry = {"type": "Point", "coordinates": [roi.longitude_deg, roi.latitude_deg]}
        features.append(
            {"type": "Feature", "geometry": geometry, "properties": roi.model_dump(mode="json", exclude_none=True)}
        )
    named = {} if generator is None else {"generator": generator}
    document = {"type": "FeatureCollection", **named, "features": features}
    write_bytes(path, (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode())


def merge_rois(present: Sequence[Roi], given: Sequence[Roi], file: Path) -> list[Roi]:
    """Return the dataset's ROIs with new ones added.

    Raises:
        DatasetError: an id is there already with another centre or radius.
    """
    known = {roi.scene_id: roi for roi in present}
    for roi in given:
        if known.setdefault(roi.scene_id, roi) != roi:
            raise DatasetError(
                f"scene {roi.scene_id} is there already with another centre, radius or description",
                file=file,
                expected=known[roi.scene_id].model_dump_json(exclude_none=True),
                remedy="give the new ROI another id, or ingest into a new folder",
            )
    return sorted(known.values(), key=lambda roi: roi.scene_id)


def refuse_swapped_coordinates(rois: Sequence[Roi], longitude_deg: float, latitude_deg: float) -> None:
    """Refuse ROIs that are far from the driven places, but near them with longitude and latitude exchanged.

    Args:
        rois: geodetic ones are looked at.
        longitude_deg: somewhere on the drive.
        latitude_deg: somewhere on the drive.

    Raises:
        UsageError: naming the ROI and its exchanged coordinates.
    """
    for roi in rois:
        if roi.longitude_deg is None or roi.latitude_deg is None or abs(roi.longitude_deg) > 90.0:
            continue
        away = float(surface_distance_m(longitude_deg, latitude_deg, roi.longitude_deg, roi.latitude_deg))
        exchanged = float(surface_distance_m(longitude_deg, latitude_deg, roi.latitude_deg, roi.longitude_deg))
        if away > _FAR_M and exchanged < _NEAR_M:
            raise UsageError(
                f"longitude {roi.longitude_deg} and latitude {roi.latitude_deg} look exchanged: the drive is"
                f" {away / 1000:.0f} km away, but {exchanged / 1000:.1f} km from the exchanged point",
                place=f"ROI {roi.scene_id}",
                expected="longitude first, then latitude",
                remedy=f"give {roi.latitude_deg},{roi.longitude_deg}",
            )


def _degrees(value: float) -> str:
    return f"{value:.5f}".replace("-", "m").replace(".", "d")


def _from_geojson(text: str, path: Path) -> list[Roi]:
    try:
        document = decode_json(text)
    except JsonError as error:
        raise SchemaError(str(error), file=path, place=error.place) from error
    features = document.get("features") if isinstance(document, dict) else None
    if not isinstance(features, list) or document.get("type") != "FeatureCollection":
        raise SchemaError("not a GeoJSON FeatureCollection", file=path, expected='{"type": "FeatureCollection", ...}')
    rois = []
    for number, feature in enumerate(features):
        place = f"feature {number}"
        if not isinstance(feature, dict) or not isinstance(feature.get("properties") or {}, dict):
            raise SchemaError("not a GeoJSON feature", file=path, place=place)
        values = dict(feature.get("properties") or {})
        geometry = feature.get("geometry")
        if geometry is not None:
            point = geometry.get("coordinates") if isinstance(geometry, dict) else None
            if not isinstance(geometry, dict) or geometry.get("type") != "Point" or not isinstance(point, list):
                raise SchemaError(
                    "a ROI is a circle round a point", file=path, place=place, expected="a Point geometry"
                )
            values.setdefault("longitude_deg", point[0] if point else None)
            values.setdefault("latitude_deg", point[1] if len(point) > 1 else None)
        rois.append(_roi(values, path, place))
    return rois


def _roi(values: dict[str, object], path: Path, place: str) -> Roi:
    plain = {_ALIASES.get(key, key): value for key, value in values.items() if key and value not in (None, "")}
    lat = plain.get("latitude_deg")
    try:
        wrong = lat is not None and not math.fabs(float(str(lat))) <= 90.0
    except ValueError:
        wrong = False
    if wrong:
        raise SchemaError(
            f"latitude {lat} is off the globe",
            file=path,
            place=place,
            expected="-90 to 90 degrees, longitude before latitude",
            remedy="exchange longitude and latitude if they are swapped",
        )
    try:
        return Roi.model_validate({key: value for key, value in plain.items() if key in Roi.model_fields})
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        expected = "scene_id, longitude_deg, latitude_deg, radius_m"
        if not key or first["type"] == "missing":
            problem = f"{key or 'ROI'}: {describe_problem(first)}"
            raise SchemaError(problem, file=path, place=place, expected=expected) from error
        raise SchemaError(
            f"{key} {first['input']}", file=path, place=place, expected=describe_expected(first)
        ) from error


def _refuse_repeated(rois: Sequence[Roi], path: Path) -> None:
    seen: set[str] = set()
    for roi in rois:
        if roi.scene_id in seen:
            raise SchemaError("the id stands twice", file=path, place=f"scene {roi.scene_id}", expected="one ROI an id")
        seen.add(roi.scene_id)
