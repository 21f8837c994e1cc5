"""The exact road map of a synthetic street."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import shapely

from mirror.schema.road_map import MapArea, MapCrossing, MapLane, MapSignal, RoadMap, SignalState
from mirror.synth.roads.crossing import Crossing
from mirror.synth.roads.layouts import find_approaches
from mirror.synth.street.plan import StreetPlan
from mirror.synth.street.world.world import AMBER_S, READY_S
from mirror.traffic.lanes.network import Lane, Network


def street_map(plan: StreetPlan) -> RoadMap:
    """Export the map of a street: all lanes, the carriageways as drivable area, zebra crossings and signals.

    The drivable area reaches from kerb to kerb, parking and cycle lanes and hard shoulders included; on a road without
    kerbs it ends at the edge of the carriageway.

    Args:
        plan: plan of the scene; of a `World`, its ``plan``.
    """
    network = plan.network
    before: dict[str, list[str]] = {name: [] for name in network.lanes}
    for name, lane in network.lanes.items():
        for successor in lane.successors:
            before[successor].append(name)
    return RoadMap(
        scene_id=plan.roi.scene_id,
        frame=plan.roi.frame,
        fitted=False,
        lanes={name: _export_lane(lane, tuple(before[name])) for name, lane in network.lanes.items()},
        drivable=tuple(_export_areas(plan.carriageways)),
        crossings=tuple(zebra for crossing in plan.crossings for zebra in _export_zebras(crossing)),
        signals=_export_signals(network),
    )


def signal_name(group: int) -> str:
    """Return the id of a signal group in the map."""
    return f"signal-{group}"


def _export_lane(lane: Lane, predecessors: tuple[str, ...]) -> MapLane:
    return MapLane(
        lane_id=lane.lane_id,
        kind=lane.use,
        center_m=np.ascontiguousarray(lane.line, np.float64),
        width_m=np.full(len(lane.line), lane.width_m),
        speed_limit_mps=lane.speed_mps,
        successors=lane.successors,
        predecessors=predecessors,
        left=lane.left,
        right=lane.right,
        stop_m=lane.stop_m,
        signal=None if lane.signal is None else signal_name(lane.signal),
        yields_to=lane.yields_to,
    )


def _export_areas(carriageways: shapely.Geometry) -> Iterator[MapArea]:
    for number, part in enumerate(shapely.get_parts(carriageways)):
        rings = (part.exterior, *part.interiors)
        yield MapArea(f"carriageway-{number}", tuple(shapely.get_coordinates(ring)[:-1] for ring in rings))


def _export_zebras(crossing: Crossing) -> Iterator[MapCrossing]:
    for number, approach in enumerate(find_approaches(crossing)):
        if approach.zebra_m is None:
            continue
        (near, far), half = approach.zebra_m, approach.arm.street.section.half_m
        corners = [approach.arm.at(out, left) for out, left in ((near, -half), (far, -half), (far, half), (near, half))]
        yield MapCrossing(f"{crossing.name}.zebra{number}", np.stack(corners))


def _export_signals(network: Network) -> Mapping[str, MapSignal]:
    signals = {}
    for group, (begin, end) in enumerate(network.green_s.tolist()):
        green_s = end - begin
        red_s = network.cycle_s - green_s - AMBER_S - READY_S
        phases: tuple[tuple[SignalState, float], ...] = (
            ("green", green_s),
            ("amber", AMBER_S),
            ("red", red_s),
            ("red_amber", READY_S),
        )
        signals[signal_name(group)] = MapSignal(signal_name(group), phases, begin)
    return signals
