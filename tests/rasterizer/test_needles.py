"""Images and gradients of needles without a blur, on the CPU against the reference in float64."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.reference.rounding_marks import find_rounding_marks

WIDTH, HEIGHT, FOCAL = 160, 96, 120.0
TRAINED = ("means", "quats", "scales", "opacities", "colors", "viewmats")


def needles(aspect: float, width_px: float, count: int = 60) -> dict[str, Any]:
    """Gaussians of a width in the image, and so many times as long."""
    random = torch.Generator().manual_seed(0)
    depth = 2.0 + 4.0 * torch.rand(count, generator=random)
    across = (torch.rand(count, 2, generator=random) - 0.5) * torch.tensor([1.2, 0.8])
    scales = torch.exp(torch.rand(count, 3, generator=random) - 0.5) * (width_px / FOCAL) * depth[:, None]
    scales[:, 0] *= aspect
    return {
        "means": torch.cat([across * depth[:, None], depth[:, None]], dim=1),
        "quats": torch.randn(count, 4, generator=random),
        "scales": scales,
        "opacities": 0.2 + 0.6 * torch.rand(count, generator=random),
        "colors": torch.rand(count, 3, generator=random),
        "viewmats": torch.eye(4)[None],
        "Ks": torch.tensor([[[FOCAL, 0.0, 80.0], [0.0, FOCAL, 48.0], [0.0, 0.0, 1.0]]]),
        "width": WIDTH,
        "height": HEIGHT,
    }


def compared(scene: dict[str, Any], **options: Any) -> tuple[float, dict[str, float]]:
    """Greatest difference of the images, and relative ones of the gradients, where rounding decides nothing."""
    images: list[Tensor] = []
    gradients: list[dict[str, Tensor]] = []
    clear = torch.ones(HEIGHT, WIDTH, dtype=torch.bool)
    for backend in ("reference", "cpu"):
        trained = {name: scene[name].clone().requires_grad_() for name in TRAINED}
        image, _, meta = rasterization(**scene | trained, backend=backend, **options)
        if backend == "reference":
            (view,) = meta["blending"].views
            marks = find_rounding_marks(
                view.projected, view.opacities, WIDTH, HEIGHT, preset=meta["blending"].preset, tile_size=16
            )
            clear = ~marks.marked
        weights = torch.rand(image.shape, generator=torch.Generator().manual_seed(5)) * clear[..., None]
        (image * weights.to(image.dtype)).sum().backward()
        images.append(image.detach()[0][clear].double())
        gradients.append({name: tensor.grad.double() for name, tensor in trained.items() if tensor.grad is not None})
    assert clear.double().mean() > 0.95
    truth, ours = gradients
    assert truth.keys() == ours.keys() == set(TRAINED)
    wrong = {name: float((ours[name] - true).norm() / true.norm()) for name, true in truth.items()}
    return float((images[1] - images[0]).abs().max()), wrong


@pytest.mark.parametrize("eps2d", [0.0, 0.3])
@pytest.mark.parametrize("aspect", [1.0, 100.0, 1e4])
def test_needles_a_pixel_wide_are_as_exact_as_round_gaussians(aspect: float, eps2d: float) -> None:
    image, gradients = compared(needles(aspect, 1.0), eps2d=eps2d)
    assert image < 1e-6
    assert max(gradients.values()) < 3e-6, gradients


def test_needles_a_pixel_wide_are_as_exact_through_a_lens() -> None:
    # shorter ones: the unscented transform wraps what is as long as the scene
    image, gradients = compared(needles(100.0, 1.0), eps2d=0.0, with_ut=True)
    assert image < 1e-6
    assert max(gradients.values()) < 3e-6, gradients


@pytest.mark.parametrize(("aspect", "width_px"), [(100.0, 0.36), (1e3, 0.036), (1e4, 0.0036)])
def test_what_is_thinner_than_a_pixel_loses_digits_by_its_width(aspect: float, width_px: float) -> None:
    image, gradients = compared(needles(aspect, width_px), eps2d=0.0)
    assert image < 1e-6 / width_px
    assert max(gradients.values()) < 1e-6 / width_px, gradients
