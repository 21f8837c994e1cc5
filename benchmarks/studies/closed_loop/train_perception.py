"""Training of the policies' perception: one network for each, from the same images and the same steps."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import torch
from safetensors.torch import load, save
from torch.nn.functional import avg_pool2d, smooth_l1_loss

from benchmarks.studies.closed_loop.perception_images import PerceptionImages
from benchmarks.studies.closed_loop.percepts import PerceptionNet, perceive, scale, to_tensor
from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.schema.files import write_bytes

Augmentation = Literal["none", "colour", "strong"]
_LEAD_SHARE: Final = 0.95
_BLUR_SHARE: Final = 0.3
_BATCH: Final = 100


@dataclass(frozen=True)
class Training:
    """The training of one policy's perception; `experiment.toml` explains the values."""

    images: int | None = None
    lights: tuple[str, ...] | None = None
    augmentation: Augmentation = "colour"
    offset_m: float = math.inf
    yaw_deg: float = math.inf
    label_noise: float = 0.0
    leads: float = 1.0
    streets: int | None = None
    share: float = 1.0

    @classmethod
    def declared(cls, values: Mapping[str, Any]) -> Training:
        """Return the training that a table of the declaration describes.

        Raises:
            UsageError: a key is unknown.
        """
        unknown = sorted(set(values) - set(cls.__dataclass_fields__))
        if unknown:
            raise UsageError(f"unknown {', '.join(unknown)}", place="policies", expected="; ".join(vars(cls())))
        lights = values.get("lights")
        return cls(**{**values, "lights": None if lights is None else tuple(lights)})


def select(training: Training, data: PerceptionImages, sight_m: float, rng: np.random.Generator) -> Int64:
    """Return the rows of the images that a policy is trained on, in the order in which they are drawn."""
    kept: Bool = np.abs(data.percepts[:, 0]) <= training.offset_m
    kept &= np.abs(data.turn_rad) <= math.radians(min(training.yaw_deg, 360.0))
    if training.lights is not None:
        kept &= np.isin(data.light, training.lights)
    if training.streets is not None:
        kept &= data.street < training.streets
    leads = data.percepts[:, 2] < _LEAD_SHARE * sight_m
    kept &= ~leads | (rng.uniform(size=len(data)) < training.leads)
    rows = rng.permutation(np.flatnonzero(kept))
    if not len(rows):
        raise UsageError("no image is left to train on", place="policies", expected="fewer conditions")
    return rows if training.images is None else rows[: training.images]


def train_network(
    training: Training, data: PerceptionImages, settings: Mapping[str, Any], sight_m: float, seed: int
) -> PerceptionNet:
    """Train the network of a policy; the same call gives the same network on the same processor."""
    rng = np.random.default_rng([seed, 1])
    rows = select(training, data, sight_m, rng)
    labels = scale(data.percepts[rows], sight_m) + training.label_noise * rng.normal(size=(len(rows), 3))
    targets = torch.from_numpy(labels.astype(np.float32))
    torch.manual_seed(seed)
    network = PerceptionNet()
    steps, batch = max(round(settings["steps"] * training.share), 1), int(settings["batch"])
    optimizer = torch.optim.AdamW(network.parameters(), float(settings["learning_rate"]), weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, float(settings["learning_rate"]), total_steps=steps + 1)
    for _ in range(steps):
        drawn = rng.integers(len(rows), size=batch)
        images = augment(to_tensor(data.images[rows[drawn]]), training.augmentation, rng)
        loss = smooth_l1_loss(network(images), targets[drawn], beta=0.3)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return network.eval()


def augment(images: torch.Tensor, kind: Augmentation, rng: np.random.Generator) -> torch.Tensor:
    """Change images (N, 3, H, W) between 0 and 1: exposure, contrast and colour; if strong, noise and blur too."""
    if kind == "none":
        return images
    count = len(images)

    def draw(low: float, high: float, channels: int = 1) -> torch.Tensor:
        return torch.from_numpy(rng.uniform(low, high, (count, channels, 1, 1)).astype(np.float32))

    changed = images.clamp_min(1e-4) ** draw(0.7, 1.4)
    changed = (changed - 0.5) * draw(0.75, 1.25) + 0.5 + draw(-0.1, 0.1)
    changed = changed * draw(0.9, 1.1, 3)
    if kind == "strong":
        height, width = images.shape[2:]
        blurred = avg_pool2d(changed, 3, 1, 1, count_include_pad=False)
        changed = torch.where(draw(0.0, 1.0) < _BLUR_SHARE, blurred, changed)
        noise = rng.normal(size=(count, 3, height, width)).astype(np.float32)
        changed = changed + draw(0.0, 0.08) * torch.from_numpy(noise)
    return changed.clamp(0.0, 1.0)


def measure_errors(network: PerceptionNet, data: PerceptionImages, sight_m: float) -> dict[str, float]:
    """Return the mean absolute errors over images; the lead's where there is one."""
    found = np.concatenate(
        [perceive(network, data.images[first : first + _BATCH], sight_m) for first in range(0, len(data), _BATCH)]
    )
    error: Float64 = np.abs(found - data.percepts)
    leads = data.percepts[:, 2] < _LEAD_SHARE * sight_m
    return {
        "offset_m": float(error[:, 0].mean()),
        "heading_deg": float(np.degrees(error[:, 1].mean())),
        "lead_m": float(error[leads, 2].mean()) if leads.any() else math.nan,
    }


def write_network(path: Path, network: PerceptionNet) -> None:
    """Write a network."""
    write_bytes(path, save({name: value.contiguous() for name, value in network.state_dict().items()}))


def read_network(path: Path) -> tuple[PerceptionNet, str]:
    """Read a network, and the first digits of its file's SHA-256."""
    data = path.read_bytes()
    network = PerceptionNet()
    network.load_state_dict(load(data))
    return network.eval(), hashlib.sha256(data).hexdigest()[:12]
