"""From images or clips to features: prepared one by one, run in batches, never twice for the same pixels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mirror.arrays import Float32, UInt8
from mirror.devices import CPU, hardware_name
from mirror.errors import UsageError
from mirror.metrics.features.cache import FeatureCache, feature_key
from mirror.metrics.inputs import Pixels, as_array

if TYPE_CHECKING:
    from torch import Tensor


class Extractor(Protocol):
    """A network that turns pixels into features.

    Attributes:
        name: what figures of these features are called.
        identity: weights and mode, as one line.
        batch: how many are run at once.
        computed: how many went through the network.
    """

    name: str
    identity: str
    batch: int
    computed: int

    def prepare(self, pixels: UInt8) -> Tensor:
        """Return one image or clip as the network takes it, without the batch axis."""

    def run(self, prepared: Tensor) -> Float32:
        """Return the features (n, d) of a batch."""


def extract(extractor: Extractor, items: Iterable[Pixels], cache: FeatureCache | None = None) -> Float32:
    """Return the features of images or clips, in their order.

    Args:
        extractor: the network.
        items: uint8, or floats from 0 to 1, which are rounded to bytes; taken one by one.
        cache: features known before are taken from it and new ones put there.

    Returns:
        (n, d).

    Raises:
        UsageError: there are none, or one is not what the network takes.
    """
    import torch

    features: list[Float32 | None] = []
    waiting: list[tuple[int, str, Tensor]] = []

    def run() -> None:
        found = extractor.run(torch.stack([prepared for _, _, prepared in waiting]))
        extractor.computed += len(waiting)
        for (at, key, _), feature in zip(waiting, found):
            features[at] = feature
            if cache is not None:
                cache.put(key, feature)
        waiting.clear()

    for at, item in enumerate(items):
        pixels = to_bytes(item)
        key = feature_key(pixels, extractor.identity) if cache is not None else ""
        features.append(cache.get(key) if cache is not None else None)
        if features[at] is None:
            waiting.append((at, key, extractor.prepare(pixels)))
        if len(waiting) == extractor.batch:
            run()
    if waiting:
        run()
    if not features:
        raise UsageError("there are no images to take features of")
    return np.stack([feature for feature in features if feature is not None])


def identity_of_device(device: str) -> str:
    """Return the suffix that a device adds to an extractor's identity: empty for the CPU, the reference."""
    return "" if device == CPU else f" on {hardware_name(device)}"


def to_bytes(pixels: Pixels) -> UInt8:
    """Return the pixels as uint8.

    Floats from 0 to 1 are rounded, not truncated: that would take half a grey level off all.

    Raises:
        UsageError: another type, not finite, or outside of 0 to 1.
    """
    pixels = as_array(pixels, "pixels")
    if pixels.dtype == np.uint8:
        return pixels
    if pixels.dtype.kind != "f":
        raise UsageError(f"pixels of type {pixels.dtype}", expected="uint8, or floats from 0 to 1")
    if not np.isfinite(pixels).all():
        raise UsageError("pixels are NaN or infinite")
    if pixels.size and (pixels.min() < 0.0 or pixels.max() > 1.0):
        raise UsageError(f"float pixels from {pixels.min():.4g} to {pixels.max():.4g}", expected="0 to 1")
    return np.rint(pixels * 255.0).astype(np.uint8)


def checked_name(name: str, reserved: Sequence[str], *, pinned: bool) -> str:
    """Return the name of a network; refuse a published metric's name unless the weights are the published ones.

    Raises:
        UsageError: a published name with other weights.
    """
    if name.startswith(tuple(reserved)) and not pinned:
        raise UsageError(f"a network called {name!r} without its published weights", remedy="give it a name of its own")
    return name
