"""Running a query: select the row groups and rows that pass, and read only the requested columns.

Where a table has a timestamp, a place or a camera, each row is filtered by it. Where it has not, the rows of the
traversals that pass are taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from mirror.arrays import Bool, Float64
from mirror.dataset.index.geoparquet import line_points
from mirror.dataset.query.arrow import floats_or_nan, is_member, to_arrow_mask, to_arrow_rows, to_numpy
from mirror.dataset.query.catalog import GLOBAL, TABLES, Catalog, RowGroups
from mirror.dataset.query.filters import Circle, Filters, LocalCircle
from mirror.geometry.geodesy import geodetic_to_ecef, mean_radius_m

_BY_TRAVERSAL = {
    "scene": "scene_id",
    "traversal": "traversal_id",
    "drive": "drive_id",
    "vehicle": "vehicle_id",
    "light": "light",
    "weather": "weather",
}
_PLACE = ("longitude_deg", "latitude_deg")
_BY_PASS = {key: column for key, column in _BY_TRAVERSAL.items() if key not in ("traversal", "vehicle")}


@dataclass(frozen=True, eq=False)
class RowGroupPart:
    """Rows of one row group.

    Attributes:
        path: file of the row group.
        number: position of the row group in the file.
        traversal: row of its traversal in the table of traversals.
        rows: number of rows that pass.
        mask: which rows pass; None: all.
    """

    path: str
    number: int
    traversal: int
    rows: int
    mask: Bool | None


def read_rows(catalog: Catalog, filters: Filters, name: str, columns: Sequence[str]) -> pa.Table:
    """Read the rows of a table that pass, in the table's order."""
    catalog = _narrowed(catalog, filters, name)
    schema = pa.schema([TABLES[name].schema.field(column) for column in columns])
    if name in GLOBAL:
        return catalog.read_global(name, columns).filter(to_arrow_mask(_global_mask(catalog, filters, name)))
    chunks: list[list[pa.Array]] = [[] for _ in columns]
    for part in select_parts(catalog, filters, name):
        passing = None if part.mask is None else to_arrow_mask(part.mask)
        for column, array in zip(chunks, catalog.columns.read(part.path, part.number, columns)):
            column.append(array if passing is None else array.filter(passing))
    arrays = [pa.chunked_array(column, field.type) for column, field in zip(chunks, schema)]
    return pa.Table.from_arrays(arrays, schema=schema).unify_dictionaries()


def count_rows(catalog: Catalog, filters: Filters, name: str) -> int:
    """Count the rows of a table that pass; row groups that pass as a whole are not read."""
    catalog = _narrowed(catalog, filters, name)
    if name in GLOBAL:
        return int(_global_mask(catalog, filters, name).sum())
    return sum(part.rows for part in select_parts(catalog, filters, name))


def _narrowed(catalog: Catalog, filters: Filters, name: str) -> Catalog:
    """The catalog of the segments that may have the rows."""
    # Scenes count the traversals of all segments, and passes may be refused, of which manifests say nothing.
    return catalog if name in ("scenes", "passes") else catalog.narrow(filters)


def select_parts(catalog: Catalog, filters: Filters, name: str) -> Iterator[RowGroupPart]:
    """Yield the row groups that contain rows which pass the filters."""
    schema = TABLES[name].schema
    stamped, placed = "timestamp_ns" in schema.names, "longitude_deg" in schema.names
    groups = catalog.row_groups(name)
    keep = traversal_mask(catalog, filters, time=not stamped, place=not placed)[groups.traversal]
    cut = np.zeros(len(keep), np.bool_)
    if stamped and filters.time is not None:
        start, end = filters.time
        keep &= (groups.end_ns >= start) & (groups.start_ns < end)
        cut = (groups.start_ns < start) | (groups.end_ns >= end)
    edges = []
    for circle in filters.within if placed else ():
        touched, covered = _box_tests(groups, circle)
        keep &= touched
        edges.append((circle, touched & ~covered))
    cameras = filters.camera if "camera" in schema.names else None
    for group in np.flatnonzero(keep).tolist():
        path, number = groups.path[group], int(groups.number[group])
        masks = []
        if cut[group] and filters.time is not None:
            (stamps,) = catalog.columns.read(path, number, ["timestamp_ns"])
            values = to_numpy(stamps)
            masks.append((values >= filters.time[0]) & (values < filters.time[1]))
        if cameras is not None:
            masks.append(is_member(catalog.columns.read(path, number, ["camera"])[0], cameras))
        if filters.withheld is not None and name in ("images", "frames"):
            masks.append(_withheld_mask(catalog, filters, name, int(groups.traversal[group]), (path, number)))
        masks += [_inside(catalog, (path, number), circle, schema.names) for circle, edge in edges if edge[group]]
        passing = np.logical_and.reduce(masks) if masks else None
        total = int(groups.rows[group])
        passed = total if passing is None else int(np.count_nonzero(passing))
        if passed:
            yield RowGroupPart(path, number, int(groups.traversal[group]), passed, None if passed == total else passing)


