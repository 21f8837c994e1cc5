"""Safety of rollouts: the values of each one from its state log, and the means over scenarios."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from mirror.errors import MirrorError
from mirror.evaluation.figures import MIN_BLOCKS, TOO_FEW_BLOCKS, compute_figures
from mirror.evaluation.result import GroupFigure
from mirror.evaluation.scorers.scorer import Values
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.safety import StateLog, read_state_log, score_rollout
from mirror.metrics.score import Score
from mirror.protocols.document import Protocol
from mirror.protocols.metrics import DrivableArea, LeastTtc
from mirror.protocols.views.view import RenderView
from mirror.schema.road_map import RoadMap, read_road_map
from mirror.schema.rollout import BY_POLICY, MAP_FILE, SCENARIO_FILE, STATES_FILE, Rollout
from mirror.schema.scenario import Scenario, read_scenario

_DRIVING_SCORES: Final = ("epdms", "pdms")
"""Scores of a drive as a whole, which a suite states for drives that the policy ends."""

_MAPS_HELD: Final = 4
TOO_FEW_SCENARIOS: Final = f"fewer than {MIN_BLOCKS} scenarios"


@dataclass(frozen=True)
class ScoredRollout:
    """One rollout with its values.

    Attributes:
        path: its folder, relative to the evaluated one.
        rollout: its document.
        scenario: its scenario.
        has_fitted_map: whether its road map was fitted to driven lines.
        values: values of the protocol's metrics; None: there is none.
        reasons: why values are missing, by metric.
        causes: who caused the events, by metric.
    """

    path: str
    rollout: Rollout
    scenario: Scenario
    has_fitted_map: bool
    values: Values
    reasons: dict[str, str]
    causes: dict[str, str]


def score_folder(folder: Path, path: str, rollout: Rollout, protocol: Protocol) -> ScoredRollout:
    """Score one rollout by the files of its folder; see `score_drive`.

    Raises:
        DatasetError: a file is missing.
        SchemaError: a file does not follow its schema.
    """
    log, scenario = read_state_log(folder / STATES_FILE), read_scenario(folder / SCENARIO_FILE)
    return score_drive(log, _read_map(folder / MAP_FILE), scenario, path, rollout, protocol)


def _read_map(file: Path) -> RoadMap:
    """Read a map; the last few are held by their bytes, which the drives of a suite on one street share."""
    try:
        return _decode_map(file.read_bytes())
    except (OSError, MirrorError):
        # Raises again, with the path of the file.
        return read_road_map(file)


@lru_cache(maxsize=_MAPS_HELD)
def _decode_map(data: bytes) -> RoadMap:
    return read_road_map(MAP_FILE, data=data)


def score_drive(
    log: StateLog, road_map: RoadMap, scenario: Scenario, path: str, rollout: Rollout, protocol: Protocol
) -> ScoredRollout:
    """Score one rollout.

    Progress counts as complete at the distance that the scenario's speed (or else the ego's speed at the start of the
    log) covers in the scenario's duration, or at the end of the route if that comes earlier. The least time to
    collision is at most its horizon.

    Args:
        log: its states.
        road_map: the map.
        scenario: the scenario.
        path: its folder, relative to the evaluated one.
        rollout: its document, which states the route.
        protocol: the protocol.
    """
    speed_mps = scenario.ego.speed_mps or math.hypot(log.vx_mps[0, 0], log.vy_mps[0, 0])
    horizon_s = next((metric.horizon_s for metric in protocol.metrics if isinstance(metric, LeastTtc)), 3.0)
    tolerance_m = next((metric.tolerance_m for metric in protocol.metrics if isinstance(metric, DrivableArea)), 0.0)
    report = score_rollout(
        log,
        road_map,
        rollout.route_m,
        reference_m=speed_mps * scenario.duration_s,
        horizon_s=horizon_s,
        tolerance_m=tolerance_m,
    )
    figures = {name: report.figures[name] for name in protocol.metric_names}
    values = {name: float(figure.value) if figure.is_valid else None for name, figure in figures.items()}
    least = values.get("least_ttc")
    if least is not None:
        values["least_ttc"] = min(least, horizon_s)
    if protocol.suite is not None and rollout.ending in BY_POLICY:
        values |= {name: protocol.suite.failed for name in _DRIVING_SCORES if name in values}
    reasons = {name: figure.reason for name, figure in figures.items() if figure.reason is not None}
    causes = {name: figure.cause for name, figure in figures.items() if figure.cause is not None}
    return ScoredRollout(path, rollout, scenario, road_map.fitted, values, reasons, causes)


def rollout_view(scored: ScoredRollout, group: str) -> RenderView:
    """Return the keys of a rollout in the table of values.

    Its scenario takes the place of a traversal; the fault of its sensors, or else its world, that of a camera.
    """
    return RenderView.model_construct(
        path=scored.path,
        group=group,
        scene_id=scored.rollout.scene_id,
        traversal_id=scored.rollout.scenario,
        frame_index=scored.rollout.seed,
        camera=scored.rollout.sensors or scored.rollout.world,
        timestamp_ns=0,
        light=scored.scenario.light,
        weather=scored.scenario.weather,
    )


def rollout_figures(protocol: Protocol, scored: Sequence[ScoredRollout]) -> Iterator[GroupFigure]:
    """Compute the means of all rollouts, and those of each scene, scenario, world and condition."""
    group = protocol.groups[0].name
    views = [rollout_view(one, group) for one in scored]
    for name in protocol.metric_names:
        scores = [
            Score(math.nan if (value := one.values[name]) is None else float(value), one.reasons.get(name))
            for one in scored
        ]
        for figure in compute_figures(protocol, MEASURES[name], group, views, scores):
            # What is resampled are scenarios, not blocks of frames.
            few = figure.interval_reason == TOO_FEW_BLOCKS
            yield figure.model_copy(update={"interval_reason": TOO_FEW_SCENARIOS}) if few else figure
