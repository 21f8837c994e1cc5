"""The judges of the study: a segmenter of road users, and a classifier of their crops, checked on true images."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import binary_cross_entropy_with_logits, conv2d, cross_entropy, pad, silu

from benchmarks.studies.generation.judge_data import LEAST_PX
from hybridworldsim.generation.autoencoder.codec import to_tensor
from hybridworldsim.generation.clips.clip import CATEGORIES
from hybridworldsim.training.run.state import dump, load
from mirror.arrays import Bool, Float64, Int64, UInt8

_BATCH: Final = 64


class Segmenter(nn.Module):
    """A small U-Net that finds the pixels of an image that its background does not show."""

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.enter = nn.Conv2d(24, width, 3, padding=1)
        self.down = nn.Conv2d(width, 2 * width, 4, stride=2, padding=1)
        self.middle = nn.Sequential(
            nn.SiLU(), nn.Conv2d(2 * width, 2 * width, 3, padding=1), nn.SiLU(),
            nn.Conv2d(2 * width, 2 * width, 3, padding=2, dilation=2), nn.SiLU(),
        )  # fmt: skip
        self.up = nn.Sequential(nn.Conv2d(2 * width, 4 * width, 1), nn.PixelShuffle(2))
        self.leave = nn.Sequential(
            nn.Conv2d(2 * width, width, 3, padding=1), nn.SiLU(), nn.Conv2d(width, 4, 3, padding=1), nn.PixelShuffle(2)
        )

    def forward(self, images: Tensor, backgrounds: Tensor) -> Tensor:
        """Map images and backgrounds (N, 3, H, W) from 0 to 1 to logits (N, H, W)."""
        x = nn.functional.pixel_unshuffle(torch.cat([4.0 * (images - backgrounds), backgrounds - 0.5], dim=1), 2)
        x = silu(self.enter(x))
        return self.leave(torch.cat([x, self.up(self.middle(self.down(x)))], dim=1))[:, 0]


class Classifier(nn.Module):
    """The class of a road user in a crop."""

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        channels = [3, width, 2 * width, 3 * width]
        self.layers = nn.Sequential(
            *(
                layer
                for before, after in itertools.pairwise(channels)
                for layer in (nn.Conv2d(before, after, 4, stride=2, padding=1), nn.GroupNorm(8, after), nn.SiLU())
            )
        )
        self.head = nn.Linear(channels[-1], len(CATEGORIES))

    def forward(self, crops: Tensor) -> Tensor:
        """Return the crops (N, 3, H, W) from 0 to 1 to logits (N, classes)."""
        return self.head(self.layers(crops - 0.5).mean(dim=(2, 3)))


class JudgeTrainer:
    """A judge in training; a `hybridworldsim.generation.training.numbered.NumberedTrainer`.

    Args:
        network: the judge.
        loss: from the number generator of a step to the loss.
        steps: number of steps.
        seed: seed of the batches.
    """

    def __init__(
        self, network: nn.Module, loss: Callable[[np.random.Generator], Tensor], steps: int, seed: int = 0
    ) -> None:
        self.network, self._loss, self._steps, self._seed = network, loss, steps, seed
        self._optimizer = torch.optim.AdamW(network.parameters(), lr=2e-3, weight_decay=0.02)

    def step(self, number: int) -> dict[str, float]:
        """Do a step."""
        for group in self._optimizer.param_groups:
            group["lr"] = 2e-3 * min((number + 1) / 50.0, 1.0) * (1.0 - number / self._steps)
        loss = self._loss(np.random.default_rng([self._seed, number]))
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self._optimizer.step()
        return {"loss": float(loss.detach())}

    def state(self) -> dict[str, Tensor]:
        """Return everything that is needed to continue."""
        return dump(self.network, self._optimizer)

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue from the result of `state`."""
        with torch.no_grad():
            load(self.network, state, self._optimizer)


