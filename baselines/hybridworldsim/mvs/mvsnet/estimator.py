"""MVSNet as a depth estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from torch import Tensor

from hybridworldsim.mvs.estimator import DepthMap, StereoImage
from hybridworldsim.mvs.learned.checkpoint import load_public_state_dict
from hybridworldsim.mvs.learned.estimation import InputFormat, MemoryLimit, estimate_depth
from hybridworldsim.mvs.learned.images import SourceImage
from hybridworldsim.mvs.learned.layers import fold_norms
from hybridworldsim.mvs.mvsnet.network import FEATURE_STRIDE, PLANES_STRIDE, STRIDE, MVSNet
from hybridworldsim.mvs.mvsnet.planes import DepthPlanes, Spacing
from hybridworldsim.mvs.mvsnet.upsampling import repeat_samples, upsample_depth
from mirror.devices import CPU
from mirror.errors import UsageError
from mirror.metrics.networks.state import load_strictly
from mirror.weights.resolve import WeightResolver

NAME: Final = "mvsnet"
BYTES_PER_PIXEL: Final = 150
BYTES_PER_PIXEL_PLANE: Final = 21
BYTES_PER_SOURCE_PIXEL: Final = 24
_INPUTS: Final = InputFormat(reference_stride=STRIDE, feature_strides=(FEATURE_STRIDE,))


@dataclass(frozen=True, eq=False, kw_only=True)
class MVSNetEstimator:
    """Depth by MVSNet, on any device; its ``repr`` names everything that results depend on.

    Attributes:
        network: the network with its weights and folded normalisations.
        sha256: hash of the checkpoint; None if the weights come from elsewhere.
        planes: number of depth planes, a multiple of 8; the published checkpoint was trained with 192.
        spacing: the quantity in which the planes are evenly spaced.
        threads: torch's number of threads; the same number gives the same bits.
        memory_bytes: images that need more memory are refused.
        device: where the network is, as torch names it; results of a GPU differ in the last digits.

    Raises:
        UsageError: the number of planes is not a multiple of 8.
    """

    network: MVSNet = field(repr=False)
    sha256: str | None = None
    planes: int = 192
    spacing: Spacing = "inverse_depth"
    threads: int = 1
    memory_bytes: int = field(default=2 << 30, repr=False)
    device: str = field(default=CPU, repr=False)

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
        device: str = CPU,
    ) -> MVSNetEstimator:
        """Load a public checkpoint, with the refinement network if the checkpoint has one.

        Raises:
            WeightsUnavailableError: the checkpoint is missing, or belongs to another network.
            UsageError: the number of planes is not a multiple of 8.
        """
        state, sha256 = load_public_state_dict(NAME, resolver or WeightResolver())
        network = MVSNet(refine=any(key.startswith("refine_network.") for key in state))
        load_strictly(network, state)
        fold_norms(network)
        network.to(device)
        return cls(
            network=network,
            sha256=sha256,
            planes=planes,
            spacing=spacing,
            threads=threads,
            memory_bytes=memory_bytes,
            device=device,
        )

    def __call__(self, reference: StereoImage, sources: Sequence[StereoImage], near_m: float, far_m: float) -> DepthMap:
        """Estimate the depth of an image; see `estimate_depth`.

        The confidence is the probability of the four planes around the expected one.

        Raises:
            UsageError: not 0 < near_m < far_m, or images that need too much memory.
        """
        planes = DepthPlanes(near_m, far_m, self.planes, self.spacing)

        def run_network(rgb: Tensor, source_images: Sequence[SourceImage]) -> tuple[Tensor, Tensor]:
            depth_m, confidence = self.network(rgb, source_images, planes)
            return upsample_depth(depth_m, FEATURE_STRIDE), repeat_samples(confidence, FEATURE_STRIDE)

        memory = MemoryLimit(
            name=f"MVSNet with {self.planes} planes",
            bytes_per_pixel=BYTES_PER_PIXEL + BYTES_PER_PIXEL_PLANE * self.planes,
            bytes_per_source_pixel=BYTES_PER_SOURCE_PIXEL,
            limit_bytes=self.memory_bytes,
        )
        return estimate_depth(
            reference, sources, near_m, far_m, inputs=_INPUTS, memory=memory, threads=self.threads,
            run_network=run_network, device=self.device,
        )  # fmt: skip
