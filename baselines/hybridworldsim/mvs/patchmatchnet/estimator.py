"""PatchmatchNet as an estimator of depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import torch

from hybridworldsim.mvs.estimator import DepthMap, PosedPicture
from hybridworldsim.mvs.learned.checkpoint import public_state_dict
from hybridworldsim.mvs.learned.layers import fold_norms
from hybridworldsim.mvs.learned.pictures import (
    hidden_samples,
    inference,
    known_depth,
    network_input,
    require_memory,
    require_range,
    unknown,
    useful_sources,
)
from hybridworldsim.mvs.learned.warping import relative_motion
from hybridworldsim.mvs.patchmatchnet.network import STRIDE, PatchmatchNet, SourcePicture
from hybridworldsim.mvs.patchmatchnet.stage import LEVELS
from mirror.metrics.networks.state import load_strictly
from mirror.weights.resolve import WeightResolver

NAME: Final = "patchmatchnet"
BYTES_PER_PIXEL: Final = 900
BYTES_PER_SOURCE_PIXEL: Final = 60


@dataclass(frozen=True, eq=False, kw_only=True)
class PatchmatchNetEstimator:
    """Depth by PatchmatchNet, on the CPU; its ``repr`` names all that results depend on.

    Attributes:
        network: filled, its normalisations folded.
        sha256: of the checkpoint; None: the network was filled by other means.
        seed: of the first hypotheses, drawn anew for every picture.
        threads: that torch computes on; results are equal to the bit at an equal number.
        memory_bytes: refuse pictures that need more.
    """

    network: PatchmatchNet = field(repr=False)
    sha256: str | None = None
    seed: int = 0
    threads: int = 1
    memory_bytes: int = field(default=2 << 30, repr=False)

    @classmethod
    def load(
        cls,
        resolver: WeightResolver | None = None,
        *,
        seed: int = 0,
        threads: int = 1,
        memory_bytes: int = 2 << 30,
    ) -> PatchmatchNetEstimator:
        """The estimator with the published weights.

        Raises:
            WeightsUnavailableError: they are not there, or are others.
        """
        state, sha256 = public_state_dict(NAME, resolver or WeightResolver())
        network = PatchmatchNet()
        load_strictly(network, state)
        fold_norms(network)
        return cls(network=network, sha256=sha256, seed=seed, threads=threads, memory_bytes=memory_bytes)

    def __call__(
        self, reference: PosedPicture, sources: Sequence[PosedPicture], near_m: float, far_m: float
    ) -> DepthMap:
        """The depth of a picture; confidence is the probability of four of the last eight hypotheses.

        Sources that were taken from the reference's own place tell nothing and are left out; pixels that no source sees
        at their depth are unknown.

        Raises:
            UsageError: no range of depths, or pictures that need too much memory.
        """
        require_range(near_m, far_m)
        used = useful_sources(reference, sources, near_m)
        if not used or not reference.valid.any():
            return unknown(reference)
        height, width = reference.valid.shape
        needed = BYTES_PER_PIXEL * width * height + BYTES_PER_SOURCE_PIXEL * sum(source.valid.size for source in used)
        require_memory(needed, self.memory_bytes, width, height, "PatchmatchNet")
        with inference(self.threads):
            draws = torch.Generator().manual_seed(self.seed)
            pictures = [_source(reference, source) for source in used]
            depth_m, confidence = self.network(network_input(reference, STRIDE), pictures, near_m, far_m, draws)
            return known_depth(reference, used, depth_m, confidence)


def _source(reference: PosedPicture, source: PosedPicture) -> SourcePicture:
    rgb = network_input(source, STRIDE)
    strides = [level.stride for level in LEVELS]
    shares = (
        (stride, hidden_samples(source, stride, rgb.shape[1] // stride, rgb.shape[2] // stride)) for stride in strides
    )
    return SourcePicture(
        rgb,
        {stride: relative_motion(reference, source, stride) for stride in strides},
        {stride: share for stride, share in shares if share is not None},
    )
