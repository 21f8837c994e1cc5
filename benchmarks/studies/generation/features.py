"""Features of images for Fréchet distances: the last layer of the trunk of ST-LPIPS, averaged over the image.

The distances have names of their own: they are neither FID nor FVD.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

import numpy as np
import torch

from hybridworldsim.generation.autoencoder.codec import to_tensor
from mirror.arrays import Float64, UInt8
from mirror.metrics.features.perceptual import filled
from mirror.metrics.features.st_lpips import split_state, st_lpips_trunk
from mirror.metrics.networks.trunk import Trunk
from mirror.weights.load import load_state_dict
from mirror.weights.resolve import WeightResolver

DIMENSIONS: Final = 256
_BATCH: Final = 64
# The normalisation of LPIPS, for images from -1 to 1.
_SHIFT: Final = (-0.030, -0.088, -0.188)
_SCALE: Final = (0.458, 0.448, 0.450)

Features: TypeAlias = Callable[[UInt8], Float64]
"""From images (N, H, W, 3) to features (N, `DIMENSIONS`)."""


def trunk_features(trunk: Trunk) -> Features:
    """Return the features of a trunk."""
    shift, scale = (torch.tensor(values).reshape(1, 3, 1, 1) for values in (_SHIFT, _SCALE))

    @torch.inference_mode()
    def features(images: UInt8) -> Float64:
        rows = [np.zeros((0, DIMENSIONS))]
        for first in range(0, len(images), _BATCH):
            batch = (2.0 * to_tensor(images[first : first + _BATCH]) - 1.0 - shift) / scale
            rows.append(trunk.features(batch).double().mean(dim=(2, 3)).numpy())
        return np.concatenate(rows)

    return features


def load_features() -> Features:
    """Return the features of the study.

    Raises:
        WeightsUnavailableError: the published weights are not there; the error states how to get them.
    """
    file = WeightResolver().resolve("st-lpips-alex")
    layers, _ = split_state(load_state_dict(file.path))
    return trunk_features(filled(st_lpips_trunk("alex"), layers))