def _withheld_mask(catalog: Catalog, filters: Filters, name: str, traversal: int, part: tuple[str, int]) -> Bool:
    """Mask of the images, or of the frames, that the filter of withheld images keeps.

    A frame is withheld if one of its images is, of the cameras of the view.
    """
    chosen = filters.withheld if filters.withheld is not None else frozenset((True, False))
    of_images = part if name == "images" else catalog.group_of("images", traversal)
    if of_images is None:
        return np.full(len(catalog.columns.read(*part, ["frame_index"])[0]), False in chosen)
    uri, camera, frame = catalog.columns.read(*of_images, ["uri", "camera", "frame_index"])
    withheld = is_member(uri, catalog.withheld)
    if name == "frames":
        own = withheld if filters.camera is None else withheld & is_member(camera, filters.camera)
        (frames,) = catalog.columns.read(*part, ["frame_index"])
        listed = frame.filter(to_arrow_mask(own)).drop_null()
        withheld = np.isin(to_numpy(frames), to_numpy(listed))
    return np.isin(withheld, list(chosen))


def traversal_mask(catalog: Catalog, filters: Filters, *, time: bool = True, place: bool = True) -> Bool:
    """Return the mask of the traversals that pass, in the order of the table of traversals.

    Args:
        catalog: the index.
        filters: the restrictions; a camera restricts no traversal.
        time: apply the filter of time: the interval from entry to exit must overlap it.
        place: apply circles to the driven line, which must have a point in each; False: only its frame must match.
    """
    passing = np.ones(len(catalog.traversal_ids), np.bool_)
    for key, column in _BY_TRAVERSAL.items():
        values = getattr(filters, key)
        if values is not None:
            passing &= is_member(catalog.read_global("traversals", [column]).column(0), values)
    if time and filters.time is not None:
        passing &= _overlaps(catalog, "traversals", filters.time)
    for circle in filters.within:
        passing &= _lines_touch(catalog, circle, passing) if place else _in_frame(catalog, circle)
    return passing


def _global_mask(catalog: Catalog, filters: Filters, name: str) -> Bool:
    if name == "traversals":
        return traversal_mask(catalog, filters)
    chosen = frozenset(catalog.traversal_ids.filter(to_arrow_mask(traversal_mask(catalog, filters))).to_pylist())
    if name == "row_groups":
        return is_member(catalog.read_global(name, ["traversal_id"]).column(0), chosen)
    if name == "scenes":
        return _scene_mask(catalog, filters, chosen)
    return _pass_mask(catalog, filters, chosen)


def _scene_mask(catalog: Catalog, filters: Filters, chosen: frozenset[str]) -> Bool:
    """Mask of the scenes with a traversal that passes. Filters of scenes alone also keep scenes without traversals."""
    scene_ids = catalog.read_global("scenes", ["scene_id"]).column(0)
    if filters == Filters(scene=filters.scene):
        return np.ones(len(scene_ids), np.bool_) if filters.scene is None else is_member(scene_ids, filters.scene)
    traversals = catalog.read_global("traversals", ["scene_id", "traversal_id"])
    passing = traversals.column("scene_id").filter(to_arrow_mask(is_member(traversals.column("traversal_id"), chosen)))
    return is_member(scene_ids, frozenset(passing.to_pylist()))


