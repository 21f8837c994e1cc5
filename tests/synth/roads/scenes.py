"""Cached plans that several tests share."""

from __future__ import annotations

from functools import cache

from mirror.schema.documents import Roi
from mirror.synth.street.plan import StreetPlan, plan_scene

KINDS = ("urban", "campus", "rural", "highway")


def roi(kind: str, radius_m: float) -> Roi:
    return Roi(scene_id="scene", frame="local", x_m=0.0, y_m=0.0, radius_m=radius_m, scene_type=kind)


@cache
def plan(kind: str, radius_m: float = 120.0, yaw_deg: float = 24.0, seed: int = 3) -> StreetPlan:
    return plan_scene(roi(kind, radius_m), yaw_deg, seed)
