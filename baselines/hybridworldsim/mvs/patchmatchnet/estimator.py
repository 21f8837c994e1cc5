"""PatchmatchNet as a depth estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import torch
from torch import Tensor

from hybridworldsim.mvs.estimator import DepthMap, StereoImage
from hybridworldsim.mvs.learned.checkpoint import load_public_state_dict
from hybridworldsim.mvs.learned.estimation import InputFormat, MemoryLimit, estimate_depth
from hybridworldsim.mvs.learned.images import SourceImage
from hybridworldsim.mvs.learned.layers import fold_norms
from hybridworldsim.mvs.patchmatchnet.network import STRIDE, PatchmatchNet
from hybridworldsim.mvs.patchmatchnet.stage import LEVELS
from mirror.devices import CPU
from mirror.metrics.networks.state import load_strictly
from mirror.weights.resolve import WeightResolver

NAME: Final = "patchmatchnet"
BYTES_PER_PIXEL: Final = 900
BYTES_PER_SOURCE_PIXEL: Final = 60
_INPUTS: Final = InputFormat(reference_stride=STRIDE, feature_strides=tuple(level.stride for level in LEVELS))


@dataclass(frozen=True, eq=False, kw_only=True)
class PatchmatchNetEstimator:
    """Depth by PatchmatchNet, on any device; its ``repr`` names everything that results depend on.

    Attributes:
        network: the network with its weights and folded normalisations.
        sha256: hash of the checkpoint; None if the weights come from elsewhere.
        seed: seed of the first hypotheses; the generator starts from it for each image.
        threads: torch's number of threads; the same number gives the same bits.
        memory_bytes: images that need more memory are refused.
        device: where the network is, as torch names it; results of a GPU differ in the last digits.
    """

    network: PatchmatchNet = field(repr=False)
    sha256: str | None = None
    seed: int = 0
    threads: int = 1
    memory_bytes: int = field(default=2 << 30, repr=False)
    device: str = field(default=CPU, repr=False)

    @classmethod
    def load(
        cls,
        resolver: WeightResolver | None = None,
        *,
        seed: int = 0,
        threads: int = 1,
        memory_bytes: int = 2 << 30,
        device: str = CPU,
    ) -> PatchmatchNetEstimator:
        """Load the published weights.

        Raises:
            WeightsUnavailableError: the file is missing or has another hash.
        """
        state, sha256 = load_public_state_dict(NAME, resolver or WeightResolver())
        network = PatchmatchNet()
        load_strictly(network, state)
        fold_norms(network)
        network.to(device)
        return cls(network=network, sha256=sha256, seed=seed, threads=threads, memory_bytes=memory_bytes, device=device)

    def __call__(self, reference: StereoImage, sources: Sequence[StereoImage], near_m: float, far_m: float) -> DepthMap:
        """Estimate the depth of an image; see `estimate_depth`.

        The confidence is the probability of four of the last eight hypotheses.

        Raises:
            UsageError: not 0 < near_m < far_m, or images that need too much memory.
        """

        def run_network(rgb: Tensor, source_images: Sequence[SourceImage]) -> tuple[Tensor, Tensor]:
            generator = torch.Generator().manual_seed(self.seed)
            depth_m, confidence = self.network(rgb, source_images, near_m, far_m, generator)
            return depth_m, confidence

        memory = MemoryLimit("PatchmatchNet", BYTES_PER_PIXEL, BYTES_PER_SOURCE_PIXEL, self.memory_bytes)
        return estimate_depth(
            reference, sources, near_m, far_m, inputs=_INPUTS, memory=memory, threads=self.threads,
            run_network=run_network, device=self.device,
        )  # fmt: skip
