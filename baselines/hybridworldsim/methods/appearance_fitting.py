"""Fits appearances to the part of held-out images that the protocol allows and then does not score."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch

from hybridworldsim.model.blocks import Block, select_views
from hybridworldsim.model.losses import colour_loss
from hybridworldsim.model.street import StreetModel
from hybridworldsim.trainable.viewpoint import Source
from hybridworldsim.training.appearance import AppearanceSelector
from hybridworldsim.training.data_loader import TrainingImageCache
from hybridworldsim.training.documents import Run, TrainedCamera
from mirror.errors import UsageError
from mirror.methods.appearance import AppearancePolicy
from mirror.protocols.rectangle import Rectangle
from mirror.protocols.views.view import RenderView

_STEPS: Final = 60
_RATE: Final = 0.05
_MAX_IMAGES: Final = 8


def fit_appearances(
    street: StreetModel, block: Block, run: Run, appearance: AppearancePolicy
) -> tuple[TrainedCamera, ...]:
    """Add latents to a street for untrained traversals and cameras that see the street.

    Each latent begins as the nearest trained one; nothing else is optimised.

    Args:
        street: receives the latents.
        block: block of the street.
        run: run that trained the street.
        appearance: policy with the truth that may be read.

    Returns:
        Cameras that were trained on or fitted.

    Raises:
        UsageError: the policy has no truth, or the protocol lets no appearance be fitted.
    """
    if appearance.truth is None:
        raise UsageError(
            "there are no held-out images to fit to", place="--appearance fit", expected="--split and --protocol"
        )
    dataset, plan = appearance.truth
    part = plan.protocol.fitted_part
    if part is None:
        raise UsageError(
            f"protocol {plan.protocol.name} lets no appearance be fitted",
            place="--appearance fit",
            expected="a protocol with a fitted part",
        )
    # A moved camera does not see what was recorded.
    moved_groups = {group.name for group in plan.protocol.groups if group.ego_shift_m}
    trained = run.sources
    images = TrainingImageCache(dataset, plan, np.array(block.origin_m))
    known = {Source(camera.traversal_id, camera.camera) for camera in trained}
    selector = AppearanceSelector(trained, "nearest", appearance.views)
    by_source: dict[Source, list[RenderView]] = {}
    for view in select_views(
        block, [view for view in plan.views if view.scene_id == run.scene and view.group not in moved_groups]
    ):
        source = Source(view.traversal_id, view.camera)
        if source not in known:
            by_source.setdefault(source, []).append(view)
    fitted_cameras = []
    for source, source_views in by_source.items():
        chosen = np.unique(
            np.linspace(0, len(source_views) - 1, min(len(source_views), _MAX_IMAGES)).round().astype(int)
        )
        nearest = selector.select(source_views[0]).content
        latent = _fit_latent(street, nearest, images, [source_views[place] for place in chosen], part)
        street.appearance.add(source, latent)
        template = next(camera for camera in trained if (camera.traversal_id, camera.camera) == nearest)
        fitted_cameras.append(
            template.model_copy(update={"traversal_id": source.traversal_id, "camera": source.camera})
        )
    return (*trained, *fitted_cameras)


def _fit_latent(
    street: StreetModel, nearest: Source, images: TrainingImageCache, views: list[RenderView], part: Rectangle
) -> torch.Tensor:
    latent = street.appearance(nearest).detach().clone().requires_grad_()
    adam = torch.optim.Adam([latent], lr=_RATE)
    for step in range(_STEPS):
        image = images(views[step % len(views)])
        fitted = torch.zeros_like(image.scored)
        fitted[part.inside(*fitted.shape)] = True
        fitted &= image.scored
        if not fitted.any():
            continue
        output = street(image.viewpoint, latent)
        (gradient,) = torch.autograd.grad(colour_loss(output.rgb, image.rgb, fitted), latent)
        latent.grad = gradient
        adam.param_groups[0]["lr"] = _RATE * (1.0 - step / _STEPS)
        adam.step()
    return latent.detach()
