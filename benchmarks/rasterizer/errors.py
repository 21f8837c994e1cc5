"""Errors of the CPU backend against the float64 reference, with pixels that float32 rounding may decide marked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.rasterizer.views import View, with_threads
from benchmarks.report import OUT
from hybridworldsim.rasterizer import reference
from hybridworldsim.rasterizer.reference.rounding_marks import RoundingMarks, find_rounding_marks
from mirror.arrays import Float64

_FELT = 1e-7  # of the largest: less is no gradient


@dataclass(frozen=True, eq=False)
class Truth:
    """A view rendered by the reference.

    Attributes:
        image: (H, W, channels) colours, float64.
        depth: (H, W) metres, float64.
        alpha: (H, W) float64.
        marks: pixels that rounding may decide.
        gradients: gradients by input, of a loss without marked pixels; empty if not requested.
    """

    image: Tensor
    depth: Tensor
    alpha: Tensor
    marks: RoundingMarks
    gradients: Mapping[str, Tensor]


@dataclass(frozen=True)
class ImageErrors:
    """Largest difference of a pixel's colours and alpha, over some pixels.

    Attributes:
        unmarked: the largest over unmarked pixels.
        worst: the largest over all pixels.
        all_999: 99.9 % of all pixels have a smaller difference.
        beyond_flips: the largest over marked pixels, minus what a flipped decision can change.
        marked_percent: share of marked pixels.
        depth: 99.9 % of pixels have a smaller difference, relative to their depth.
    """

    unmarked: float
    worst: float
    all_999: float
    beyond_flips: float
    marked_percent: float
    depth: float


@dataclass(frozen=True)
class GradientErrors:
    """Relative differences of one input's gradient.

    Attributes:
        norm: of the whole tensor.
        median: of single Gaussians that have a gradient; rotating a sphere, for instance, has none.
        percentile_99: of the same Gaussians.
    """

    norm: float
    median: float
    percentile_99: float


def truth(view: View, *, gradients: bool) -> Truth:
    """Render a view by the slow reference; the result is cached until the reference or the scene changes."""
    kept = OUT / "rasterizer" / f"{_cache_key(view)}{'_gradients' if gradients else ''}.pt"
    if kept.is_file():
        image, depth, alpha, marked, jump, found = torch.load(kept, weights_only=True)
        return Truth(image, depth, alpha, RoundingMarks(marked, jump), found)
    with with_threads(1):  # the reference's many small steps only wait for each other
        true = render_truth(view, gradients)
    kept.parent.mkdir(parents=True, exist_ok=True)
    torch.save((true.image, true.depth, true.alpha, *true.marks, true.gradients), kept)
    return true


def render_truth(view: View, gradients: bool) -> Truth:
    """Render a view by the float64 reference, with gradients if requested."""
    tensors = view.tensors(torch.float64, gradients=gradients)
    with torch.set_grad_enabled(gradients):
        image, alphas, meta = view.render(tensors, "reference")
    blending = meta["blending"]
    seen = blending.views[0]
    marks = find_rounding_marks(
        seen.projected, seen.opacities, view.width, view.height, preset=blending.preset, tile_size=blending.tile_size
    )
    found = _gradients(view, tensors, image, alphas, marks) if gradients else {}
    return Truth(image[0, ..., :-1].detach(), image[0, ..., -1].detach(), alphas[0, ..., 0].detach(), marks, found)


def compute_image_errors(view: View, true: Truth) -> ImageErrors:
    """Return the errors of the image of the CPU backend."""
    with torch.no_grad():
        image, alphas, _ = view.render(view.tensors())
    colors = (image[0, ..., :-1].double() - true.image).abs().amax(-1)
    distance: Float64 = colors.maximum((alphas[0, ..., 0].double() - true.alpha).abs()).numpy()
    depth: Float64 = ((image[0, ..., -1].double() - true.depth).abs() / true.depth.clamp_min(0.1)).numpy()
    marked = true.marks.marked.numpy()
    clear, doubtful = distance[~marked], (distance - true.marks.jump.numpy())[marked]
    return ImageErrors(
        unmarked=float(clear.max(initial=0.0)),
        worst=float(distance.max()),
        all_999=_quantile(distance, 0.999),
        beyond_flips=float(doubtful.max(initial=0.0)),
        marked_percent=100.0 * float(marked.mean()),
        depth=_quantile(depth, 0.999),
    )


def compute_gradient_errors(view: View, true: Truth) -> dict[str, GradientErrors]:
    """Return the errors of the CPU backend's gradients, by input."""
    tensors = view.tensors(gradients=True)
    image, alphas, _ = view.render(tensors)
    found = _gradients(view, tensors, image, alphas, true.marks)
    errors = {}
    for name, expected in true.gradients.items():
        distance = (found[name].double() - expected).reshape(len(expected), -1).norm(dim=1).numpy()
        length = expected.reshape(len(expected), -1).norm(dim=1).numpy()
        felt = length > _FELT * length.max()
        single = distance[felt] / length[felt]
        errors[name] = GradientErrors(
            norm=float(np.linalg.norm(distance) / np.linalg.norm(length)),
            median=_quantile(single, 0.5),
            percentile_99=_quantile(single, 0.99),
        )
    return errors


def _cache_key(view: View) -> str:
    """Hash of the reference's inputs and of its source."""
    given = (
        view.scene.digest,
        view.width,
        view.height,
        view.channels,
        view.spherical_harmonics,
        sorted(view.options.items()),
    )
    sources = sorted(Path(reference.__file__).parent.glob("*.py"))
    return sha256(repr(given).encode() + b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]


def _gradients(
    view: View, tensors: Mapping[str, Tensor], image: Tensor, alphas: Tensor, marks: RoundingMarks
) -> dict[str, Tensor]:
    clear = (~marks.marked)[None, ..., None]
    weights = [(weight * clear).to(image.dtype) for weight in view.weights]
    found = torch.autograd.grad([image, alphas], list(tensors.values()), weights)
    return dict(zip(tensors, found))


def _quantile(values: Float64, share: float) -> float:
    return float(np.quantile(values, share)) if len(values.ravel()) else 0.0
