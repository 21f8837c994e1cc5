"""The routes that vehicles are driven along: through the scene, and those that meet each branch of the trigger."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from mirror.synth.driving import Drive, Stop
from mirror.synth.world import LANE_CENTRE_M, World

Waypoints = list[tuple[float, float]]
_LEAD_M: Final = 24.0


def _along(world: World, speed: float) -> tuple[Waypoints, dict[str, object]]:
    """The whole main street."""
    end = world.roi.radius_m + _LEAD_M
    return [(-end, 0.0), (end, 0.0)], {}


def _back(world: World, speed: float) -> tuple[Waypoints, dict[str, object]]:
    """The whole main street, in the other direction."""
    end = world.roi.radius_m + _LEAD_M
    return [(end, 0.0), (-end, 0.0)], {}


def _turn(world: World, speed: float) -> tuple[Waypoints, dict[str, object]]:
    """In on the main street, right at the crossing, out on the cross street."""
    radius = world.roi.radius_m
    out = math.sqrt(radius**2 - world.cross_m**2) + _LEAD_M
    return [(-radius - _LEAD_M, 0.0), (world.cross_m, 0.0), (world.cross_m, -out)], {"corner_m": 11.0}


def _edge(world: World, speed: float) -> tuple[Waypoints, dict[str, object]]:
    """The street at the edge of the ROI: inside for 8 s."""
    half = math.sqrt(world.roi.radius_m**2 - (world.edge_m + LANE_CENTRE_M) ** 2)
    end = half + 3.0 * speed
    return [(world.edge_m, -end), (world.edge_m, end)], {"speed_mps": 2.0 * half / 8.0}


def _corner(world: World, speed: float) -> tuple[Waypoints, dict[str, object]]:
    """Skims the ROI: along the street at its edge, then away from it."""
    end = math.sqrt(world.roi.radius_m**2 - world.edge_m**2) + 40.0
    return [(world.edge_m, -end), (world.edge_m, 0.0), (world.edge_m - 60.0, 0.0)], {"corner_m": 12.0}


def _still(world: World, speed: float) -> tuple[Waypoints, dict[str, object]]:
    """Stands in the ROI, and then moves up by 14 m."""
    return [(-20.0, 0.0), (-6.0, 0.0)], {"speed_mps": 2.0, "stops": (Stop(0.0, 35.0),)}


def _twice(world: World, speed: float) -> tuple[Waypoints, dict[str, object]]:
    """Out of the ROI, round, and in again."""
    start, turn = world.roi.radius_m - 15.0 * speed, world.roi.radius_m + 30.0
    lane = LANE_CENTRE_M
    points = [(start, -lane), (turn - 16.0, -lane), (turn - 8.0, -4.6), (turn, -4.6)]
    return [*points, *((u, -v) for u, v in reversed(points))], {"corner_m": 4.5, "keep_right_m": 0.0}


def _uturn(world: World, speed: float) -> tuple[Waypoints, dict[str, object]]:
    """Turns round on the edge of the ROI: 2.8 s outside between two short visits."""
    turn = world.roi.radius_m + 2.0
    points = [(turn - 30.0, -4.6), (turn, -4.6)]
    return [*points, *((u, -v) for u, v in reversed(points))], {"corner_m": 4.5, "keep_right_m": 0.0, "speed_mps": 5.0}


ROUTES: Final[dict[str, Callable[[World, float], tuple[Waypoints, dict[str, object]]]]] = {
    "along": _along,
    "back": _back,
    "turn": _turn,
    "edge": _edge,
    "corner": _corner,
    "still": _still,
    "twice": _twice,
    "uturn": _uturn,
}


def drive_along(world: World, route: str, speed_mps: float, *, aside_m: float = 0.0, sway: float = 0.0) -> Drive:
    """A drive of a named route.

    Args:
        world: the scene.
        route: one of `ROUTES`.
        speed_mps: cruising speed, where the route does not ask for another.
        aside_m: how far right of the lane's centre this driver keeps.
        sway: phase of the body's motions.
    """
    waypoints, own = ROUTES[route](world, speed_mps)
    values: dict[str, object] = {"speed_mps": speed_mps, "keep_right_m": LANE_CENTRE_M + aside_m, **own}
    return Drive([world.point(u, v) for u, v in waypoints], sway=sway, **values)  # type: ignore[arg-type]