def _pass_mask(catalog: Catalog, filters: Filters, chosen: frozenset[str]) -> Bool:
    """Mask of the passes that pass by their columns. Filters of vehicle or place keep only accepted passes."""
    columns = catalog.read_global("passes", [*_BY_PASS.values(), "traversal_id"])
    passing = np.ones(columns.num_rows, np.bool_)
    for key, column in _BY_PASS.items():
        values = getattr(filters, key)
        if values is not None:
            passing &= is_member(columns.column(column), values)
    if filters.time is not None:
        passing &= _overlaps(catalog, "passes", filters.time)
    if filters.traversal is not None or filters.vehicle is not None or filters.within:
        passing &= is_member(columns.column("traversal_id"), chosen)
    return passing


def _overlaps(catalog: Catalog, name: str, time: tuple[int, int]) -> Bool:
    ends = catalog.read_global(name, ["entry_ns", "exit_ns"])
    return (to_numpy(ends.column("exit_ns")) >= time[0]) & (to_numpy(ends.column("entry_ns")) < time[1])


def _box_tests(groups: RowGroups, circle: Circle | LocalCircle) -> tuple[Bool, Bool]:
    """Masks of the row groups that may have a row in the circle, and of those that lie entirely in it."""
    if isinstance(circle, Circle):
        boxes = (groups.west, groups.east, groups.south, groups.north)
        return circle.touches(*boxes), circle.covers(*boxes)
    return np.ones(len(groups.path), np.bool_), np.zeros(len(groups.path), np.bool_)


def _inside(catalog: Catalog, part: tuple[str, int], circle: Circle | LocalCircle, names: Sequence[str]) -> Bool:
    columns = _PLACE if isinstance(circle, Circle) else ("x_m", "y_m") if "x_m" in names else ("tx_m", "ty_m")
    first, second = catalog.columns.read(*part, columns)
    return circle.contains(floats_or_nan(first), floats_or_nan(second))


def _in_frame(catalog: Catalog, circle: Circle | LocalCircle) -> Bool:
    """Mask of the traversals of scenes in the circle's frame."""
    scenes = catalog.read_global("scenes", ["scene_id", "frame"])
    frame = circle.frame if isinstance(circle, LocalCircle) else None
    same = frozenset(row["scene_id"] for row in scenes.to_pylist() if row["frame"] == frame)
    return is_member(catalog.read_global("traversals", ["scene_id"]).column(0), same)


def _lines_touch(catalog: Catalog, circle: Circle | LocalCircle, among: Bool) -> Bool:
    """Mask of those among some traversals with a point of their driven line (local frame: a pose) in the circle."""
    passing = among & _in_frame(catalog, circle)
    if isinstance(circle, LocalCircle):
        ids = frozenset(catalog.traversal_ids.filter(to_arrow_mask(passing)).to_pylist())
        hits = select_parts(catalog, Filters(traversal=ids, within=(circle,)), "ego_poses")
        return np.isin(np.arange(len(passing)), [part.traversal for part in hits])
    (boxes,) = catalog.read_global("traversals", ["bbox"]).column(0).chunks
    west, south, east, north = (floats_or_nan(part) for part in boxes.flatten())
    passing &= circle.touches(west, east, south, north)
    candidates = np.flatnonzero(passing)
    if len(candidates):
        lines = catalog.read_global("traversals", ["geometry"]).column(0).take(to_arrow_rows(candidates))
        passing[candidates] = [
            _line_distance_m(line_points(wkb), circle) <= circle.radius_m for wkb in lines.to_pylist()
        ]
    return passing


def _line_distance_m(points: Float64, circle: Circle) -> float:
    """Smallest distance in metres of a line (N, 2) of longitudes and latitudes from the circle's centre.

    Segments are straight in space; the middle of a 100 m segment lies 0.2 mm below the surface.
    """
    xyz = geodetic_to_ecef(points[:, 0], points[:, 1]) - geodetic_to_ecef(circle.longitude_deg, circle.latitude_deg)
    start, step = xyz[:-1], np.diff(xyz, axis=0)
    squared = np.maximum(np.einsum("ij,ij->i", step, step), np.finfo(np.float64).tiny)
    share = np.clip(-np.einsum("ij,ij->i", start, step) / squared, 0.0, 1.0)
    chord = float(np.sqrt(np.min(np.sum((start + share[:, None] * step) ** 2, axis=1))))
    radius = float(mean_radius_m(circle.latitude_deg))
    return 2.0 * radius * float(np.arcsin(min(chord / (2.0 * radius), 1.0)))
