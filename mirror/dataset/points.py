"""Points of the static scene from the layers of traversals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float32, Float64, Int64, UInt8
from mirror.dataset.query.arrow import floats_or_nan, to_arrow_mask, to_numpy
from mirror.dataset.query.catalog import Catalog
from mirror.dataset.query.filters import Filters
from mirror.dataset.query.select import read_rows, select_parts
from mirror.dataset.traversal import missing_layer_error, rows_of_layer
from mirror.schema.tables import POINTS

_COLUMNS: Final = ("x_m", "y_m", "z_m", "r", "g", "b", "kind", "views", "sigma_m", "source", "source_version")


@dataclass(frozen=True, eq=False)
class Points:
    """N points of the static scene.

    Attributes:
        position_m: (N, 3) in the world frame of their scene.
        rgb: (N, 3) colours.
        kind: (N,) ``ground``, ``background`` or ``far``.
        views: (N,) number of images that agree on each point.
        sigma_m: (N,) standard deviation along the ray; NaN: unknown.
        traversal_id: (N,) traversal of each point's layer.
    """

    position_m: Float64
    rgb: UInt8
    kind: tuple[str, ...]
    views: Int64
    sigma_m: Float32
    traversal_id: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.position_m)


def read_points(catalog: Catalog, filters: Filters, chosen: str | None) -> Points:
    """Read the points of the chosen layer, in the traversals that pass the filters; see `Dataset.points`."""
    if chosen is not None:
        layers = read_rows(catalog, filters, "traversals", ["layers"]).column(0).to_pylist()
        if layers and not any(f"{POINTS.name}/{chosen}" in names for names in layers):
            raise missing_layer_error(POINTS.name, chosen, catalog.store.root)
    ids: list[str] = []
    parts: list[pa.Table] = []
    for part in select_parts(catalog, filters, POINTS.name):
        table = pa.Table.from_arrays(catalog.columns.read(part.path, part.number, _COLUMNS), names=_COLUMNS)
        traversal_id = catalog.traversal_ids[part.traversal].as_py()
        in_layer = rows_of_layer(
            POINTS.name, traversal_id, table.column("source"), table.column("source_version"), chosen
        )
        parts.append(table.filter(to_arrow_mask(in_layer)).drop_columns(["source", "source_version"]))
        ids += [traversal_id] * parts[-1].num_rows
    plain = pa.schema([POINTS.schema.field(name) for name in _COLUMNS[:-2]])
    points = pa.concat_tables([plain.empty_table(), *parts], promote_options="permissive").combine_chunks()
    return Points(
        position_m=np.stack([floats_or_nan(points.column(name)) for name in ("x_m", "y_m", "z_m")], axis=1),
        rgb=np.stack([to_numpy(points.column(name)) for name in ("r", "g", "b")], axis=1).astype(np.uint8),
        kind=tuple(points.column("kind").to_pylist()),
        views=to_numpy(points.column("views")).astype(np.int64),
        sigma_m=floats_or_nan(points.column("sigma_m")).astype(np.float32),
        traversal_id=tuple(ids),
    )
