"""Distance of two images between a network's unit-length features, weighted by learned heads (Zhang et al., 2018)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from mirror.arrays import AnyArray, Bool, Float32
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.metrics.inputs import ImageLayout, Pixels, as_array, as_image
from mirror.metrics.networks.state import load_strictly
from mirror.metrics.networks.trunk import Trunk
from mirror.metrics.score import EMPTY_MASK, Score
from mirror.weights.resolve import ResolvedWeights

Masked = Literal["map", "zero-fill"]

_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
_ROWS = 16
_RESERVED = ("lpips", "st_lpips", "st-lpips")


class ClampWarning(UserWarning):
    """An image had values outside of 0 to 1; they were clamped."""


class PerceptualDistance:
    """A trunk and its heads, ready to compare.

    Args:
        name: what figures are called. The names of published metrics are only for their published weights.
        trunk: filled.
        heads: for every tap the weights of its channels, (channels,).
        weights: the files that trunk and heads came from.
        device: where the network runs, as torch names it.

    Attributes:
        name: as given.
        weights: hash of every file, by name.
        compared: pairs that went through the network.
        skipped: pairs of equal bytes, whose distance is 0 without it.
        clamped: values outside of 0 to 1 so far.

    Raises:
        UsageError: a published name with other weights, or heads that do not fit.
    """

    def __init__(
        self,
        name: str,
        trunk: Trunk,
        heads: Sequence[Tensor],
        weights: Sequence[ResolvedWeights] = (),
        device: str = CPU,
    ) -> None:
        if name.startswith(_RESERVED) and not (weights and all(file.pinned for file in weights)):
            raise UsageError(
                f"a network called {name!r} without its published weights", remedy="give it a name of its own"
            )
        if tuple(head.numel() for head in heads) != trunk.channels:
            raise UsageError(f"heads of {[head.numel() for head in heads]} channels", expected=str(trunk.channels))
        self.name = name
        self.weights: Mapping[str, str] = {file.name: file.sha256 for file in weights}
        self.compared = self.skipped = self.clamped = 0
        self._device = device
        self._trunk = trunk.to(memory_format=torch.channels_last).to(device)  # type: ignore[call-overload]
        self._heads = [head.detach().reshape(1, -1, 1, 1).clone().to(device) for head in heads]

    def __call__(
        self,
        renders: Sequence[Pixels],
        truth: Pixels,
        mask: Pixels | None = None,
        masked: Masked = "map",
        *,
        layout: ImageLayout | None = None,
    ) -> list[Score]:
        """Distance of every render from one truth, whose features are computed once for all.

        Args:
            renders: images (h, w, 3), or as ``layout`` says; arrays or torch tensors on the CPU: uint8, or floats from
                0 to 1.
            truth: of the same shape.
            mask: (h, w), true where pixels count; None: everywhere.
            masked: ``map``: the mean of the distance map over the mask, with the caveat that features see beyond it;
                ``zero-fill``: both images black outside of it and the mean over the whole frame, as MTGS has it: its
                value shrinks with the mask.
            layout: ``hwc`` or ``chw``; None: arrays (h, w, 3).

        Returns:
            One score each; NaN with a reason where the mask is empty.

        Raises:
            UsageError: shapes differ, an image is too small, of another type or not finite.
        """
        if masked not in ("map", "zero-fill"):
            raise UsageError(f"masked is {masked!r}", expected="'map' or 'zero-fill'")
        images = [as_image(truth, "truth", layout), *(as_image(render, "render", layout) for render in renders)]
        counted = None if mask is None else as_array(mask, "mask")
        self._check(images, counted)
        if counted is not None and not counted.any():
            return [EMPTY_MASK] * len(renders)
        different = [at for at, image in enumerate(images[1:]) if not _equal(image, images[0])]
        scores = [Score(0.0)] * len(renders)
        self.skipped += len(renders) - len(different)
        if different:
            chosen = [self._to_unit(images[at]) for at in (0, *(at + 1 for at in different))]
            values = self._distances(np.stack(chosen), counted, masked)
            self.compared += len(different)
            for at, value in zip(different, values):
                scores[at] = Score(value)
        return scores

    def _check(self, images: Sequence[AnyArray], mask: Bool | None) -> None:
        shape = images[0].shape
        if len(shape) != 3 or shape[2] != 3 or min(shape[:2]) < self._trunk.minimum:
            least = self._trunk.minimum
            raise UsageError(f"an image of shape {shape}", expected=f"(h, w, 3) with h and w of {least} or more")
        for image in images:
            if image.shape != shape:
                raise UsageError(f"an image of shape {image.shape} beside one of {shape}")
        if mask is not None and (mask.shape != shape[:2] or mask.dtype != np.bool_):
            raise UsageError(f"a mask of {mask.dtype} and shape {mask.shape}", expected=f"bool, {shape[:2]}")

    def _to_unit(self, image: AnyArray) -> Float32:
        """Float32 from 0 to 1; what lies outside is clamped and counted."""
        if image.dtype == np.uint8:
            scaled: Float32 = image.astype(np.float32) / np.float32(255.0)
            return scaled
        if image.dtype.kind != "f":
            raise UsageError(f"an image of type {image.dtype}", expected="uint8, or floats from 0 to 1")
        if not np.isfinite(image).all():
            raise UsageError(f"{int((~np.isfinite(image)).sum())} values of an image are NaN or infinite")
        outside = int(((image < 0.0) | (image > 1.0)).sum())
        if outside:
            self.clamped += outside
            warnings.warn(f"{outside} values outside of 0 to 1 were clamped", ClampWarning, stacklevel=3)
        return np.clip(image, 0.0, 1.0).astype(np.float32)

    def _distances(self, images: Float32, mask: Bool | None, masked: Masked) -> list[float]:
        if mask is not None and masked == "zero-fill":
            images = images * mask[:, :, None].astype(np.float32)
            mask = None
        with torch.inference_mode():
            batch = torch.from_numpy(images).to(self._device).permute(0, 3, 1, 2)
            shift, scale = (
                torch.tensor(values, device=self._device).reshape(1, 3, 1, 1) for values in (_SHIFT, _SCALE)
            )
            batch = (2.0 * batch - 1.0 - shift) / scale
            maps = self._maps(batch)
            if mask is None:
                return sum(map_.double().mean(dim=(1, 2)) for map_ in maps).tolist()  # type: ignore[union-attr]
            height, width = mask.shape
            wide = sum(
                functional.interpolate(map_[:, None], (height, width), mode="bilinear", align_corners=False)
                for map_ in maps
            )
            chosen = wide[:, 0, torch.from_numpy(mask).to(self._device)]  # type: ignore[index]
            return chosen.double().mean(dim=1).tolist()

    def _maps(self, batch: Tensor) -> list[Tensor]:
        """For every tap the (renders, h', w') distances from the first image."""
        rows: list[list[Tensor]] = [[] for _ in self._heads]
        for tap, features in self._trunk.taps(batch.contiguous(memory_format=torch.channels_last)):
            for part in features.split(_ROWS, dim=2):
                unit = part / (part.square().sum(dim=1, keepdim=True).sqrt_() + 1e-10)
                apart = (unit[1:] - unit[:1]).square_()
                rows[tap].append((apart * self._heads[tap]).sum(dim=1))
        return [torch.cat(parts, dim=1) for parts in rows]


def filled(trunk: Trunk, state: Mapping[str, Tensor], *, unused: tuple[str, ...] = ()) -> Trunk:
    """Return a trunk filled with the weights of a state dict; every key must match."""
    load_strictly(trunk, state, unused=unused)
    return trunk


def _equal(a: AnyArray, b: AnyArray) -> bool:
    return a.dtype == b.dtype and np.array_equal(a, b)
