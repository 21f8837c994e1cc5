"""What is asked of all models of a scene, and what is exactly known of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from benchmarks.studies.static_reconstruction.data import narrowed, opened
from benchmarks.studies.static_reconstruction.declared import Declared
from benchmarks.studies.static_reconstruction.truth.street import StreetTruth
from mirror.protocols.views import plan_views
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import View


@dataclass(frozen=True, eq=False)
class Asked:
    """Views of a scene, and their truth.

    Attributes:
        plan: views of training and of held-out traversals.
        street: what is exactly known.
    """

    plan: Plan
    street: StreetTruth

    def views(self, group: str) -> list[View]:
        """Those of a group: all that is scored."""
        return [view for view in self.plan.views if view.group == group]


@lru_cache(4)
def asked(folder: Path, declaration: Declared, scene: str, split: str, width_px: int) -> Asked:
    """The same for all models of a scene, split and width."""
    dataset = opened(folder)
    plan = plan_views(dataset.where(scene=scene), narrowed(declaration, width_px), split)
    return Asked(plan, StreetTruth(dataset, plan, declaration.preset, declaration.scenes_seed))
