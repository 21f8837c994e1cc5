"""MVSNet as an estimator of depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

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
from hybridworldsim.mvs.mvsnet.enlargement import enlarged, repeated
from hybridworldsim.mvs.mvsnet.network import FEATURE_STRIDE, PLANES_STRIDE, STRIDE, MVSNet, SourcePicture
from hybridworldsim.mvs.mvsnet.planes import DepthPlanes, Spacing
from mirror.errors import UsageError
from mirror.metrics.networks.state import load_strictly
from mirror.weights.resolve import WeightResolver

NAME: Final = "mvsnet"
BYTES_PER_PIXEL: Final = 150
BYTES_PER_PIXEL_PLANE: Final = 21
BYTES_PER_SOURCE_PIXEL: Final = 24


@dataclass(frozen=True, eq=False, kw_only=True)
class MVSNetEstimator:
    """Depth by MVSNet, on the CPU; its ``repr`` names all that results depend on.

    Attributes:
        network: filled, its normalisations folded.
        sha256: of the checkpoint; None: the network was filled by other means.
        planes: how many planes of depth, a multiple of 8; the published checkpoint was trained with 192.
        spacing: what the planes are even in.
        threads: that torch computes on; results are equal to the bit at an equal number.
        memory_bytes: refuse pictures that need more.

    Raises:
        UsageError: a number of planes that the network cannot halve three times.
    """

    network: MVSNet = field(repr=False)
    sha256: str | None = None
    planes: int = 192
    spacing: Spacing = "inverse_depth"
    threads: int = 1
    memory_bytes: int = field(default=2 << 30, repr=False)

    def __post_init__(self) -> None:
        if self.planes < PLANES_STRIDE or self.planes % PLANES_STRIDE:
            raise UsageError(f"{self.planes} planes of depth", expected=f"a multiple of {PLANES_STRIDE}")

    @classmethod
    def load(
        cls,
        resolver: WeightResolver | None = None,
        *,
        planes: int = 192,
        spacing: Spacing = "inverse_depth",
        threads: int = 1,
        memory_bytes: int = 2 << 30,
    ) -> MVSNetEstimator:
        """The estimator with a public checkpoint, with refinement if the checkpoint has it.

        Raises:
            WeightsUnavailableError: it is not there, or is of another network.
            UsageError: a number of planes that the network cannot halve three times.
        """
        state, sha256 = public_state_dict(NAME, resolver or WeightResolver())
        network = MVSNet(refine=any(key.startswith("refine_network.") for key in state))
        load_strictly(network, state)
        fold_norms(network)
        return cls(
            network=network, sha256=sha256, planes=planes, spacing=spacing, threads=threads, memory_bytes=memory_bytes
        )

    def __call__(
        self, reference: PosedPicture, sources: Sequence[PosedPicture], near_m: float, far_m: float
    ) -> DepthMap:
        """The depth of a picture; confidence is the probability of the four planes about the expected one.

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
        per_pixel = BYTES_PER_PIXEL + BYTES_PER_PIXEL_PLANE * self.planes
        needed = per_pixel * width * height + BYTES_PER_SOURCE_PIXEL * sum(source.valid.size for source in used)
        require_memory(needed, self.memory_bytes, width, height, f"MVSNet with {self.planes} planes")
        with inference(self.threads):
            depth_m, confidence = self.network(
                network_input(reference, STRIDE),
                [_source(reference, source) for source in used],
                DepthPlanes(near_m, far_m, self.planes, self.spacing),
            )
            return known_depth(reference, used, enlarged(depth_m, FEATURE_STRIDE), repeated(confidence, FEATURE_STRIDE))


def _source(reference: PosedPicture, source: PosedPicture) -> SourcePicture:
    rgb = network_input(source, FEATURE_STRIDE)
    rows, columns = (side // FEATURE_STRIDE for side in rgb.shape[1:])
    hidden = hidden_samples(source, FEATURE_STRIDE, rows, columns)
    return SourcePicture(rgb, relative_motion(reference, source, FEATURE_STRIDE), hidden)