def segmenter_loss(
    network: nn.Module, images: UInt8, backgrounds: UInt8, masks: Bool, batch: int = 16
) -> Callable[[np.random.Generator], Tensor]:
    """Return the loss of a step.

    Images are blurred and noisy, as generated ones are, so that such traces are no clue.
    """

    def loss(rng: np.random.Generator) -> Tensor:
        rows = rng.integers(0, len(images), batch)
        given = to_tensor(images[rows])
        blurred = blur(given, float(rng.uniform(0.3, 1.2)))
        share = torch.from_numpy(rng.integers(0, 2, (batch, 1, 1, 1))).float()
        given = share * blurred + (1.0 - share) * given
        deviation = rng.uniform(0.0, 0.04, (batch, 1, 1, 1))
        given = given + torch.from_numpy(rng.normal(size=given.shape) * deviation).float()
        logits, true = network(given, to_tensor(backgrounds[rows])), torch.from_numpy(masks[rows]).float()
        share = logits.sigmoid()
        both, either = (share * true).sum(), (share + true - share * true).sum()
        # Road users cover few pixels: entropy alone begins with empty masks.
        return binary_cross_entropy_with_logits(logits, true) + 1.0 - both / either.clamp(min=1.0)

    return loss


def classifier_loss(
    network: nn.Module, crops: UInt8, classes: Int64, batch: int = 48
) -> Callable[[np.random.Generator], Tensor]:
    """Return the loss of a step.

    Classes are drawn equally often, as far as there are crops; crops are mirrored and noisy.
    """
    weight = 1.0 / np.sqrt(np.bincount(classes, minlength=len(CATEGORIES)).clip(1))[classes]
    weight /= weight.sum()

    def loss(rng: np.random.Generator) -> Tensor:
        rows = rng.choice(len(crops), batch, p=weight)
        given = to_tensor(crops[rows])
        flipped = torch.from_numpy(rng.integers(0, 2, batch)).bool()[:, None, None, None]
        given = torch.where(flipped, given.flip(-1), given)
        given = blur(given, float(rng.uniform(0.1, 0.8)))
        gain = torch.from_numpy(rng.uniform(0.85, 1.15, (batch, 1, 1, 1))).float()
        given = gain * given + 0.03 * torch.from_numpy(rng.normal(size=given.shape)).float()
        return cross_entropy(network(given), torch.from_numpy(classes[rows]))

    return loss


def blur(images: Tensor, deviation_px: float) -> Tensor:
    """Return a Gaussian blur of images (N, 3, H, W)."""
    reach = 3
    line = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / deviation_px) ** 2)
    line = line / line.sum()
    kernel = line.expand(3, 1, 1, -1)
    padded = pad(images, (reach,) * 4, mode="replicate")
    return conv2d(conv2d(padded, kernel, groups=3), kernel.transpose(2, 3), groups=3)


@torch.no_grad()
def segment(network: nn.Module, images: UInt8, backgrounds: UInt8) -> Bool:
    """Return the masks (N, H, W) of images (N, H, W, 3)."""
    masks = [
        network(to_tensor(images[first : first + _BATCH]), to_tensor(backgrounds[first : first + _BATCH])).numpy() > 0.0
        for first in range(0, len(images), _BATCH)
    ]
    return np.concatenate(masks)


@torch.no_grad()
def classify(network: nn.Module, crops: UInt8) -> Int64:
    """Return the classes (N,) of crops (N, H, W, 3)."""
    found = [network(to_tensor(crops[first : first + _BATCH])).argmax(dim=1) for first in range(0, len(crops), _BATCH)]
    return np.asarray(torch.cat(found).numpy())


def mask_ious(found: Bool, true: Bool) -> Float64:
    """Return the intersection over union of each mask whose truth has at least `LEAST_PX` pixels."""
    judged = true.sum(axis=(1, 2)) >= LEAST_PX
    both, either = (found & true)[judged].sum(axis=(1, 2)), (found | true)[judged].sum(axis=(1, 2))
    return np.asarray(both / either)


def balanced_accuracy(found: Int64, true: Int64) -> float:
    """Return the mean over the classes of the share of their members that are found."""
    return float(np.mean([(found[true == one] == one).mean() for one in np.unique(true)]))
