"""Pictures as networks take them, and depth maps as estimators give them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.mvs.estimator import DepthMap, PosedPicture
from hybridworldsim.mvs.learned.warping import baseline_m, relative_motion, sample, source_positions
from mirror.errors import UsageError

_LEAST_BASELINE = 1e-6


def network_input(picture: PosedPicture, stride: int) -> Tensor:
    """(3, H, W) RGB from 0 to 1; sides grow to multiples of the stride by repeating the last row and column."""
    rgb = torch.from_numpy(np.ascontiguousarray(picture.rgb)).permute(2, 0, 1).float().div_(255.0)
    height, width = picture.rgb.shape[:2]
    below, right = -height % stride, -width % stride
    return functional.pad(rgb[None], (0, right, 0, below), "replicate")[0] if below or right else rgb


def hidden_samples(picture: PosedPicture, stride: int, rows: int, columns: int) -> Tensor | None:
    """(rows, columns) 1 where any of a sample's pixels is not valid, else 0; None: all are valid."""
    if picture.valid.all():
        return None
    hidden = torch.from_numpy(~picture.valid).float()
    height, width = hidden.shape
    padded = functional.pad(hidden[None, None], (0, columns * stride - width, 0, rows * stride - height))
    return functional.max_pool2d(padded, stride)[0, 0]


def useful_sources(reference: PosedPicture, sources: Sequence[PosedPicture], near_m: float) -> list[PosedPicture]:
    """Sources that can tell depths apart: those that were not taken from where the reference was, and show anything."""
    least = _LEAST_BASELINE * near_m
    return [source for source in sources if source.valid.any() and baseline_m(reference, source) > least]


def require_range(near_m: float, far_m: float) -> None:
    """Refuse what is no range of depths.

    Raises:
        UsageError: not 0 < near < far, or not finite.
    """
    if not (0.0 < near_m < far_m < float("inf")):
        raise UsageError(f"depths from {near_m!r} to {far_m!r} m", expected="0 < near_m < far_m, finite")


def require_memory(needed: int, limit: int, width: int, height: int, what: str) -> None:
    """Refuse pictures that need more memory than is allowed.

    Raises:
        UsageError: they do; it names both figures.
    """
    if needed > limit:
        raise UsageError(
            f"{what} of a picture of {width} x {height} px needs {needed / 2**20:.0f} MiB",
            expected=f"at most memory_bytes, {limit / 2**20:.0f} MiB",
            remedy="scale the pictures down, give fewer sources, or allow more memory_bytes",
        )


def unknown(reference: PosedPicture) -> DepthMap:
    """The depth map of which nothing is known."""
    shape = reference.valid.shape
    return DepthMap(np.full(shape, np.nan, np.float32), np.zeros(shape, np.float32))


def known_depth(
    reference: PosedPicture, sources: Sequence[PosedPicture], depth_m: Tensor, confidence: Tensor
) -> DepthMap:
    """A depth map without what no source can have told: pixels that are masked, or that no source sees at their depth.

    Args:
        reference: the picture.
        sources: those that were used.
        depth_m: (H, W) or larger, of a padded picture.
        confidence: likewise.
    """
    height, width = reference.valid.shape
    depth_m, confidence = depth_m[:height, :width], confidence[:height, :width]
    seen = torch.zeros((height, width), dtype=torch.bool)
    for source in sources:
        rows, columns = source.valid.shape
        positions = source_positions(relative_motion(reference, source, 1), depth_m[None], columns, rows)
        seen |= sample(torch.from_numpy(source.valid).float()[None], positions)[0, 0] > 0.5
    told = torch.from_numpy(reference.valid) & seen & torch.isfinite(depth_m) & (depth_m > 0.0)
    return DepthMap(
        torch.where(told, depth_m, torch.nan).numpy(), torch.where(told, confidence, 0.0).clamp_(0.0, 1.0).numpy()
    )


@contextmanager
def inference(threads: int) -> Iterator[None]:
    """Without gradients, on a stated number of threads: torch's sums depend on it."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(before)
