"""Fréchet and kernel inception distance (Heusel et al., 2017; Bińkowski et al., 2018) of two sets of images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mirror.arrays import AnyArray, Float32, UInt8
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.metrics.features.cache import FeatureCache
from mirror.metrics.features.extractor import checked_name, extract, identity_of_device
from mirror.metrics.features.frechet import FrechetDistance, frechet_distance
from mirror.metrics.features.kid import KernelDistance, kid
from mirror.metrics.inputs import Layout, Pixels, images_of
from mirror.weights.load import load_state_dict
from mirror.weights.resolve import ResolvedWeights, WeightResolver

if TYPE_CHECKING:
    from torch import Tensor

    from mirror.metrics.networks.inception import FidInception
    from mirror.metrics.networks.resize import FidResize

ENOUGH = 2048
_SIDE = 299


@dataclass(frozen=True)
class Fid:
    """A Fréchet inception distance with everything that it depends on.

    Attributes:
        name: ``fid``, or the name of another network.
        frechet: the distance, with error bound, rank and n.
        kernel: the kernel distance of the same features, which is unbiased at any n; None below 4 images.
        mode: how images were resized, ``clean | tf1``.
        weights: hash of the network's file, by name.
        warning: why the figure is not to be compared with others; None if it is.
    """

    name: str
    frechet: FrechetDistance
    kernel: KernelDistance | None
    mode: FidResize
    weights: Mapping[str, str]
    warning: str | None

    @property
    def value(self) -> float:
        """The Fréchet distance."""
        return self.frechet.value


class InceptionFeatures:
    """The network behind FID and KID, with its normalisation folded.

    Args:
        network: filled; it is folded in place.
        mode: ``clean`` resizes as clean-fid does, ``tf1`` as the first FID and torch-fidelity do.
        name: what figures are called; ``fid`` only with the published weights.
        weights: the file that the network came from.
        batch: images at once.
        device: where the network runs, as torch names it; part of the identity, because its sums differ.

    Raises:
        UsageError: a published name with other weights, or no such mode.
    """

    def __init__(
        self,
        network: FidInception,
        mode: FidResize = "clean",
        *,
        name: str,
        weights: Sequence[ResolvedWeights] = (),
        batch: int = 8,
        device: str = CPU,
    ) -> None:
        if mode not in ("clean", "tf1"):
            raise UsageError(f"mode is {mode!r}", expected="'clean' or 'tf1'")
        pinned = bool(weights) and all(file.pinned for file in weights)
        self.name = checked_name(name, ("fid", "kid"), pinned=pinned)
        self.mode: FidResize = mode
        self.weights = {file.name: file.sha256 for file in weights}
        self.identity = f"{name} {mode} {sorted(self.weights.items())}{identity_of_device(device)}"
        self.batch, self.computed = batch, 0
        self._network, self._device = network.fold().to(device), device

    def prepare(self, pixels: UInt8) -> Tensor:
        """Convert one image (h, w, 3) to the network's input (3, 299, 299): (grey - 128) / 128.

        Raises:
            UsageError: another shape.
        """
        import torch

        from mirror.metrics.networks.resize import resize_clean, resize_tf1

        if pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
            raise UsageError(f"an image of shape {pixels.shape}", expected="(h, w, 3)")
        image = torch.from_numpy(np.ascontiguousarray(pixels)).permute(2, 0, 1)[None].float()
        resized = (resize_clean if self.mode == "clean" else resize_tf1)(image, _SIDE)
        return ((resized - 128.0) / 128.0)[0]

    def run(self, prepared: Tensor) -> Float32:
        """Return the features (n, 2048)."""
        import torch

        with torch.inference_mode():
            features: Float32 = (
                self._network(prepared.to(self._device).contiguous(memory_format=torch.channels_last)).cpu().numpy()
            )
        return features


def load_inception(
    mode: FidResize = "clean", resolver: WeightResolver | None = None, device: str = CPU
) -> InceptionFeatures:
    """Return the network behind FID, with its published weights, on a device.

    Raises:
        WeightsUnavailableError: the file is not there or is another one.
    """
    from mirror.metrics.networks.inception import FidInception
    from mirror.metrics.networks.state import load_strictly

    file = (resolver or WeightResolver()).resolve("inception-fid")
    network = FidInception()
    load_strictly(network, load_state_dict(file.path))
    return InceptionFeatures(network, mode, name="fid", weights=[file], device=device)


def fid(
    renders: Iterable[Pixels],
    truth: Iterable[Pixels],
    network: InceptionFeatures,
    *,
    cache: FeatureCache | None = None,
    seed: int = 0,
    layout: Layout | None = None,
) -> Fid:
    """Compute the Fréchet inception distance between renders and photographs.

    Args:
        renders: images (h, w, 3) of any size, or images or batches as ``layout`` says; arrays or torch tensors on the
            CPU, uint8 or floats from 0 to 1; taken one by one.
        truth: likewise.
        network: of `load_inception`.
        cache: of features; truth is computed once for all methods.
        seed: of the kernel distance's subsets.
        layout: of every item, as of `mirror.metrics.images.psnr.psnr`.

    Raises:
        UsageError: fewer than 2 images on a side, or images that do not fit.
    """
    first = extract(network, images_of(renders, "render", layout), cache)
    return fid_of_features(first, extract(network, images_of(truth, "truth", layout), cache), network, seed=seed)


def fid_of_features(renders: AnyArray, truth: AnyArray, network: InceptionFeatures, *, seed: int = 0) -> Fid:
    """Compute `fid` of features (n, 2048) that `extract` gave."""
    distance = frechet_distance(renders, truth)
    fewest = min(distance.n)
    warning = None
    if fewest < ENOUGH:
        warning = (
            f"{fewest} images are fewer than {ENOUGH}: the Fréchet distance is far too large by its bias; compare it "
            "only with figures of the same images, and rather the kernel distance"
        )
    kernel = kid(renders, truth, seed=seed) if fewest >= 4 else None
    return Fid(network.name, distance, kernel, network.mode, network.weights, warning)
