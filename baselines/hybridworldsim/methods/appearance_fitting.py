"""Looks that are fitted to a declared part of held-out images, which is not scored: their left half."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch

from hybridworldsim.model.blocks import Block, select_views
from hybridworldsim.model.losses import colour_loss
from hybridworldsim.model.street import Street
from hybridworldsim.training.appearance import AppearanceSelector
from hybridworldsim.training.data_loader import TrainingImageCache
from hybridworldsim.training.run.folder import Run, TrainedCamera
from hybridworldsim.training.viewpoint import Source
from mirror.errors import UsageError
from mirror.methods.appearance import FITTED_PART, AppearancePolicy
from mirror.protocols.views.view import RenderView

_STEPS: Final = 60
_RATE: Final = 0.05
_MOST_PICTURES: Final = 8


def fit_appearances(street: Street, block: Block, run: Run, appearance: AppearancePolicy) -> tuple[TrainedCamera, ...]:
    """Add a latent to a street for each traversal and camera of its scene that sees it and that it was not trained on.

    Each begins with the nearest trained one; nothing but the latent is learnt.

    Args:
        street: gets the latents.
        block: where it is.
        run: what it was trained on.
        appearance: with the truth that may be looked at.

    Returns:
        What was trained on or fitted.

    Raises:
        UsageError: there is no truth to look at.
    """
    if appearance.truth is None:
        raise UsageError(
            "there are no held-out images to fit to", place="--appearance fit", expected="--split and --protocol"
        )
    dataset, plan = appearance.truth
    # What was recorded is not what a camera sees that was moved.
    moved = {group.name for group in plan.protocol.groups if group.ego_shift_m}
    seen = run.sources
    images = TrainingImageCache(dataset, plan, np.array(block.origin_m))
    known = {Source(one.traversal_id, one.camera) for one in seen}
    looks = AppearanceSelector(seen, "nearest", appearance.views)
    by_source: dict[Source, list[RenderView]] = {}
    for view in select_views(
        block, [view for view in plan.views if view.scene_id == run.scene and view.group not in moved]
    ):
        source = Source(view.traversal_id, view.camera)
        if source not in known:
            by_source.setdefault(source, []).append(view)
    fitted = []
    for source, own in by_source.items():
        chosen = np.unique(np.linspace(0, len(own) - 1, min(len(own), _MOST_PICTURES)).round().astype(int))
        near = looks.select(own[0]).content
        latent = _fitted(street, near, images, [own[place] for place in chosen])
        street.appearance.add(source, latent)
        one = next(one for one in seen if (one.traversal_id, one.camera) == near)
        fitted.append(one.model_copy(update={"traversal_id": source.traversal_id, "camera": source.camera}))
    return (*seen, *fitted)


def _fitted(street: Street, near: Source, images: TrainingImageCache, views: list[RenderView]) -> torch.Tensor:
    latent = street.appearance(near).detach().clone().requires_grad_()
    adam = torch.optim.Adam([latent], lr=_RATE)
    for step in range(_STEPS):
        image = images(views[step % len(views)])
        part = torch.zeros_like(image.scored)
        part[:, : int(FITTED_PART.right * part.shape[1])] = True
        part &= image.scored
        if not part.any():
            continue
        output = street(image.viewpoint, latent)
        (gradient,) = torch.autograd.grad(colour_loss(output.rgb, image.rgb, part), latent)
        latent.grad = gradient
        adam.param_groups[0]["lr"] = _RATE * (1.0 - step / _STEPS)
        adam.step()
    return latent.detach()
