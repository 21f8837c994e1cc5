"""The steps that all learned depth estimators have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from torch import Tensor

from hybridworldsim.mvs.estimator import DepthMap, StereoImage, make_unknown_depth, require_depth_range
from hybridworldsim.mvs.learned.images import (
    SourceImage,
    drop_unseen_depth,
    make_source_image,
    select_useful_sources,
    to_network_input,
    torch_inference,
)
from mirror.devices import CPU
from mirror.errors import UsageError

RunNetwork = Callable[[Tensor, Sequence[SourceImage]], tuple[Tensor, Tensor]]
"""From the reference (3, H, W) and its sources to depth (H, W), metres, and confidence (H, W)."""


@dataclass(frozen=True)
class InputFormat:
    """The sizes of a network's inputs.

    Attributes:
        reference_stride: the sides of the reference are padded to multiples of this.
        feature_strides: strides of the features; the sides of sources are padded to multiples of the largest.
    """

    reference_stride: int
    feature_strides: tuple[int, ...]


@dataclass(frozen=True)
class MemoryLimit:
    """The memory that an estimate needs at most, and the memory that is allowed.

    Attributes:
        name: of the network, for the message.
        bytes_per_pixel: of the reference.
        bytes_per_source_pixel: of the sources.
        limit_bytes: allowed.
    """

    name: str
    bytes_per_pixel: int
    bytes_per_source_pixel: int
    limit_bytes: int

    def check(self, reference: StereoImage, sources: Sequence[StereoImage]) -> None:
        """Check that images fit.

        Raises:
            UsageError: they need more memory than is allowed; the message has both figures.
        """
        height, width = reference.valid.shape
        source_pixels = sum(source.valid.size for source in sources)
        needed = self.bytes_per_pixel * width * height + self.bytes_per_source_pixel * source_pixels
        if needed > self.limit_bytes:
            raise UsageError(
                f"{self.name} of an image of {width} x {height} px needs {needed / 2**20:.0f} MiB",
                expected=f"at most memory_bytes, {self.limit_bytes / 2**20:.0f} MiB",
                remedy="scale the images down, give fewer sources, or allow more memory_bytes",
            )


def estimate_depth(
    reference: StereoImage,
    sources: Sequence[StereoImage],
    near_m: float,
    far_m: float,
    *,
    inputs: InputFormat,
    memory: MemoryLimit,
    threads: int,
    run_network: RunNetwork,
    device: str = CPU,
) -> DepthMap:
    """Estimate the depth of an image with a network.

    Sources at the position of the reference carry no information and are left out. Pixels that no source sees at their
    depth are unknown.

    Args:
        reference: the image.
        sources: its neighbours.
        near_m: smallest depth searched.
        far_m: largest depth searched.
        inputs: sizes of the network's inputs.
        memory: limit that is checked first.
        threads: torch's number of threads.
        run_network: runs the network on the prepared images.
        device: where the network is.

    Raises:
        UsageError: not 0 < near_m < far_m, or images that need too much memory.
    """
    require_depth_range(near_m, far_m)
    used = select_useful_sources(reference, sources, near_m)
    if not used or not reference.valid.any():
        return make_unknown_depth(reference)
    memory.check(reference, used)
    with torch_inference(threads):
        source_images = [make_source_image(reference, source, inputs.feature_strides, device) for source in used]
        depth_m, confidence = run_network(
            to_network_input(reference, inputs.reference_stride).to(device), source_images
        )
        return drop_unseen_depth(reference, used, depth_m, confidence)
