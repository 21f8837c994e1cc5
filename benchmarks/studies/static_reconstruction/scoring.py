"""Score a trained model on the images of training and of held-out traversals, as the protocol defines it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mirror.arrays import Bool, UInt8
from mirror.metrics.features.perceptual import PerceptualDistance
from mirror.metrics.features.st_lpips import st_lpips
from mirror.metrics.images.colour_correction import psnr_cc
from mirror.metrics.images.psnr import psnr
from mirror.metrics.images.ssim import ssim
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

_PERCEIVED = 40
"""ST-LPIPS takes half a second an image: about so many images of a group get it, evenly chosen."""


@dataclass(frozen=True)
class Scores:
    """Scores of one image; `st_lpips` is None where it was not computed."""

    path: str
    group: str
    traversal_id: str
    psnr: float
    psnr_cc: float
    ssim: float
    st_lpips: float | None = None


def score_views(
    render: Callable[[RenderView], UInt8],
    plan: Plan,
    truth: GroundTruth,
    groups: Sequence[str],
    network: PerceptualDistance | None = None,
) -> list[Scores]:
    """Render and score the views of groups; some views of each group by ST-LPIPS too, if its network is given."""
    found = []
    for group in groups:
        views = [view for view in plan.views if view.group == group]
        every = max(len(views) // _PERCEIVED, 1)
        for place, view in enumerate(views):
            perceived = None if place % every else network
            found.append(score_image(view, render(view), truth.image(view), truth.scored_mask(view), perceived))
    return found


def score_image(
    view: RenderView, image: UInt8, true: UInt8, mask: Bool, network: PerceptualDistance | None = None
) -> Scores:
    """Score an image (H, W, 3) of a view against the true one (H, W, 3), over the pixels of a mask (H, W)."""
    return Scores(
        view.path,
        view.group,
        view.traversal_id,
        float(psnr(image, true, mask=mask)),
        float(psnr_cc(image, true, mask=mask).db),
        float(ssim(image, true, mask=mask, preset="gaussian11", mask_mode="map")),
        None if network is None else float(st_lpips(image, true, network, mask=mask)),
    )


def average_scores(scores: Sequence[Scores], group: str) -> dict[str, float]:
    """Return means over images within traversals, then over traversals, as the protocol defines it; NaN is left out."""
    own = [one for one in scores if one.group == group]
    traversals = sorted({one.traversal_id for one in own})
    means = {}
    for metric in ("psnr", "psnr_cc", "ssim", "st_lpips"):
        values = [(one.traversal_id, value) for one in own if (value := getattr(one, metric)) is not None]
        if not values:
            continue
        per = [np.nanmean([value for traversal, value in values if traversal == key]) for key in traversals]
        means[metric] = float(np.mean(per))
    return means


def scores_as_json(scores: Sequence[Scores]) -> list[dict[str, Any]]:
    """Return the scores as JSON objects."""
    return [asdict(one) for one in scores]
