"""Autoencoders of diffusers (extra ``generation``): AutoencoderKL and AutoencoderTiny from local folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from hybridworldsim.generation.network.checkpoints import read_weights
from mirror.errors import UsageError
from mirror.installation import install_command
from mirror.schema.strict_json import decode_json
from mirror.weights.errors import WeightsUnavailableError

CONFIG: Final = "config.json"
WEIGHTS: Final = "diffusion_pytorch_model.safetensors"
_CLASSES: Final = ("AutoencoderKL", "AutoencoderTiny")


class DiffusersAutoencoder:
    """An autoencoder of diffusers as a `LatentCodec`.

    Args:
        model: the autoencoder.
    """

    def __init__(self, model: Any) -> None:
        self._model = model.eval().requires_grad_(False)
        config = model.config
        self._kl = type(model).__name__ == "AutoencoderKL"
        self.channels = int(config.latent_channels)
        blocks = config.block_out_channels if self._kl else config.encoder_block_out_channels
        self.stride = 2 ** (len(blocks) - 1)
        self._shift = float(config.get("shift_factor") or 0.0) if self._kl else 0.0
        self._scale = float(config.scaling_factor) if self._kl else 1.0

    def to(self, device: torch.device | str) -> DiffusersAutoencoder:
        """Move the autoencoder to a device and return the autoencoder."""
        self._model.to(device)
        return self

    def encode(self, images: Tensor) -> Tensor:
        """Map images (N, 3, height, width) from 0 to 1 to latents: the mean of the posterior, shifted and scaled."""
        encoded = self._model.encode(2.0 * images - 1.0)
        if not self._kl:
            return encoded.latents
        return (encoded.latent_dist.mean - self._shift) * self._scale

    def decode(self, latents: Tensor) -> Tensor:
        """Map latents to images (N, 3, height, width).

        Raises:
            UsageError: the latents have another number of channels.
        """
        if latents.shape[-3] != self.channels:
            raise UsageError(f"latents of {latents.shape[-3]} channels", expected=f"{self.channels} channels")
        return 0.5 * self._model.decode(latents / self._scale + self._shift).sample + 0.5


def load_autoencoder(folder: Path) -> DiffusersAutoencoder:
    """Load the ``vae`` folder of a released pipeline, strictly by key.

    Args:
        folder: holds ``config.json`` and ``diffusion_pytorch_model.safetensors``.

    Raises:
        UsageError: diffusers is not installed.
        WeightsUnavailableError: a file is missing, of another class, or its tensors do not fit.
    """
    try:
        import diffusers
    except ImportError as error:
        raise UsageError(
            "autoencoders of released models need diffusers", remedy=install_command("generation")
        ) from error
    try:
        config = decode_json((folder / CONFIG).read_text())
    except (OSError, ValueError) as error:
        raise WeightsUnavailableError(
            f"cannot be read ({error})", file=folder / CONFIG, expected="the folder of an autoencoder"
        ) from error
    name = config.get("_class_name")
    if name not in _CLASSES:
        raise WeightsUnavailableError(f"an autoencoder {name!r}", file=folder / CONFIG, expected=" or ".join(_CLASSES))
    model = getattr(diffusers, name).from_config(config)
    state = read_weights(folder / WEIGHTS)
    try:
        model.load_state_dict(state, strict=True)
    except RuntimeError as error:
        problem = " ".join(str(error).split())
        raise WeightsUnavailableError(
            problem[:300], file=folder / WEIGHTS, expected=f"the tensors of {name}"
        ) from error
    return DiffusersAutoencoder(model)
