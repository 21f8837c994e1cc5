"""The views of a scene that all models render, and their exact truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from benchmarks.studies.static_reconstruction.declaration import Declaration
from benchmarks.studies.static_reconstruction.scenes import open_scenes, protocol_at
from benchmarks.studies.static_reconstruction.truth.street import StreetTruth
from mirror.protocols.views import plan_views
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True, eq=False)
class TruthRequest:
    """Views of a scene and their exact truth.

    Attributes:
        plan: views of training and of held-out traversals.
        street: exact truth of the views.
    """

    plan: Plan
    street: StreetTruth

    def views(self, group: str) -> list[RenderView]:
        """Return all scored views of a group."""
        return [view for view in self.plan.views if view.group == group]


@lru_cache(4)
def request_truth(folder: Path, declaration: Declaration, scene: str, split: str, width_px: int) -> TruthRequest:
    """Return the views and truth of a scene; the same object for all models of a scene, split and width."""
    dataset = open_scenes(folder)
    plan = plan_views(dataset.where(scene=scene), protocol_at(declaration, width_px), split)
    return TruthRequest(plan, StreetTruth(dataset, plan, declaration.preset, declaration.scenes_seed))
