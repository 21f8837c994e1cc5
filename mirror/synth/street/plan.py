"""The plan of a scene: roads, ground, and the places of everything else."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
import shapely

from mirror.arrays import Bool, Float64, Records
from mirror.errors import UsageError
from mirror.schema.documents import Roi
from mirror.synth.model import Model, merge_models
from mirror.synth.roads.crossing import CrossedStreet, Crossing
from mirror.synth.roads.ground import build_ground, merge_outlines
from mirror.synth.roads.ground_index import GroundIndex, build_ground_index
from mirror.synth.roads.layouts import build_layouts
from mirror.synth.roads.networks import build_network
from mirror.synth.roads.overbridge import build_overbridge
from mirror.synth.roads.relief import Relief, draw_land, find_level_stretches
from mirror.synth.roads.schemes import BEYOND_M, SCHEMES
from mirror.synth.seeds import derive_hash_seed, random_stream
from mirror.synth.street.frontages import place_lots
from mirror.synth.street.lots import Lot, Rail, Spot
from mirror.synth.street.spots import place_rails, place_spots
from mirror.traffic.lanes.network import Network

_FIELDS_M: Final = 260.0
_FORECOURT_M: Final = 0.4
_LEAST_RADIUS_M: Final = 50.0
_MOST_RADIUS_M: Final = 400.0


@dataclass(frozen=True)
class StreetPlan:
    """The plan of a scene, in its world frame: east, north, up, metres, the origin at the ROI's centre.

    Attributes:
        roi: the region of interest.
        kind: kind of scene.
        yaw_rad: direction of the main street at the ROI's centre, counter-clockwise from east.
        streets: the streets, the main street first.
        crossings: the crossings.
        ground: faces of carriageways, kerbs, pavements and land, and of a bridge if the scene has one.
        layouts: (L, MOST_MARKS) MARK; the ``layout`` of the carriageways' faces is an index into it.
        network: the lanes.
        lots: places for houses.
        spots: places for lamps, trees, signs and lights.
        rails: rails beside the streets.
        ground_index: heights of the ground.
        carriageways: area of the carriageways on the ground plane.
        roads: area of the carriageways with pavements or shoulders, squares and bridges.
        lot_area: area of the lots.
    """

    roi: Roi
    kind: str
    yaw_rad: float
    streets: tuple[CrossedStreet, ...]
    crossings: tuple[Crossing, ...]
    ground: Model
    layouts: Records
    network: Network
    lots: tuple[Lot, ...]
    spots: tuple[Spot, ...]
    rails: tuple[Rail, ...]
    ground_index: GroundIndex
    carriageways: shapely.Geometry
    roads: shapely.Geometry
    lot_area: shapely.Geometry

    def height_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Float64:
        """Return the heights (...,) of the ground at positions; on a kerb's edge, the higher of the two.

        Raises:
            UsageError: a position is outside the ground, or not finite.
        """
        return self.ground_index.height_m(x_m, y_m)

    def is_free(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike, clear_m: float = 0.0) -> Bool:
        """Return whether positions (...,) are open land, at least ``clear_m`` from every road, square and lot."""
        places = shapely.points(np.asarray(x_m, np.float64), np.asarray(y_m, np.float64))
        return np.asarray(
            (shapely.distance(self.roads, places) > clear_m) & (shapely.distance(self.lot_area, places) > clear_m)
        )


def plan_scene(roi: Roi, yaw_deg: float, seed: int) -> StreetPlan:
    """Plan a scene.

    Args:
        roi: the region of interest; its radius sets the extent, its ``scene_type`` the kind (default: urban).
        yaw_deg: direction of the main street at the centre, counter-clockwise from east.
        seed: seed of all random choices.

    Raises:
        UsageError: the ROI's radius is below 50 or above 400 m.
    """
    if not _LEAST_RADIUS_M <= roi.radius_m <= _MOST_RADIUS_M:
        raise UsageError(
            f"a ROI of {roi.radius_m:g} m", place="radius_m", expected=f"{_LEAST_RADIUS_M:g} to {_MOST_RADIUS_M:g} m"
        )
    kind = roi.scene_type or "urban"
    layout_rng, land_rng, lot_rng, spot_rng = (random_stream("plan", seed, 11, part) for part in range(4))
    yaw = math.radians(yaw_deg)
    scheme = SCHEMES[kind](roi.radius_m, yaw, layout_rng)
    feet = scheme.kerb_m > 0.0
    streets, crossings = scheme.streets, scheme.crossings
    layouts = build_layouts(streets, crossings)
    relief = Relief(
        draw_land(land_rng, scheme.slope, scheme.steepest),
        streets,
        tuple(find_level_stretches(street, crossings) for street in streets),
        scheme.kerb_m,
        layouts.dips,
    )
    roads = merge_outlines(streets, layouts.stations, crossings, feet)
    covers = [replace(scheme.pavement, outline=roads.roads), *scheme.covers]
    if scheme.forecourt_m:
        forecourt = roads.roads.buffer(scheme.forecourt_m, join_style="bevel").simplify(_FORECOURT_M)
        covers.append(replace(scheme.pavement, outline=forecourt))
    extent = roi.radius_m + BEYOND_M, roi.radius_m + _FIELDS_M
    ground_seed = derive_hash_seed("ground", seed, public=seed)
    ground = build_ground(
        streets, layouts.stations, roads, relief, layouts.stretches, covers, scheme.parcels, yaw, extent, ground_seed
    )
    ground_index = build_ground_index(ground.triangles)
    surfaces, squares = [ground.model], [cover.outline for cover in scheme.covers]
    if scheme.bridge_m is not None:
        under = streets[0].line.at(scheme.bridge_m)
        bridge = build_overbridge(streets[0], scheme.bridge_m, float(ground_index.height_m(*under)))
        surfaces.append(bridge.model)
        squares.append(bridge.outline)
    road_area = shapely.union_all([roads.roads, *squares])
    lots = place_lots(streets, road_area, kind, ground_index.height_m, lot_rng)
    lot_area = shapely.union_all([lot.outline() for lot in lots])
    for geometry in (road_area, lot_area):
        shapely.prepare(geometry)
    return StreetPlan(
        roi,
        kind,
        yaw,
        streets,
        crossings,
        merge_models(surfaces),
        layouts.table,
        build_network(streets, crossings, feet, ground_index.height_m),
        lots,
        place_spots(streets, crossings, kind, shapely.union_all([roads.carriageway, *squares]), ground_index, spot_rng),
        place_rails(streets, layouts.stations, kind, ground_index),
        ground_index,
        roads.carriageway,
        road_area,
        lot_area,
    )
