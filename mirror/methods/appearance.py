"""How images shall look of traversals that a method was not trained on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from mirror.dataset.dataset import Dataset
from mirror.protocols.rectangle import Rectangle
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

FITTED_PART: Final = Rectangle(left=0.0, top=0.0, right=0.5, bottom=1.0)
"""The part of a held-out image that an appearance may be fitted to. It is not scored then."""


@dataclass(frozen=True)
class AppearancePolicy:
    """How pictures shall look of traversals and cameras that were not trained on.

    Attributes:
        policy: ``nearest``, ``mean``, ``fit``, a traversal, a word of light or weather, or ``sweep:A:B``.
        views: all that will be rendered, so that whole lines can be compared.
        everywhere: the policy holds for what was trained on too: the light of a recorded traversal is edited.
        truth: for ``fit`` alone: the dataset and the plan whose pictures may be looked at, in their left half.
    """

    policy: str = "nearest"
    views: Sequence[RenderView] = ()
    everywhere: bool = False
    truth: tuple[Dataset, Plan] | None = None
