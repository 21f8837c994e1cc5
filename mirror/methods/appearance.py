"""The appearance policy: which appearance the renders of untrained traversals and cameras get."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mirror.dataset.dataset import Dataset
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView


@dataclass(frozen=True)
class AppearancePolicy:
    """Chooses the appearance of renders of traversals and cameras that a method was not trained on.

    Attributes:
        policy: ``nearest``, ``mean``, ``fit``, a traversal, a word of light or weather, or ``sweep:A:B``.
        views: all views that will be rendered, so that a policy can compare complete driven lines.
        everywhere: whether the policy also applies to trained traversals, which edits their light.
        truth: only for ``fit``: the dataset and plan that give the images; only the protocol's fitted part is read.
    """

    policy: str = "nearest"
    views: Sequence[RenderView] = ()
    everywhere: bool = False
    truth: tuple[Dataset, Plan] | None = None
