"""How far the CPU backend is from the float64 reference, and what the reference knows to be undecidable in float32."""

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
    """A view by the reference.

    Attributes:
        image: (H, W, channels) colours, float64.
        depth: (H, W) metres, float64.
        alpha: (H, W) float64.
        marks: where rounding may decide.
        gradients: by input; of a loss that leaves marked pixels out; empty if not asked for.
    """

    picture: Tensor
    depth: Tensor
    alpha: Tensor
    marks: RoundingMarks
    gradients: Mapping[str, Tensor]


@dataclass(frozen=True)
class PictureErrors:
    """Largest difference of a pixel's colours and alpha, over some pixels.

    Attributes:
        unmarked: the largest, outside marks.
        worst: the largest of all.
        all_999: 99.9 % of all pixels are better.
        beyond_flips: the largest of marked pixels, less what a flip there can do.
        marked_percent: of pixels.
        depth: 99.9 % of pixels are better, relative to their depth.
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
        median: of single Gaussians that have a gradient; turning a sphere, for one, changes nothing.
        percentile_99: of the same.
    """

    norm: float
    median: float
    percentile_99: float


def truth(view: View, *, gradients: bool) -> Truth:
    """Render a view by the reference, which takes minutes: what it gave is kept until it or the scene changes."""
    kept = OUT / "rasterizer" / f"{_key(view)}{'_gradients' if gradients else ''}.pt"
    if kept.is_file():
        picture, depth, alpha, marked, jump, found = torch.load(kept, weights_only=True)
        return Truth(picture, depth, alpha, RoundingMarks(marked, jump), found)
    with with_threads(1):  # the reference's many small steps only wait for each other
        true = render_truth(view, gradients)
    kept.parent.mkdir(parents=True, exist_ok=True)
    torch.save((true.picture, true.depth, true.alpha, *true.marks, true.gradients), kept)
    return true


def render_truth(view: View, gradients: bool) -> Truth:
    """Render a view by the float64 reference, with gradients if they are asked for."""
    tensors = view.tensors(torch.float64, gradients=gradients)
    with torch.set_grad_enabled(gradients):
        picture, alphas, meta = view.render(tensors, "reference")
    blending = meta["blending"]
    seen = blending.views[0]
    marks = find_rounding_marks(
        seen.projected, seen.opacities, view.width, view.height, preset=blending.preset, tile_size=blending.tile_size
    )
    found = _gradients(view, tensors, picture, alphas, marks) if gradients else {}
    return Truth(picture[0, ..., :-1].detach(), picture[0, ..., -1].detach(), alphas[0, ..., 0].detach(), marks, found)


def picture_errors(view: View, true: Truth) -> PictureErrors:
    """Errors of what the CPU backend renders."""
    with torch.no_grad():
        picture, alphas, _ = view.render(view.tensors())
    colors = (picture[0, ..., :-1].double() - true.picture).abs().amax(-1)
    apart: Float64 = colors.maximum((alphas[0, ..., 0].double() - true.alpha).abs()).numpy()
    depth: Float64 = ((picture[0, ..., -1].double() - true.depth).abs() / true.depth.clamp_min(0.1)).numpy()
    marked = true.marks.marked.numpy()
    clear, doubtful = apart[~marked], (apart - true.marks.jump.numpy())[marked]
    return PictureErrors(
        unmarked=float(clear.max(initial=0.0)),
        worst=float(apart.max()),
        all_999=_quantile(apart, 0.999),
        beyond_flips=float(doubtful.max(initial=0.0)),
        marked_percent=100.0 * float(marked.mean()),
        depth=_quantile(depth, 0.999),
    )


def gradient_errors(view: View, true: Truth) -> dict[str, GradientErrors]:
    """Errors of the CPU backend's gradients, by input."""
    tensors = view.tensors(gradients=True)
    picture, alphas, _ = view.render(tensors)
    found = _gradients(view, tensors, picture, alphas, true.marks)
    errors = {}
    for name, wanted in true.gradients.items():
        apart = (found[name].double() - wanted).reshape(len(wanted), -1).norm(dim=1).numpy()
        length = wanted.reshape(len(wanted), -1).norm(dim=1).numpy()
        felt = length > _FELT * length.max()
        single = apart[felt] / length[felt]
        errors[name] = GradientErrors(
            norm=float(np.linalg.norm(apart) / np.linalg.norm(length)),
            median=_quantile(single, 0.5),
            percentile_99=_quantile(single, 0.99),
        )
    return errors


def _key(view: View) -> str:
    """Of what the reference is given, and of its source."""
    given = (view.scene.digest, view.width, view.height, view.channels, view.harmonics, sorted(view.options.items()))
    sources = sorted(Path(reference.__file__).parent.glob("*.py"))
    return sha256(repr(given).encode() + b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]


def _gradients(
    view: View, tensors: Mapping[str, Tensor], picture: Tensor, alphas: Tensor, marks: RoundingMarks
) -> dict[str, Tensor]:
    clear = (~marks.marked)[None, ..., None]
    weights = [(weight * clear).to(picture.dtype) for weight in view.weights]
    found = torch.autograd.grad([picture, alphas], list(tensors.values()), weights)
    return dict(zip(tensors, found))


def _quantile(values: Float64, share: float) -> float:
    return float(np.quantile(values, share)) if len(values.ravel()) else 0.0
