"""A street through a rolling shutter: the rows below are seen last or first, and learning has gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hybridworldsim.trainable.viewpoint import to_viewpoint
from mirror.protocols.views.view import RenderView, RollingDirection, ViewShutter, to_pose
from tests.model.streets import SOURCES, street, view

FIRST, LAST = -25.3, -24.7


def rolling_view(first: float, last: float, direction: RollingDirection = "top_to_bottom") -> RenderView:
    """A view from x = -25 m whose rows are seen from x = first to x = last."""
    ends = {
        name: to_pose((0.5, -0.5, 0.5, -0.5, x, 0.0, 1.5))
        for name, x in (("world_SE3_first", first), ("world_SE3_last", last))
    }
    shutter = ViewShutter(direction=direction, first_ns=-15e6, last_ns=15e6, **ends)
    return view(-25.0).model_copy(update={"shutter": shutter})


@pytest.mark.parametrize("direction", ["top_to_bottom", "bottom_to_top"])
def test_the_ground_before_the_camera_is_seen_at_the_time_of_its_rows(direction: RollingDirection) -> None:
    one = street(seed=3)
    latent = one.appearance(SOURCES[0])
    output = one(to_viewpoint(rolling_view(FIRST, LAST, direction), np.zeros(3)), latent)
    # cameras at rest, through the same path
    rests = [to_viewpoint(rolling_view(x, x), np.zeros(3)) for x in (FIRST, LAST)]
    first, last = (one(rest, latent).rgb.detach()[-8:] for rest in rests)
    near, far = (last, first) if direction == "top_to_bottom" else (first, last)
    rendered = output.rgb.detach()[-8:]
    assert (rendered - near).abs().mean() < 0.3 * (rendered - far).abs().mean()
    output.rgb.sum().backward()
    gradients = [parameter.grad for parameter in one.background.parameters() if parameter.grad is not None]
    assert gradients and all(torch.isfinite(gradient).all() for gradient in gradients)
    assert any(gradient.abs().max() > 0.0 for gradient in gradients)
