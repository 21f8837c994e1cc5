"""Scores a trained model: each picture of training and of held-out traversals, as the protocol has them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.evaluation.truth.source import TruthSource
from mirror.evaluation.views.plan import Plan
from mirror.evaluation.views.view import View
from mirror.metrics.images.colour_correction import psnr_cc
from mirror.metrics.images.psnr import psnr
from mirror.metrics.images.ssim import ssim


@dataclass(frozen=True)
class Scores:
    """Of one picture."""

    path: str
    group: str
    traversal_id: str
    psnr: float
    psnr_cc: float
    ssim: float


def scores_of(render: Callable[[View], UInt8], plan: Plan, truth: TruthSource, groups: Sequence[str]) -> list[Scores]:
    """Render and score the views of some groups."""
    found = []
    for view in plan.views:
        if view.group not in groups:
            continue
        found.append(scored(view, render(view), truth.picture(view), truth.scored(view)))
    return found


def scored(view: View, picture: UInt8, true: UInt8, mask: Bool) -> Scores:
    """Score a picture (H, W, 3) of a view by what is true of the pixels of a mask (H, W)."""
    return Scores(
        view.path,
        view.group,
        view.traversal_id,
        float(psnr(picture, true, mask=mask)),
        float(psnr_cc(picture, true, mask=mask).db),
        float(ssim(picture, true, mask=mask, preset="gaussian11", mask_mode="map")),
    )


def averaged(scores: Sequence[Scores], group: str) -> dict[str, float]:
    """Means of pictures within traversals, then of traversals, as the protocol has it; NaN is left out."""
    own = [one for one in scores if one.group == group]
    traversals = sorted({one.traversal_id for one in own})
    means = {}
    for metric in ("psnr", "psnr_cc", "ssim"):
        per = [np.nanmean([getattr(one, metric) for one in own if one.traversal_id == key]) for key in traversals]
        means[metric] = float(np.mean(per))
    return means


def plain(scores: Sequence[Scores]) -> list[dict[str, Any]]:
    """As JSON has it."""
    return [asdict(one) for one in scores]
