"""Training steps of the tiny autoencoder: the square error of reconstructed images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from hybridworldsim.generation.autoencoder.codec import to_tensor
from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder, TinySettings
from hybridworldsim.training.run.state import dump, load
from mirror.arrays import Int64, UInt8

_CLIP = 1.0


@dataclass(frozen=True)
class AutoencoderSettings:
    """Settings of an autoencoder's training.

    Attributes:
        model: its size.
        batch: images of a step.
        learning_rate: highest rate; it falls in proportion to the remaining steps.
        warmup: steps in which the rate rises.
    """

    model: TinySettings = field(default_factory=TinySettings)
    batch: int = 8
    learning_rate: float = 2e-3
    warmup: int = 50

    @property
    def document(self) -> dict[str, Any]:
        """All settings as JSON values."""
        return asdict(self)


class ImageRows(Protocol):
    """A sequence of N images (H, W, 3): an array, or images that are read on access."""

    def __len__(self) -> int: ...

    def __getitem__(self, rows: Int64 | slice, /) -> UInt8: ...


class AutoencoderTrainer:
    """An autoencoder in training. A step depends on its number, the seed and the state only.

    Args:
        settings: see `AutoencoderSettings`.
        images: (N, H, W, 3).
        steps: number of steps of the whole training.
        seed: seed of the parameters and of the order of images.

    Attributes:
        model: the autoencoder; its latents are not normalised before `finish`.
    """

    def __init__(self, settings: AutoencoderSettings, images: ImageRows, steps: int, *, seed: int = 0) -> None:
        torch.manual_seed(seed)
        self._settings, self._images, self._steps, self._seed = settings, images, steps, seed
        self.model = TinyAutoencoder(settings.model)
        self._optimizer = torch.optim.AdamW(self.model.parameters(), lr=settings.learning_rate, betas=(0.9, 0.99))

    def step(self, number: int) -> dict[str, float]:
        """Do a step; returns the losses by name."""
        settings = self._settings
        rate = min((number + 1) / max(settings.warmup, 1), 1.0) * (1.0 - number / self._steps)
        for group in self._optimizer.param_groups:
            group["lr"] = settings.learning_rate * rate
        rows = np.random.default_rng([self._seed, number]).integers(0, len(self._images), settings.batch)
        images = to_tensor(self._images[rows])
        loss = (self.model.decode(self.model.encode(images)) - images).square().mean()
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.model.parameters(), _CLIP)
        self._optimizer.step()
        return {"square": float(loss.detach())}

    @torch.no_grad()
    def finish(self, count: int = 512) -> TinyAutoencoder:
        """Normalise the latents by evenly chosen images, and return the autoencoder."""
        chosen = self._images[:: max(1, len(self._images) // count)]
        parts = [self.model.encode(to_tensor(chosen[first : first + 32])) for first in range(0, len(chosen), 32)]
        self.model.set_statistics(torch.cat(parts))
        return self.model

    def state(self) -> dict[str, Tensor]:
        """Return everything that a run needs to continue, by name."""
        return dump(self.model, self._optimizer)

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue from the result of `state`.

        Raises:
            DatasetError: a parameter is missing.
        """
        with torch.no_grad():
            load(self.model, state, self._optimizer)


@torch.no_grad()
def reconstruction_psnr_db(model: TinyAutoencoder, images: UInt8) -> float:
    """Return the mean PSNR of reconstructed images (N, H, W, 3), in dB: an upper bound for generated images."""
    errors = []
    for first in range(0, len(images), 32):
        batch = to_tensor(images[first : first + 32])
        decoded = model.decode(model.encode(batch)).clamp(0.0, 1.0)
        errors.append((decoded - batch).square().mean(dim=(1, 2, 3)))
    return float((-10.0 * torch.cat(errors).clamp(min=1e-10).log10()).mean())
