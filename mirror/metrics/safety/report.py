"""All figures of a rollout's safety: each has a value, a reason where it has none, and names who caused it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from mirror.arrays import Bool
from mirror.errors import UsageError
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.safety.collisions import Collision, find_collisions
from mirror.metrics.safety.comfort import COMFORT_BOUNDS, LEAST_STAMPS, measure_comfort
from mirror.metrics.safety.drivable_area import NUPLAN_TOLERANCE_M, DrivableAreaCompliance, drivable_area_compliance
from mirror.metrics.safety.driving_score import (
    DrivingScore,
    collision_factor,
    combine_factors,
    direction_factor,
    lane_keeping_factor,
    progress_factor,
)
from mirror.metrics.safety.lanes import (
    LanePositions,
    RedLight,
    driven_while,
    find_red_lights,
    lanes_of_route,
    locate_on_lanes,
)
from mirror.metrics.safety.presets import (
    collisions_at_stamps,
    navsim_time_to_collision,
    nuplan_time_to_collision,
)
from mirror.metrics.safety.progress import Progress, route_progress
from mirror.metrics.safety.state_log import StateLog
from mirror.metrics.safety.ttc import least_time_to_collision
from mirror.schema.road_map import RoadMap

EGO: Final = "ego"
_NO_MAP: Final = "no road map was given"
_NO_ROUTE: Final = "no route was given"

_TOGETHER: Final = (
    "collisions",
    "at_fault_collisions",
    "impact_speed",
    "least_ttc",
    "ttc_nuplan",
    "ttc_nuplan_within_bound",
    "ttc_navsim_within_bound",
    "drivable_area",
    "drivable_margin",
    "off_road",
    "wrong_lane",
    "red_lights",
    "comfort",
    "progress",
    "progress_share",
    "pdms",
    "epdms",
)
"""The figures that share what they are computed from; the functions of the catalogue compute the others."""

FIGURES: Final[Mapping[str, tuple[str, Literal["higher", "lower"]]]] = {
    name: (MEASURES[name].unit, MEASURES[name].better)
    for name in (
        *_TOGETHER,
        *(name for name, one in MEASURES.items() if one.kind == "rollout" and one.function is not None),
    )
}
"""Names of the figures, each with its unit and which direction is better. docs/safety.md has their formulas."""


@dataclass(frozen=True)
class SafetyFigure:
    """One figure of a rollout.

    Attributes:
        name: one of `FIGURES`.
        value: the value; infinite where nothing happens within the horizon; NaN: there is none.
        reason: why there is no value; None: there is one.
        cause: who caused it: ``ego``, or the id of an agent or a signal; None: nothing happened.
        stamp_ns: when; None: nothing happened, or the figure describes the whole log.
    """

    name: str
    value: float
    reason: str | None = None
    cause: str | None = None
    stamp_ns: int | None = None

    @property
    def is_valid(self) -> bool:
        """Return whether there is a value."""
        return self.reason is None


@dataclass(frozen=True, eq=False)
class SafetyReport:
    """The safety of a rollout.

    Attributes:
        figures: the figures by name, in the order of `FIGURES`.
        collisions: first contacts of the ego with each agent.
        red_lights: stop lines passed at red; empty without a map.
        score: PDMS and EPDMS with their factors; None: they have no value.
    """

    figures: Mapping[str, SafetyFigure]
    collisions: tuple[Collision, ...]
    red_lights: tuple[RedLight, ...]
    score: DrivingScore | None

    def _repr_html_(self) -> str:
        """Return the figures as an HTML table for notebooks."""
        from mirror.pages.notebook import show_rows

        rows = [
            (MEASURES[one.name].title, f"{one.value:.4g}", MEASURES[one.name].unit, one.reason or one.cause or "")
            for one in self.figures.values()
        ]
        return show_rows("Safety", ("figure", "value", "unit", "caused by"), rows)


@dataclass(frozen=True, eq=False)
class _OnMap:
    """The ego on a map."""

    positions: LanePositions
    area: DrivableAreaCompliance
    off_road: Bool
    between_lanes: Bool


def score_rollout(
    log: StateLog,
    road_map: RoadMap | None = None,
    route_m: npt.ArrayLike | None = None,
    *,
    reference_m: float | None = None,
    horizon_s: float = 3.0,
    tolerance_m: float = NUPLAN_TOLERANCE_M,
) -> SafetyReport:
    """Compute all safety figures of a log of states.

    Args:
        log: states of the ego, the agents and the signals.
        road_map: the map, in the frame of the log; None: figures that need one have no value.
        route_m: (K, 2) the ego's route; None: figures that need one have no value.
        reference_m: progress that counts as complete, at most the length of the route ahead; None: that length.
        horizon_s: horizon of the least time to collision.
        tolerance_m: how far outside the drivable area a corner may be.

    Raises:
        UsageError: the horizon, the tolerance or the route is invalid.
    """
    on_map = None if road_map is None else _locate(log, road_map, tolerance_m)
    collisions = find_collisions(log, between_lanes=None if on_map is None else on_map.between_lanes)
    figures = [*_collision_figures(collisions), _least_ttc(log, horizon_s)]
    red_lights: tuple[RedLight, ...] = ()
    no_signals: str | None = None
    if road_map is not None and on_map is not None:
        figures += _preset_figures(log, on_map)
        figures += _area_figures(log, on_map)
        try:
            red_lights = find_red_lights(log, road_map, on_map.positions)
        except UsageError as error:
            no_signals = error.problem
    else:
        names = ("ttc_nuplan", "ttc_nuplan_within_bound", "ttc_navsim_within_bound", "drivable_area")
        figures += [_missing(name, _NO_MAP) for name in (*names, "drivable_margin", "off_road", "wrong_lane")]
        no_signals = _NO_MAP
    figures.append(_red_light_figure(red_lights, no_signals))
    figures.append(_comfort_figure(log))
    progress = None if route_m is None else route_progress(log, route_m)
    share, progress_figures = _progress_figures(progress, reference_m)
    figures += progress_figures
    by_name = {figure.name: figure for figure in figures}
    score: DrivingScore | None = None
    needed = (by_name[name].reason for name in ("red_lights", "comfort", "progress"))
    lacking = next((reason for reason in needed if reason is not None), None)
    if road_map is not None and on_map is not None and progress is not None and route_m is not None and lacking is None:
        score = _driving_score(log, road_map, on_map, np.asarray(route_m, np.float64), progress, share, by_name)
    for name in ("pdms", "epdms"):
        if score is None:
            by_name[name] = _missing(name, lacking or _NO_MAP)
        else:
            by_name[name] = SafetyFigure(name, getattr(score, name))
    for name in FIGURES:
        if name not in _TOGETHER:
            by_name[name] = MEASURES[name].load()(log, road_map, route_m)
    return SafetyReport({name: by_name[name] for name in FIGURES}, collisions, red_lights, score)


def _locate(log: StateLog, road_map: RoadMap, tolerance_m: float) -> _OnMap:
    positions = locate_on_lanes(log, road_map)
    area = drivable_area_compliance(log, road_map.drivable_rings, tolerance_m=tolerance_m)
    off_road = area.margin_m < 0.0
    return _OnMap(positions, area, off_road, positions.between_lanes | off_road)


def _missing(name: str, reason: str) -> SafetyFigure:
    return SafetyFigure(name, math.nan, reason)


def _collision_figures(collisions: tuple[Collision, ...]) -> list[SafetyFigure]:
    def first(which: Callable[[Collision], bool]) -> tuple[str | None, int | None]:
        found = next((one for one in collisions if which(one)), None)
        return (None, None) if found is None else (found.agent, found.stamp_ns)

    figures = [SafetyFigure("collisions", len(collisions), None, *first(lambda one: True))]
    at_fault = [one for one in collisions if one.is_at_fault]
    if any(one.is_at_fault is None for one in collisions):
        figures.append(
            _missing("at_fault_collisions", f"the fault of a lateral collision depends on the lanes: {_NO_MAP}")
        )
    else:
        figures.append(
            SafetyFigure("at_fault_collisions", len(at_fault), None, *first(lambda one: bool(one.is_at_fault)))
        )
    worst = max(collisions, key=lambda one: one.impact_speed_mps, default=None)
    figures.append(
        SafetyFigure("impact_speed", 0.0)
        if worst is None
        else SafetyFigure("impact_speed", worst.impact_speed_mps, None, worst.agent, worst.stamp_ns)
    )
    return figures


def _least_ttc(log: StateLog, horizon_s: float) -> SafetyFigure:
    least = least_time_to_collision(log, horizon_s=horizon_s)
    return SafetyFigure("least_ttc", least.value_s, None, least.agent, least.stamp_ns)


def _preset_figures(log: StateLog, on_map: _OnMap) -> list[SafetyFigure]:
    lanes = {"between_lanes": on_map.between_lanes, "in_junction": on_map.positions.in_junction}
    nuplan, navsim = nuplan_time_to_collision(log, **lanes), navsim_time_to_collision(log, **lanes)
    return [
        SafetyFigure("ttc_nuplan", nuplan.least_s, None, nuplan.agent, nuplan.stamp_ns),
        SafetyFigure("ttc_nuplan_within_bound", float(nuplan.is_within_bound), None, nuplan.agent, nuplan.stamp_ns),
        SafetyFigure("ttc_navsim_within_bound", float(navsim.is_within_bound), None, navsim.agent, navsim.stamp_ns),
    ]


def _area_figures(log: StateLog, on_map: _OnMap) -> list[SafetyFigure]:
    area, positions = on_map.area, on_map.positions

    def distance(name: str, holds: Bool) -> SafetyFigure:
        if not holds.any():
            return SafetyFigure(name, 0.0)
        return SafetyFigure(name, driven_while(log, holds), None, EGO, int(log.stamps_ns[np.argmax(holds)]))

    outside = None if area.is_compliant else EGO
    return [
        SafetyFigure("drivable_area", float(area.is_compliant), None, outside, area.stamp_ns if outside else None),
        SafetyFigure("drivable_margin", area.least_margin_m, None, EGO, area.stamp_ns),
        distance("off_road", on_map.off_road),
        distance("wrong_lane", positions.is_oncoming),
    ]


def _red_light_figure(red_lights: tuple[RedLight, ...], reason: str | None) -> SafetyFigure:
    if reason is not None:
        return _missing("red_lights", reason)
    if not red_lights:
        return SafetyFigure("red_lights", 0.0)
    return SafetyFigure("red_lights", len(red_lights), None, EGO, red_lights[0].stamp_ns)


def _comfort_figure(log: StateLog) -> SafetyFigure:
    if len(log.stamps_ns) < LEAST_STAMPS:
        return _missing("comfort", f"{len(log.stamps_ns)} stamps; at least {LEAST_STAMPS} are needed")
    found = measure_comfort(log, COMFORT_BOUNDS)
    return SafetyFigure(
        "comfort", float(found.is_comfortable), None, None if found.is_comfortable else EGO, found.stamp_ns
    )


def _progress_figures(progress: Progress | None, reference_m: float | None) -> tuple[float, list[SafetyFigure]]:
    if progress is None:
        return math.nan, [_missing("progress", _NO_ROUTE), _missing("progress_share", _NO_ROUTE)]
    reference = progress.route_ahead_m if reference_m is None else min(reference_m, progress.route_ahead_m)
    share = progress_factor(progress.progress_m, reference)
    return share, [SafetyFigure("progress", progress.progress_m), SafetyFigure("progress_share", share)]


def _driving_score(
    log: StateLog,
    road_map: RoadMap,
    on_map: _OnMap,
    route_m: npt.NDArray[np.float64],
    progress: Progress,
    share: float,
    figures: Mapping[str, SafetyFigure],
) -> DrivingScore:
    positions = on_map.positions
    on_route = ~np.isnan(positions.center_offset_m) & lanes_of_route(route_m, road_map)
    off_route = ~np.any(on_route, axis=1) & ~positions.in_junction
    # NAVSIM tolerates no corner outside, unlike nuPlan, and looks at the stamps only.
    return combine_factors(
        no_collision=collision_factor(collisions_at_stamps(log, on_map.between_lanes)),
        drivable_area=float(not on_map.off_road.any()),
        driving_direction=direction_factor(log, off_route),
        traffic_lights=float(figures["red_lights"].value == 0.0),
        progress=share,
        time_to_collision=figures["ttc_navsim_within_bound"].value,
        lane_keeping=lane_keeping_factor(log, progress, positions),
        comfort=figures["comfort"].value,
    )
